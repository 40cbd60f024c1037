"""Where curves cross grid edges and each other.

Lines and arcs share one implicit equation. In the frame of a piece (origin in the middle of its chord of
half length c, u along the chord, v to its left) the circle through both ends with bulge b is

    g(u, v) = m v - k (u^2 + v^2 - c^2) = 0,    m = (1 - b^2)/(1 + b^2),  k = b / (c (1 + b^2)),

where |grad g| = 1 on the circle and k is half its curvature: g is the distance to first order, positive to
the left. Nothing cancels as b goes to 0, where g = v is the straight line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, arc_centre

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

END_SLACK = 1e-12
"""A grid node this close to a curve, in edge lengths, lies on it."""

TOUCH = 1e-9
"""Curves this close, in sizes of their common box, touch: what a CAD file's digits leave."""


class Crossings(NamedTuple):
    """Points where a curve crosses straight edges, sorted by edge and parameter.

    Attributes
    ----------
    edge : (k,) int64
        Which edge.
    t : (k,) float64
        Fraction along the edge, 0..1; exactly 0 or 1 where the edge's end lies on the curve.
    piece : (k,) int64
        Which piece of the curve.
    s : (k,) float64
        Fraction along the piece, 0..1.
    """

    edge: Ints
    t: Floats
    piece: Ints
    s: Floats


def curve_edge_crossings(curve: Curve, starts: Floats, ends: Floats) -> Crossings:
    """All crossings of a curve with straight edges.

    An edge's end within ``END_SLACK`` (and rounding) of the curve is on it, for every edge at that node
    alike. An edge that runs along the curve reports nothing (its neighbours report the nodes), nor does one
    that only touches an arc between its ends. A crossing at a vertex of the curve is reported by both pieces.

    Parameters
    ----------
    curve : Curve
    starts, ends : (e, 2) float64, metres

    Returns
    -------
    Crossings
    """
    edge, piece = _candidates(curve, starts, ends)
    p, q = starts[edge], ends[edge] - starts[edge]
    scale = np.maximum(np.abs(p).max(axis=1, initial=0.0), np.abs(curve.points).max())
    slack = END_SLACK * np.hypot(*q.T) + 8.0 * np.finfo(float).eps * scale
    pair, t, s = _line_roots(curve, piece, p, q, slack)
    order = np.lexsort((piece[pair], t, edge[pair]))
    pair, t, s = pair[order], t[order], s[order]
    return Crossings(edge[pair], t, piece[pair], s)


def intersections(first: Curve, second: Curve) -> Floats:
    """(k, 2) Points (metres) common to two curves; where they run along each other, nothing.

    Curves that come within ``TOUCH`` of each other touch there: an end on a side, a vertex on a vertex, and
    tangent arcs are all found. A point that several pieces share is returned once.
    """
    both = np.vstack([first.box, second.box])
    slack = TOUCH * float(np.max(np.ptp(both, axis=0)))
    found = [
        _against_lines(first, second, slack),
        _against_lines(second, first, slack),
        _arcs_with_arcs(first, second, slack),
        _ends_on(first, second, slack),
        _ends_on(second, first, slack),
    ]
    points = np.vstack(found)
    return np.asarray(points[distinct(points, 2.0 * slack)])


def _candidates(curve: Curve, starts: Floats, ends: Floats) -> tuple[Ints, Ints]:
    """((k,), (k,)) Edges and pieces whose boxes overlap, each pair once.

    Long pieces are searched in parts as short as an edge, or a diagonal would meet every edge of the grid.
    """
    import shapely

    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    length = np.hypot(*(ends - starts).T)
    margin = 1e-9 * float(length.max(initial=0.0))
    near = np.flatnonzero(np.all((low <= curve.box[1] + margin) & (high >= curve.box[0] - margin), axis=1))
    if len(near) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    longest = float(np.median(length[near]))
    parts = np.maximum(1, np.ceil(curve.lengths / longest).astype(np.int64))
    fine = curve.subdivided(longest)
    owner = np.repeat(np.arange(len(parts)), parts)
    reach = 0.5 * np.abs(fine.bulges) * fine.chords + margin  # the sagitta of each part
    part_low = np.minimum(fine.points[:-1], fine.points[1:]) - reach[:, None]
    part_high = np.maximum(fine.points[:-1], fine.points[1:]) + reach[:, None]
    near = near[_in_same_bins(low[near], high[near], part_low, part_high)]
    tree = shapely.STRtree(shapely.box(*part_low.T, *part_high.T))
    edge, part = tree.query(shapely.box(*low[near].T, *high[near].T))
    code = np.unique(near[edge] * len(parts) + owner[part])
    return code // len(parts), code % len(parts)


def _in_same_bins(low: Floats, high: Floats, part_low: Floats, part_high: Floats) -> Bools:
    """(e,) Whether boxes share a bin with any part: spares the tree all edges far from the curve."""
    origin = low.min(axis=0)
    width = float(np.max(high - low))
    shape = np.floor((high.max(axis=0) - origin) / width).astype(np.int64) + 2
    marked = np.zeros(shape, dtype=bool)
    first, last = (np.floor((corner - origin) / width).astype(np.int64) for corner in (part_low, part_high))
    span = int(np.max(last - first)) + 1  # a few: parts are hardly longer than an edge
    for i, j in np.ndindex(span, span):
        bins = first + (i, j)
        bins = bins[np.all((bins <= last) & (bins >= 0) & (bins < shape), axis=1)]
        marked[bins[:, 0], bins[:, 1]] = True
    i0, j0 = np.floor((low - origin) / width).astype(np.int64).T
    near = marked[i0, j0] | marked[i0 + 1, j0] | marked[i0, j0 + 1] | marked[i0 + 1, j0 + 1]
    return np.asarray(near)


def _line_roots(
    curve: Curve, piece: Ints, p: Floats, q: Floats, slack: Floats
) -> tuple[Ints, Floats, Floats]:
    """((k,), (k,), (k,)) Pair, t and s where p + t q meets the piece, for (n,) pieces and (n, 2) p and q."""
    u, v, half = _frame(curve, piece, p)
    du, dv, _ = _frame(curve, piece, p + q)
    du, dv = du - u, dv - v
    b = curve.bulges[piece]
    m, k = (1.0 - b**2) / (1.0 + b**2), b / (half * (1.0 + b**2))
    g0 = m * v - k * (u**2 + v**2 - half**2)
    g1 = m * (v + dv) - k * ((u + du) ** 2 + (v + dv) ** 2 - half**2)
    t = _roots(-k * (du**2 + dv**2), m * dv - 2.0 * k * (u * du + v * dv), g0, g1, slack)
    pair, which = np.nonzero((t >= -END_SLACK) & (t <= 1.0 + END_SLACK))
    t = np.clip(t[pair, which], 0.0, 1.0)
    on, s = _along(curve, piece[pair], u[pair] + t * du[pair], v[pair] + t * dv[pair], slack[pair])
    return pair[on], t[on], s[on]


def _frame(curve: Curve, piece: Ints, x: Floats) -> tuple[Floats, Floats, Floats]:
    """((n,), (n,), (n,)) Coordinates u, v of (n, 2) points in the frames of (n,) pieces; half chords."""
    a, b = curve.points[piece], curve.points[piece + 1]
    along = (b - a) / curve.chords[piece][:, None]
    d = x - 0.5 * (a + b)
    u = d[:, 0] * along[:, 0] + d[:, 1] * along[:, 1]
    v = along[:, 0] * d[:, 1] - along[:, 1] * d[:, 0]
    return u, v, 0.5 * curve.chords[piece]


def _roots(a: Floats, b: Floats, g0: Floats, g1: Floats, slack: Floats) -> Floats:
    """(n, 2) Roots of g(t) = a t^2 + b t + g0, nan where there is none; g1 is g(1).

    An end where |g| is within the slack is a root exactly there; an edge along which it stays so has none.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        disc = b**2 - 4.0 * a * g0
        w = -0.5 * (b + np.copysign(np.sqrt(disc), b))  # nan where g never vanishes
        t = np.stack([np.where(a == 0.0, np.nan, w / a), np.where(w == 0.0, np.nan, g0 / w)], axis=1)
        touching = (a != 0.0) & (np.abs(disc) <= 4.0 * np.abs(a) * slack)  # |g| between the roots: disc/4a
    t[touching] = np.nan
    on0, on1 = np.abs(g0) <= slack, np.abs(g1) <= slack
    for column, (on, end) in enumerate(((on0, 0.0), (on1, 1.0))):
        gap = np.where(np.isnan(t), np.inf, np.abs(t - end))
        nearest = np.where(np.isinf(gap).all(axis=1), column, np.argmin(gap, axis=1))
        rows = np.flatnonzero(on)
        t[rows, nearest[rows]] = end
    t[on0 & on1 & (0.25 * np.abs(a) <= slack)] = np.nan
    return t


def _along(curve: Curve, piece: Ints, u: Floats, v: Floats, slack: Floats) -> tuple[Bools, Floats]:
    """((n,), (n,)) Whether points of the whole circle (or line) are on the piece, and their fraction s.

    The fraction follows from the distances to both ends, tan(s angle/2) = ra sin / (rb + ra cos), which
    loses nothing for flat arcs.
    """
    b, half = curve.bulges[piece], 0.5 * curve.chords[piece]
    ra, rb = np.hypot(u + half, v), np.hypot(u - half, v)
    # Flat arcs: inside the disc on the chord (ill-conditioned at a semicircle); others: on their side of it.
    inside = np.where(np.abs(b) <= 0.5, u**2 + v**2 <= half**2, v * np.sign(b) <= 0.0)
    on = inside | (np.minimum(ra, rb) <= 2.0 * slack)
    h = 0.5 * curve.angles[piece]
    flat = b == 0.0
    safe = np.where(flat, 1.0, h)
    bent = np.arctan2(ra * np.abs(np.sin(safe)), rb + ra * np.cos(safe)) / np.abs(safe)
    s = np.clip(np.where(flat, ra / (ra + rb), bent), 0.0, 1.0)
    return on, np.where(ra <= slack, 0.0, np.where(rb <= slack, 1.0, s))


def _box_pairs(first: Curve, second: Curve, slack: float) -> tuple[Ints, Ints]:
    """((k,), (k,)) Pieces of two curves whose boxes overlap."""
    import shapely

    boxes = []
    for curve in (first, second):
        reach = np.where(np.abs(curve.bulges) > 1.0, 1.0, 0.5) * np.abs(curve.bulges) * curve.chords + slack
        low = np.minimum(curve.points[:-1], curve.points[1:]) - reach[:, None]
        high = np.maximum(curve.points[:-1], curve.points[1:]) + reach[:, None]
        boxes.append(shapely.box(*low.T, *high.T))
    a, b = shapely.STRtree(boxes[1]).query(boxes[0])
    return np.asarray(a, dtype=np.int64), np.asarray(b, dtype=np.int64)


def _against_lines(curve: Curve, other: Curve, slack: float) -> Floats:
    """(k, 2) Points where any piece of a curve meets the straight pieces of another."""
    a, b = _box_pairs(curve, other, slack)
    straight = other.bulges[b] == 0.0
    a, b = a[straight], b[straight]
    p, q = other.points[b], other.points[b + 1] - other.points[b]
    pair, t, _ = _line_roots(curve, a, p, q, np.full(len(a), slack))
    crossing = p[pair] + t[:, None] * q[pair]
    return np.vstack([crossing, _tangent_points(curve, a, p, q, slack)])


def _tangent_points(curve: Curve, piece: Ints, p: Floats, q: Floats, slack: float) -> Floats:
    """(k, 2) Points where arcs touch lines p..p+q from one side."""
    bent = curve.bulges[piece] != 0.0
    piece, p, q = piece[bent], p[bent], q[bent]
    centre = arc_centre(curve.points[piece], curve.points[piece + 1], curve.bulges[piece])
    radius = np.hypot(*(curve.points[piece] - centre).T)
    t = np.sum((centre - p) * q, axis=1) / np.sum(q * q, axis=1)
    foot = p + t[:, None] * q
    hit = (np.abs(np.hypot(*(foot - centre).T) - radius) <= slack) & (t >= 0.0) & (t <= 1.0)
    u, v, _ = _frame(curve, piece, foot)
    on, _ = _along(curve, piece, u, v, np.full(len(piece), slack))
    return np.asarray(foot[hit & on])


def _arcs_with_arcs(first: Curve, second: Curve, slack: float) -> Floats:
    """(k, 2) Points where arcs of two curves meet."""
    a, b = _box_pairs(first, second, slack)
    bent = (first.bulges[a] != 0.0) & (second.bulges[b] != 0.0)
    a, b = a[bent], b[bent]
    ca = arc_centre(first.points[a], first.points[a + 1], first.bulges[a])
    cb = arc_centre(second.points[b], second.points[b + 1], second.bulges[b])
    ra, rb = np.hypot(*(first.points[a] - ca).T), np.hypot(*(second.points[b] - cb).T)
    d = np.hypot(*(cb - ca).T)
    apart = (d > slack) & (d <= ra + rb + slack) & (d >= np.abs(ra - rb) - slack)
    a, b, ca, cb, ra, rb, d = (x[apart] for x in (a, b, ca, cb, ra, rb, d))
    along = 0.5 * (d + (ra - rb) * (ra + rb) / d)
    square = ra**2 - along**2
    touch = (np.abs(d - ra - rb) <= slack) | (np.abs(d - np.abs(ra - rb)) <= slack)
    across = np.where(touch, 0.0, np.sqrt(np.maximum(square, 0.0)))
    e = (cb - ca) / d[:, None]
    foot, normal = ca + along[:, None] * e, np.column_stack([-e[:, 1], e[:, 0]])
    points = np.vstack([foot + across[:, None] * normal, foot - across[:, None] * normal])
    a, b = np.tile(a, 2), np.tile(b, 2)
    on = np.ones(len(points), dtype=bool)
    for curve, piece in ((first, a), (second, b)):
        u, v, _ = _frame(curve, piece, points)
        on &= _along(curve, piece, u, v, np.full(len(piece), slack))[0]
    return np.asarray(points[on])


def _ends_on(curve: Curve, other: Curve, slack: float) -> Floats:
    """(k, 2) Free ends of an open curve that lie on another one, also where the two run along each other."""
    if curve.closed:
        return np.zeros((0, 2))
    ends = np.repeat(curve.points[[0, -1]], len(other.bulges), axis=0)
    piece = np.tile(np.arange(len(other.bulges)), 2)
    u, v, half = _frame(other, piece, ends)
    b = other.bulges[piece]
    g = ((1.0 - b**2) * v - b * (u**2 + v**2 - half**2) / half) / (1.0 + b**2)
    on, _ = _along(other, piece, u, v, np.full(len(piece), slack))
    return np.asarray(ends[on & (np.abs(g) <= slack)])


def distinct(points: Floats, gap: float) -> Ints:
    """(k,) Numbers of the points that have no earlier kept one within ``gap``."""
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return np.arange(len(points))
    keep = np.ones(len(points), dtype=bool)
    pairs = cKDTree(points).query_pairs(gap, output_type="ndarray")  # first < second
    for first, second in pairs[np.argsort(pairs[:, 1], kind="stable")]:
        keep[second] &= not keep[first]
    return np.flatnonzero(keep)
