"""How far the surfaces of contact pairs are from each other at the start."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from phantomnode.pipeline.contacts import Pair
from phantomnode.pipeline.prepare import Floats, Ints, Prepared


class Gap(NamedTuple):
    """How far the slave of a pair is from its master.

    distance, m: between the two, or how deep the deepest slave point is, negative; slave, master: (2,) places
    where the two are nearest, m.
    """

    distance: float
    slave: Floats
    master: Floats


def initial_gaps(prepared: Prepared) -> list[Gap | None]:
    """The gap of each pair at the start; None for self contact, whose two surfaces are one.

    Overlaps are those of the slave points: what a case takes as its zero (``overlap = "offset"``).
    """
    contact, found = prepared.model.contact, list[Gap | None]()
    for pair in prepared.pairs:
        if pair.slave == pair.master:
            found.append(None)
            continue
        slave, master = slave_surface(prepared, pair), master_surface(prepared, pair)
        # From either side: what is nearest may be a corner of the one or of the other.
        way = min(_shortest(slave, master), _shortest(master, slave)[::-1], key=_length)
        depth = float(contact.offset[pair.points].max(initial=0.0))
        found.append(Gap(-depth if depth > 0.0 else _length(way), *way))
    return found


def slave_surface(prepared: Prepared, pair: Pair) -> Floats:
    """(s, 2, 2) Ends of the segments of the slave of a pair, m."""
    return ends_of(prepared, pair.segment_nodes, pair.start_shape, pair.end_shape)


def master_surface(prepared: Prepared, pair: Pair) -> Floats:
    """(m, 2, 2) Ends of the segments of its master, m, and its sharp corners, segments without length.

    Points see the master with its corners cut off; these are points of their own.
    """
    return np.concatenate([master_ends(prepared, pair.passes[0]), _corners(prepared, pair)])


def _shortest(ends: Floats, others: Floats) -> Floats:
    """(2, 2) The shortest way from the ends and middles of some segments, (s, 2, 2), to others, m."""
    places = np.concatenate([ends[:, 0], ends.mean(axis=1), ends[:, 1]])
    lines = shapely.linestrings(others)
    (_, number), distance = shapely.STRtree(lines).query_nearest(
        shapely.points(places), return_distance=True, all_matches=False
    )
    nearest = int(np.argmin(distance))
    way = shapely.shortest_line(shapely.Point(places[nearest]), lines[number[nearest]])
    return np.asarray(shapely.get_coordinates(way))


def _length(way: Floats) -> float:
    return float(np.hypot(*(way[1] - way[0])))


def _corners(prepared: Prepared, pair: Pair) -> Floats:
    """(c, 2, 2) The sharp corners of the master of a pair as segments without length, m."""
    contact, found = prepared.model.contact, [np.zeros((0, 2, 2))]
    for k in (k for k in pair.corners if contact.sign[k] < 0.0):
        points = slice(*contact.slave_first[k : k + 2])
        shape = contact.slave_shape[points]
        found.append(ends_of(prepared, contact.slave_nodes[points], shape, shape))
    return np.concatenate(found)


def ends_of(prepared: Prepared, nodes: Ints, start: Floats, end: Floats) -> Floats:
    """(s, 2, 2) Ends of segments, m, from their nodes and the shape functions at either end."""
    x = prepared.model.x[nodes]
    return np.stack([np.einsum("si,sik->sk", shape, x) for shape in (start, end)], axis=1)


def master_ends(prepared: Prepared, number: int) -> Floats:
    """(s, 2, 2) Ends of the master segments of a pass, m."""
    contact = prepared.model.contact
    part = slice(contact.master_first[number], contact.master_first[number + 1])
    return ends_of(prepared, contact.master_nodes[part], contact.start_shape[part], contact.end_shape[part])
