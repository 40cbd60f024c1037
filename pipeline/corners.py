"""How deep sharp corners of a master stand in the slave, between the points that feel contact.

Contact is felt at the points of the slave alone (solver/contact.py), so that a corner of the master can sink in
between two of them without a force. It should not: the summary tells how deep it does.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from phantomnode.pipeline.prepare import Prepared

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SHARP = math.radians(20.0)
"""A master that turns by more at a vertex has a corner there: more than the pieces of an arc over a cell do."""


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


def master_corners(prepared: Prepared, number: int) -> Corners:
    """The corners that stick out of the master of a pair; none in self contact."""
    contact, pair = prepared.model.contact, prepared.pairs[number]
    k = pair.passes[0]
    masters = np.arange(contact.master_first[k], contact.master_first[k + 1])
    if len(contact.exclusion) and contact.exclusion[k] > 0.0:
        masters = masters[:0]
    masters = masters[contact.following[masters] >= 0]
    here, onward = (_direction(prepared, which) for which in (masters, contact.following[masters]))
    turn = np.arctan2(here[:, 0] * onward[:, 1] - here[:, 1] * onward[:, 0], np.sum(here * onward, axis=1))
    sharp = masters[turn > SHARP]  # the material is on the left
    return Corners(
        contact.master_nodes[sharp], contact.end_shape[sharp], pair.segment_nodes, pair.start_shape,
        pair.end_shape, float(contact.reach[k]),
    )  # fmt: skip


def _direction(prepared: Prepared, masters: Ints) -> Floats:
    """(k, 2) From the start to the end of some master segments in the undeformed bodies, m."""
    contact = prepared.model.contact
    along = contact.end_shape[masters] - contact.start_shape[masters]
    return np.asarray(np.einsum("si,sia->sa", along, prepared.model.x[contact.master_nodes[masters]]))


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
    place = np.einsum("ci,cia->ca", corners.shape, x[corners.nodes] + u[corners.nodes])[:, None]
    parents = x[corners.segment_nodes] + u[corners.segment_nodes]
    start, end = (np.einsum("si,sia->sa", shape, parents) for shape in (corners.start, corners.end))
    along, off = end - start, place - start
    length2 = np.maximum(np.sum(along**2, axis=-1), np.finfo(np.float64).tiny)
    at = np.sum(off * along, axis=-1) / length2
    distance = np.hypot(*np.moveaxis(off - np.clip(at, 0.0, 1.0)[..., None] * along, -1, 0))
    nearest = np.argmin(distance, axis=1)[:, None]
    at, distance = (np.take_along_axis(values, nearest, axis=1) for values in (at, distance))
    side = along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0]
    inside = (np.take_along_axis(side, nearest, axis=1) > 0.0) & (at >= 0.0) & (at <= 1.0)
    return float(np.max(distance, where=inside & (distance < corners.reach), initial=0.0))
