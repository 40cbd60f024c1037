"""Bytes that an element takes: in the arrays of the loop, and at the peak of preparation."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .blocks import side_of, uniform_block, waves
from .measure import Figure, Plan, duration, python
from .stepping import started

PEAK = """
import sys
from tests.benchmarks.blocks import uniform_block, waves
from tests.benchmarks.memory import own_peak
from tests.benchmarks.stepping import started
side = int(sys.argv[1])
prepared = uniform_block(side)
started(prepared, waves(prepared, side)).take(1)
print(own_peak())
"""

SMALL = """
import sys
from tests.benchmarks.blocks import disc_in_grid
from tests.benchmarks.memory import own_peak
disc_in_grid(int(sys.argv[1]))
print(own_peak())
"""


def own_peak() -> int:
    """Largest resident memory of this process so far, bytes, without what its parent had when it was forked."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # macOS, in bytes


def memory(plan: Plan) -> Iterator[Figure]:
    """Of a uniform block; the peak is that of a process that prepares it and takes a step."""
    side = side_of(1e4, plan)
    prepared = uniform_block(side)
    loop = nbytes(started(prepared, waves(prepared, side)))
    yield Figure("memory of the loop's arrays", None, loop / side**2, "bytes/element", "uniform block, 10k")
    side = side_of(1e6, plan)
    empty, full = (int(python("-c", PEAK, str(cells)).output) for cells in (4, side))
    peak = (full - empty) / side**2
    yield Figure(
        "peak memory of a process", None, peak, "bytes/element", "uniform block, 1M; beyond a tiny one's"
    )


def sparse(plan: Plan) -> Iterator[Figure]:
    """A body in a hundredth of its grid: what preparation takes should be that of the body."""
    cells = str(side_of(16e6, plan))
    done = [python("-c", SMALL, cells) for _ in range(plan.processes)]
    yield duration("prepare a disc in 1 % of 16M cells", [each.seconds for each in done], "whole process")
    peak = max(int(each.output) for each in done) / 2**30
    yield Figure("its peak memory", None, peak, "GiB", "whole process")


def nbytes(value: Any) -> int:
    """Bytes of all arrays in nested tuples."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    return sum(nbytes(item) for item in value) if isinstance(value, tuple) else 0
