"""Node relocation: who moves, where to, and who must not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import cartesian, scaled_jacobians
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.mapped import polar
from phantomnode.geometry.relocate import ON_CURVE, QUALITY_FLOOR, QUALITY_LOSS, feature_points, relocate

EPS = np.finfo(float).eps


def chain(*points, bulges=None):
    points = np.array(points, float)
    return Curve(points, np.zeros(len(points) - 1) if bulges is None else np.asarray(bulges, float))


def circle(r, centre=(0.0, 0.0)):
    (x, y) = centre
    return chain((x + r, y), (x - r, y), (x + r, y), bulges=[1.0, 1.0])


def square(half, angle=0.0, centre=(0.0, 0.0)):
    c, s = half * np.cos(angle), half * np.sin(angle)
    corners = [(-c + s, -s - c), (c + s, s - c), (c - s, s + c), (-c - s, -s + c)]
    return chain(*(np.add(p, centre) for p in corners + corners[:1]))


GRID = cartesian((-1, -1), (1, 1), cell=0.1, aligned=True)


def node_at(grid, x, y):
    return int(np.argmin(np.hypot(*(grid.xy - (x, y)).T)))


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.0, 3.2), st.floats(-0.1, 0.1), st.floats(0.3, 0.6), st.sampled_from([0.05, 0.1, 0.2, 0.45])
)
@example(0.0, 1e-12, 0.5, 0.05)
def test_the_rule_and_the_guard(angle, offset, half, distance):
    curves = [square(half, angle, (offset, 0.03)), circle(0.21, (0.011, offset)), chain((half, 0), (2, 0.5))]
    new = relocate(GRID, curves, distance)
    phi = np.array([LevelSet.of_curve(c).distance(new.grid.xy) for c in curves])
    on = np.flatnonzero(new.on_curve >= 0)
    off = np.abs(phi[new.on_curve[on], on])
    assert np.all(off[~new.feature[on]] <= 8 * EPS)  # some operations on coordinates of 1
    # Curves touch where they are that close (the free end of the chain stands 1e-12 beside the square): one feature.
    assert np.all(off <= ON_CURVE * max(np.ptp(c.box, axis=0).max() for c in curves))
    old = np.array([LevelSet.of_curve(c).distance(GRID.xy) for c in curves])
    shift = np.hypot(*(new.grid.xy - GRID.xy).T)
    assert np.all(shift[new.moved] <= 1.5 * distance * GRID.node_size[new.moved] * (1 + 1e-12))
    assert np.all(shift[new.moved & ~new.feature] < distance * GRID.node_size[new.moved & ~new.feature])
    np.testing.assert_array_equal(
        new.grid.xy[~new.moved & (new.on_curve < 0)], GRID.xy[~new.moved & (new.on_curve < 0)]
    )
    assert np.all(np.abs(old).min(axis=0)[new.moved & ~new.feature] > 0)
    # Quality: no cell under its bound; nobody on anybody's place.
    before, after = (scaled_jacobians(xy, GRID.quads).min(axis=1) for xy in (GRID.xy, new.grid.xy))
    assert np.all(after >= np.minimum(QUALITY_FLOOR, QUALITY_LOSS * before))
    assert len(np.unique(new.grid.xy, axis=0)) == len(GRID.xy)


def test_a_near_node_moves_along_the_normal_and_a_far_one_stays():
    line = chain((-2.0, 0.008), (2.0, 0.008))
    new = relocate(GRID, [line])
    assert np.all(new.grid.xy[new.on_curve == 0, 1] == 0.008) and new.moved.sum() == 21
    np.testing.assert_array_equal(new.grid.xy[:, 0], GRID.xy[:, 0])
    assert not relocate(GRID, [chain((-2.0, 0.012), (2.0, 0.012))]).moved.any()
    assert relocate(GRID, [chain((-2.0, 0.012), (2.0, 0.012))], 0.2).moved.sum() == 21


def test_outer_nodes_that_are_on_no_curve_may_move():
    new = relocate(GRID, [chain((-2.0, 0.99), (2.0, 0.99 + 1e-6))])
    assert new.moved[node_at(GRID, 0.0, 1.0)]


def test_corners_go_to_nodes():
    box = square(0.5 + 0.003)
    new = relocate(GRID, [box])
    for corner in box.points[:-1]:
        node = node_at(new.grid, *corner)
        np.testing.assert_array_equal(new.grid.xy[node], corner)
        assert new.feature[node] and new.on_curve[node] == 0
    assert new.feature.sum() == 4


def test_a_corner_takes_its_nearest_node_only_and_no_second_one_goes_there():
    corner = chain((-2, -0.048), (0.01, -0.048), (0.01, 2))  # between two nodes, nearly
    new = relocate(GRID, [corner], 0.45)
    at = np.all(new.grid.xy == [0.01, -0.048], axis=1)
    assert at.sum() == 1
    assert len(np.unique(new.grid.xy, axis=0)) == len(GRID.xy)


def test_nodes_on_a_straight_boundary_stay_on_it():
    box = chain((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    interface = chain((-1, -0.995), (1, -0.9))  # leaves the left side next to the bottom
    new = relocate(GRID, [box, interface])
    outer = np.abs(GRID.xy).max(axis=1) == 1.0
    assert np.all(np.abs(new.grid.xy[outer]).max(axis=1) == 1.0)
    bottom = GRID.xy[:, 1] == -1.0
    np.testing.assert_array_equal(new.grid.xy[bottom, 1], -1.0)
    assert np.all(new.on_curve[outer] == 0)


def test_a_boundary_node_slides_along_its_boundary_to_a_feature():
    box = chain((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    new = relocate(GRID, [box, chain((0.004, -1), (0.3, 0.33))])
    node = node_at(GRID, 0.0, -1.0)
    np.testing.assert_array_equal(new.grid.xy[node], [0.004, -1.0])
    assert new.feature[node] and new.moved[node]


def test_a_boundary_node_does_not_leave_it_for_a_feature_inside():
    box = chain((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    new = relocate(GRID, [box, chain((0.0, -0.99), (0.3, 0.33))])  # a free end just above the bottom
    assert not new.moved[node_at(GRID, 0.0, -1.0)]


def test_a_node_near_two_curves_stays():
    new = relocate(GRID, [chain((-2, 0.004), (2, 0.004)), chain((-2, -0.004), (2, -0.004))])
    assert not new.moved.any()


def test_curves_that_run_along_each_other_are_one_to_a_node():
    twice = [chain((-2, 0.004), (2, 0.004)), chain((2, 0.004), (-2, 0.004))]
    assert relocate(GRID, twice).moved.sum() == 21


def test_rounding_beside_a_line_is_mended_without_notice():
    new = relocate(GRID, [chain((-2.0, 1e-12), (2.0, 1e-12))])
    on = new.on_curve == 0
    assert on.sum() == 21 and np.all(new.grid.xy[on, 1] == 1e-12) and not new.moved.any()


def test_distance_zero_moves_nothing():
    new = relocate(GRID, [square(0.503, 0.3)], 0.0)
    assert not new.moved.any()


def test_on_a_ring_nodes_move_radially():
    grid = polar((0, 0), (0.25, 0.5), counts=(5, 48))
    new = relocate(grid, [circle(0.448)])
    on = new.on_curve == 0
    assert on.sum() == 48
    np.testing.assert_allclose(np.hypot(*new.grid.xy[on].T), 0.448, rtol=4 * EPS)
    angle = [np.arctan2(*xy[on].T) for xy in (grid.xy, new.grid.xy)]
    np.testing.assert_allclose(angle[0], angle[1], atol=20 * EPS)


def test_feature_points_are_corners_ends_and_crossings_once_each():
    points, owner = feature_points([square(0.5), chain((-0.5, 0.0), (0.5, 0.0)), circle(0.2)])
    assert len(points) == 4 + 2 + 2
    assert {tuple(p) for p in np.round(points[-2:], 12)} == {(-0.2, 0.0), (0.2, 0.0)}
    assert list(owner[:4]) == [0] * 4
    assert len(feature_points([circle(0.2)])[0]) == 0 and len(feature_points([])[0]) == 0


@pytest.mark.parametrize("distance", [-0.1, 0.5, float("nan")])
def test_distances_out_of_bounds_are_refused(distance):
    with pytest.raises(GeometryError, match="below 0.5"):
        relocate(GRID, [circle(0.3)], distance)
