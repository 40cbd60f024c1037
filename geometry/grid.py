"""Background grids: quadrilateral cells that need not fit any geometry."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Numbers = NDArray[np.int32] | NDArray[np.int64]
"""Numbers of nodes and cells, of which there may be millions."""
Pair = tuple[float, float]

MOST_CELLS = 50_000_000
"""More cells than this are a slip of the pen (a cell size in the wrong unit), not a model."""

CHUNK = 1 << 14
"""Rows of a long array that are worked on at a time, so that intermediate arrays stay small."""

NO_NODES, NOWHERE = np.zeros(0, dtype=np.int64), np.zeros((0, 2))


def chunks(count: int) -> Iterator[slice]:
    """Slices of at most ``CHUNK`` rows that make up the whole."""
    for first in range(0, count, CHUNK):
        yield slice(first, min(first + CHUNK, count))


@dataclass(frozen=True)
class BackgroundGrid:
    """Quadrilateral cells.

    Attributes
    ----------
    xy : (n, 2) float64, metres
        Node positions.
    quads : (m, 4) int32 or int64
        Nodes of each cell, counter-clockwise.
    shape : (int, int) or None
        Cells in the first and the second direction where the grid is structured (cell number =
        j * shape[0] + i); None where it is not.
    """

    xy: Floats
    quads: Numbers
    shape: tuple[int, int] | None = None

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.xy)

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.quads)

    @property
    def closed(self) -> bool:
        """Whether the last row of cells of a structured grid joins the first (a full ring)."""
        return self.shape is not None and self.node_count == (self.shape[0] + 1) * self.shape[1]

    def position(self, nodes: Numbers) -> Floats:
        """(k, 2) Positions of some nodes, metres."""
        return np.asarray(self.xy[nodes])

    def corners(self, cells: Numbers) -> Numbers:
        """(k, 4) Nodes of some cells, counter-clockwise."""
        return self.quads[cells]

    @cached_property
    def box(self) -> Floats:
        """(2, 2) Lower left and upper right corner of the bounding box, metres."""
        return np.array([self.xy.min(axis=0), self.xy.max(axis=0)])

    @cached_property
    def cell_box(self) -> Floats:
        """(2,) The largest extents of a cell along x and y, metres."""
        return np.asarray(np.max([np.ptp(corners, axis=1).max(axis=0) for corners in self._cells()], axis=0))

    @cached_property
    def largest_step(self) -> Floats:
        """(2,) The largest extents of a cell edge along x and y, metres."""
        steps = (np.abs(np.roll(corners, -1, axis=1) - corners) for corners in self._cells())
        return np.asarray(np.max([step.max(axis=(0, 1)) for step in steps], axis=0))

    def moved(self, nodes: Ints, positions: Floats) -> BackgroundGrid:
        """The grid with some nodes (k,), ascending, at other positions (k, 2), metres."""
        xy = self.xy.copy()
        xy[nodes] = positions
        return BackgroundGrid(xy, self.quads, self.shape)

    def in_bins(self, marked: Bools, low: Floats, width: Floats) -> Bools:
        """(n,) Whether nodes lie in marked bins, of the given width each from ``low`` on."""
        inside = np.empty(self.node_count, dtype=bool)
        for rows in chunks(self.node_count):
            i, j = np.floor((self.xy[rows] - low) / width).astype(np.int64).T
            inside[rows] = marked[i, j]
        return inside

    def _cells(self) -> Iterator[Floats]:
        """(k, 4, 2) Corners of all cells, some at a time."""
        for rows in chunks(self.cell_count):
            yield self.position(self.corners(np.arange(rows.start, rows.stop)))

    @cached_property
    def edges(self) -> Ints:
        """(e, 2) Every cell edge once, lower node number first, sorted."""
        ends = np.stack([self.quads, np.roll(self.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
        # One number an edge sorts faster than a row of two.
        code = np.unique(ends.min(axis=1) * np.int64(len(self.xy)) + ends.max(axis=1))
        return np.column_stack(np.divmod(code, len(self.xy)))

    @cached_property
    def areas(self) -> Floats:
        """(m,) Area of each cell, m^2."""
        return np.concatenate([_areas(corners) for corners in self._cells()])

    @cached_property
    def node_size(self) -> Floats:
        """(n,) Length of the shortest cell edge at each node, metres: the local h."""
        length = np.hypot(*(self.xy[self.edges[:, 1]] - self.xy[self.edges[:, 0]]).T)
        size = np.full(len(self.xy), np.inf)
        for end in (0, 1):
            np.minimum.at(size, self.edges[:, end], length)
        return size

    @cached_property
    def typical_size(self) -> float:
        """Side of a square with the area of the median cell, metres: the h of a penalty E/h."""
        return float(np.sqrt(np.median(self.areas)))

    @cached_property
    def cell_size(self) -> float:
        """Length of the longest cell edge, metres."""
        sides = (np.roll(corners, -1, axis=1) - corners for corners in self._cells())
        return float(max(np.hypot(side[..., 0], side[..., 1]).max() for side in sides))


class RectangularGrid(BackgroundGrid):
    """Cells between straight grid lines, of which some nodes may have been moved.

    It keeps its lines and the moved nodes alone, so that what is empty costs nothing; ``xy`` and ``quads`` are made
    where somebody asks for them. Sizes are those of the lines and of the cells with a moved node.
    """

    lines: tuple[Floats, Floats]
    others: tuple[Ints, Floats]

    def __init__(self, x: Floats, y: Floats, nodes: Ints = NO_NODES, positions: Floats = NOWHERE) -> None:
        """Grid lines at (n_x + 1,) x and (n_y + 1,) y; the moved (k,) nodes, ascending, and where they are."""
        for name, value in (
            ("lines", (x, y)), ("others", (nodes, positions)), ("shape", (len(x) - 1, len(y) - 1)),
        ):  # fmt: skip
            object.__setattr__(self, name, value)

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.lines[0]) * len(self.lines[1])

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return (len(self.lines[0]) - 1) * (len(self.lines[1]) - 1)

    @cached_property
    def xy(self) -> Floats:  # type: ignore[override]
        """(n, 2) Positions of all nodes, metres."""
        return self.position(np.arange(self.node_count))

    @cached_property
    def quads(self) -> Numbers:  # type: ignore[override]
        """(m, 4) Nodes of all cells."""
        return self.corners(np.arange(self.cell_count))

    def position(self, nodes: Numbers) -> Floats:
        """(k, 2) Positions of some nodes, metres."""
        j, i = np.divmod(nodes, len(self.lines[0]))
        xy = np.stack([self.lines[0][i], self.lines[1][j]], axis=-1)
        moved, positions = self.others
        if len(moved):
            place = np.minimum(np.searchsorted(moved, nodes), len(moved) - 1)
            there = moved[place] == nodes
            xy[there] = positions[place[there]]
        return xy

    def corners(self, cells: Numbers) -> Numbers:
        """(k, 4) Nodes of some cells, counter-clockwise."""
        columns = len(self.lines[0])
        first = cells + cells // (columns - 1)
        return np.asarray(first[..., None] + np.array([0, 1, columns + 1, columns], dtype=first.dtype))

    def moved(self, nodes: Ints, positions: Floats) -> RectangularGrid:
        """The grid with some nodes (k,), ascending, at other positions (k, 2), metres."""
        kept = ~np.isin(self.others[0], nodes)
        every = np.concatenate([self.others[0][kept], nodes])
        order = np.argsort(every)
        return RectangularGrid(
            *self.lines, every[order], np.concatenate([self.others[1][kept], positions])[order]
        )

    def in_bins(self, marked: Bools, low: Floats, width: Floats) -> Bools:
        """(n,) Whether nodes lie in marked bins, of the given width each from ``low`` on."""
        i, j = (
            np.floor((line - start) / size).astype(np.int64)
            for line, start, size in zip(self.lines, low, width, strict=True)
        )
        inside = np.ascontiguousarray(marked[:, j][i].T).reshape(-1)
        nodes, positions = self.others
        inside[nodes] = marked[tuple(np.floor((positions - low) / width).astype(np.int64).T)]
        return np.asarray(inside)

    @cached_property
    def box(self) -> Floats:
        """(2, 2) Lower left and upper right corner of the bounding box, metres."""
        every = np.vstack([[line[k] for line in self.lines] for k in (0, -1)] + [self.others[1]])
        return np.array([every.min(axis=0), every.max(axis=0)])

    @cached_property
    def cell_box(self) -> Floats:
        """(2,) The largest extents of a cell along x and y, metres."""
        return np.asarray(np.maximum(self._largest, np.ptp(self._crooked, axis=1).max(axis=0, initial=0.0)))

    @cached_property
    def largest_step(self) -> Floats:
        """(2,) The largest extents of a cell edge along x and y, metres."""
        steps = np.abs(np.roll(self._crooked, -1, axis=1) - self._crooked)
        return np.asarray(np.maximum(self._largest, steps.max(axis=(0, 1), initial=0.0)))

    @cached_property
    def areas(self) -> Floats:
        """(m,) Area of each cell, m^2."""
        areas = np.multiply.outer(*(np.diff(line) for line in self.lines[::-1])).reshape(-1)
        areas[self._crooked_cells] = _areas(self._crooked)
        return areas

    @cached_property
    def cell_size(self) -> float:
        """Length of the longest cell edge, metres."""
        sides = np.roll(self._crooked, -1, axis=1) - self._crooked
        longest = np.hypot(sides[..., 0], sides[..., 1]).max(initial=0.0)
        return float(max(longest, self._largest.max()))

    @cached_property
    def _largest(self) -> Floats:
        """(2,) Largest distances of neighbouring grid lines, metres."""
        return np.array([np.diff(line).max() for line in self.lines])

    @cached_property
    def _crooked_cells(self) -> Ints:
        """Cells with a moved node."""
        j, i = np.divmod(self.others[0], len(self.lines[0]))
        n_x, n_y = len(self.lines[0]) - 1, len(self.lines[1]) - 1
        around = [(i - a, j - b) for a in (0, 1) for b in (0, 1)]
        cells = [(y * n_x + x)[(x >= 0) & (x < n_x) & (y >= 0) & (y < n_y)] for x, y in around]
        return np.unique(np.concatenate(cells))

    @cached_property
    def _crooked(self) -> Floats:
        """(k, 4, 2) Corners of the cells with a moved node, metres."""
        return self.position(self.corners(self._crooked_cells))


def _areas(corners: Floats) -> Floats:
    """(k,) Areas of cells with (k, 4, 2) corners, m^2."""
    (d1x, d1y), (d2x, d2y) = (corners[:, 2:] - corners[:, :2]).transpose(1, 2, 0)
    return np.asarray(0.5 * (d1x * d2y - d1y * d2x))


def cartesian(
    low: Pair,
    high: Pair,
    *,
    cell: float | Pair | None = None,
    counts: tuple[int, int] | None = None,
    aligned: bool,
) -> BackgroundGrid:
    """Rectangular cells over the box from ``low`` to ``high``.

    Parameters
    ----------
    low, high : (x, y), metres
    cell : float or (float, float), metres
        Cell size, the same or one for each direction; give this or ``counts``.
    counts : (int, int)
        Cells in x and y; for aligned grids only.
    aligned : bool
        True: the grid is exactly the box (its ends to the bit), in equal cells not larger than ``cell``.
        False: grid lines stand at integer multiples of the cell and cover the box with half a cell or
        more to spare, so that no side of the box is the outer line of the grid by accident.

    Raises
    ------
    GeometryError
        For an empty box, sizes that are not positive, or more than ``MOST_CELLS`` cells.
    """
    require_finite("the box of the grid", (*low, *high))
    if not (low[0] < high[0] and low[1] < high[1]):
        raise GeometryError(f"the box of the grid is empty: low {low} must be below high {high} in x and y")
    if (cell is None) == (counts is None):
        raise GeometryError("a Cartesian grid needs either a cell size or counts, and not both")
    if counts is not None:
        if not aligned:
            raise GeometryError("counts need an aligned grid; give a cell size for one that is not aligned")
        n_x, n_y = whole_counts(counts)
        x, y = np.linspace(low[0], high[0], n_x + 1), np.linspace(low[1], high[1], n_y + 1)
        return check(RectangularGrid(x, y))
    sizes = (cell, cell) if isinstance(cell, int | float) else cell
    assert sizes is not None
    require_finite("the cell size", sizes)
    if len(sizes) != 2 or min(sizes) <= 0.0:
        raise GeometryError(f"the cell size must be positive (one number, or one for x and y), not {cell}")
    spans = [(b - a) / h for a, b, h in zip(low, high, sizes, strict=True)]
    box = f" in its box of {high[0] - low[0]:.4g} x {high[1] - low[1]:.4g} m"
    require_cells((spans[0] + 2.0) * (spans[1] + 2.0), box)
    if aligned:
        # 1e-9: a box of 40.00000000001 cells, which is what decimal fractions give, has 40 of them.
        divided = (max(1, math.ceil(span - 1e-9)) for span in spans)
        return cartesian(low, high, counts=tuple(divided), aligned=True)  # type: ignore[arg-type]
    x, y = (
        h * np.arange(math.floor(a / h - 0.5), math.ceil(b / h + 0.5) + 1, dtype=np.float64)
        for a, b, h in zip(low, high, sizes, strict=True)
    )
    return check(RectangularGrid(x, y))


def check(grid: BackgroundGrid) -> BackgroundGrid:
    """The grid itself, if all of its cells can be used.

    Raises
    ------
    GeometryError
        Where there is no cell, a number is not finite or no node, or a cell has a corner without a positive
        Jacobian (clockwise, folded over or without area); it names the cell and where it is.
    """
    if grid.cell_count == 0:
        raise GeometryError("the grid has no cells")
    if isinstance(grid, RectangularGrid) and len(grid.others[0]) == 0 and _ascending(*grid.lines):
        return grid
    if not np.all(np.isfinite(grid.xy)):
        node = int(np.flatnonzero(~np.isfinite(grid.xy).all(axis=1))[0])
        raise GeometryError(f"node {node} of the grid has a coordinate that is not finite")
    if grid.quads.min() < 0 or grid.quads.max() >= len(grid.xy):
        raise GeometryError(f"a cell of the grid names a node that is none of its {len(grid.xy)}")
    worst = [
        scaled_jacobians(grid.xy, grid.corners(np.arange(rows.start, rows.stop))).min(axis=1)
        for rows in chunks(grid.cell_count)
    ]
    bad = np.flatnonzero(~(np.concatenate(worst) > 0.0))
    if len(bad):
        x, y = grid.xy[grid.corners(bad[0])].mean(axis=0)
        raise GeometryError(
            f"{len(bad)} of {grid.cell_count} grid cells are inverted or folded over, the first is cell "
            f"{bad[0]} at ({x:.6g}, {y:.6g}); cells must be convex and run counter-clockwise"
        )
    return grid


def _ascending(*lines: Floats) -> bool:
    """Whether grid lines are finite and each lies beyond the one before."""
    return all(bool(np.isfinite(line).all() and (np.diff(line) > 0.0).all()) for line in lines)


def scaled_jacobians(xy: Floats, quads: Numbers) -> Floats:
    """(m, 4) Sine of the angle at each corner of the cells: 1 for a rectangle, <= 0 where it is inverted."""
    corners = xy[quads]
    onward = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    cross = onward[..., 0] * back[..., 1] - onward[..., 1] * back[..., 0]
    lengths = np.hypot(*np.moveaxis(onward, -1, 0)) * np.hypot(*np.moveaxis(back, -1, 0))
    return np.asarray(np.divide(cross, lengths, out=np.zeros_like(cross), where=lengths > 0.0))


def whole_counts(counts: Sequence[int]) -> tuple[int, int]:
    """Two whole numbers of cells, each at least 1, and not too many together."""
    if len(counts) != 2 or any(n != int(n) or n < 1 for n in counts):
        raise GeometryError(f"the counts of a grid must be two whole numbers from 1 on, not {tuple(counts)}")
    require_cells(float(counts[0]) * float(counts[1]))
    return int(counts[0]), int(counts[1])


def require_cells(cells: float, box: str = "") -> None:
    """Refuse more than ``MOST_CELLS`` cells; ``box`` says where they would be."""
    if cells > MOST_CELLS:
        raise GeometryError(
            f"the grid would have {cells:.3g} cells{box}, more than {MOST_CELLS:.0e}; choose larger ones (units?)"
        )


def require_finite(what: str, numbers: Sequence[float]) -> None:
    """Refuse numbers that are not finite."""
    if not all(math.isfinite(number) for number in numbers):
        raise GeometryError(f"{what} needs finite numbers, not {tuple(numbers)}")
