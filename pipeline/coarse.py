"""Slaves whose points stand too far apart for what they meet: what to say of them before a run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from phantomnode.pipeline.corner_points import widest_gap
from phantomnode.pipeline.gaps import master_ends
from phantomnode.pipeline.tally import pair_bodies
from phantomnode.pipeline.turning import SHARP, narrowest

if TYPE_CHECKING:
    from phantomnode.pipeline.prepare import Prepared

COARSE = 3.0
"""Times as large as the cells of the master: with such cells a body is better not the slave."""


def coarse_slaves(prepared: Prepared) -> Iterator[str]:
    """A warning of each pair whose slave is much coarser than its master, or than roundings of an obstacle."""
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
        gap = widest_gap(prepared.case.contact[pair.name].points)
        radius = _narrowest(prepared, number, gap * cell)
        if radius * SHARP < gap * cell:
            yield (
                f"contact {pair.name}: {pair.master} has roundings of {radius:.2g} m radius, which the points of "
                f"{pair.slave} do not follow: cells of {radius * SHARP / gap:.2g} m do"
            )


def _narrowest(prepared: Prepared, number: int, spacing: float) -> float:
    """The smallest radius, m, of the roundings of the master of a pair, seen over a way of ``spacing``, m."""
    contact, k = prepared.model.contact, prepared.pairs[number].passes[0]
    first, last = contact.master_first[k : k + 2]
    following = contact.following[first:last]
    return narrowest(master_ends(prepared, k), np.where(following >= 0, following - first, -1), spacing)
