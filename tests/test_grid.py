"""Background grids: where their nodes stand, what their cells cover, what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid, cartesian, check, scaled_jacobians
from phantomnode.geometry.mapped import mapped, polar

EPS = np.finfo(float).eps


def chain(*points, bulges=None):
    points = np.array(points, float)
    return Curve(points, np.zeros(len(points) - 1) if bulges is None else np.asarray(bulges, float))


def boundary_edges(grid):
    """Number of edges that belong to one cell only."""
    ends = np.stack([grid.quads, np.roll(grid.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    _, count = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    assert count.max() <= 2
    return int(np.sum(count == 1))


def test_aligned_cells_fill_the_box_to_the_bit():
    low, high = (0.1, -0.7), (1.3, 0.2)
    grid = cartesian(low, high, cell=0.1, aligned=True)
    assert grid.shape == (12, 9)
    for axis in (0, 1):
        assert grid.xy[:, axis].min() == low[axis] and grid.xy[:, axis].max() == high[axis]
    assert grid.areas.sum() == pytest.approx(1.2 * 0.9, rel=20 * EPS)
    assert boundary_edges(grid) == 2 * (12 + 9)


def test_aligned_cells_are_not_larger_than_asked():
    grid = cartesian((0, 0), (1, 1), cell=(0.3, 0.7), aligned=True)
    assert grid.shape == (4, 2)
    np.testing.assert_allclose(grid.areas, 0.125, rtol=10 * EPS)


def test_counts():
    assert cartesian((0, 0), (3, 1), counts=(7, 2), aligned=True).shape == (7, 2)


@pytest.mark.parametrize("low", [(0.0, 0.0), (0.05, 0.02), (-0.31, 0.499)])
def test_unaligned_lines_are_multiples_with_half_a_cell_around(low):
    high = (low[0] + 1.0, low[1] + 0.5)
    grid = cartesian(low, high, cell=0.1, aligned=False)
    np.testing.assert_array_equal(grid.xy, 0.1 * np.round(grid.xy / 0.1))
    margin = 0.5 * 0.1 * (1 - 1e-9)  # a box that is on the lines to rounding has its half cell to rounding
    assert np.all(grid.xy.min(axis=0) <= np.array(low) - margin)
    assert np.all(grid.xy.max(axis=0) >= np.array(high) + margin)
    assert np.all(grid.xy.min(axis=0) > np.array(low) - 0.16)


def test_edges_are_every_pair_once_in_order():
    grid = polar((0.0, 0.0), (1.0, 2.0), counts=(2, 5))
    ends = np.stack([grid.quads, np.roll(grid.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    np.testing.assert_array_equal(grid.edges, np.unique(np.sort(ends, axis=1), axis=0))


def test_cells_are_numbered_along_the_first_direction():
    grid = cartesian((0, 0), (3, 2), cell=1.0, aligned=True)
    np.testing.assert_allclose(grid.xy[grid.quads[1 * 3 + 2]].mean(axis=0), [2.5, 1.5])


def test_a_full_ring_closes():
    grid = polar((1.0, -2.0), (0.25, 0.5), counts=(5, 48))
    assert len(grid.xy) == 6 * 48 and grid.shape == (5, 48)
    assert boundary_edges(grid) == 2 * 48
    # A regular 48-gon has area n/2 r^2 sin(2 pi/n).
    exact = 24 * np.sin(2 * np.pi / 48) * (0.25 - 0.0625)
    assert grid.areas.sum() == pytest.approx(exact, rel=100 * EPS)
    assert scaled_jacobians(grid.xy, grid.quads).min() > 0.99


def test_a_half_ring_ends_exactly_on_the_axis():
    grid = polar((0.0, 0.0), (1.0, 2.0), (0.0, 180.0), counts=(2, 10))
    assert len(grid.xy) == 3 * 11
    assert np.all(grid.xy[:3, 1] == 0.0) and np.all(grid.xy[-3:, 1] == 0.0)
    np.testing.assert_array_equal(grid.xy[-3:, 0], [-1.0, -1.5, -2.0])
    assert boundary_edges(grid) == 2 * (2 + 10)


def test_mapped_between_straight_sides_is_the_cartesian_grid():
    sides = (chain((0, 0), (2, 0)), chain((2, 0), (2, 1)), chain((0, 1), (2, 1)), chain((0, 0), (0, 1)))
    np.testing.assert_allclose(
        mapped(*sides, counts=(4, 3)).xy,
        cartesian((0, 0), (2, 1), counts=(4, 3), aligned=True).xy,
        atol=4 * EPS,
    )


@pytest.mark.parametrize("turned", range(16))
def test_mapped_curves_may_run_either_way(turned):
    sides = [chain((0, 0), (2, 0), bulges=[0.2]), chain((2, 0), (2.5, 1)), chain((0, 1), (2.5, 1)),
             chain((0, 0), (-0.2, 0.4), (0, 1))]  # fmt: skip
    run = [c.reversed() if turned >> k & 1 else c for k, c in enumerate(sides)]
    grid = mapped(*run, counts=(6, 4))
    np.testing.assert_allclose(grid.xy, mapped(*sides, counts=(6, 4)).xy, atol=10 * EPS)
    assert grid.areas.min() > 0


def test_mapped_outer_nodes_are_on_their_curves():
    bottom = chain((0, 0), (1, 0), bulges=[0.3])
    grid = mapped(bottom, chain((1, 0), (1, 2)), chain((0, 2), (1, 2)), chain((0, 0), (0, 2)), counts=(8, 8))
    lower = grid.xy[:9]
    np.testing.assert_allclose(lower, bottom.at(np.zeros(9, np.int64), np.linspace(0, 1, 9)), atol=4 * EPS)
    spacing = np.hypot(*np.diff(lower, axis=0).T)
    np.testing.assert_allclose(spacing, spacing[0], rtol=20 * EPS)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: cartesian((0, 0), (0, 1), cell=0.1, aligned=True), "empty"),
        (lambda: cartesian((0, 0), (1, 1), cell=-0.1, aligned=True), "positive"),
        (lambda: cartesian((0, 0), (1, 1), cell=0.0, aligned=False), "positive"),
        (lambda: cartesian((0, 0), (1, 1), cell=float("nan"), aligned=False), "finite"),
        (lambda: cartesian((0, 0), (np.inf, 1), cell=0.1, aligned=False), "finite"),
        (lambda: cartesian((0, 0), (1, 1), aligned=True), "either"),
        (lambda: cartesian((0, 0), (1, 1), cell=1, counts=(1, 1), aligned=True), "not both"),
        (lambda: cartesian((0, 0), (1, 1), counts=(2, 2), aligned=False), "aligned"),
        (lambda: cartesian((0, 0), (1, 1), counts=(0, 2), aligned=True), "whole numbers"),
        (lambda: cartesian((0, 0), (1, 1), counts=(1.5, 2), aligned=True), "whole numbers"),
        (lambda: cartesian((0, 0), (1, 1), cell=1e-6, aligned=True), "units"),
        (lambda: polar((0, 0), (0, 1), counts=(1, 8)), "radii"),
        (lambda: polar((0, 0), (1, 2), (0, 400), counts=(1, 8)), "angles"),
        (lambda: polar((0, 0), (1, 2), counts=(1, 2)), "less than 180"),
    ],
)
def test_refused(build, message):
    with pytest.raises(GeometryError, match=message):
        build()


def test_mapped_curves_that_do_not_meet_are_named():
    with pytest.raises(GeometryError, match=r"right and top are 0\.1 m apart"):
        mapped(
            chain((0, 0), (1, 0)),
            chain((1, 0), (1, 0.9)),
            chain((0, 1), (1, 1)),
            chain((0, 0), (0, 1)),
            (2, 2),
        )


def test_mapped_curves_in_clockwise_order_are_refused():
    left, right = chain((0, 0), (0, 1)), chain((1, 0), (1, 1))
    with pytest.raises(GeometryError, match="counter-clockwise"):
        mapped(chain((0, 0), (1, 0)), left, chain((0, 1), (1, 1)), right, (2, 2))


def test_a_folded_cell_is_named_with_its_place():
    xy = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [1.2, 0.1]])
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    with pytest.raises(GeometryError, match=r"1 of 2 .* cell 1 at \(1\.3, 0\.275\)"):
        check(BackgroundGrid(xy, quads))


@pytest.mark.parametrize(
    ("xy", "quads", "message"),
    [
        (np.zeros((0, 2)), np.zeros((0, 4), np.int64), "no cells"),
        (np.full((4, 2), np.nan), np.array([[0, 1, 2, 3]]), "not finite"),
        (np.eye(4, 2), np.array([[0, 1, 2, 4]]), "names a node"),
        (np.zeros((4, 2)), np.array([[0, 1, 2, 3]]), "inverted"),
    ],
)
def test_check_refuses(xy, quads, message):
    with pytest.raises(GeometryError, match=message):
        check(BackgroundGrid(xy, quads))


@pytest.mark.parametrize("moves", [0, 1, 30])
def test_a_rectangular_grid_is_the_grid_of_its_nodes_and_cells(moves):
    """It keeps its lines and its moved nodes alone; what it says is that of the same cells, to the bit."""
    rng = np.random.default_rng(moves)
    grid = cartesian((-0.3, 0.1), (1.0, 0.9), cell=(0.07, 0.11), aligned=False)
    nodes = np.sort(rng.choice(len(grid.xy), moves, replace=False))
    grid = grid.moved(nodes, grid.position(nodes) + rng.uniform(-0.02, 0.02, (moves, 2)))
    again = nodes[: moves // 2]
    grid = grid.moved(again, grid.position(again) + 0.001)
    same = BackgroundGrid(grid.xy, grid.quads, grid.shape)
    assert (
        (grid.node_count, grid.cell_count)
        == (same.node_count, same.cell_count)
        == (len(grid.xy), len(grid.quads))
    )
    for what in (
        "box",
        "cell_box",
        "largest_step",
        "areas",
        "node_size",
        "typical_size",
        "cell_size",
        "edges",
    ):
        np.testing.assert_array_equal(getattr(grid, what), getattr(same, what), err_msg=what)
    low, width = grid.box[0], grid.cell_box
    marked = rng.random(np.floor((grid.box[1] - low) / width).astype(int) + 1) < 0.5
    np.testing.assert_array_equal(grid.in_bins(marked, low, width), same.in_bins(marked, low, width))
    np.testing.assert_array_equal(grid.corners(np.array([[3, 0], [7, 5]])), same.quads[[[3, 0], [7, 5]]])
