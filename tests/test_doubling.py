"""Real and phantom nodes: the sharing of Fig. 6, node counts, and random cuts against polygon operations."""

from __future__ import annotations

import numpy as np
import pytest

from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.cut import cut
from phantomnode.geometry.doubling import CutMesh, double
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.noding import Lattice


def square_grid(cells: int, size: float = 1.0) -> BackgroundGrid:
    n = cells + 1
    x, y = np.meshgrid(np.arange(n) * size, np.arange(n) * size)
    first = (np.arange(cells)[:, None] * n + np.arange(cells)).reshape(-1)
    quads = np.column_stack([first, first + 1, first + n + 1, first + n])
    return BackgroundGrid(np.column_stack([x.reshape(-1), y.reshape(-1)]), quads, (cells, cells))


def line(*points: tuple[float, float]) -> Curve:
    return Curve(np.array(points, dtype=float), np.zeros(len(points) - 1))


def box(x0: float, y0: float, x1: float, y1: float) -> Region:
    return Region(line((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)))


def disc(x: float, y: float, r: float) -> Curve:
    return Curve(np.array([[x + r, y], [x - r, y], [x + r, y]]), np.ones(2))


def cut_mesh(grid: BackgroundGrid, regions: tuple[Region, ...], *interfaces: Curve) -> CutMesh:
    return double(grid, cut(grid, regions, interfaces, Lattice.of(grid)))


BLOCK = (box(0, 0, 5, 5),)
CHECKERBOARD = tuple(box(i, j, i + 1, j + 1) for j in range(5) for i in range(5) if (i + j) % 2 == 0)

# formulation of the merging rule by hand: 5 x 5 cells, elements and nodes.
COUNTS = {
    "uncut": (BLOCK, [], 25, 36),
    "cut across at y = 2.4": (BLOCK, [line((0, 2.4), (5, 2.4))], 30, 48),
    "cut that starts and ends outside the body": (BLOCK, [line((-1, 2.4), (6, 2.4))], 30, 48),
    "crack with its tip in a cell": (BLOCK, [line((0, 2.4), (2.5, 2.4))], 27, 40),
    "crack with its tip on an edge": (BLOCK, [line((0, 2.4), (2, 2.4))], 27, 40),
    "crack within one cell, edge to edge": (BLOCK, [line((2, 2.4), (3, 2.4))], 26, 36),
    "crack inside one cell": (BLOCK, [line((2.2, 2.4), (2.8, 2.4))], 25, 36),
    "cut on a grid line": (BLOCK, [line((0, 2), (5, 2))], 25, 42),
    "crack on a grid line, tip at a node": (BLOCK, [line((0, 2), (3, 2))], 25, 39),
    "crack on a grid line, tip within an edge: cut back": (BLOCK, [line((0, 2), (2.5, 2))], 25, 38),
    "crack along one edge is closed": (BLOCK, [line((2, 2), (3, 2))], 25, 36),
    "cut along the diagonal": (BLOCK, [line((0, 0), (5, 5))], 30, 52),
    "checkerboard of bodies": (CHECKERBOARD, [], 13, 52),
    "hole within one cell": ((Region(BLOCK[0].outer, (disc(2.5, 2.5, 0.3),)),), [], 25, 36),
    "disc within one cell": ((Region(disc(2.5, 2.5, 0.3)),), [], 1, 4),
    "thin strip that passes each cell twice": ((box(0, 2.3, 5, 2.4),), [], 5, 12),
    "two strips in the same cells": ((box(0, 2.1, 5, 2.2), box(0, 2.6, 5, 2.8)), [], 10, 24),
}


@pytest.mark.parametrize("name", COUNTS)
def test_elements_and_nodes(name: str) -> None:
    regions, interfaces, elements, nodes = COUNTS[name]
    mesh = cut_mesh(square_grid(5), regions, *interfaces)
    assert (len(mesh.elements), len(mesh.xy)) == (elements, nodes)
    assert np.isclose(mesh.area.sum(), sum(region.area for region in regions), rtol=0.05)


def sharing(mesh: CutMesh, cell: int) -> list[set[int]]:
    """Nodes of the elements of one cell."""
    return [set(mesh.elements[k].tolist()) for k in np.flatnonzero(mesh.cell == cell)]


def test_fig_6a_a_full_cut_shares_no_node() -> None:
    """Fig. 6a: the interface cuts the element into two; no node in common, each side with its own 4."""
    mesh = cut_mesh(square_grid(3), (box(0, 0, 3, 3),), line((0, 1.4), (3, 1.6)))
    one, two = sharing(mesh, 4)
    assert not one & two
    phantom = ~mesh.real
    assert all(np.count_nonzero(phantom[list(side)]) == 2 for side in (one, two))


def test_fig_6b_a_crack_that_ends_on_the_right_edge_shares_the_nodes_of_that_edge() -> None:
    mesh = cut_mesh(square_grid(3), (box(0, 0, 3, 3),), line((0, 1.4), (2, 1.6)))
    one, two = sharing(mesh, 4)
    assert sorted(mesh.grid_node[list(one & two)]) == [6, 10]  # (2, 1) and (2, 2): the right edge of the cell


def test_fig_6c_a_crack_that_ends_on_the_lower_edge_shares_the_nodes_of_that_edge() -> None:
    """Fig. 6c: neighbouring edges are cut, the tip is on the lower one; one of the two nodes of that edge
    is used by the element before, too."""
    mesh = cut_mesh(square_grid(3), (box(0, 0, 3, 3),), line((0, 1.9), (1, 1.5), (1.6, 1.0)))
    one, two = sharing(mesh, 4)
    assert sorted(mesh.grid_node[list(one & two)]) == [5, 6]  # (1, 1) and (2, 1): the lower edge of the cell
    before = set().union(*sharing(mesh, 3))
    assert sorted(mesh.grid_node[list(one & two & before)]) == [5]


def test_a_branching_cut_gives_three_fragments_that_share_no_node() -> None:
    """Three cuts from the middle of a cell to the boundary: three separate bodies meet in the cell."""
    arms = [line((1.5, 1.5), end) for end in ((0.0, 1.4), (3.0, 1.45), (1.55, 3.0))]
    mesh = cut_mesh(square_grid(3), (box(0, 0, 3, 3),), *arms)
    first, second, third = sharing(mesh, 4)
    assert not (first & second or first & third or second & third)
    assert mesh.component.max() == 2
