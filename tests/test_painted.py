"""Cells painted as pixels: each pixel has the colour of the cell at its place, and none is left out."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from phantomnode.pipeline import drawing
from phantomnode.pipeline.painted import PaintedCells, paint


def waves(columns, rows, width, height):
    """(m, 4, 2) Quadrilaterals that fill a part of a picture between two waves, in pixels."""
    x, y = np.meshgrid(np.linspace(0.1, 0.9, columns + 1), np.linspace(0.2, 0.8, rows + 1))
    y = y + 0.1 * np.sin(7.0 * x)
    p = np.stack([width * x, height * y], axis=-1)
    return np.stack([p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]], axis=2).reshape(-1, 4, 2)


def halves(quads):
    """(2 m, 3, 2) Their triangles."""
    return quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 2)


@pytest.mark.parametrize("corners", [4, 3])
@pytest.mark.parametrize(
    "columns", [2, 23, 300], ids=["large cells", "cells of some pixels", "cells below a pixel"]
)
def test_a_pixel_has_the_number_of_a_cell_that_touches_it(columns, corners):
    cells = waves(columns, columns, 90, 70)
    cells = cells if corners == 4 else halves(cells)
    number = np.full((70, 90), -1)
    paint(cells, 0, number)
    shapes = shapely.polygons(cells)
    row, column = np.nonzero(number >= 0)
    pixels = shapely.box(column, row, column + 1, row + 1)
    assert np.all(shapely.distance(pixels, shapes[number[row, column]]) < 1e-9)


@pytest.mark.parametrize("columns", [2, 23, 300])
def test_no_pixel_within_the_cells_is_left_out_and_none_beyond_them_is_painted(columns):
    cells = waves(columns, columns, 90, 70)
    number = np.full((70, 90), -1)
    paint(cells, 0, number)
    whole = shapely.union_all(shapely.polygons(cells), grid_size=1e-6)
    column, row = np.meshgrid(np.arange(90), np.arange(70))
    pixels = shapely.box(column, row, column + 1, row + 1)
    assert np.all(number[shapely.contains(whole, pixels)] >= 0)
    assert np.all(number[~shapely.intersects(whole.buffer(1e-6), pixels)] == -1)


def test_cells_that_reach_out_of_the_picture_or_lie_beyond_it():
    cells = waves(9, 9, 90, 70)
    moved, number, whole = cells - (40.0, 30.0), np.full((35, 45), -1), np.full((70, 90), -1)
    paint(moved, 0, number)
    paint(cells, 0, whole)
    np.testing.assert_array_equal(number, whole[30:65, 40:85])
    paint(cells + 1000.0, 0, number)
    np.testing.assert_array_equal(number, whole[30:65, 40:85])


def test_very_many_cells_are_painted_in_the_colours_of_few(monkeypatch):
    """The same picture by polygons and by pixels: but for what is within a pixel of an edge between colours."""
    cells = waves(8, 8, 1.0, 1.0)
    pictures = []
    for limit in (10**6, 3):
        monkeypatch.setattr(drawing, "VERY_MANY", limit)
        figure, (axes,) = drawing.map_figure(np.array([[0.0, 0.0], [1.0, 1.0]]), 4.0)
        filled = drawing.fill(axes, cells, array=np.arange(64.0) // 32, edgecolor="face", cmap="turbo")
        assert isinstance(filled, PaintedCells) is (limit == 3)
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
        figure.canvas.draw()
        pictures.append(np.asarray(figure.canvas.buffer_rgba(), dtype=int)[..., :3])
    differ = np.abs(pictures[0] - pictures[1]).max(axis=-1) > 30
    assert np.count_nonzero(np.abs(pictures[0] - 255).max(axis=-1) > 30) > 50 * np.count_nonzero(differ)


def test_other_places_of_the_same_cells_and_no_cells():
    cells = PaintedCells(np.zeros((0, 4, 2)))
    assert cells.get_datalim(None).x0 == np.inf
    cells.set_verts(waves(2, 2, 1.0, 1.0))
    np.testing.assert_allclose(cells.get_datalim(None).intervalx, [0.1, 0.9], rtol=1e-15)
