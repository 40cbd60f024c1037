"""The part of a grid that curves can touch.

Relocation and cutting look at this part alone, so that their cost goes with the length of the curves. The rest
of the cells is whole, or empty, and takes no more than its inside test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.grid import BackgroundGrid

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

REACH = 1.25
"""Nodes this near to a curve are near it, in sizes of the largest cell along x and y. A cell that the curve passes
through has its corners within 1, chords of arcs miss the arc by less than 0.1, and relocation reaches out to 3/4 of
an edge, 1.06 where that runs along the diagonal of the box of its cell."""


@dataclass(frozen=True)
class Part:
    """Some cells of a grid, as a grid of their own: those that have a node near a curve.

    Attributes
    ----------
    grid : BackgroundGrid
        The cells of the part, with nodes and cells in the order of the whole grid.
    cells, nodes : (c,), (n,) int64
        Their numbers in the whole grid, ascending.
    near : (n,) bool
        Whether a node is near a curve: all cells around it belong to the part then.
    """

    grid: BackgroundGrid
    cells: Ints
    nodes: Ints
    near: Bools


def near_part(grid: BackgroundGrid, curves: Sequence[Curve]) -> Part:
    """The cells that have a node near one of the curves; of a grid without structure all cells."""
    if grid.shape is None:
        every = np.ones(grid.node_count, dtype=bool)
        return Part(grid, np.arange(grid.cell_count), np.arange(grid.node_count), every)
    near = _near_nodes(grid, curves)
    cells = np.flatnonzero(_touched(grid, near))
    if len(cells) == 0:
        cells = np.zeros(1, dtype=np.int64)  # a part is a grid, and a grid has a cell
    corners = grid.corners(cells)
    used = np.zeros(grid.node_count, dtype=bool)
    used[corners] = True
    nodes = np.flatnonzero(used)
    part = BackgroundGrid(grid.position(nodes), np.searchsorted(nodes, corners))
    return Part(part, cells, nodes, near[nodes])


def _near_nodes(grid: BackgroundGrid, curves: Sequence[Curve]) -> Bools:
    """(n,) Whether a node lies in a bin, as large as the largest cell, that a curve comes near."""
    low, high = grid.box
    width = grid.cell_box
    marked = np.zeros(np.floor((high - low) / width).astype(np.int64) + 1, dtype=bool)
    for curve in curves:
        fine = curve.subdivided(float(width.min()))
        reach = (0.5 * np.abs(fine.bulges) * fine.chords)[:, None] + REACH * width  # with the sagitta
        a, b = fine.points[:-1], fine.points[1:]
        first = np.floor((np.minimum(a, b) - reach - low) / width).astype(np.int64)
        last = np.floor((np.maximum(a, b) + reach - low) / width).astype(np.int64)
        seen = np.all((last >= 0) & (first < marked.shape), axis=1)
        first, last = np.maximum(first[seen], 0), np.minimum(last[seen], np.array(marked.shape) - 1)
        for i, j in np.ndindex(*(np.max(last - first, axis=0, initial=-1) + 1)):
            bins = first + (i, j)
            bins = bins[np.all(bins <= last, axis=1)]
            marked[bins[:, 0], bins[:, 1]] = True
    return grid.in_bins(marked, low, width)


def _touched(grid: BackgroundGrid, nodes: Bools) -> Bools:
    """(m,) Cells of a structured grid that have one of the marked nodes for a corner."""
    assert grid.shape is not None
    rows = nodes.reshape(-1, grid.shape[0] + 1)
    if grid.closed:
        rows = np.vstack([rows, rows[:1]])
    along = rows[:, :-1] | rows[:, 1:]
    return np.asarray(along[:-1] | along[1:]).reshape(-1)
