"""The benchmarks, in the order of the table: each is a function from a plan to lines of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from .batches import batches
from .blocks import general, growth, threads, uniform
from .cutting import cutting, distance
from .machine import ceilings
from .measure import Figure, Plan
from .memory import memory, sparse
from .output import output
from .runs import ring_impact, wavy_block
from .startup import startup

Benchmark = Callable[[Plan], Iterator[Figure]]

BENCHMARKS: dict[str, Benchmark] = {
    function.__name__: function
    for function in (
        ceilings,
        uniform,
        threads,
        general,
        growth,
        memory,
        sparse,
        distance,
        cutting,
        startup,
        ring_impact,
        wavy_block,
        output,
        batches,
    )
}
