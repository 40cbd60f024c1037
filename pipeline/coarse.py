"""Slaves whose points stand too far apart for what they meet: what to say of them before a run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from phantomnode.pipeline.corner_points import widest_gap
from phantomnode.pipeline.tally import pair_bodies
from phantomnode.pipeline.turning import SHARP, most_turned

if TYPE_CHECKING:
    from phantomnode.pipeline.prepare import Prepared
    from phantomnode.pipeline.rigid import Rigid

COARSE = 3.0
"""Times as large as the cells of the master: with such cells a body is better not the slave."""


def coarse_slaves(prepared: Prepared) -> Iterator[str]:
    """A warning of each pair whose slave is much coarser than its master, or than an obstacle turns."""
    for number, pair in enumerate(prepared.pairs):
        slave, master = pair_bodies(prepared, number)
        if len(pair.passes) == 2 or slave is master:
            continue
        cell = slave.grid.typical_size
        if master is not None:
            ratio = cell / master.grid.typical_size
            if ratio > COARSE:
                yield (
                    f"contact {pair.name}: cells of the slave, {pair.slave}, are {ratio:.3g} times as large as those "
                    f"of the master: make {pair.master} the slave, or passes = 2"
                )
            continue
        rigid = next(each for each in prepared.rigids if each.name == pair.master)
        gap = widest_gap(prepared.case.contact[pair.name].points)
        turn = _turn(rigid, gap * cell)
        if turn > SHARP:
            fine = _followed(rigid, gap * cell) / gap
            yield (
                f"contact {pair.name}: {pair.master} turns by {math.degrees(turn):.0f} degrees between points of "
                f"{pair.slave}, {gap * cell:.2g} m apart, which do not follow it"
                + (f": cells of {fine:.2g} m do" if fine > 0.0 else "")
            )


def _turn(rigid: Rigid, spacing: float) -> float:
    """By what angle an obstacle turns over a way of ``spacing``, m, at most, sharp corners left out."""
    return most_turned(rigid.xy[rigid.segments], rigid.following, spacing)


def _followed(rigid: Rigid, spacing: float) -> float:
    """The widest spacing of points, m, below this one over which an obstacle turns by no more than a sharp corner.

    To one per cent, by halving; 0 where that is a thousandth of it or less, as at vertices beside each other.
    """
    low, high = 1e-3 * spacing, spacing
    if _turn(rigid, low) > SHARP:
        return 0.0
    while high > 1.01 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if _turn(rigid, middle) > SHARP else (middle, high)
    return low
