"""Bytes that an element takes: in the arrays of the loop, and at the peak of a process."""

from __future__ import annotations

import resource
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from phantomnode.pipeline.prepare import Prepared
from phantomnode.pipeline.run import run

from .blocks import mapped_block, side_of, uniform_block
from .measure import Figure, Plan, duration, python
from .stepping import started

BLOCKS = {"uniform": uniform_block, "general": mapped_block}
"""All cells equal, in rows; and no two of them alike."""

PEAK = """
import sys
from tests.benchmarks.memory import BLOCKS, own_peak
from tests.benchmarks.stepping import started
prepared = BLOCKS[sys.argv[1]](int(sys.argv[2]))
started(prepared, prepared.velocity).take(1)
print(own_peak())
"""

RUN = """
import sys
from tests.benchmarks.memory import BLOCKS, own_peak, run_with_output
run_with_output(BLOCKS[sys.argv[1]](int(sys.argv[2])))
print(own_peak())
"""

FRAMES, STEPS = 5, 40
"""Frames of fields in a run, and its steps."""

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


def run_with_output(prepared: Prepared) -> None:
    """A run of the same bodies as a user has it: pulled at its outline, with frames, history, and the picture."""
    case = prepared.case
    output = case.output.model_copy(
        update={
            "fields": case.output.fields.model_copy(update={"count": FRAMES}),
            "history": case.output.history.model_copy(update={"count": 2 * FRAMES}),
        }
    )
    time = case.time.model_copy(update={"end": STEPS * prepared.dt})
    velocity = case.body["block"].model_copy(update={"initial_velocity": (10.0, 0.0)})
    short = case.model_copy(update={"output": output, "time": time, "body": {"block": velocity}})
    del prepared
    with tempfile.TemporaryDirectory() as folder:
        run(short, Path(folder) / "run")


def memory(plan: Plan) -> Iterator[Figure]:
    """Of a uniform block and of one without equal cells; peaks are those of processes, beyond a tiny one's."""
    small, large = side_of(1e4, plan), side_of(1e6, plan)
    for name, block in BLOCKS.items():
        prepared = block(small)
        loop = nbytes(started(prepared, prepared.velocity)) / small**2
        yield Figure(f"the loop's arrays, {name}", None, loop, "bytes/element", "10k")
    for what, program in (("prepared and stepped", PEAK), ("a run with output", RUN)):
        for name in BLOCKS:
            empty, full = (int(python("-c", program, name, str(side)).output) for side in (4, large))
            peak = (full - empty) / large**2
            yield Figure(f"peak, {what}, {name}", None, peak, "bytes/element", "1M; whole process")


def sparse(plan: Plan) -> Iterator[Figure]:
    """A body in a hundredth of its grid: what preparation takes should be that of the body."""
    cells = str(side_of(16e6, plan))
    done = [python("-c", SMALL, cells) for _ in range(plan.processes)]
    yield duration("prepare a disc in 1 % of 16M cells", [each.seconds for each in done], "whole process")
    peak = max(int(each.output) for each in done) / 2**30
    yield Figure("its peak memory", None, peak, "GiB", "whole process")


def nbytes(value: Any) -> int:
    """Bytes of all arrays in nested tuples; views of one array count once."""
    return sum({array.ctypes.data: array.nbytes for array in _arrays(value) if array.nbytes}.values())


def _arrays(value: Any) -> Iterator[np.ndarray[Any, Any]]:
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _arrays(item)
