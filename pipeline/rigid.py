"""Rigid obstacles: curves without a mesh, followed by straight segments between nodes that are moved.

The nodes of an obstacle stand in the model behind those of the bodies. They have no mass and are held in both
directions, so that what the contact does to them is a reaction and its work is external work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.pipeline.bodies import CutBody, at, curves_of
from phantomnode.pipeline.drawings import Drawings
from phantomnode.pipeline.pairing import MasterSide, previous_of
from phantomnode.pipeline.schema import Case

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CHORD_ERROR = 1e-3
"""Distance of an obstacle's segments from its curve, in cells of the finest body that touches it: of the order of
the penetration under a light load, a thousandth of what the cut of a body leaves out of a curve of few cells."""

STRAIGHT = 1e-9
"""A vertex that turns by less, in radians, stands on a straight line: a thousand times what doubles round."""


@dataclass(frozen=True)
class Rigid:
    """One rigid obstacle.

    Attributes
    ----------
    name : str
    curves : tuple of Curve
        As placed, with the obstacle on the left.
    xy : (n, 2) float64, metres
        The vertices of its segments.
    segments : (s, 2) int64
        First and last vertex of each.
    following : (s,) int64
        The segment that goes on from each, -1 at a free end.
    nodes : slice
        Its vertices in the model.
    """

    name: str
    curves: tuple[Curve, ...]
    xy: Floats
    segments: Ints
    following: Ints
    nodes: slice

    def master_side(self) -> MasterSide:
        """Its segments as masters."""
        start, end = self.segments.T + self.nodes.start
        unit = np.eye(4)[[0, 1]]
        count = len(self.segments)
        return MasterSide(
            nodes=np.column_stack([start, end, end, end]),
            start=np.repeat(unit[:1], count, axis=0),
            end=np.repeat(unit[1:], count, axis=0),
            previous=previous_of(self.following),
            following=self.following,
            place=np.tile([-2.0, 0.0, 0.0, np.inf], (count, 1)),
        )


def rigid_obstacles(
    case: Case, cut: dict[str, CutBody], first_node: int, drawings: Drawings
) -> tuple[Rigid, ...]:
    """All obstacles of a case; their nodes begin at ``first_node``.

    Raises
    ------
    CaseError
        Where a geometry cannot be read.
    """
    made: list[Rigid] = []
    for name, table in case.rigid.items():
        cells = [
            cut[contact.slave.partition(".")[0]].grid.cell_size
            for contact in case.contact.values()
            if contact.master == name and contact.slave.partition(".")[0] in cut
        ]
        with at(case, f"rigid.{name}.geometry"):
            curves, _ = curves_of(drawings, table.geometry)
            curves = tuple(_facing(curve, table.side) for curve in curves)
            extent = max(float(np.max(curve.box[1] - curve.box[0])) for curve in curves)
            error = CHORD_ERROR * min(cells, default=extent)
            chains = [_turning(curve.polyline(error), curve.closed) for curve in curves]
        rigid = _joined(name, curves, chains, first_node)
        first_node = rigid.nodes.stop
        made.append(rigid)
    return tuple(made)


def _facing(curve: Curve, side: str) -> Curve:
    """The curve with the obstacle on its left; the left of a closed one is its inside."""
    if curve.closed and curve.signed_area < 0.0:
        curve = curve.reversed()
    return curve if side == "left" else curve.reversed()


def _turning(chain: Floats, closed: bool) -> Floats:
    """The vertices, (n, 2), m, without those that stand on a straight line: pieces of one are one segment."""
    chain = chain[np.append(True, np.any(np.diff(chain, axis=0) != 0.0, axis=1))]  # each place once
    along = np.diff(chain, axis=0)
    before = np.roll(along, 1, axis=0)
    cross = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
    size = np.hypot(*before.T) * np.hypot(*along.T)
    stays = (np.abs(cross) > STRAIGHT * size) | (np.sum(before * along, axis=1) < 0.0)
    if not closed:
        stays[0] = True
        return np.asarray(chain[np.append(stays, True)])
    kept = chain[:-1][stays]
    return np.vstack([kept, kept[:1]])


def _joined(name: str, curves: tuple[Curve, ...], chains: list[Floats], first_node: int) -> Rigid:
    """The segments of all curves of an obstacle."""
    xy, segments, following, node, segment = [], [], [], 0, 0
    for curve, chain in zip(curves, chains, strict=True):
        count = len(chain) - 1
        vertices = chain[:-1] if curve.closed else chain
        start = np.arange(count)
        end = (start + 1) % len(vertices)
        after = segment + start + 1
        after[-1] = segment if curve.closed else -1
        xy.append(vertices)
        segments.append(node + np.column_stack([start, end]))
        following.append(after)
        node, segment = node + len(vertices), segment + count
    nodes = slice(first_node, first_node + node)
    return Rigid(name, curves, np.vstack(xy), np.vstack(segments), np.concatenate(following), nodes)
