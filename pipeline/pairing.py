"""The two sides of contact pairs as arrays: slave points on segments of a body, master segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.geometry.doubling import BoundarySegments, CutMesh
from phantomnode.pipeline.bodies import CutBody
from phantomnode.pipeline.contact_tables import SlavePoints
from phantomnode.pipeline.surfaces import Surface
from phantomnode.pipeline.traces import balanced, traces
from phantomnode.solver.model import Contact

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Number = TypeVar("Number", bound=np.generic)

NOBODY = np.zeros(0, dtype=np.int64)

LEAST_JUMP = 0.01
"""Where the faces of a crack part by less of a jump of their nodes, springs grow no stiffer: those nodes bear less
than a hundredth of such a point, and the straight pieces of the master miss up to 4e-3 of a jump."""


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
    jump : (g,) float64
        By what part of a jump of their nodes the faces of a crack part at each point (:func:`jump_between`);
        1 where slave and master are not joined.
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
    jump: Floats
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
    sign : float
        -1 where the points belong to the master of the pair.
    crowd : float, m
        The most weight that can meet at a node of the master where points stand alone; 0 where they line a surface.
    allowed : float, m
        The depth up to which points feel nothing.
    """

    pair: int
    slave: SlaveSide
    master: MasterSide
    penalty: float
    tangential_penalty: float
    friction: float
    reach: float
    exclusion: float
    sign: float = 1.0
    crowd: float = 0.0
    allowed: float = 0.0


def slave_side(
    surface: Surface, body: CutBody, first_node: int, points: SlavePoints, across: Ints = NOBODY
) -> SlaveSide:
    """The slave points on the segments of a surface; ``across`` are those of the master if of the same body."""
    mesh = body.mesh
    segments, chosen = mesh.segments, surface.segments
    at, share = point_rule(points)
    parents, ends = segments.element[chosen], segments.ends[chosen]
    places = (1.0 - at)[:, None] * ends[:, None, 0] + at[:, None] * ends[:, None, 1]
    owners = np.repeat(mesh.nodes(parents), points.count, axis=0)
    point_shape = shape(to_local(mesh.xy[owners], places.reshape(-1, 2))).reshape(-1, points.count, 4)
    point_shape = balanced(point_shape, mesh.xy[mesh.elements[parents]], ends, at, share)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    curve, along, whole = distance_along(segments)
    start = along[chosen]
    return SlaveSide(
        nodes=mesh.nodes(parents) + first_node,
        start=shape(segments.local[chosen, 0]),
        end=shape(segments.local[chosen, 1]),
        points=owners + first_node,
        point_shape=point_shape.reshape(-1, 4),
        weight=(length[:, None] * share).reshape(-1),
        jump=jump_between(mesh, chosen, across, point_shape).reshape(-1),
        place=np.column_stack(
            [np.repeat(curve[chosen], points.count), (start[:, None] + length[:, None] * at).reshape(-1)]
        ),
        half_way=start + 0.5 * length,
        whole=whole[chosen],
        middle=np.repeat(ends.mean(axis=1), points.count, axis=0),
    )


def jump_between(mesh: CutMesh, chosen: Ints, across: Ints, point_shape: Floats) -> Floats:
    """(s, n) By what part J of a jump of their nodes the faces of a crack part at the points of each segment.

    Beside a tip the two faces have nodes in common, which cannot part: there J is the sum of the shape functions of
    all others, and falls to zero at the tip. A jump of p/eps of those nodes then makes the pressure p at every
    point whose spring is eps/J, whatever way the crack runs through its cells, and each node gets its very part of
    that pressure. With springs of eps the first edge from a tip would get a third of the pressure of the segment,
    where half of it is its to bear: the faces would overlap by up to 1.27 p/eps there. No node feels more than at
    any other point: those in common feel nothing, and the others eps w/J N J.

    Parameters
    ----------
    mesh : CutMesh
    chosen, across : (s,), (m,) int64
        The segments of the points, and those that can be their other face, by their numbers in ``mesh.segments``.
    point_shape : (s, n, 4) float64
    """
    segments = mesh.segments
    number = {tuple(ends.ravel().tolist()): k for k, ends in zip(across, segments.ends[across], strict=True)}
    turned = segments.ends[chosen][:, ::-1].reshape(-1, 4).tolist()
    other = np.array([number.get(tuple(ends), -1) for ends in turned], dtype=np.int64)
    mine, theirs = (mesh.nodes(segments.element[faces]) for faces in (chosen, other))
    joined = np.any(mine[:, :, None] == theirs[:, None, :], axis=2) & (other >= 0)[:, None]
    jump = 1.0 - np.einsum("sni,si->sn", point_shape, joined)
    return np.where(jump < LEAST_JUMP, LEAST_JUMP, jump)


def master_side(closed: Ints, body: CutBody, first_node: int, points: SlavePoints) -> MasterSide:
    """The segments of a surface, closed around its ends (see :func:`closed_surface`), by their numbers (m,).

    They are divided where shape functions are not linear along them (:mod:`phantomnode.pipeline.traces`), for
    slave points by the rule given.
    """
    mesh, segments = body.mesh, body.mesh.segments
    number = np.full(len(segments.ends) + 1, -1)  # the last stands for "no neighbour"
    number[closed] = np.arange(len(closed))
    pieces = traces(mesh, closed, number[segments.following[closed]], *point_rule(points))
    owner = closed[pieces.segment]
    curve, along, whole = distance_along(segments)
    length = np.hypot(*(segments.ends[owner, 1] - segments.ends[owner, 0]).T)
    start, end = along[owner] + length * pieces.part.T
    return MasterSide(
        nodes=mesh.nodes(segments.element[owner]) + first_node,
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
    jump = stacked("slave", "jump", np.zeros(0))
    contact = Contact(
        slave_nodes=stacked("slave", "points", no_nodes),
        slave_shape=stacked("slave", "point_shape", no_shape),
        slave_weight=stacked("slave", "weight", np.zeros(0)) / jump,
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
    if np.any(jump < 1.0):
        contact = contact._replace(slave_jump=jump)
    if any(each.friction > 0.0 for each in passes):
        contact = contact._replace(
            friction=numbers("friction"), tangential_penalty=numbers("tangential_penalty")
        )
    if any(a.pair == b.pair for a, b in zip(passes, passes[1:], strict=False)):
        numbers_of_pairs = np.array([each.pair for each in passes], dtype=np.int64)
        contact = contact._replace(pair=numbers_of_pairs, sign=numbers("sign"))
    if any(each.crowd > 0.0 for each in passes):
        contact = contact._replace(crowd=numbers("crowd"))
    if any(each.exclusion > 0.0 for each in passes):
        contact = contact._replace(
            exclusion=numbers("exclusion"),
            slave_place=stacked("slave", "place", np.zeros((0, 2))),
            master_place=stacked("master", "place", np.zeros((0, 4))),
        )
    return contact
