"""How deep sharp corners of a master stand in the slave, between the points that feel contact.

Contact is felt at the points of the slave, and at corners from a small depth on (corner_points.py) unless the case
does without: the summary tells how deep corners of the master stand whatever feels them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.gaps import master_ends
from phantomnode.pipeline.turning import sharp

if TYPE_CHECKING:
    from phantomnode.pipeline.prepare import Prepared

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Corners(NamedTuple):
    """The corners of the master of a pair and the segments of its slave.

    nodes (c, 4), shape (c, 4): a corner is sum_I shape[I] x[nodes I]; segment_nodes (s, 4), start (s, 4), end (s, 4)
    likewise; reach, m: what is farther away is another matter.
    """

    nodes: Ints
    shape: Floats
    segment_nodes: Ints
    start: Floats
    end: Floats
    reach: float


class Nearest(NamedTuple):
    """The segment nearest to each of some places.

    segment (c,); at (c,) parameter along it, beyond 0..1 where an end of it is nearest; distance (c,), m, from the
    segment; deep (c,) whether the place is on its left, where the material is.
    """

    segment: Ints
    at: Floats
    distance: Floats
    deep: NDArray[np.bool_]


def nearest_along(places: Floats, ends: Floats) -> Nearest:
    """For (c, 2) places the nearest of the segments with (s, 2, 2) ends, m."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    off = places[:, None] - start
    length2 = np.maximum(np.sum(along**2, axis=-1), np.finfo(np.float64).tiny)
    at = np.sum(off * along, axis=-1) / length2
    distance = np.hypot(*np.moveaxis(off - np.clip(at, 0.0, 1.0)[..., None] * along, -1, 0))
    side = along[:, 0] * off[..., 1] - along[:, 1] * off[..., 0]
    segment = np.argmin(distance, axis=1)
    at, distance, side = (
        np.take_along_axis(values, segment[:, None], axis=1)[:, 0] for values in (at, distance, side)
    )
    return Nearest(segment, at, distance, side > 0.0)


def master_corners(prepared: Prepared, number: int) -> Corners:
    """The corners that stick out of the master of a pair; none in self contact."""
    contact, pair = prepared.model.contact, prepared.pairs[number]
    k = pair.passes[0]
    if pair.corners:
        theirs = [c for c in pair.corners if contact.sign[c] < 0.0]
        points = np.concatenate(
            [np.arange(*contact.slave_first[c : c + 2]) for c in theirs] or [np.zeros(0, int)]
        )
        nodes, shape = contact.slave_nodes[points], contact.slave_shape[points]
    else:
        first, last = contact.master_first[k : k + 2]
        own = len(contact.exclusion) > 0 and contact.exclusion[k] > 0.0
        following = contact.following[first:last]
        following = np.full_like(following, -1) if own else np.where(following >= 0, following - first, -1)
        at = first + sharp(master_ends(prepared, k), following)
        nodes, shape = contact.master_nodes[at], contact.end_shape[at]
    return Corners(
        nodes, shape, pair.segment_nodes, pair.start_shape, pair.end_shape, float(contact.reach[k])
    )


def deepest_corner(corners: Corners, x: Floats, u: Floats) -> float:
    """How deep the deepest corner lies behind the slave segment nearest to it, m; 0 where none does.

    Parameters
    ----------
    corners : Corners
    x, u : (n, 2) float64, metres
        Reference positions and displacements of the nodes of the model.
    """
    if len(corners.nodes) == 0:
        return 0.0
    place = np.einsum("ci,cia->ca", corners.shape, x[corners.nodes] + u[corners.nodes])
    parents = x[corners.segment_nodes] + u[corners.segment_nodes]
    start, end = (np.einsum("si,sia->sa", shape, parents) for shape in (corners.start, corners.end))
    near = nearest_along(place, np.stack([start, end], axis=1))
    inside = near.deep & (near.at >= 0.0) & (near.at <= 1.0) & (near.distance < corners.reach)
    return float(np.max(near.distance, where=inside, initial=0.0))
