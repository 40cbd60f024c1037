"""How long a user waits for the first sign of life, with cached kernels."""

from __future__ import annotations

from collections.abc import Iterator

from .measure import Figure, Plan, duration, python

FIRST_STEP = """
from phantomnode import load_case, prepare
from phantomnode.pipeline.run import march
case = load_case("ring_impact", ["time.end=1e-6", "output.fields.count=1", "output.history.count=1"])
march(prepare(case), [])
"""


def startup(plan: Plan) -> Iterator[Figure]:
    """Second starts: the first one has written what can be cached."""
    for name, command in (
        ("start-up, --help", ("-m", "phantomnode", "--help")),
        ("start-up, ring_impact to its first step", ("-c", FIRST_STEP)),
    ):
        python(*command)
        yield duration(name, [python(*command).seconds for _ in range(plan.repeats)], "whole process")
