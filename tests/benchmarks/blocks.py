"""Element updates per second on blocks of one material, without contact or cut elements."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.elements import lame_constants
from phantomnode.pipeline.prepare import Prepared, prepare

from .measure import Figure, Plan, Seconds, alternating, medians, rate, repeated
from .stepping import started

Floats = NDArray[np.float64]

MATERIAL = {"E": 10e9, "nu": 0.3, "rho": 7800.0}
WAVE = 20
"""Cells in a wave of the initial velocity: strains are there after some ten steps."""

STRAIN = 0.05
"""Their size: the velocity over that of dilatational waves."""

UPDATES = 60e6
"""Element updates in one timed run, at least 20 steps."""


def uniform_block(side: int, **more: Any) -> Prepared:
    """side x side equal cells on a square of 1 m, which is free."""
    return _prepared(
        {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}},
        {"kind": "cartesian", "counts": [side, side], "aligned": True},
        **more,
    )


def mapped_block(side: int) -> Prepared:
    """side x side cells on a crooked quadrilateral: no two of them are alike."""
    corners = [[0.0, 0.0], [1.2, 0.1], [1.0, 1.1], [-0.1, 0.9]]
    names = "bottom", "right", "top", "left"
    sides = {
        name: {"polyline": {"points": [corners[k], corners[(k + 1) % 4]]}} for k, name in enumerate(names)
    }
    return _prepared({"polygon": {"points": corners}}, {"kind": "mapped", "counts": [side, side], **sides})


def disc_in_grid(side: int) -> Prepared:
    """A disc that fills a hundredth of its grid of side x side cells."""
    disc = {"circle": {"centre": [0.5, 0.5], "radius": math.sqrt(0.01 / math.pi)}}
    grid = {"kind": "cartesian", "counts": [side, side], "aligned": True, "box": [[0.0, 0.0], [1.0, 1.0]]}
    return _prepared(disc, grid)


def _prepared(geometry: dict[str, Any], grid: dict[str, Any], **more: Any) -> Prepared:
    body = {"geometry": geometry, "grid": grid, "material": "soft"}
    table = {"time": {"end": 1.0}, "material": {"soft": MATERIAL}, "body": {"block": body}}
    return prepare(case_from_table(table | more))


def waves(prepared: Prepared, side: int) -> Floats:
    """(n, 2) Initial velocity, m/s, of plane waves along x and y."""
    material = prepared.case.material["soft"]
    lame, shear = lame_constants(material)
    speed = STRAIN * math.sqrt((lame + 2.0 * shear) / material.rho)
    return np.asarray(speed * np.sin(2.0 * np.pi * side / WAVE * prepared.model.x))


def steps_for(side: int, plan: Plan) -> int:
    """Steps in one timed run."""
    return max(20 if plan.scale == 1.0 else 2, round(plan.scale * UPDATES / side**2))


@cache
def uniform_runs(side: int, plan: Plan) -> tuple[Seconds, ...]:
    """Runs on the uniform block; measured once, for it stands in two rows."""
    prepared, steps = uniform_block(side), steps_for(side, plan)
    loop = started(prepared, waves(prepared, side))
    return tuple(repeated(lambda: loop.take(steps), plan.repeats))


def side_of(elements: float, plan: Plan) -> int:
    """Cells along a side of a square of so many, or of the plan's part of them."""
    return round(math.sqrt(plan.sized(elements, least=16)))


def uniform(plan: Plan) -> Iterator[Figure]:
    """Finite-strain element updates, all cells equal."""
    for elements, name in ((1e4, "10k"), (250e3, "250k"), (4e6, "4M")):
        side = side_of(elements, plan)
        work = 1e-6 * side**2 * steps_for(side, plan)
        yield rate(f"uniform block, {name}", work, "M updates/s", uniform_runs(side, plan))


def threads(plan: Plan) -> Iterator[Figure]:
    """The uniform block on one thread and on two, in turns."""
    side = side_of(250e3, plan)
    prepared, steps = uniform_block(side), steps_for(side, plan)
    one, two = (started(prepared, waves(prepared, side), count) for count in (1, 2))
    runs = alternating([lambda: one.take(steps), lambda: two.take(steps)], plan.repeats)
    work = 1e-6 * side**2 * steps
    yield rate("uniform block, 250k, 2 threads", work, "M updates/s", runs[1])
    cpu, wall = (before / after for before, after in zip(medians(runs[0]), medians(runs[1]), strict=True))
    yield Figure("two threads against one", cpu, wall, "x", f"{two.layout.threads} in use")


def general(plan: Plan) -> Iterator[Figure]:
    """The same where every element has gradients of its own."""
    side = side_of(250e3, plan)
    prepared, steps = mapped_block(side), steps_for(side, plan)
    loop = started(prepared, waves(prepared, side))
    runs = repeated(lambda: loop.take(steps), plan.repeats)
    yield rate("general block, 250k", 1e-6 * side**2 * steps, "M updates/s", runs)


def growth(plan: Plan) -> Iterator[Figure]:
    """How the cost of a step grows with the number of elements: the slope in a log-log plot."""
    sides = [side_of(elements, plan) for elements in (1e4, 250e3, 1e6, 4e6)]
    costs = []
    for side in sides:
        seconds = medians(uniform_runs(side, plan))
        costs.append([time / steps_for(side, plan) for time in seconds])
    slopes = [
        float(np.polyfit(np.log(np.square(sides)), np.log(column), 1)[0])
        for column in zip(*costs, strict=True)
    ]
    milliseconds = ", ".join(f"{1e3 * cpu:.3g}" for cpu, _ in costs)
    yield Figure("cost of a step, 10k to 4M", *slopes, "slope", f"{milliseconds} ms CPU at 10k, 250k, 1M, 4M")
