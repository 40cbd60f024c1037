"""Sharp corners and narrow roundings of the surfaces of a contact pair as points of contact of their own.

Slave points stand between the ends of the segments: a corner of the master sinks in between two of them before any
is felt, and a corner of the slave goes a fifth of a cell deep before its nearest point touches. Corners are
therefore points as well, those of either surface against the other. They are felt from a small depth on only: where
surfaces lie flat on each other the other points bear all, so that a constant pressure stays constant. To a slave of
coarse cells a rounding of the master, or all of a pin, is such a corner: between two points a body could pass it.

The tip of a wedge in a flat face is pushed back along the normal of the face, by its corner. A slave point that
stands in the tip would be pushed out through a flank instead, aside: with a sharp tip twice as hard as back. For all
other points corners of the master are therefore cut off, .15 of a cell before the tip. Its ends are rounded:
a point of a face that lies on a flank and slides past its end would be pushed aside at once.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from phantomnode.geometry.bilinear import shape
from phantomnode.pipeline.bodies import CutBody
from phantomnode.pipeline.contact_tables import SlavePoints
from phantomnode.pipeline.pairing import (
    NOBODY,
    ContactPass,
    MasterSide,
    SlaveSide,
    master_side,
    point_rule,
    previous_of,
)
from phantomnode.pipeline.rigid import Rigid
from phantomnode.pipeline.surfaces import Surface, closed_surface
from phantomnode.pipeline.turning import sharp, sharp_or_narrow

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WEIGHT = 0.07
"""Of a corner, in cells of the slave: a heavier one shortens the step where cells are cut small, a lighter one sinks
in until other points meet the master beside it."""

ALLOWED = 0.01
"""Depth, in the smaller cells of the two sides, up to which a corner feels nothing: in equal cells what a pressure of
E/20 takes at the automatic penalty, 5 E/h."""

CUT_OFF = 0.19
"""Of the smaller cell of the two sides: how far before a corner it is cut off on either side."""

BESIDE = 0.9
"""Of the way from the end of a segment to its first slave point, which no cut reaches, so that flat faces of equal
width bear each other to their ends."""

MOST = 0.45
"""Of the way to the next corner that may be cut off: it is cut off, too."""

PARTS = (0.8, 0.12, 0.08)
"""Of the depth, by which corners are cut off one time after the other: of 135 degrees 17 are left at each vertex."""

ALMOST = 0.98
"""Of a segment: what is left of it when more is cut off is not worth a segment."""

FLAT = 1e-6
"""Lines whose directions differ by less do not cross."""

Piece = tuple[Ints, Floats, Floats]
"""A segment: its four nodes and the shape functions at its ends."""

SHARING = 1.5
"""Corners that are nearer to each other than this, in cells of the slave, share the weight of one: others can stand
in different cells."""

MEETING = 3.0
"""Corners that are nearer to each other than this, in diagonals of the largest cell on the other surface, can stand
on one node: the cells around it take two, and surfaces move towards each other."""


class CornerPoints(NamedTuple):
    """Sharp corners that stick out of a surface, and vertices of narrow roundings.

    nodes (c, 4), shape (c, 4) at the corner, place (c, 2), m; rounding (c,): the number that the vertices of one
    rounding have in common, its own for every sharp corner.
    """

    nodes: Ints
    shape: Floats
    place: Floats
    rounding: Ints


def with_corners(
    passes: list[ContactPass],
    slave: Surface,
    master: Surface | Rigid,
    cut: dict[str, CutBody],
    first_node: dict[str, int],
    points: SlavePoints,
    penalties: tuple[float, float],
) -> list[ContactPass]:
    """The passes of a pair with corners cut off their masters, and behind them those of the corners.

    First the corners of the master against the slave, then those of the slave against the master.

    Parameters
    ----------
    passes : list of ContactPass
        That of the slave's points against the master, and the other way round where there are two.
    slave, master : Surface, Surface or Rigid
        Of different bodies.
    cut, first_node : dict
        The cut bodies by name, and where their nodes begin in the model.
    points : SlavePoints
        The rule by which segments are divided.
    penalties : (float, float), Pa/m
        The normal and the tangential one of the corners.
    """
    body, main, found = cut[slave.body], passes[0], []
    cell = body.grid.typical_size
    fine = cell if isinstance(master, Rigid) else min(cell, cut[master.body].grid.typical_size)
    depth = cut_depth(fine, points)
    spacing = widest_gap(points) * cell if len(passes) == 1 else 0.0  # else the master has points, too
    for each, side in zip(passes, (master, slave), strict=False):
        if isinstance(side, Rigid):
            xy, first = side.xy, side.nodes.start
        else:
            xy, first = cut[side.body].mesh.xy, first_node[side.body]
        found.append(replace(each, master=rounded_off(each.master, xy, first, depth)))
    if isinstance(master, Rigid):
        theirs, widest = rigid_corners(master, spacing), 0.0
    else:
        other = cut[master.body]
        closed = closed_surface(other.mesh.segments, master.segments, NOBODY)
        theirs = body_corners(other, closed, first_node[master.body], spacing)
        widest = _widest(other, closed)
    if len(theirs.nodes):
        around = closed_surface(body.mesh.segments, slave.segments, NOBODY)
        surface = master_side(around, body, first_node[slave.body], points)
        reach = _widest(body, around)
        found.append(_one_pass(main, theirs, surface, cell, reach, penalties, -1.0, ALLOWED * fine))
    mine = body_corners(body, slave.segments, first_node[slave.body])
    if len(mine.nodes):
        found.append(_one_pass(main, mine, main.master, cell, widest, penalties, 1.0, ALLOWED * fine))
    return found


def widest_gap(points: SlavePoints) -> float:
    """The widest gap between neighbouring slave points by a rule, in segments."""
    at, _ = point_rule(points)
    return float(np.max(np.diff([*at, 1.0 + at[0]])))


def rigid_corners(rigid: Rigid, spacing: float = 0.0) -> CornerPoints:
    """Those of an obstacle, for points of another surface that stand so far apart, m."""
    found, rounding = sharp_or_narrow(rigid.xy[rigid.segments], rigid.following, spacing)
    at = rigid.segments[found, 1]
    nodes = np.repeat(at[:, None] + rigid.nodes.start, 4, axis=1)
    return CornerPoints(nodes, np.repeat(np.eye(4)[:1], len(at), axis=0), rigid.xy[at], rounding)


def body_corners(body: CutBody, chosen: Ints, first_node: int, spacing: float = 0.0) -> CornerPoints:
    """Those at an end of any of the chosen segments of a body, by their numbers (s,) in ``mesh.segments``.

    ``spacing`` as for :func:`rigid_corners`.
    """
    mesh, segments = body.mesh, body.mesh.segments
    at, rounding = sharp_or_narrow(segments.ends, segments.following, spacing)
    mine = np.isin(at, chosen) | np.isin(segments.following[at], chosen)
    at, rounding = at[mine], rounding[mine]
    nodes = mesh.nodes(segments.element[at]) + first_node
    return CornerPoints(nodes, shape(segments.local[at, 1]), segments.ends[at, 1], rounding)


def rounded_off(side: MasterSide, xy: Floats, first_node: int, depth: float) -> MasterSide:
    """The masters with sharp corners cut off, and then those that the cuts make, within a depth of the corner, m.

    A slave point that slides past a corner is turned little by little. Parameters are those of :func:`cut_off`.
    """
    for part in PARTS:
        side = cut_off(side, xy, first_node, part * depth)
    return side


def cut_off(side: MasterSide, xy: Floats, first_node: int, depth: float) -> MasterSide:
    """The masters with sharp corners cut off by a segment more for each, or by two where cells meet at the corner.

    Parameters
    ----------
    side : MasterSide
    xy : (n, 2) float64, metres
        Nodes of its body or obstacle in the reference configuration.
    first_node : int
        Number of the first of them in the side.
    depth : float, m
        How far before a corner on either side; less where a segment is short. 0 leaves corners as they are.
    """
    x = xy[side.nodes - first_node]
    ends = np.stack([np.einsum("si,sia->sa", at, x) for at in (side.start, side.end)], axis=1)
    length, corners = np.hypot(*(ends[:, 1] - ends[:, 0]).T), sharp(ends, side.following)
    start, end, following = side.start.copy(), side.end.copy(), side.following.tolist()
    new, before, gone = list[Piece](), list[int](), np.zeros(len(length), dtype=bool)
    backward = side.previous.copy()
    backward[side.following[corners]] = -1  # no way leads over another corner
    onward = side.following.copy()
    onward[corners] = -1
    for s in corners if depth > 0.0 else ():
        ways = [(int(k), links) for k, links in ((s, backward), (side.following[s], onward))]
        deep = min(depth, *(MOST * _straight(k, depth / MOST, length, links) for k, links in ways))
        for far in (True, False):  # over several cells, or, where no segment can join those, within one
            (a, back, passed), (b, on, skipped) = (
                _way(k, deep, length, side.nodes, links, far) for k, links in ways
            )
            first = (1.0 - back) * side.end[a] + back * side.start[a]
            last = (1.0 - on) * side.start[b] + on * side.end[b]
            pieces = _bridge(side, x, (a, first), (b, last))
            if pieces:
                break
        if not pieces or a == b or gone[[a, b]].any():
            continue
        gone[passed + skipped] = True
        end[a], start[b], following[a] = first, last, len(following)
        following += [*range(len(following) + 1, len(following) + len(pieces)), b]
        before += [a] * len(pieces)
        new += pieces
    if not new:
        return side
    nodes, starts, ends_of_new = zip(*new, strict=True)
    kept = np.append(~gone, np.ones(len(new), dtype=bool))
    number = np.append(np.cumsum(kept) - 1, -1)  # the last stands for "no neighbour"
    links = number[np.array(following, dtype=np.int64)[kept]]
    return MasterSide(
        nodes=np.concatenate([side.nodes, nodes])[kept],
        start=np.concatenate([start, starts])[kept],
        end=np.concatenate([end, ends_of_new])[kept],
        previous=previous_of(links),
        following=links,
        place=np.concatenate([side.place, side.place[before]])[kept],
    )


def _straight(at: int, enough: float, length: Floats, links: Ints) -> float:
    """The length of a way from a corner to the next one or a free end, m, or more than what is enough."""
    total = 0.0
    while at >= 0 and total < enough:
        total, at = total + length[at], int(links[at])
    return total


def _way(
    at: int, depth: float, length: Floats, nodes: Ints, links: Ints, far: bool
) -> tuple[int, float, list[int]]:
    """Where a way of ``depth`` from a corner ends: the segment, the part of it that is gone, and those passed.

    It leaves something of the last of them, and leaves the cell of the corner only if it may go ``far``.
    """
    passed: list[int] = []
    while depth > ALMOST * length[at]:
        beyond = int(links[at])
        if beyond < 0 or not (far or np.array_equal(nodes[beyond], nodes[at])):
            return at, MOST, passed
        passed.append(at)
        depth, at = max(depth - length[at], 0.0), beyond
    return at, depth / length[at], passed


def _bridge(side: MasterSide, x: Floats, one: tuple[int, Floats], other: tuple[int, Floats]) -> list[Piece]:
    """The segments between a point before a corner and one behind it, (number of a segment, shape) each.

    One where four nodes carry both. Points in two cells beside each other are joined where the way between them
    crosses the edge that the cells have in common; where it does not, there is none.
    """
    (s, first), (n, last) = one, other
    joined = _on_common_nodes((side.nodes[s], first), (side.nodes[n], last))
    if joined is not None:
        return [joined]
    common = [(i, int(k)) for i in range(4) for k in np.flatnonzero(side.nodes[n] == side.nodes[s, i])]
    if len(common) != 2:
        return []
    (i, k), (j, m) = common
    a, b, low, high = first @ x[s], last @ x[n], x[s, i], x[s, j]
    matrix = np.column_stack([high - low, a - b])  # low + t (high - low) = a + u (b - a)
    if abs(np.linalg.det(matrix)) < FLAT * np.abs(matrix).max() ** 2:
        return []
    t, u = np.linalg.solve(matrix, a - low)
    if not (0.0 <= t <= 1.0 and 0.0 < u < 1.0):
        return []
    unit = np.eye(4)
    here, there = ((1.0 - t) * unit[p] + t * unit[q] for p, q in ((i, j), (k, m)))
    return [(side.nodes[s], first, here), (side.nodes[n], there, last)]


def _on_common_nodes(one: tuple[Ints, Floats], other: tuple[Ints, Floats]) -> Piece | None:
    """A segment between two points with their four nodes each on the same four nodes; None where they have more."""
    used = np.unique(np.concatenate([nodes[values != 0.0] for nodes, values in (one, other)]))
    if len(used) > 4:
        return None
    nodes = np.concatenate([used, np.repeat(used[-1:], 4 - len(used))])
    shapes = np.zeros((2, 4))
    for row, (own, values) in zip(shapes, (one, other), strict=True):
        np.add.at(row, np.searchsorted(used, own[values != 0.0]), values[values != 0.0])
    return nodes, shapes[0], shapes[1]


def cut_depth(cell: float, points: SlavePoints) -> float:
    """How far before a corner it is cut off, m, for slave points by a rule on segments of about a cell, m."""
    return float(min(CUT_OFF, BESIDE * point_rule(points)[0][0]) * cell)


def _one_pass(
    main: ContactPass,
    corners: CornerPoints,
    surface: MasterSide,
    cell: float,
    widest: float,
    penalties: tuple[float, float],
    sign: float,
    allowed: float,
) -> ContactPass:
    """Corners against a surface, at the full penalty: no other points stand where they stand.

    ``cell`` is that of the slave, ``widest`` the longest diagonal of the cells on the surface, m; the corners feel
    nothing up to the depth ``allowed``, m.
    """
    weight, crowd = _shared(corners, cell, MEETING * widest)
    return replace(
        main,
        slave=_lone_points(corners, weight),
        master=surface,
        penalty=penalties[0],
        tangential_penalty=penalties[1],
        sign=sign,
        crowd=crowd,
        allowed=allowed,
    )


def _shared(corners: CornerPoints, cell: float, meeting: float) -> tuple[Floats, float]:
    """(c,) Weights of corners, m, and a bound on those of all that are no farther apart than ``meeting``, m.

    A corner that is alone weighs a part of the cell, m, of the slave. Corners beside each other share that, and so do
    the vertices of a rounding, which count as one corner in their middle.
    """
    _, number, count = np.unique(corners.rounding, return_inverse=True, return_counts=True)
    middle = np.column_stack([np.bincount(number, axis) / count for axis in corners.place.T])
    radius = np.zeros(len(count))
    np.maximum.at(radius, number, np.hypot(*(corners.place - middle[number]).T))
    tree = cKDTree(middle)
    total = WEIGHT * cell / tree.query_ball_point(middle, SHARING * cell, return_length=True)
    crowd = 0.0
    for i in range(len(count)):  # one by one: all lists of thousands of teeth would fill the memory
        near = tree.query_ball_point(middle[i], meeting + radius[i] + radius.max())
        apart = np.hypot(*(middle[near] - middle[i]).T)
        crowd = max(crowd, float(total[near] @ (apart <= meeting + radius[i] + radius[near])))
    return np.asarray((total / count)[number], dtype=np.float64), crowd


def _lone_points(corners: CornerPoints, weight: Floats) -> SlaveSide:
    """Corners as slave points without segments, (c,) weights in m."""
    count = len(weight)
    none, nothing = np.zeros((0, 4)), np.zeros(0)
    return SlaveSide(
        nodes=np.zeros((0, 4), dtype=np.int64),
        start=none,
        end=none,
        points=corners.nodes,
        point_shape=corners.shape,
        weight=weight,
        jump=np.ones(count),
        place=np.column_stack([np.full(count, -1.0), np.zeros(count)]),
        half_way=nothing,
        whole=nothing,
        middle=corners.place,
    )


def _widest(body: CutBody, chosen: Ints) -> float:
    """The longest diagonal of the cells on a surface, m."""
    mesh = body.mesh
    x = mesh.xy[mesh.nodes(mesh.segments.element[chosen])]
    return float(np.max(np.linalg.norm(x[:, :2] - x[:, 2:], axis=2)))
