"""What the segments of an arrangement carry: grid edges with the cells beside them, outlines, interfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.arrangement import Arrangement
from phantomnode.geometry.chains import Chains
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.noding import Pieces

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class CellEdges:
    """The edges of a grid with the cells beside them.

    Attributes
    ----------
    ends : (e, 2) int64
        Nodes of each edge.
    cell : (e, 2) int64
        The cell on the left (in which the edge runs forward) and the one on the right; -1 outside the grid.
    corner : (e, 2) int64
        The corner of that cell at which the edge starts (left: at ends[0]; right: at ends[1]).
    """

    ends: Ints
    cell: Ints
    corner: Ints

    @classmethod
    def of(cls, grid: BackgroundGrid) -> CellEdges:
        """Find the edges of a grid; more than two cells at an edge, or cells that overlap, are refused."""
        quads = grid.quads.astype(np.int64)
        directed = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
        forward = directed[:, 0] < directed[:, 1]
        # One number an edge sorts faster than a row of two.
        code, edge = np.unique(
            directed.min(axis=1) * grid.node_count + directed.max(axis=1), return_inverse=True
        )
        ends = np.column_stack(np.divmod(code, grid.node_count))
        cell, corner = np.full((len(ends), 2), -1), np.full((len(ends), 2), -1)
        for side, mask in ((0, forward), (1, ~forward)):
            if np.bincount(edge[mask]).max(initial=0) > 1:
                raise GeometryError("the background grid has an edge with two cells on the same side")
            number = np.flatnonzero(mask)
            cell[edge[mask], side], corner[edge[mask], side] = number // 4, number % 4
        return cls(ends, cell, corner)


@dataclass(frozen=True)
class Tags:
    """What each segment of an arrangement carries, (s,) each.

    Attributes
    ----------
    grid_edge : int64
        The grid edge it is a part of, -1 inside cells.
    edge_forward : bool
        Whether it runs along that edge.
    material_left, material_right : bool
        Whether an outline with its material on that side runs along it.
    curve, piece : int64
        The curve and piece of its barrier, -1 where it carries none.
    curve_forward : bool
        Whether it runs along that curve.
    """

    grid_edge: Ints
    edge_forward: Bools
    material_left: Bools
    material_right: Bools
    curve: Ints
    piece: Ints
    curve_forward: Bools

    @classmethod
    def of(
        cls, arrangement: Arrangement, pieces: Pieces, source_edges: Ints, chains: Chains, loops: int
    ) -> Tags:
        """Read off where each noded piece came from; an outline goes before an interface."""
        count, segment, forward = len(arrangement.ends), arrangement.piece_segment, arrangement.piece_forward
        grid_edge, edge_forward = np.full(count, -1), np.zeros(count, dtype=bool)
        on_edge = pieces.source < len(source_edges)
        grid_edge[segment[on_edge]] = source_edges[pieces.source[on_edge]]
        edge_forward[segment[on_edge]] = forward[on_edge]
        # Sources after the edges are the chains; after these, bridges.
        barrier = ~on_edge & (pieces.source < len(source_edges) + len(chains.curve))
        chain = pieces.source[barrier] - len(source_edges)
        segment, forward = segment[barrier], forward[barrier]
        outline = chains.curve[chain] < loops
        left, right = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        left[segment[outline & forward]] = True
        right[segment[outline & ~forward]] = True
        # Written in descending order of the curve, so that an outline stays where it meets an interface.
        order = np.argsort(-chain, kind="stable")
        curve, piece, curve_forward = np.full(count, -1), np.full(count, -1), np.zeros(count, dtype=bool)
        curve[segment[order]] = chains.curve[chain[order]]
        piece[segment[order]] = chains.piece[chain[order]]
        curve_forward[segment[order]] = forward[order]
        return cls(grid_edge, edge_forward, left, right, curve, piece, curve_forward)
