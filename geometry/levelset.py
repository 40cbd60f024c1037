"""Signed distance to curves and regions: exact for lines and arcs, with the right sign everywhere.

The sign is that of the closest feature. Inside a piece it is the side of the piece; at a vertex all points
that are closest to it lie on the outer side of its corner, so the sign belongs to the corner and not to the
point: + where the curve turns right there, - where it turns left (the material is on the left).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Region, arc_centre
from phantomnode.geometry.errors import GeometryError
from phantomnode.kernels import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SMOOTH = 1e-6
"""Below this turn (radians) a vertex has no corner of its own: the side of its mean normal decides."""

TIE = 1e-14
"""Relative difference of distances that rounding alone may cause."""


NOWHERE = 1e150
"""Where chords stand that belong to no piece: farther away than anything, with a square."""

SLACK = 7
"""Column of the slack of a chord."""


class Closest(NamedTuple):
    """What is closest to each of n points.

    Attributes
    ----------
    distance : (n,) float64, metres
        Signed: positive in the material (of regions) or on the left (of a curve).
    normal : (n, 2) float64
        Gradient of the signed distance; on the curve its left normal.
    point : (n, 2) float64, metres
        The closest point.
    curve, piece : (n,) int64
        The curve, in the order given (the loops of regions in order), and the piece of it.
    s : (n,) float64
        Fraction along the piece, 0..1.
    """

    distance: Floats
    normal: Floats
    point: Floats
    curve: Ints
    piece: Ints
    s: Floats


class LevelSet:
    """Signed distance to the outlines of regions or to one curve.

    Made by :meth:`of_regions` or :meth:`of_curve`.
    """

    def __init__(self, groups: Sequence[Sequence[Curve]]) -> None:
        """One group of curves for each region; the level set of several is that of their union."""
        self._groups = [_pieces(curves) for curves in groups]
        counts = np.array([len(curves) for curves in groups])
        self._first_curve = np.cumsum(counts) - counts

    @classmethod
    def of_regions(cls, regions: Sequence[Region]) -> LevelSet:
        """Positive in the material of the regions, negative in the void (and in their holes).

        Where two regions share an edge that edge is a zero line with material on both sides.
        """
        if not regions:
            raise GeometryError("a level set needs at least one region")
        return cls([region.loops for region in regions])

    @classmethod
    def of_curve(cls, curve: Curve) -> LevelSet:
        """Positive on the left of the curve; past a free end, on the left of the end's tangent."""
        return cls([[curve]])

    def distance(self, xy: Floats) -> Floats:
        """(n,) Signed distance, metres, of (n, 2) points."""
        xy = np.ascontiguousarray(xy, dtype=np.float64).reshape(-1, 2)
        distance = _distance(self._groups[0], xy)
        for pieces in self._groups[1:]:
            np.maximum(distance, _distance(pieces, xy), out=distance)
        return np.asarray(distance)

    def normal(self, xy: Floats) -> Floats:
        """(n, 2) Gradient of the signed distance at (n, 2) points, of unit length.

        At points closest to a corner it is radial; at a point on the curve it is the left normal (at a
        corner itself the mean of both).
        """
        return self.query(xy).normal

    def closest(self, xy: Floats) -> tuple[Floats, Ints, Ints, Floats]:
        """Closest points (n, 2), their curve (n,), piece (n,) and fraction along the piece (n,)."""
        found = self.query(xy)
        return found.point, found.curve, found.piece, found.s

    def query(self, xy: Floats) -> Closest:
        """Everything about the closest feature of (n, 2) points at once."""
        xy = np.ascontiguousarray(xy, dtype=np.float64).reshape(-1, 2)
        best: Closest | None = None
        for pieces, first in zip(self._groups, self._first_curve, strict=True):
            found = Closest(*_query(pieces, xy))
            found.curve[:] += first
            if best is None:
                best = found
                continue
            larger = found.distance > best.distance
            for kept, new in zip(best, found, strict=True):
                kept[larger] = new[larger]
        assert best is not None  # of_regions and of_curve give at least one group
        return best


PIECE = np.dtype(
    [(name, np.float64) for name in (
        "ax", "ay", "bx", "by",  # start and end, metres
        "ex", "ey", "half",  # unit vector along the chord, half its length
        "bulge", "cx", "cy", "radius", "half_angle",  # of lines 0, any, infinite, 0
        "leaving_x", "leaving_y", "arriving_x", "arriving_y",  # unit tangents at start and end
        "start_turn", "start_sign", "start_nx", "start_ny", "end_turn", "end_sign", "end_nx", "end_ny",
    )]
    + [("curve", np.int64), ("piece", np.int64)]
)  # fmt: skip
"""A line or arc. At a vertex: the turn there (radians, unsigned), the sign of the points closest to it (0: by the
side of the normal), and the mean left normal."""

Piece = Any
"""A record of ``PIECE``: numba's is typed by the kernel, that without numba is a ``np.record``."""


class _Pieces(NamedTuple):
    """Lines and arcs for the kernels.

    ``rows`` is (n,) of ``PIECE``: a kernel that takes a record takes one pointer, where a tuple of arrays would
    be counted, array by array, at each call. ``chords`` is a complete binary tree of the pieces, which follow each
    other along their curves: node i has the children 2i and 2i + 1, and the leaves, from ``len(chords) // 2`` on, are
    the pieces. Each row is a straight segment (start, end, unit vector, length) and its slack: no piece below it
    is farther from the segment.
    """

    rows: Any  # np.recarray
    chords: Floats


def _pieces(curves: Sequence[Curve]) -> _Pieces:
    """The pieces of one region's loops, or of one curve."""
    start = np.vstack([c.points[:-1] for c in curves])
    end = np.vstack([c.points[1:] for c in curves])
    bulge = np.concatenate([c.bulges for c in curves])
    chord = np.concatenate([c.chords for c in curves])
    if not (np.all(np.isfinite(start)) and np.all(np.isfinite(bulge)) and np.all(chord > 0.0)):
        raise GeometryError("a curve has a piece without length or a coordinate that is not finite")
    bent = bulge != 0.0
    centre = arc_centre(start, end, np.where(bent, bulge, 1.0))
    # An arc leaves its chord by at most its sagitta, or its diameter beyond a semicircle.
    reach = np.where(np.abs(bulge) <= 1.0, 0.5 * np.abs(bulge), 0.5 * (1.0 + bulge**2)) * chord
    rows = np.recarray(len(start), dtype=PIECE)
    rows.ax, rows.ay, rows.bx, rows.by = *start.T, *end.T
    (rows.ex, rows.ey), rows.half = (end - start).T / chord, 0.5 * chord
    rows.bulge, (rows.cx, rows.cy) = bulge, centre.T
    rows.radius = np.where(bent, 0.25 * chord * (1.0 + bulge**2) / np.abs(np.where(bent, bulge, 1.0)), np.inf)
    rows.half_angle = 0.5 * np.concatenate([c.angles for c in curves])
    rows.leaving_x, rows.leaving_y = np.vstack([c.tangents[0] for c in curves]).T
    rows.arriving_x, rows.arriving_y = np.vstack([c.tangents[1] for c in curves]).T
    turn, sign, normal = (np.concatenate(each) for each in zip(*(_vertices(c) for c in curves), strict=True))
    (rows.start_turn, rows.end_turn), (rows.start_sign, rows.end_sign) = turn.T, sign.T
    (rows.start_nx, rows.end_nx), (rows.start_ny, rows.end_ny) = normal.T
    rows.curve = np.repeat(np.arange(len(curves)), [len(c.bulges) for c in curves])
    rows.piece = np.concatenate([np.arange(len(c.bulges)) for c in curves])
    return _Pieces(rows, _chord_tree(start, end, reach))


def _vertices(curve: Curve) -> tuple[Floats, Floats, Floats]:
    """((n, 2), (n, 2), (n, 2, 2)) Turn, sign and mean normal at the start and the end of each piece."""
    out, into = curve.tangents
    before, after = np.roll(into, 1, axis=0), out  # at the start of each piece
    curvature = 4.0 * curve.bulges / (curve.chords * (1.0 + curve.bulges**2))
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.sum(before * after, axis=1))
    sign = np.where(np.abs(turn) > SMOOTH, -np.sign(turn), 0.0)
    # A cusp turns back on itself: left where the way out lies to the left of the way in.
    cusp = np.pi - np.abs(turn) < SMOOTH
    sign[cusp] = np.where((curvature + np.roll(curvature, 1))[cusp] < 0.0, -1.0, 1.0)
    mean = before + after
    mean[cusp] = before[cusp]
    mean /= np.hypot(*mean.T)[:, None]
    turn, sign, mean = (np.stack([x, np.roll(x, -1, axis=0)], axis=1) for x in (np.abs(turn), sign, mean))
    if not curve.closed:
        turn[0, 0] = turn[-1, 1] = sign[0, 0] = sign[-1, 1] = 0.0
        mean[0, 0], mean[-1, 1] = out[0], into[-1]
    return turn, sign, np.stack([-mean[..., 1], mean[..., 0]], axis=-1)


def _chord_tree(start: Floats, end: Floats, reach: Floats) -> Floats:
    """(2 * leaves, 8) Tree of chords around (n,) pieces that stay within their reach of their chords, metres.

    leaves is a power of two. A chord of chords stays as near to its pieces as its ends and those of its children
    say: the distance from a segment is convex along another one.
    """
    leaves = 1 << (len(start) - 1).bit_length()
    a, b, slack = np.full((leaves, 2), NOWHERE), np.full((leaves, 2), NOWHERE), np.zeros(leaves)
    a[: len(start)], b[: len(start)], slack[: len(start)] = start, end, reach
    levels = [_chords(a, b, slack)]
    while len(a) > 1:
        lone = a[1::2, 0] == NOWHERE
        first, last = a[0::2], np.where(lone[:, None], b[0::2], b[1::2])
        whole = _chords(first, last, np.zeros(len(first)))
        off = np.stack([_off(whole, point[k::2]) for k in (0, 1) for point in (a, b)])
        both = np.maximum(off[0::2], off[1::2]) + slack.reshape(-1, 2).T
        a, b, slack = first, last, np.where(lone, both[0], both.max(axis=0))
        levels.append(_chords(a, b, slack))
    return np.concatenate([np.zeros((1, 8)), *levels[::-1]])


def _chords(a: Floats, b: Floats, slack: Floats) -> Floats:
    """(k, 8) Start, end, unit vector, length and slack of chords, the slack with room for rounding."""
    length = np.hypot(*(b - a).T)
    along = (b - a) / np.where(length > 0.0, length, 1.0)[:, None]
    return np.column_stack([a, b, along, length, slack + TIE * (slack + length)])


def _off(chords: Floats, points: Floats) -> Floats:
    """(k,) Distances of (k, 2) points from chords."""
    a, b = points - chords[:, :2], points - chords[:, 2:4]
    (ex, ey), t = chords[:, 4:6].T, np.sum(a * chords[:, 4:6], axis=1)
    inside = np.abs(ex * a[:, 1] - ey * a[:, 0])
    outside = np.where(t <= 0.0, np.hypot(*a.T), np.hypot(*b.T))
    return np.asarray(np.where((t <= 0.0) | (t >= chords[:, 6]), outside, inside))


@kernel
def _query(pieces: _Pieces, xy: Floats) -> tuple[Floats, Floats, Floats, Ints, Ints, Floats]:
    """Closest feature of every point; a neighbour's answer is the first guess of the next."""
    n = len(xy)
    distance, s = np.empty(n), np.empty(n)
    normal, point = np.empty((n, 2)), np.empty((n, 2))
    curve, piece = np.empty(n, np.int64), np.empty(n, np.int64)
    guess, stack, waiting = 0, np.empty(64, np.int64), np.empty(64)
    for i in range(n):
        x, y = xy[i, 0], xy[i, 1]
        guess, vertex, far = _nearest(pieces, x, y, guess, stack, waiting)
        found = pieces.rows[guess]
        px, py, nx, ny, phi = _foot(found, vertex, far, x, y)
        distance[i] = phi
        normal[i, 0], normal[i, 1] = nx, ny
        point[i, 0], point[i, 1] = px, py
        curve[i], piece[i] = found.curve, found.piece
        s[i] = _fraction(found, vertex, px, py)
    return distance, normal, point, curve, piece, s


@kernel
def _distance(pieces: _Pieces, xy: Floats) -> Floats:
    """Signed distance of every point, as of :func:`_query`, in two thirds of its time."""
    distance, stack, waiting = np.empty(len(xy)), np.empty(64, np.int64), np.empty(64)
    guess = 0
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        guess, vertex, far = _nearest(pieces, x, y, guess, stack, waiting)
        distance[i] = _foot(pieces.rows[guess], vertex, far, x, y)[4]
    return distance


@kernel
def _nearest(
    pieces: _Pieces, x: float, y: float, guess: int, stack: Ints, waiting: Floats
) -> tuple[int, int, float]:
    """Closest piece, its closest vertex (0 start, 1 end, -1 inside the piece), unsigned distance.

    Of features that are equally far the one with the smallest turn counts: a corner that touches the
    outside of another one from within must not speak for the points out there. Then the lower number.
    """
    rows, best = pieces.rows, guess
    far, vertex, turn = _measure(rows[best], x, y)
    limit = far * (1.0 + TIE)
    chords, leaves = pieces.chords, len(pieces.chords) // 2
    i, top = 1, 0
    while True:
        if i < leaves:  # on to the nearer child; the other waits, if it is near enough
            near, other = 2 * i, 2 * i + 1
            d2, d2_other = _off2(chords, near, x, y), _off2(chords, other, x, y)
            if d2_other < d2:
                near, other, d2, d2_other = other, near, d2_other, d2
            if d2_other <= (limit + chords[other, SLACK]) ** 2:
                stack[top], waiting[top] = other, d2_other
                top += 1
            if d2 <= (limit + chords[near, SLACK]) ** 2:
                i = near
                continue
        elif i - leaves != best:
            d, v, t = _measure(rows[i - leaves], x, y)
            tie = abs(d - far) <= TIE * far
            if (d < far and not tie) or (tie and (t < turn or (t == turn and i - leaves < best))):
                best, far, vertex, turn = i - leaves, d, v, t
                limit = far * (1.0 + TIE)
        while top > 0 and waiting[top - 1] > (limit + chords[stack[top - 1], SLACK]) ** 2:
            top -= 1
        if top == 0:
            return best, vertex, far
        top -= 1
        i = stack[top]


@kernel
def _off2(chords: Floats, i: int, x: float, y: float) -> float:
    """Square of the distance of a point from a chord of the tree."""
    ax, ay = x - chords[i, 0], y - chords[i, 1]
    ex, ey = chords[i, 4], chords[i, 5]
    t = min(max(ax * ex + ay * ey, 0.0), chords[i, 6])
    dx, dy = ax - t * ex, ay - t * ey
    return dx * dx + dy * dy


@kernel
def _measure(piece: Piece, x: float, y: float) -> tuple[float, int, float]:
    """Unsigned distance to a piece, closest vertex (-1: inside the piece), turn at that vertex."""
    ax, ay = x - piece.ax, y - piece.ay
    bx, by = x - piece.bx, y - piece.by
    past_start = ax * piece.leaving_x + ay * piece.leaving_y > 0.0
    before_end = bx * piece.arriving_x + by * piece.arriving_y < 0.0
    # The normals at both ends bound the sector of an arc, which is not convex beyond a semicircle.
    inside = (past_start or before_end) if abs(piece.bulge) > 1.0 else (past_start and before_end)
    if inside:
        return abs(_side(piece, x, y)), -1, 0.0
    da, db = np.sqrt(ax * ax + ay * ay), np.sqrt(bx * bx + by * by)
    if da <= db:
        return da, 0, piece.start_turn
    return db, 1, piece.end_turn


@kernel
def _side(piece: Piece, x: float, y: float) -> float:
    """Signed distance to the whole line or circle of a piece, positive to the left.

    With g of intersect.py the power of the point is r^2 - rho^2 = +-2 r g, so r - rho = 2 g / (1 + rho/r).
    """
    ex, ey = piece.ex, piece.ey
    ax, ay = x - piece.ax, y - piece.ay
    b, v = piece.bulge, ex * ay - ey * ax
    if b == 0.0:
        return v
    bx, by = x - piece.bx, y - piece.by
    g = ((1.0 - b * b) * v - b * (ax * bx + ay * by) / piece.half) / (1.0 + b * b)
    cx, cy = piece.cx - x, piece.cy - y
    return 2.0 * g / (1.0 + np.sqrt(cx * cx + cy * cy) / piece.radius)


@kernel
def _foot(
    piece: Piece, vertex: int, far: float, x: float, y: float
) -> tuple[float, float, float, float, float]:
    """Closest point (x, y), gradient (x, y) and signed distance on the closest feature."""
    if vertex >= 0:
        px = piece.bx if vertex == 1 else piece.ax
        py = piece.by if vertex == 1 else piece.ay
        nx, ny = (piece.end_nx, piece.end_ny) if vertex == 1 else (piece.start_nx, piece.start_ny)
        if far == 0.0:
            return px, py, nx, ny, 0.0
        sign = piece.end_sign if vertex == 1 else piece.start_sign
        if sign == 0.0:
            sign = 1.0 if (x - px) * nx + (y - py) * ny >= 0.0 else -1.0
        return px, py, sign * (x - px) / far, sign * (y - py) / far, sign * far
    phi = _side(piece, x, y)
    nx, ny = -piece.ey, piece.ex
    if piece.bulge != 0.0:
        cx, cy = piece.cx - x, piece.cy - y
        rho = np.sqrt(cx * cx + cy * cy)
        if rho == 0.0:  # every point of the arc is as close: take its start
            cx, cy = piece.cx - piece.ax, piece.cy - piece.ay
            rho = piece.radius
        turn = 1.0 if piece.bulge > 0.0 else -1.0
        nx, ny = turn * cx / rho, turn * cy / rho
    return x - phi * nx, y - phi * ny, nx, ny, phi


@kernel
def _fraction(piece: Piece, vertex: int, px: float, py: float) -> float:
    """Fraction along a piece of a point on it: tan(s angle/2) = ra sin / (rb + ra cos)."""
    if vertex >= 0:
        return float(vertex)
    ax, ay = px - piece.ax, py - piece.ay
    bx, by = px - piece.bx, py - piece.by
    ra, rb = np.sqrt(ax * ax + ay * ay), np.sqrt(bx * bx + by * by)
    h = abs(piece.half_angle)
    if h == 0.0:
        return ra / (ra + rb)
    return np.arctan2(ra * np.sin(h), rb + ra * np.cos(h)) / h
