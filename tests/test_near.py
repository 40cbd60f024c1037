"""The part of a grid near curves: what it must hold, and that the rest changes no bit of a cut."""

from __future__ import annotations

import tracemalloc
from dataclasses import astuple

import numpy as np
import pytest
from test_doubling import box, disc, line, square_grid

from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.cut import cut
from phantomnode.geometry.doubling import CutMesh, double
from phantomnode.geometry.grid import BackgroundGrid, cartesian
from phantomnode.geometry.inside import connected_in_rows
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.mapped import polar
from phantomnode.geometry.near import near_part
from phantomnode.geometry.noding import Lattice
from phantomnode.geometry.relocate import relocate

Body = tuple[tuple[Region, ...], tuple[Curve, ...]]


def wavy(count: int, x: float, y: float, r: float, wave: float, waves: int) -> Curve:
    t = np.linspace(0.0, 2.0 * np.pi, count + 1)
    radius = r + wave * np.cos(waves * t)
    points = np.column_stack([x + radius * np.cos(t), y + radius * np.sin(t)])
    points[-1] = points[0]
    return line(*points)


BODIES: dict[str, Body] = {
    "disc": ((Region(disc(20.1, 19.7, 15.3)),), ()),
    "thin ring": ((Region(disc(20.1, 19.7, 17.0), (disc(20.1, 19.7, 15.9),)),), ()),
    "wavy with holes and a crack": (
        (Region(wavy(300, 20, 20, 17, 1.0, 5), (wavy(80, 12, 20, 3, 0.7, 7), disc(28, 20, 0.4))),),
        (line((15.0, 25.0), (24.3, 31.2)), disc(20.0, 10.0, 4.0)),
    ),
    "two discs and a speck": (
        (Region(disc(10, 10, 6.2)), Region(disc(29, 30, 8.0)), Region(disc(30.5, 10.5, 0.3))),
        (),
    ),
    "along grid lines": ((box(5, 5, 20, 30), box(20, 10, 33, 20)), (line((5.0, 12.0), (20.0, 12.0)),)),
    "all of the grid": ((box(0, 0, 40, 40),), (line((8.0, 8.0), (8.0, 20.0), (31.0, 20.0)),)),
}


def cut_mesh(grid: BackgroundGrid, body: Body) -> CutMesh:
    curves = [*(loop for region in body[0] for loop in region.loops), *body[1]]
    moved = relocate(grid, curves).grid
    return double(moved, cut(moved, *body, Lattice.of(grid)))


def assert_same(one: CutMesh, other: CutMesh) -> None:
    for a, b in zip(astuple(one), astuple(other), strict=True):
        if isinstance(a, tuple):
            assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
        else:
            assert a.dtype == b.dtype and np.array_equal(a, b)


@pytest.mark.parametrize("name", BODIES)
def test_a_structured_grid_is_cut_to_the_bit_as_the_same_cells_without_a_structure(name: str) -> None:
    """Of a grid without structure all cells are looked at as if near a curve."""
    grid = square_grid(40)
    assert_same(cut_mesh(grid, BODIES[name]), cut_mesh(BackgroundGrid(grid.xy, grid.quads), BODIES[name]))


@pytest.mark.parametrize("angles", [(0.0, 360.0), (-90.0, 200.0)])
def test_so_is_a_polar_grid_closed_or_not(angles: tuple[float, float]) -> None:
    grid = polar((0.0, 0.0), (10.0, 30.0), angles, counts=(20, 90))
    for body in (
        (
            (Region(disc(0.5, 20.0, 6.0)), Region(disc(20.0, 0.0, 5.0))),
            (),
        ),  # the second where the ring closes
        ((Region(disc(0.0, 0.0, 29.0), (disc(0.1, 0.0, 11.0),)),), (disc(0.0, 0.0, 20.0),)),
    )[: 2 if angles[0] == 0.0 else 1]:
        assert_same(cut_mesh(grid, body), cut_mesh(BackgroundGrid(grid.xy, grid.quads), body))


def test_the_part_holds_every_node_within_a_cell_of_a_curve_and_all_cells_around_it() -> None:
    curves = [wavy(200, 20, 20, 15, 2.0, 5), disc(-300.0, 0.0, 303.0), line((3.0, 35.0), (9.0, 36.5))]
    grid = cartesian((0.0, 0.0), (40.0, 40.0), cell=(0.4, 1.0), aligned=True)
    part = near_part(grid, curves)
    inside = np.zeros(len(grid.xy), dtype=bool)
    inside[part.nodes[part.near]] = True
    off = np.min([np.abs(LevelSet.of_curve(curve).distance(grid.xy)) for curve in curves], axis=0)
    assert inside[off <= 0.4].all() and not inside[off > 4.5].any()
    assert np.isin(np.flatnonzero(inside[grid.quads].any(axis=1)), part.cells).all()
    np.testing.assert_array_equal(part.grid.xy, grid.xy[part.nodes])
    np.testing.assert_array_equal(part.nodes[part.grid.quads], grid.quads[part.cells])


def test_a_part_without_a_curve_is_one_cell() -> None:
    part = near_part(square_grid(4), [disc(50.0, 0.0, 3.0)])
    assert len(part.cells) == 1 and not part.near.any()


def test_sets_of_cells_in_rows_hang_together_by_edges_and_round_a_closed_ring() -> None:
    chosen = np.array([[1, 0, 1], [0, 1, 0], [1, 1, 0], [1, 0, 1]], dtype=bool)
    count, label = connected_in_rows(chosen, closed=False)
    assert count == 4
    np.testing.assert_array_equal(label, [0, -1, 1, -1, 2, -1, 2, 2, -1, 2, -1, 3])
    count, label = connected_in_rows(chosen, closed=True)
    np.testing.assert_array_equal(label, [0, -1, 1, -1, 0, -1, 0, 0, -1, 0, -1, 1])
    assert count == 2


def test_what_is_empty_of_a_grid_costs_a_few_bytes_a_cell() -> None:
    """A disc of 2,000 cells in a grid of 1e6: marks, numbers of regions and counts of copies, 1 to 4 bytes each."""
    region = Region(disc(500.0, 500.0, 25.0))
    peaks = []
    for cells in (1000, 1500):
        tracemalloc.start()
        grid = cartesian((0.0, 0.0), (cells, cells), cell=1.0, aligned=True)
        mesh = cut_mesh(grid, ((region,), ()))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert mesh.area.sum() == pytest.approx(region.area, rel=1e-3)
    assert np.diff(peaks)[0] <= 12 * (1500**2 - 1000**2)
