"""Fragments as fans about their centroids: area and centroid kept, five modes resisted, odd shapes too."""

from __future__ import annotations

import mapbox_earcut
import numpy as np
import pytest

from phantomnode.geometry.bilinear import gradients, to_local
from phantomnode.geometry.fans import centroid_fans

CELL = np.array([[0.0, 0.0], [1.0, 0.05], [1.1, 1.0], [-0.05, 0.9]])

SHAPES = {
    "whole cell": CELL.tolist(),
    "triangle": [(0, 0), (0.4, 0), (0, 0.3)],
    "sliver": [(0, 0), (1, 0.05), (0, 1e-3)],
    "pentagon": [(0, 0), (1, 0.05), (1.05, 0.5), (0.4, 0.9), (-0.04, 0.8)],
    "angle": [(0, 0), (1, 0.05), (1, 0.15), (0.1, 0.1), (0.1, 0.9), (0, 0.9)],  # its centroid lies outside
    "horseshoe": [(0, 0), (1, 0.05), (1, 0.8), (0.9, 0.8), (0.9, 0.2), (0.1, 0.2), (0.1, 0.8), (0, 0.8)],
    "notched": [(0, 0), (1, 0.05), (1, 0.9), (0.52, 0.46), (0, 0.9)],
}


def triangles_of(ring):
    ring = np.array(ring, dtype=float)
    corners = ring[mapbox_earcut.triangulate_float64(ring, np.array([len(ring)])).reshape(-1, 3)]
    signed = areas(corners)
    return np.where(signed[:, None, None] < 0, corners[:, ::-1], corners)


def areas(triangles):
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def centroid(triangles):
    return areas(triangles) @ triangles.mean(axis=1) / areas(triangles).sum()


def modes(triangles):
    """Number of modes of the cell, of eight, that one point a triangle resists."""
    points = triangles.mean(axis=1)
    g = gradients(
        np.repeat(CELL[None], len(points), axis=0), to_local(np.repeat(CELL[None], len(points), 0), points)
    )
    rows = []
    for at in g:
        xx, yy, xy = np.zeros((3, 8))
        xx[::2], yy[1::2], xy[::2], xy[1::2] = at[:, 0], at[:, 1], at[:, 1], at[:, 0]
        rows += [xx, yy, xy]
    return np.linalg.matrix_rank(np.array(rows), tol=1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_a_fan_fills_the_fragment_and_sees_every_mode(name):
    triangles = triangles_of(SHAPES[name])
    fan, element = centroid_fans(triangles, np.full(len(triangles), 7))
    assert np.all(element == 7) and np.all(areas(fan) > 0.0)
    assert areas(fan).sum() == pytest.approx(areas(triangles).sum(), rel=1e-13)
    np.testing.assert_allclose(centroid(fan), centroid(triangles), atol=1e-14)
    if name != "sliver":  # its points lie as good as on a line
        assert modes(fan) == 5
    about_one_point = len(SHAPES[name]) == len(fan)
    assert about_one_point == (name not in ("angle", "horseshoe"))


def test_one_point_of_a_plain_triangle_misses_modes():
    """Why it must be a fan: one point resists the three strains and no other mode, so phantom nodes fly away."""
    assert modes(triangles_of(SHAPES["triangle"])) == 3
    assert modes(centroid_fans(triangles_of(SHAPES["triangle"]), np.zeros(1, int))[0]) == 5


def test_many_fragments_keep_their_order():
    parts = [triangles_of(SHAPES[name]) for name in ("angle", "pentagon", "triangle")]
    owner = np.repeat([2, 5, 11], [len(part) for part in parts])
    fan, element = centroid_fans(np.concatenate(parts), owner)
    assert np.all(np.diff(element) >= 0) and set(element) == {2, 5, 11}
    for number, part in zip((2, 5, 11), parts, strict=True):
        alone = centroid_fans(part, np.zeros(len(part), int))[0]
        np.testing.assert_array_equal(fan[element == number], alone)


def test_nothing_stays_nothing():
    fan, element = centroid_fans(np.zeros((0, 3, 2)), np.zeros(0, np.int64))
    assert fan.shape == (0, 3, 2) and element.shape == (0,)
