"""Curves as chains of straight barriers: from one grid edge to the next, with sharp corners kept.

Inside a cell the zero line of a level set is straight between its crossings of the cell's edges; neighbours
share the crossing, so they agree exactly. A sharp corner inside a cell is a vertex of the chain, and so are
grid nodes that stand on the curve (relocated ones among them).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.intersect import curve_edge_crossings
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.noding import UNITS_PER_CELL, Lattice

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ON_CURVE = 1e-9
"""A grid node nearer to a curve than this times its h stands on the curve (relocation puts it there to
rounding, 1e-15; a body drawn to fit the grid comes within 1e-12)."""

NEAR_NODE = UNITS_PER_CELL / 2**9
"""Crossings this near (lattice units, h/512) to a node on the same curve are that node: an arc through a node
crosses the edges that touch it again at distances of rounding over the angle between them."""

SAME_POINT = 2.0
"""Points this near (lattice units) to a grid node or a curve's free end are that, whatever curve they are on."""

RIM = 4.0
"""Points this near (lattice units) to a side of a cell may lie on it: rounding moves both."""

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
    middle : (k, 2) int64
        Lattice point of the curve half-way between the ends of each barrier.
    """

    starts: Ints
    ends: Ints
    curve: Ints
    piece: Ints
    middle: Ints

    def __getitem__(self, chosen: Bools) -> Chains:
        """Some of the barriers."""
        return Chains(*(getattr(self, field.name)[chosen] for field in fields(self)))


def barrier_chains(curves: list[Curve], grid: BackgroundGrid, lattice: Lattice, loops: int) -> Chains:
    """All curves as chains of barriers between the edges of a (relocated) grid.

    The first ``loops`` curves are outlines. A curve on which another one ends has a vertex there, or the chord
    of an arc would leave the two a sliver apart, and the cut would stay open.
    """
    nodes = lattice.snap(grid.xy)
    ends = np.vstack([np.zeros((0, 2)), *(curve.points[[0, -1]] for curve in curves if not curve.closed)])
    places = np.vstack([nodes, lattice.snap(ends)])
    tree = cKDTree(places)
    slack = SAME_POINT * float(lattice.unit.min())
    node_size = np.where(np.isfinite(grid.node_size), grid.node_size, -1.0)  # a node of no cell is on nothing
    columns: list[tuple[Ints, ...]] = []
    for number, curve in enumerate(curves):
        level_set = LevelSet.of_curve(curve)
        closest = level_set.query(grid.xy)
        on = np.abs(closest.distance) <= ON_CURVE * node_size
        where, corners = _vertices(curve, grid, (closest.piece + closest.s)[on])
        closest = level_set.query(ends)
        met = (closest.piece + closest.s)[np.abs(closest.distance) <= slack]
        met = _in_turn(curve, met, where[0])
        met = met[_left_of_chord(curve, where, met)] if number < loops else met
        where = np.union1d(where, met)
        fixed = np.isin(_around(curve, where), np.concatenate([corners, _around(curve, met)]))
        attracts = np.concatenate([on, np.zeros(len(ends), dtype=bool)])
        points = _snapped(curve, where, fixed, lattice, places, tree, attracts)
        middle = 0.5 * (where[:-1] + where[1:])
        piece = np.minimum(middle.astype(np.int64) % len(curve.bulges), len(curve.bulges) - 1)
        real = np.any(points[1:] != points[:-1], axis=1)
        column = points[:-1], points[1:], np.full(len(piece), number), piece, lattice.snap(_at(curve, middle))
        columns.append(tuple(values[real] for values in column))
    return Chains(*(np.concatenate(values) for values in zip(*columns, strict=True)))


def in_cells(chains: Chains, corners: Ints) -> tuple[Chains, Bools]:
    """The barriers that lie in the grid, and which of its cells (m, 4, 2) come near one of them.

    Between two crossings a curve is all inside or all outside the grid. Outside, where no edge is crossed, its
    chord may be long and cut a corner of the grid off: such a barrier is none. One whose chord runs along the
    rim of the grid stays: the rim is made of chords of the same arc.
    """
    low, high = (
        np.minimum(chains.starts, chains.ends) - RIM,
        np.maximum(chains.starts, chains.ends) + RIM,
    )
    tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
    least, most = corners.min(axis=1), corners.max(axis=1)
    cell, chain = tree.query(shapely.box(least[:, 0], least[:, 1], most[:, 0], most[:, 1]))
    depth = _depth(corners[cell], chains.middle[chain])
    chord = _depth(corners[cell], (0.5 * (chains.starts + chains.ends))[chain])
    kept = np.zeros(len(chains.curve), dtype=bool)
    kept[chain[(depth >= -RIM) | (np.abs(chord) <= RIM)]] = True
    band = np.zeros(len(corners), dtype=bool)
    band[cell[kept[chain]]] = True
    return (chains[kept] if kept.any() else chains), band  # where none is in, all stay in the void outside


def _depth(corners: Ints, points: Floats | Ints) -> Floats:
    """(k,) Distance (lattice units) of points from the nearest side of cells (k, 4, 2), negative outside."""
    side = (np.roll(corners, -1, axis=1) - corners).astype(np.float64)
    across = (
        side[..., 0] * (points[:, None] - corners)[..., 1]
        - side[..., 1] * (points[:, None] - corners)[..., 0]
    )
    return np.asarray(np.min(across / np.hypot(side[..., 0], side[..., 1]), axis=1))


def _vertices(curve: Curve, grid: BackgroundGrid, at_nodes: Floats) -> tuple[Floats, Floats]:
    """Parameters (piece + fraction, ascending) of the vertices of a chain; those of the corners among them.

    ``at_nodes`` are the parameters of the grid nodes on the curve. A closed chain ends one turn after its
    first vertex.
    """
    _, _, piece, s = curve_edge_crossings(curve, grid.xy[grid.edges[:, 0]], grid.xy[grid.edges[:, 1]])
    corners = _around(curve, np.flatnonzero(curve.corners).astype(np.float64))
    where = np.unique(_around(curve, np.concatenate([piece + s, at_nodes, corners])))
    if curve.closed:
        where = where if len(where) else np.zeros(1)
        where = np.append(where, where[0] + len(curve.bulges))
    return _with_turns(curve, where), corners


def _around(curve: Curve, where: Floats) -> Floats:
    """Parameters within one turn from the start of a closed curve; those of an open one as they are."""
    return np.asarray(np.mod(where, len(curve.bulges))) if curve.closed else where


def _in_turn(curve: Curve, where: Floats, first: float) -> Floats:
    """Parameters within one turn from the first vertex of a chain."""
    where = _around(curve, where)
    return np.where(where < first, where + len(curve.bulges), where) if curve.closed else where


def _at(curve: Curve, where: Floats) -> Floats:
    """(k, 2) Points at parameters, up to two turns of a closed curve."""
    piece = np.minimum(np.floor(where).astype(np.int64), len(curve.bulges) * (2 if curve.closed else 1) - 1)
    return curve.at(piece % len(curve.bulges), where - piece)


def _left_of_chord(curve: Curve, where: Floats, points: Floats) -> Bools:
    """(k,) Whether points of a curve lie left of (or on) the chord of the chain that spans them.

    On the right of an outline's chord is the void: whoever ends there has crossed the chord before.
    """
    k = np.clip(np.searchsorted(where, points), 1, len(where) - 1)
    start, end, point = _at(curve, where[k - 1]), _at(curve, where[k]), _at(curve, points)
    return np.asarray(_cross_dot(end - start, point - start)[0] >= 0.0)


def _with_turns(curve: Curve, where: Floats) -> Floats:
    """Add vertices where a chain would turn by more than ``LARGEST_TURN`` between two of them."""
    start, end = curve.tangents
    turn_of_piece = np.abs(curve.angles)
    joint = np.abs(np.arctan2(*_cross_dot(end, np.roll(start, -1, axis=0))))
    joint[curve.corners[1:]] = 0.0  # a vertex of the chain in any case
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
    fixed: Bools,
    lattice: Lattice,
    places: Ints,
    tree: cKDTree,
    on_curve: Bools,
) -> Ints:
    """(k, 2) Lattice points of the vertices of a chain; those beside a grid node or a free end are that."""
    points = lattice.snap(_at(curve, where))
    distance, nearest = tree.query(points)
    reach = np.where(on_curve[nearest] & ~fixed, NEAR_NODE, SAME_POINT)
    return np.where((distance <= reach)[:, None], places[nearest], points)
