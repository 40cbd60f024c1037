"""Joint snap-rounding of grid lines and barriers: straight segments that meet at their ends only.

Raw floating point breaks connectivity: a barrier an ulp off a grid line leaves slivers that float freely or
leaks through a corner. Here every end point is a point of one integer lattice, intersections are rounded to
it, and a segment that passes within a unit or so of a vertex is led through it, until segments meet at common
ends only. All signs are exact (int64), and every piece remembers the segment it came from, so what is a
barrier is known from the same pass that makes the pieces (Hobby, Comput. Geom. 13, 1999: snap rounding).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

UNITS_PER_CELL = 2**22
"""Lattice units along the longest cell edge. Directions of two segments within a cell then differ by more than
2^-47 rad, which arctan2 in double precision tells apart, and cross products fit into int64 with room."""


ON_LINE = 1.5
"""A point of a line and the ends of the line are each rounded by up to sqrt(1/2) units, so the rounded point is
off the rounded line by up to sqrt(2): an interface that ends on an outline must still end on it."""

CLEAR = 4.0
"""Units from the ends of a segment from which ``ON_LINE`` holds."""


@dataclass(frozen=True)
class Lattice:
    """The integer lattice of one background grid.

    Attributes
    ----------
    origin, unit : (2,) float64, metres
        Position of the lattice point (0, 0) and the spacing along x and y.
    """

    origin: Floats
    unit: Floats

    @classmethod
    def of(cls, grid: BackgroundGrid) -> Lattice:
        """The lattice of a grid before relocation: nodes of a Cartesian grid are points of it."""
        return cls(grid.box[0], grid.largest_step / UNITS_PER_CELL)

    def snap(self, xy: Floats) -> Ints:
        """(k, 2) Nearest lattice points of (k, 2) positions."""
        return np.rint((xy - self.origin) / self.unit).astype(np.int64)

    def position(self, points: Ints) -> Floats:
        """(k, 2) Positions of lattice points, metres."""
        return np.asarray(self.origin + points * self.unit)


@dataclass(frozen=True)
class Pieces:
    """Segments that meet at their ends only.

    Attributes
    ----------
    vertices : (v, 2) int64
        Lattice points, each once.
    ends : (k, 2) int64
        Start and end vertex of each piece, in the direction of its source; pieces of different sources
        may coincide.
    source : (k,) int64
        The segment each piece came from.
    """

    vertices: Ints
    ends: Ints
    source: Ints


def cross(a: Ints, b: Ints) -> Ints:
    """(...,) z-component of the cross product of (..., 2) integer vectors, exact."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def node_segments(starts: Ints, ends: Ints) -> Pieces:
    """Split segments where they cross or pass a vertex, until they meet at their ends only.

    Parameters
    ----------
    starts, ends : (k, 2) int64
        Lattice points.

    Returns
    -------
    Pieces
        ``source`` numbers the given segments; those of zero length are left out.

    Raises
    ------
    GeometryError
        If splitting does not come to an end (never met; a guard).
    """
    source = np.flatnonzero(np.any(starts != ends, axis=1))
    a, b = starts[source], ends[source]
    active = np.ones(len(source), dtype=bool)
    for _ in range(100):
        segment, point = _splits(a, b, active)
        if len(segment) == 0:
            vertices, index = np.unique(np.vstack([a, b]), axis=0, return_inverse=True)
            index = index.reshape(2, -1).T
            return Pieces(vertices, np.ascontiguousarray(index), source)
        a, b, source, active = _split(a, b, source, segment, point)
    raise GeometryError("noding of the cut did not end: report this geometry as a bug")


def _splits(a: Ints, b: Ints, active: NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """(k,) segments and (k, 2) points at which they must be split; ``active`` ones changed last time."""
    tree = shapely.STRtree(_boxes(a, b))
    changed = np.flatnonzero(active)
    first, second = tree.query(_boxes(a[changed], b[changed]))
    i, j = changed[first], second
    keep = ~active[j] | (i < j)
    i, j = i[keep], j[keep]
    # A vertex of one segment in the half-unit neighbourhood of the other: lead the other through it.
    whom, where = [], []
    for s, t in ((i, j), (j, i)):
        for vertex in (a, b):
            hit = _passes(a[s], b[s], vertex[t])
            whom.append(s[hit])
            where.append(vertex[t][hit])
    # Proper crossings: the rounded intersection becomes a vertex of both. Segments that are led through a
    # vertex already wait for the next round: beside it their crossing would only round to another one, and so
    # on, unit by unit.
    led = np.zeros(len(a), dtype=bool)
    led[np.concatenate(whom)] = True
    hit = ~led[i] & ~led[j] & _cross_properly(a[i], b[i], a[j], b[j])
    p, q = i[hit], j[hit]
    meeting = _intersection(a[p], b[p], a[q], b[q])
    whom, where = [*whom, p, q], [*where, meeting, meeting]
    segment, point = np.concatenate(whom), np.vstack(where)
    inner = np.any(point != a[segment], axis=1) & np.any(point != b[segment], axis=1)
    return segment[inner], point[inner]


def _split(
    a: Ints, b: Ints, source: Ints, segment: Ints, point: Ints
) -> tuple[Ints, Ints, Ints, NDArray[np.bool_]]:
    """Segments replaced by the chains through their split points, in the direction of the segment."""
    along = np.sum((point - a[segment]) * (b - a)[segment], axis=1)
    rows = np.unique(np.column_stack([segment, along, point]), axis=0)
    split = np.unique(rows[:, 0])
    chain = np.concatenate([split, rows[:, 0], split])
    key = np.concatenate([np.full(len(split), -1), np.arange(len(rows)), np.full(len(split), len(rows))])
    points = np.vstack([a[split], rows[:, 2:], b[split]])
    order = np.lexsort([key, chain])
    chain, points = chain[order], points[order]
    link = (chain[:-1] == chain[1:]) & np.any(points[:-1] != points[1:], axis=1)
    whole = np.ones(len(a), dtype=bool)
    whole[split] = False
    count = int(np.count_nonzero(link))
    return (
        np.vstack([a[whole], points[:-1][link]]),
        np.vstack([b[whole], points[1:][link]]),
        np.concatenate([source[whole], source[chain[:-1][link]]]),
        np.concatenate([np.zeros(np.count_nonzero(whole), dtype=bool), np.ones(count, dtype=bool)]),
    )


def _boxes(a: Ints, b: Ints) -> NDArray[np.object_]:
    """Bounding boxes of segments, a unit wider on each side."""
    low, high = np.minimum(a, b) - 1.0, np.maximum(a, b) + 1.0
    return np.asarray(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))


def _passes(a: Ints, b: Ints, v: Ints) -> NDArray[np.bool_]:
    """Whether segments a-b pass v beside their ends: at less than half the diagonal of a pixel, or, ``CLEAR``
    of both ends, at less than ``ON_LINE``. Both parts of a segment led through v are shorter than it was, so
    this comes to an end.
    """
    along = b - a
    length2 = np.sum(along * along, axis=1)
    dot = np.sum((v - a) * along, axis=1)
    between = (dot > 0) & (dot < length2)
    # In doubles: a decision of tolerance, made once for the one shared segment, so nothing can disagree.
    miss2 = cross(along, v - a).astype(np.float64) ** 2
    clear = np.minimum(dot, length2 - dot) >= CLEAR * np.sqrt(length2.astype(np.float64))
    return np.asarray(between & (miss2 <= np.where(clear, ON_LINE**2, 0.5) * length2))


def _cross_properly(a: Ints, b: Ints, c: Ints, d: Ints) -> NDArray[np.bool_]:
    """Whether segments a-b and c-d cross at a point inside both; exact."""
    on_c, on_d = np.sign(cross(b - a, c - a)), np.sign(cross(b - a, d - a))
    on_a, on_b = np.sign(cross(d - c, a - c)), np.sign(cross(d - c, b - c))
    return np.asarray((on_c * on_d < 0) & (on_a * on_b < 0))


def _intersection(a: Ints, b: Ints, c: Ints, d: Ints) -> Ints:
    """(k, 2) Lattice points nearest to the crossings of a-b and c-d."""
    t = cross(c - a, d - c) / cross(b - a, d - c)
    return a + np.rint(t[:, None] * (b - a)).astype(np.int64)
