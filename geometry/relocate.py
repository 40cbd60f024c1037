"""Node relocation (paper, Fig. 11): grid nodes very close to a curve are moved onto it.

The cut then passes through the node and leaves no sliver, so no phantom node hangs on a fraction of a cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid, scaled_jacobians
from phantomnode.geometry.intersect import END_SLACK, distinct, intersections
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.near import near_part

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ON_CURVE = 1e-9
"""A node this close to a curve, in units of its h, was meant to be on it and is not moved off it."""

FEATURE_REACH = 1.5
"""Feature points attract nodes from this many times the distance of the rest of a curve."""

QUALITY_FLOOR = 0.3
QUALITY_LOSS = 0.8
"""A move may take a cell's least scaled Jacobian down to the floor or to this part of what it was."""


class Fate(NamedTuple):
    """What became of (k,) nodes.

    Attributes
    ----------
    moved : bool
        Whether a node has left its place (by more than 1e-9 h: rounding is mended without notice).
    on_curve : int64
        The curve on which it now lies (the first of several), -1 if none.
    feature : bool
        Whether it lies on a feature point: a sharp corner, a free end, a point common to two curves.
    """

    moved: Bools
    on_curve: Ints
    feature: Bools


@dataclass(frozen=True)
class Relocation:
    """A grid with relocated nodes.

    Attributes
    ----------
    grid : BackgroundGrid
        Same cells, new node positions.
    nodes : (k,) int64
        The nodes in the part of the grid near the curves, ascending.
    fate : Fate
        What became of them; all others stayed and are on no curve.
    """

    grid: BackgroundGrid
    nodes: Ints
    fate: Fate

    @cached_property
    def moved(self) -> Bools:
        """(n,) Whether each node of the grid has moved, as in :class:`Fate`."""
        return self._of_all(self.fate.moved, False)

    @cached_property
    def on_curve(self) -> Ints:
        """(n,) The curve on which each node now lies, as in :class:`Fate`."""
        return self._of_all(self.fate.on_curve, -1)

    @cached_property
    def feature(self) -> Bools:
        """(n,) Whether each node is on a feature point, as in :class:`Fate`."""
        return self._of_all(self.fate.feature, False)

    def _of_all(self, values: NDArray[Any], others: int | bool) -> NDArray[Any]:
        """(n,) Values of the nodes near curves, and the one of all others."""
        every = np.full(self.grid.node_count, others)
        every[self.nodes] = values
        return every


@dataclass(frozen=True)
class _Nearness:
    """What each node is near to: (n,) the curve it is on, or -1; (n,) the only one it is near, or -1;
    (n, 2) the closest point of either.
    """

    on: Ints
    near: Ints
    target: Floats


def relocate(grid: BackgroundGrid, curves: Sequence[Curve], distance: float = 0.1) -> Relocation:
    """Move the nodes closest to curves onto them.

    With h the shortest cell edge at a node: the nearest node within 1.5 ``distance`` h of a feature point
    goes there; any other node within ``distance`` h of exactly one curve goes to its closest point. A node
    that is on a curve already leaves it for nothing, and moves along it to features only. Moves that
    would take the least scaled Jacobian of a cell below min(0.3, 0.8 of what it was) are not made.

    Parameters
    ----------
    grid : BackgroundGrid
    curves : sequence of Curve
        The loops of the body's regions, then its interfaces.
    distance : float
        In units of h, at least 0 (nothing moves but what rounding left beside a curve) and below 0.5.

    Returns
    -------
    Relocation

    Raises
    ------
    GeometryError
        For a distance out of bounds.
    """
    if not 0.0 <= distance < 0.5:
        raise GeometryError(f"the relocation distance must be at least 0 and below 0.5 cells, not {distance}")
    part = near_part(grid, curves)
    xy, fate = _relocated(part.grid, curves, distance)
    away = np.any(xy != part.grid.xy, axis=1)
    return Relocation(grid.moved(part.nodes[away], xy[away]), part.nodes, fate)


def _relocated(grid: BackgroundGrid, curves: Sequence[Curve], distance: float) -> tuple[Floats, Fate]:
    """The nodes of the part of a grid near curves: (n, 2) where they go, metres, and what becomes of them."""
    h = np.where(np.isfinite(grid.node_size), grid.node_size, 0.0)  # a node of no cell stays
    points, owner = feature_points(curves)
    nearness = _nearness(grid, curves, h, distance)
    taken = _features_taken(grid, curves, points, h, distance, nearness)

    target, on_curve = grid.xy.copy(), nearness.on.copy()
    plain = (nearness.on >= 0) | (nearness.near >= 0)
    plain &= ~_close_to(nearness.target, points, ON_CURVE * h)
    plain[taken >= 0] = False
    target[plain] = nearness.target[plain]
    target[taken >= 0] = points[taken[taken >= 0]]
    moved = _allowed(grid, target, taken >= 0)

    xy = np.where(moved[:, None], target, grid.xy)
    at_feature = (taken >= 0) & np.all(xy == target, axis=1)
    gone = moved & plain & (nearness.on < 0)
    on_curve[gone] = nearness.near[gone]
    on_curve[at_feature] = owner[taken[at_feature]]
    left = np.hypot(*(xy - grid.xy).T) > ON_CURVE * h
    return xy, Fate(left, on_curve, at_feature)


def feature_points(curves: Sequence[Curve]) -> tuple[Floats, Ints]:
    """((k, 2), (k,)) Sharp corners, free ends, common points of curves, each once; the first curve there."""
    points = [np.zeros((0, 2))]
    for curve in curves:
        corners = curve.points[:-1][curve.corners[:-1]] if curve.closed else curve.points[curve.corners]
        points.append(corners)
    for k, curve in enumerate(curves):
        for other in curves[k + 1 :]:
            if np.all(curve.box[0] <= other.box[1]) and np.all(other.box[0] <= curve.box[1]):
                points.append(intersections(curve, other))
    every = np.vstack(points)
    if len(every) == 0:
        return every, np.zeros(0, np.int64)
    size = max(float(np.ptp(curve.box, axis=0).max()) for curve in curves)
    every = every[distinct(every, ON_CURVE * size)]  # corners come first and are exact
    owner = np.full(len(every), -1)
    for k, curve in enumerate(curves):
        here = np.abs(LevelSet.of_curve(curve).distance(every)) <= ON_CURVE * size
        owner[here & (owner < 0)] = k
    return every, owner


def _nearness(grid: BackgroundGrid, curves: Sequence[Curve], h: Floats, distance: float) -> _Nearness:
    """Which curve each node is on or near.

    A node near two curves is near none (between them it would be moved arbitrarily) unless they run along
    each other there, which is one curve to it.
    """
    n = len(grid.xy)
    on, near = np.full(n, -1), np.full(n, -1)
    target, several = grid.xy.copy(), np.zeros(n, dtype=bool)
    for k, curve in enumerate(curves):
        reach = max(distance, ON_CURVE) * h[:, None]
        inside = np.all((grid.xy >= curve.box[0] - reach) & (grid.xy <= curve.box[1] + reach), axis=1)
        nodes = np.flatnonzero(inside)
        found = LevelSet.of_curve(curve).query(grid.xy[nodes])
        gap = np.abs(found.distance)
        on_it = gap <= ON_CURVE * h[nodes]
        near_it = gap < distance * h[nodes]
        same = np.hypot(*(found.point - target[nodes]).T) <= ON_CURVE * h[nodes]
        several[nodes[near_it & (near[nodes] >= 0) & ~same]] = True
        first = nodes[near_it & (near[nodes] < 0)]
        near[first] = k
        fresh = (near_it & (near[nodes] == k) & (on[nodes] < 0)) | (on_it & (on[nodes] < 0))
        target[nodes[fresh]] = found.point[fresh]
        # What rounding leaves is not worth a move: crossings take the node as on the curve.
        rounding = END_SLACK * h[nodes] + 8.0 * np.finfo(float).eps * np.abs(grid.xy[nodes]).max(axis=1)
        exact = nodes[fresh & on_it & (gap <= rounding)]
        target[exact] = grid.xy[exact]
        on[nodes[on_it & (on[nodes] < 0)]] = k
    near[several | (on >= 0)] = -1
    return _Nearness(on, near, target)


def _features_taken(
    grid: BackgroundGrid,
    curves: Sequence[Curve],
    points: Floats,
    h: Floats,
    distance: float,
    nearness: _Nearness,
) -> Ints:
    """(n,) The feature point to which each node goes, -1 if none: the closest pairs first, each once."""
    taken = np.full(len(grid.xy), -1)
    node, feature, gap = _pairs_within(grid.xy, points, FEATURE_REACH * max(distance, ON_CURVE) * h)
    # A node on a curve keeps to it.
    along = np.ones(len(node), dtype=bool)
    for k, curve in enumerate(curves):
        bound = np.flatnonzero(nearness.on[node] == k)
        if len(bound):
            off = np.abs(LevelSet.of_curve(curve).distance(points[feature[bound]]))
            along[bound] = off <= ON_CURVE * h[node[bound]]
    node, feature, gap = node[along], feature[along], gap[along]
    free = np.ones(len(points), dtype=bool)
    for i in np.lexsort((node, gap)):
        if taken[node[i]] < 0 and free[feature[i]]:
            taken[node[i]] = feature[i]
            free[feature[i]] = False
    return taken


def _pairs_within(xy: Floats, points: Floats, reach: Floats) -> tuple[Ints, Ints, Floats]:
    """((k,), (k,), (k,)) Nodes and points not farther apart than the node's (n,) reach, and how far."""
    from scipy.spatial import cKDTree

    if len(points) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    low, high = points.min(axis=0) - reach[:, None], points.max(axis=0) + reach[:, None]
    nodes = np.flatnonzero(np.all((xy >= low) & (xy <= high), axis=1))
    balls = cKDTree(points).query_ball_point(xy[nodes], reach[nodes])
    feature = np.array([f for ball in balls for f in ball], dtype=np.int64)
    node = np.repeat(nodes, [len(ball) for ball in balls])
    return node, feature, np.hypot(*(xy[node] - points[feature]).T)


def _close_to(xy: Floats, points: Floats, reach: Floats) -> Bools:
    """(n,) Whether each of (n, 2) places has one of the (k, 2) points within its reach (n,)."""
    node, _, _ = _pairs_within(xy, points, reach)
    close = np.zeros(len(xy), dtype=bool)
    close[node] = True
    return close


def _allowed(grid: BackgroundGrid, target: Floats, to_feature: Bools) -> Bools:
    """(n,) Which nodes may move to their target without spoiling a cell.

    Moves of spoilt cells are taken back, those to features last, until every touched cell is fit.
    """
    moved = np.any(target != grid.xy, axis=1)
    cells = np.flatnonzero(moved[grid.quads].any(axis=1))
    quads = grid.quads[cells]
    before = scaled_jacobians(grid.xy, quads).min(axis=1)
    least = np.minimum(QUALITY_FLOOR, QUALITY_LOSS * before)
    while True:
        xy = np.where(moved[:, None], target, grid.xy)
        touched = moved[quads].any(axis=1)
        spoilt = quads[touched & (scaled_jacobians(xy, quads).min(axis=1) < least)]
        if len(spoilt) == 0:
            return np.asarray(moved)
        plain = moved[spoilt] & ~to_feature[spoilt]
        only_features = ~plain.any(axis=1)
        moved[spoilt[plain]] = False
        moved[spoilt[only_features].ravel()] = False
