"""What a batch adds to each of its cases: cases that take no time of their own."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from phantomnode.pipeline import batch, engine, one_case
from phantomnode.pipeline.one_case import DONE, Order, Outcome

from .measure import Figure, Plan

SWEEP = """
base = "ring_impact"
[axis.speed]
key = "body.ring.initial_velocity.1"
linspace = {{ first = -1.0, last = -100.0, count = {count} }}
"""


def idle(order: Order) -> Outcome:
    """All that a worker does about a case, but for the run."""
    with patch.object(one_case, "_attempt", lambda order, goes_on: (DONE, "", "")):
        return one_case.run_order(order)


def batches(plan: Plan) -> Iterator[Figure]:
    """A sweep of 1,000 idle cases: validation, orders, outcome.json, results.csv; a worker on each core."""
    count, outcomes = plan.sized(1000, 2), engine.outcomes
    with (
        TemporaryDirectory() as folder,
        patch.object(batch, "outcomes", lambda *given: outcomes(*given, idle)),
    ):
        sweep = Path(folder) / "sweep.toml"
        sweep.write_text(SWEEP.format(count=count))
        began = time.perf_counter()
        done = batch.run_batch(sweep, Path(folder) / "out")
        each = (time.perf_counter() - began) / count
    assert done.status == "done"
    yield Figure(
        f"batch, each of {count:,} idle cases", None, 1e3 * each, "ms", "start of the workers included"
    )
