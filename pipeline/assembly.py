"""Surfaces of contact pairs become the arrays that kernels see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.pipeline.bodies import CutBody
from phantomnode.pipeline.surfaces import Surface, closed_surface
from phantomnode.pipeline.traces import traces
from phantomnode.solver.model import Contact

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Number = TypeVar("Number", bound=np.generic)

POINTS_PER_SEGMENT = 2
"""Gauss points on each slave segment (paper, section 4.1)."""

GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)


@dataclass(frozen=True)
class PairSurfaces:
    """The two surfaces of one contact pair, in nodes of the model.

    Attributes
    ----------
    slave_nodes : (s, 4) int64
        Nodes of the parent element of each slave segment.
    slave_start, slave_end : (s, 4) float64
        Shape functions at its ends.
    points, point_shape, weight : (g, 4) int64, (g, 4) float64, (g,) float64
        Nodes, shape functions and reference length, m, of the slave points, segment by segment.
    master_nodes, master_start, master_end : (m, 4)
        The same for the master segments, closed around the ends of the named surface and divided where
        shape functions are not linear along them (:mod:`phantomnode.pipeline.traces`).
    previous, following : (m,) int64
        Neighbours of the master segments within the pair, -1 at a free end.
    """

    slave_nodes: Ints
    slave_start: Floats
    slave_end: Floats
    points: Ints
    point_shape: Floats
    weight: Floats
    master_nodes: Ints
    master_start: Floats
    master_end: Floats
    previous: Ints
    following: Ints


def pair_surfaces(
    slave: Surface, master: Surface, bodies: dict[str, CutBody], first_node: dict[str, int]
) -> PairSurfaces:
    """Slave points and master segments of one contact pair."""
    mesh = bodies[slave.body].mesh
    segments = mesh.segments
    parents = segments.element[slave.segments]
    ends = segments.ends[slave.segments]
    local_points = np.einsum("g,sa->sga", 1.0 - GAUSS, ends[:, 0]) + np.einsum("g,sa->sga", GAUSS, ends[:, 1])
    owners = np.repeat(mesh.elements[parents], POINTS_PER_SEGMENT, axis=0)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    other = bodies[master.body].mesh
    same = slave.body == master.body
    closed = closed_surface(
        other.segments, master.segments, slave.segments if same else np.zeros(0, dtype=int)
    )
    number = np.full(len(other.segments.ends) + 1, -1)  # the last stands for "no neighbour"
    number[closed] = np.arange(len(closed))
    pieces = traces(other, closed, number[other.segments.following[closed]])
    following = pieces.following
    previous = np.full(len(following), -1)
    previous[following[following >= 0]] = np.flatnonzero(following >= 0)
    return PairSurfaces(
        slave_nodes=mesh.elements[parents] + first_node[slave.body],
        slave_start=shape(segments.local[slave.segments, 0]),
        slave_end=shape(segments.local[slave.segments, 1]),
        points=owners + first_node[slave.body],
        point_shape=shape(to_local(mesh.xy[owners], local_points.reshape(-1, 2))),
        weight=np.repeat(length / POINTS_PER_SEGMENT, POINTS_PER_SEGMENT),
        master_nodes=other.elements[other.segments.element[closed[pieces.segment]]] + first_node[master.body],
        master_start=pieces.start,
        master_end=pieces.end,
        previous=previous,
        following=following,
    )


def joined_contact(pairs: list[PairSurfaces], penalty: Floats, reach: Floats) -> Contact:
    """All pairs in one list.

    Parameters
    ----------
    pairs : list of PairSurfaces
    penalty : (k,) float64, Pa/m
    reach : (k,) float64, metres
    """

    def stacked(name: str, empty: NDArray[Number]) -> NDArray[Number]:
        return np.ascontiguousarray(np.concatenate([empty, *(getattr(pair, name) for pair in pairs)]))

    slave_first = np.cumsum([0, *(len(pair.weight) for pair in pairs)])
    master_first = np.cumsum([0, *(len(pair.following) for pair in pairs)])
    no_nodes, no_shape = np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4))
    links = []
    for name in ("previous", "following"):
        shifted = [
            np.where(getattr(pair, name) >= 0, getattr(pair, name) + offset, -1)
            for pair, offset in zip(pairs, master_first, strict=False)
        ]
        links.append(np.concatenate([np.zeros(0, dtype=np.int64), *shifted]))
    return Contact(
        slave_nodes=stacked("points", no_nodes),
        slave_shape=stacked("point_shape", no_shape),
        slave_weight=stacked("weight", np.zeros(0)),
        slave_first=slave_first.astype(np.int64),
        master_nodes=stacked("master_nodes", no_nodes),
        start_shape=stacked("master_start", no_shape),
        end_shape=stacked("master_end", no_shape),
        previous=links[0],
        following=links[1],
        master_first=master_first.astype(np.int64),
        penalty=penalty,
        reach=reach,
        offset=np.zeros(int(slave_first[-1])),
    )
