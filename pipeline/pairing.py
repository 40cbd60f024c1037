"""The two sides of contact pairs as arrays: slave points on segments of a body, master segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.geometry.doubling import BoundarySegments
from phantomnode.pipeline.bodies import CutBody
from phantomnode.pipeline.contact_tables import SlavePoints
from phantomnode.pipeline.surfaces import Surface, closed_surface
from phantomnode.pipeline.traces import balanced, traces
from phantomnode.solver.model import Contact

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Number = TypeVar("Number", bound=np.generic)


def point_rule(points: SlavePoints) -> tuple[Floats, Floats]:
    """Places of the slave points on a segment, (n,) in 0..1, and their parts of its length, (n,).

    Newton-Cotes points of one a segment stand in its middle; more are equally spaced from end to end.
    """
    if points.rule == "gauss" and points.count == 2:
        # In closed form: numpy's places are off by an ulp, and so not symmetric about the middle.
        return 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0), np.array([0.5, 0.5])
    if points.rule == "gauss" or points.count == 1:
        places, weights = np.polynomial.legendre.leggauss(points.count)
        return 0.5 + 0.5 * places, 0.5 * weights
    from scipy.integrate import newton_cotes  # slow to import, rarely needed

    weights, _ = newton_cotes(points.count - 1, 1)
    return np.linspace(0.0, 1.0, points.count), np.asarray(weights) / (points.count - 1)


@dataclass(frozen=True)
class SlaveSide:
    """Slave points of one pass, in nodes of the model.

    Attributes
    ----------
    nodes : (s, 4) int64
        Nodes of the parent element of each slave segment.
    start, end : (s, 4) float64
        Shape functions at its ends.
    points, point_shape, weight : (g, 4) int64, (g, 4) float64, (g,) float64
        Nodes, shape functions and reference length, m, of the slave points, segment by segment.
    place : (g, 2) float64
        Number of the curve on which each point lies and the distance along it, m.
    half_way, whole : (s,) float64
        Distance along its curve of the middle of each segment, and length of that curve, infinite where it is
        open, m.
    middle : (g, 2) float64
        Middle of the segment of each point in the reference configuration, m, for messages.
    """

    nodes: Ints
    start: Floats
    end: Floats
    points: Ints
    point_shape: Floats
    weight: Floats
    place: Floats
    half_way: Floats
    whole: Floats
    middle: Floats


@dataclass(frozen=True)
class MasterSide:
    """Master segments of one pass, in nodes of the model.

    Attributes
    ----------
    nodes, start, end : (m, 4)
        Nodes that carry each segment, and shape functions at its ends.
    previous, following : (m,) int64
        Neighbours of the segments within the pass, -1 at a free end.
    place : (m, 4) float64
        As ``master_place`` of :class:`phantomnode.solver.model.Contact`.
    """

    nodes: Ints
    start: Floats
    end: Floats
    previous: Ints
    following: Ints
    place: Floats


@dataclass(frozen=True)
class ContactPass:
    """Points of one surface against segments of another.

    Attributes
    ----------
    pair : int
        Number of the pair, to which one or two passes belong.
    slave : SlaveSide
    master : MasterSide
    penalty, tangential_penalty : float, Pa/m
    friction : float
        Coulomb's coefficient.
    reach : float, m
    exclusion : float, m
        Distance along its own curve within which a point sees nothing; 0 but in self contact.
    """

    pair: int
    slave: SlaveSide
    master: MasterSide
    penalty: float
    tangential_penalty: float
    friction: float
    reach: float
    exclusion: float


def slave_side(surface: Surface, body: CutBody, first_node: int, points: SlavePoints) -> SlaveSide:
    """The slave points on the segments of a surface."""
    mesh = body.mesh
    segments, chosen = mesh.segments, surface.segments
    _, share = point_rule(points)
    at = places_on(segments, chosen, points)
    parents, ends = segments.element[chosen], segments.ends[chosen]
    places = (1.0 - at)[:, :, None] * ends[:, None, 0] + at[:, :, None] * ends[:, None, 1]
    owners = np.repeat(mesh.elements[parents], points.count, axis=0)
    point_shape = shape(to_local(mesh.xy[owners], places.reshape(-1, 2))).reshape(-1, points.count, 4)
    point_shape = balanced(point_shape, mesh.xy[mesh.elements[parents]], ends, at, share)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    curve, along, whole = distance_along(segments)
    start = along[chosen]
    return SlaveSide(
        nodes=mesh.elements[parents] + first_node,
        start=shape(segments.local[chosen, 0]),
        end=shape(segments.local[chosen, 1]),
        points=owners + first_node,
        point_shape=point_shape.reshape(-1, 4),
        weight=(length[:, None] * share).reshape(-1),
        place=np.column_stack(
            [np.repeat(curve[chosen], points.count), (start[:, None] + length[:, None] * at).reshape(-1)]
        ),
        half_way=start + 0.5 * length,
        whole=whole[chosen],
        middle=np.repeat(ends.mean(axis=1), points.count, axis=0),
    )


def places_on(segments: BoundarySegments, chosen: Ints, points: SlavePoints) -> Floats:
    """(s, n) Places of the slave points on each of the chosen segments, in 0..1.

    Where a segment ends at the tip of a crack, its points stand at the square root of their share t of its
    length from there. The jump g of the faces is a straight line from zero at the tip to g1 at the first cell edge,
    and its springs give the nodes of that edge eps L g1 sum(w t^2) = eps L g1/3, where half the pressure of the
    segment is theirs to bear: the faces would overlap by up to 1.27 times what the pressure takes there, and the
    next edges swing about it. Any rule has sum(w sqrt(t)^2) = 1/2, so that a uniform pressure p makes the overlap
    p/eps at every edge but the tip; the body, which is stiff, can only lessen it. As the tip's nodes are common to
    both faces, the springs are no stiffer than half a segment of any other is.
    """
    at = np.tile(point_rule(points)[0], (len(chosen), 1))
    at_start, at_end = at_tips(segments)
    at = np.where(at_start[chosen, None], np.sqrt(at), at)
    return np.where(at_end[chosen, None], 1.0 - np.sqrt(1.0 - at), at)


def at_tips(segments: BoundarySegments) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(s,) Whether each segment begins, and ends, at the tip of a crack: the boundary turns back on itself there."""
    ends, first = segments.ends, np.flatnonzero(segments.following >= 0)
    second = segments.following[first]
    back = np.all(ends[first] == ends[second, ::-1], axis=(1, 2)) & (segments.side[first] != 0)
    at_start, at_end = np.zeros((2, len(ends)), dtype=bool)
    at_end[first[back]], at_start[second[back]] = True, True
    return at_start, at_end


def master_side(
    surface: Surface, body: CutBody, first_node: int, without: Ints, points: SlavePoints
) -> MasterSide:
    """The segments of a surface, closed around its ends (see :func:`closed_surface`).

    They are divided where shape functions are not linear along them (:mod:`phantomnode.pipeline.traces`), for
    slave points by the rule given.
    """
    mesh, segments = body.mesh, body.mesh.segments
    closed = closed_surface(segments, surface.segments, without)
    number = np.full(len(segments.ends) + 1, -1)  # the last stands for "no neighbour"
    number[closed] = np.arange(len(closed))
    places, share = places_on(segments, closed, points), point_rule(points)[1]
    pieces = traces(mesh, closed, number[segments.following[closed]], places, share)
    owner = closed[pieces.segment]
    curve, along, whole = distance_along(segments)
    length = np.hypot(*(segments.ends[owner, 1] - segments.ends[owner, 0]).T)
    start, end = along[owner] + length * pieces.part.T
    return MasterSide(
        nodes=mesh.elements[segments.element[owner]] + first_node,
        start=pieces.start,
        end=pieces.end,
        previous=previous_of(pieces.following),
        following=pieces.following,
        place=np.column_stack([curve[owner], 0.5 * (start + end), 0.5 * (end - start), whole[owner]]),
    )


def previous_of(following: Ints) -> Ints:
    """(m,) The links the other way round."""
    previous = np.full(len(following), -1)
    previous[following[following >= 0]] = np.flatnonzero(following >= 0)
    return previous


def distance_along(segments: BoundarySegments) -> tuple[Floats, Floats, Floats]:
    """Chains of segments: number, distance of the start along it, m, and length, m, infinite where open; (s,)."""
    count = len(segments.ends)
    length = np.hypot(*(segments.ends[:, 1] - segments.ends[:, 0]).T)
    curve, along, whole = np.full(count, -1.0), np.zeros(count), np.full(count, np.inf)
    has_previous = np.zeros(count, dtype=bool)
    has_previous[segments.following[segments.following >= 0]] = True
    chains = 0
    for first in (*np.flatnonzero(~has_previous), *range(count)):  # open chains from their ends, then loops
        if curve[first] >= 0:
            continue
        chain, s, distance = [], int(first), 0.0
        while s >= 0 and curve[s] < 0:
            curve[s], along[s] = chains, distance
            distance += length[s]
            chain.append(s)
            s = int(segments.following[s])
        if s == first:
            whole[chain] = distance
        chains += 1
    return curve, along, whole


def joined_contact(passes: list[ContactPass]) -> Contact:
    """All passes in one list; features that no pair makes use of stay empty."""

    def stacked(side: str, name: str, empty: NDArray[Number]) -> NDArray[Number]:
        columns = [getattr(getattr(each, side), name) for each in passes]
        return np.ascontiguousarray(np.concatenate([empty, *columns]))

    def numbers(name: str) -> Floats:
        return np.array([getattr(each, name) for each in passes], dtype=float)

    slave_first = np.cumsum([0, *(len(each.slave.weight) for each in passes)])
    master_first = np.cumsum([0, *(len(each.master.following) for each in passes)])
    no_nodes, no_shape = np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4))
    links = []
    for name in ("previous", "following"):
        shifted = [
            np.where(getattr(each.master, name) >= 0, getattr(each.master, name) + offset, -1)
            for each, offset in zip(passes, master_first, strict=False)
        ]
        links.append(np.concatenate([np.zeros(0, dtype=np.int64), *shifted]))
    contact = Contact(
        slave_nodes=stacked("slave", "points", no_nodes),
        slave_shape=stacked("slave", "point_shape", no_shape),
        slave_weight=stacked("slave", "weight", np.zeros(0)),
        slave_first=slave_first.astype(np.int64),
        master_nodes=stacked("master", "nodes", no_nodes),
        start_shape=stacked("master", "start", no_shape),
        end_shape=stacked("master", "end", no_shape),
        previous=links[0],
        following=links[1],
        master_first=master_first.astype(np.int64),
        penalty=numbers("penalty"),
        reach=numbers("reach"),
        offset=np.zeros(int(slave_first[-1])),
    )
    if any(each.friction > 0.0 for each in passes):
        contact = contact._replace(
            friction=numbers("friction"), tangential_penalty=numbers("tangential_penalty")
        )
    if any(a.pair == b.pair for a, b in zip(passes, passes[1:], strict=False)):
        contact = contact._replace(pair=np.array([each.pair for each in passes], dtype=np.int64))
    if any(each.exclusion > 0.0 for each in passes):
        contact = contact._replace(
            exclusion=numbers("exclusion"),
            slave_place=stacked("slave", "place", np.zeros((0, 2))),
            master_place=stacked("master", "place", np.zeros((0, 4))),
        )
    return contact
