"""Curves as chains of straight barriers: from one grid edge to the next, with sharp corners kept.

Inside a cell the zero line of a level set is straight between its crossings of the cell's edges; neighbours
share the crossing, so they agree exactly. A sharp corner inside a cell is a vertex of the chain, and so are
grid nodes that stand on the curve (relocated ones among them).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.intersect import curve_edge_crossings
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.noding import UNITS_PER_CELL, Lattice

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ON_CURVE = 1e-9
"""A grid node nearer to a curve than this times its h stands on the curve (relocation puts it there to
rounding, 1e-15; a body drawn to fit the grid comes within 1e-12)."""

NEAR_NODE = UNITS_PER_CELL / 2**9
"""Crossings this near (lattice units, h/512) to a node on the same curve are that node: an arc through a node
crosses the edges that touch it again at distances of rounding over the angle between them."""

SAME_POINT = 2.0
"""Points this near (lattice units) to a grid node are that node, whatever curve they are on."""

LARGEST_TURN = np.radians(30.0)
"""A chain turns by no more than this at a vertex inside a cell (a chord then misses less than 4 % of the
height of its arc's radius); only curves with a radius of the order of a cell need the extra vertices."""


@dataclass(frozen=True)
class Chains:
    """Barriers on the lattice.

    Attributes
    ----------
    starts, ends : (k, 2) int64
        Lattice points of each barrier, in the direction of its curve.
    curve, piece : (k,) int64
        The curve and the piece of it that each barrier stands for.
    """

    starts: Ints
    ends: Ints
    curve: Ints
    piece: Ints


def barrier_chains(curves: list[Curve], grid: BackgroundGrid, lattice: Lattice) -> Chains:
    """All curves as chains of barriers between the edges of a (relocated) grid."""
    nodes = lattice.snap(grid.xy)
    tree = cKDTree(nodes)
    columns: list[tuple[Ints, Ints, Ints, Ints]] = []
    for number, curve in enumerate(curves):
        closest = LevelSet.of_curve(curve).query(grid.xy)
        on = np.abs(closest.distance) <= ON_CURVE * grid.node_size
        where, fixed = _vertices(curve, grid, (closest.piece + closest.s)[on])
        points = _snapped(curve, where, fixed, lattice, nodes, tree, on)
        middle = 0.5 * (where[:-1] + where[1:])
        piece = np.minimum(middle.astype(np.int64) % len(curve.bulges), len(curve.bulges) - 1)
        real = np.any(points[1:] != points[:-1], axis=1)
        columns.append((points[:-1][real], points[1:][real], np.full(np.sum(real), number), piece[real]))
    starts, ends, which, pieces = (np.concatenate(c) for c in zip(*columns, strict=True))
    return Chains(starts, ends, which, pieces)


def _vertices(curve: Curve, grid: BackgroundGrid, at_nodes: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Parameters (piece + fraction, ascending) of the vertices of a chain, and which of them are corners.

    ``at_nodes`` are the parameters of the grid nodes on the curve. A closed chain ends one turn after its
    first vertex.
    """
    count = len(curve.bulges)
    _, _, piece, s = curve_edge_crossings(curve, grid.xy[grid.edges[:, 0]], grid.xy[grid.edges[:, 1]])
    corners = np.flatnonzero(curve.corners).astype(np.float64)
    where = np.concatenate([piece + s, at_nodes, corners])
    if curve.closed:
        where, corners = np.mod(where, count), np.mod(corners, count)
        where = np.unique(where) if len(where) else np.zeros(1)
        where = np.append(where, where[0] + count)
    else:
        where = np.unique(where)
    where = _with_turns(curve, where)
    return where, np.isin(np.mod(where, count) if curve.closed else where, corners)


def _with_turns(curve: Curve, where: Floats) -> Floats:
    """Add vertices where a chain would turn by more than ``LARGEST_TURN`` between two of them."""
    start, end = curve.tangents
    turn_of_piece = np.abs(curve.angles)
    joint = np.abs(np.arctan2(*_cross_dot(end, np.roll(start, -1, axis=0))))
    # Turning angle from the first vertex on, over the parameter; twice round for closed chains.
    rounds = 2 if curve.closed else 1
    steps = np.tile(np.stack([turn_of_piece, joint], axis=1), (rounds, 1)).reshape(-1)
    total = np.concatenate([[0.0], np.cumsum(steps)])[:-1]
    knots = np.arange(rounds * len(curve.bulges))
    at_start, at_end = total[0::2], total[1::2]
    turned = np.concatenate([at_start, at_end[-1:]])
    turn = np.interp(where, np.append(knots, rounds * len(curve.bulges)), turned)
    extra = [where]
    for k in np.flatnonzero(np.diff(turn) > LARGEST_TURN):
        parts = int(np.ceil((turn[k + 1] - turn[k]) / LARGEST_TURN))
        goal = turn[k] + np.arange(1, parts) * (turn[k + 1] - turn[k]) / parts
        extra.append(np.interp(goal, turned, np.append(knots, rounds * len(curve.bulges))))
    return np.unique(np.concatenate(extra))


def _cross_dot(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """(k,) Cross and dot products of (k, 2) vectors."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1)


def _snapped(
    curve: Curve,
    where: Floats,
    fixed: NDArray[np.bool_],
    lattice: Lattice,
    nodes: Ints,
    tree: cKDTree,
    on_curve: NDArray[np.bool_],
) -> Ints:
    """(k, 2) Lattice points of the vertices of a chain; those beside a grid node are the node."""
    piece = np.minimum(np.floor(where).astype(np.int64), len(curve.bulges) * (2 if curve.closed else 1) - 1)
    points = lattice.snap(curve.at(piece % len(curve.bulges), where - piece))
    distance, nearest = tree.query(points)
    reach = np.where(on_curve[nearest] & ~fixed, NEAR_NODE, SAME_POINT)
    return np.where((distance <= reach)[:, None], nodes[nearest], points)
