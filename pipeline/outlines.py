"""Edges and segments put in order: the rim of some cells, the chains that segments make."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Numbers = NDArray[np.int32] | NDArray[np.int64]

TOUCH = 1e-6
"""Ends nearer to each other than this part of the size of all segments are one place: files hold float32."""

ON_LINE = 1e-4
"""A point nearer to an edge than this part of its length lies on it: files hold float32."""

CELLS = 1 << 16
"""Cells whose edges are sorted at a time: what is needed in between stays small."""

CANDIDATES = 4
"""Segments that are looked at where one ends: both faces of a crack, and those of a second one beside it."""


def open_edges(rings: Sequence[Numbers], points: Floats) -> Ints:
    """(b, 2) Points of the edges that belong to one cell only: boundaries and open interfaces.

    Where the outline leaves a grid line, the edge of a whole cell has a shorter one of a cut cell beside it; only
    what reaches beyond that is open.

    Parameters
    ----------
    rings : sequence of (m, k) int32 or int64
        Points of cells of k corners, in their order around the cell.
    points : (p, 2) float64, m
        Where they are in the undeformed bodies.
    """
    # Most edges belong to two cells that are not far from each other in the list.
    parts = [ring[start : start + CELLS] for ring in rings for start in range(0, len(ring), CELLS)]
    edges = _single(np.concatenate([np.zeros((0, 2), np.int64), *(_single(_sides(part)) for part in parts)]))
    return _single(_beyond_shorter(edges, points))


def _sides(ring: Numbers) -> Ints:
    """(m k, 2) Directed edges of (m, k) cells."""
    return np.stack([ring, np.roll(ring, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)


def _single(edges: Ints) -> Ints:
    """The edges that are there once, in either direction."""
    low, high = edges.min(axis=1), edges.max(axis=1)
    key = low * (np.max(high, initial=0) + 1) + high  # one number sorts in a fifth of the time of two
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    return np.asarray(edges[first[count == 1]])


def _beyond_shorter(edges: Ints, points: Floats) -> Ints:
    """Directed edges without the parts that lie beside shorter ones, run the other way, from the same point."""
    edges, gone = edges.copy(), np.zeros(len(edges), dtype=bool)
    for end in (0, 1):
        # The neighbour of an edge a-b is c-a at its begin, or b-c at its end; what is left is c-b, or a-c.
        one, other = _pairs(edges[:, end], edges[:, 1 - end])
        here, far = points[edges[one, end]], points[edges[one, 1 - end]]
        along, short = far - here, points[edges[other, end]] - here
        length2 = np.sum(along**2, axis=1)
        part = np.sum(short * along, axis=1) / np.where(length2 > 0.0, length2, 1.0)
        aside = np.abs(along[:, 0] * short[:, 1] - along[:, 1] * short[:, 0])
        lies = (part > ON_LINE) & (part < 1.0 - ON_LINE) & (aside < ON_LINE * length2)
        edges[one[lies], end] = edges[other[lies], end]
        gone[other[lies]] = True
    return edges[~gone]


def _pairs(one: Ints, other: Ints) -> tuple[Ints, Ints]:
    """(k,) Places in the first and in the second array that hold the same number."""
    order = np.argsort(other, kind="stable")
    first = np.searchsorted(other[order], one, side="left")
    count = np.searchsorted(other[order], one, side="right") - first
    begin = np.repeat(np.arange(len(one)), count)
    within = np.arange(len(begin)) - np.repeat(np.cumsum(count) - count, count)
    return begin, order[first[begin] + within]


class Chain(NamedTuple):
    """Segments that follow each other.

    order : (k,) int64, their numbers along the chain; closed : whether the last one meets the first.
    """

    order: Ints
    closed: bool


def chains(ends: Floats) -> list[Chain]:
    """The chains of directed segments, the longest first; a segment follows the one at whose end it begins.

    Parameters
    ----------
    ends : (s, 2, 2) float64, m
        Start and end of each segment.
    """
    if len(ends) == 0:
        return []
    following = _following(ends)
    begins = np.ones(len(ends), dtype=bool)
    begins[following[following >= 0]] = False
    left = np.ones(len(ends), dtype=bool)
    found = []
    for first in (*np.flatnonzero(begins), *range(len(ends))):
        order, here = [], int(first)
        while here >= 0 and left[here]:
            left[here] = False
            order.append(here)
            here = int(following[here])
        if order:
            found.append(Chain(np.array(order), here == order[0]))
    return sorted(found, key=lambda chain: -len(chain.order))


def solid_sides(ends: Floats, width: float) -> list[Floats]:
    """Polygons, (k, 2), that show where obstacles are solid; those of :func:`sides_of`."""
    return [polygon for polygon, _ in sides_of(ends, width)]


def sides_of(ends: Floats, width: float) -> list[tuple[Floats, int]]:
    """Polygons, (k, 2), that show where obstacles are solid, on the left of their segments; a segment of each.

    The inside of a chain that is closed about it; of others a strip along each segment.

    Parameters
    ----------
    ends : (s, 2, 2) float64, m
        Start and end of each segment.
    width : float, m
        Of the strips.
    """
    found: list[tuple[Floats, int]] = []
    for chain in chains(ends):
        start, end = np.moveaxis(ends[chain.order], 1, 0)
        twice = np.sum(start[:, 0] * end[:, 1] - end[:, 0] * start[:, 1])
        if chain.closed and twice > 0.0:
            found.append((start, int(chain.order[0])))
            continue
        along = end - start
        length = np.maximum(np.hypot(*along.T), np.finfo(np.float64).tiny)
        aside = width * np.column_stack([-along[:, 1], along[:, 0]]) / length[:, None]
        strips = np.stack([start, end, end + aside, start + aside], axis=1)
        found.extend(zip(strips, chain.order.tolist(), strict=True))
    return found


def _following(ends: Floats) -> Ints:
    """(s,) The segment that begins where each one ends, -1 where there is none.

    Two faces of a crack stand on the same place: of several segments the one that turns least goes on.
    """
    count = min(CANDIDATES, len(ends))
    reach = TOUCH * float(np.ptp(ends.reshape(-1, 2), axis=0).max())
    distance, near = cKDTree(ends[:, 0]).query(ends[:, 1], k=np.arange(1, count + 1))
    along = ends[:, 1] - ends[:, 0]
    unit = along / np.maximum(np.hypot(*along.T), np.finfo(np.float64).tiny)[:, None]
    straight = np.where(distance <= reach, np.einsum("sk,snk->sn", unit, unit[near]), -np.inf)
    best = np.argmax(straight, axis=1)
    rows = np.arange(len(ends))
    return np.where(np.isfinite(straight[rows, best]), near[rows, best], -1)
