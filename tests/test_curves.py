"""Curves and regions: measures exact with their arcs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phantomnode.geometry.curves import Curve, Region, arc_centre, part, part_names
from phantomnode.geometry.errors import GeometryError

EPS = np.finfo(float).eps


def chain(*points, bulges=None, **names):
    return Curve(np.array(points, float), np.zeros(len(points) - 1) if bulges is None else bulges, **names)


def circle(r=1.0, centre=(0.0, 0.0), parts=2):
    t = np.linspace(0.0, 2.0 * np.pi, parts + 1)
    points = np.asarray(centre) + r * np.column_stack([np.cos(t), np.sin(t)])
    points[-1] = points[0]
    return Curve(points, np.full(parts, np.tan(0.5 * np.pi / parts)))


def square(low=0.0, high=1.0):
    return chain((low, low), (high, low), (high, high), (low, high), (low, low))


@pytest.mark.parametrize("parts", [2, 3, 4, 7])
def test_area_and_length_of_a_circle(parts):
    c = circle(0.3, (1e3, -2e3), parts)
    # Coordinates of 2e3 carry errors of eps * 2e3, over a size of 0.3.
    assert c.signed_area == pytest.approx(np.pi * 0.09, rel=EPS * 2e3 / 0.3 * 10)
    assert c.lengths.sum() == pytest.approx(2.0 * np.pi * 0.3, rel=EPS * 2e3 / 0.3 * 10)
    assert c.reversed().signed_area == pytest.approx(-c.signed_area, rel=10 * EPS)


def test_area_of_a_rectangle_with_a_bite_and_a_cap():
    # Unit square, bottom bulging out by a semicircle, top bitten by one: the areas cancel.
    c = chain((0, 0), (1, 0), (1, 1), (0, 1), (0, 0), bulges=np.array([1.0, 0.0, -1.0, 0.0]))
    assert c.signed_area == pytest.approx(1.0, rel=10 * EPS)


def test_three_quarter_arc_has_more_than_a_semicircle():
    c = chain((1, 0), (0, -1), bulges=np.array([np.tan(np.radians(270.0) / 4.0)]))
    assert c.lengths[0] == pytest.approx(1.5 * np.pi, rel=10 * EPS)
    np.testing.assert_allclose(c.box, [[-1, -1], [1, 1]], atol=10 * EPS)
    np.testing.assert_allclose(c.at(np.array([0]), np.array([1 / 3])), [[0, 1]], atol=10 * EPS)


@given(st.floats(-3.0, 3.0), st.floats(0.0, 1.0))
def test_points_of_an_arc_are_on_its_circle(bulge, s):
    c = chain((0.2, -0.1), (0.9, 0.5), bulges=np.array([bulge]))
    p = c.at(np.array([0]), np.array([s]))[0]
    if abs(bulge) < 1e-3:  # the centre is too far away to measure from; the sagitta bounds the offset
        direction = (c.points[1] - c.points[0]) / c.chords[0]
        off = direction[0] * (p - c.points[0])[1] - direction[1] * (p - c.points[0])[0]
        assert abs(off) <= 0.5 * abs(bulge) * c.chords[0] + 4 * EPS
    else:
        centre = arc_centre(c.points[0], c.points[1], np.asarray(bulge))
        radius = np.hypot(*(c.points[0] - centre))
        assert np.hypot(*(p - centre)) == pytest.approx(radius, abs=20 * EPS * max(1.0, radius))


@pytest.mark.parametrize("bulge", [0.0, 0.3])
def test_ends_of_pieces_are_vertices_to_the_bit(bulge):
    c = Curve(circle(0.3, (0.1, 0.7), 5).points, np.full(5, bulge))
    pieces = np.arange(5)
    np.testing.assert_array_equal(c.at(pieces, np.zeros(5)), c.points[:-1])
    np.testing.assert_array_equal(c.at(pieces, np.ones(5)), c.points[1:])


def test_corners_of_a_square_but_not_of_a_circle_or_a_fillet():
    assert square().corners.all()
    assert not circle(parts=3).corners.any()
    # A quarter fillet is tangent to its neighbours; the free ends are corners.
    fillet = chain((0, 0), (1, 0), (2, 1), (2, 2), bulges=np.array([0.0, np.tan(np.pi / 8), 0.0]))
    np.testing.assert_array_equal(fillet.corners, [True, False, False, True])
    assert chain((0, 0), (1, 0), (0, 0.0)).corners.all()  # a path there and back turns by 180 degrees


def test_subdivided_keeps_shape_and_names():
    c = chain((0, 0), (1, 0), (1, 1), (0, 0), bulges=np.array([0.0, 0.5, 0.0]), names=("a", "b", "c"))
    fine = c.subdivided(0.1)
    assert fine.lengths.max() <= 0.1 * (1 + 4 * EPS)
    assert fine.signed_area == pytest.approx(c.signed_area, rel=50 * EPS)
    assert fine.closed and set(fine.names) == {"a", "b", "c"}
    assert fine.lengths[np.array(fine.names) == "b"].sum() == pytest.approx(c.lengths[1], rel=50 * EPS)


@pytest.mark.parametrize("error", [1e-1, 1e-3, 1e-6])
def test_polyline_keeps_its_chord_error(error):
    polygon = circle(2.0).polyline(error)
    middle = 0.5 * (polygon[:-1] + polygon[1:])
    sagitta = 2.0 - np.hypot(*middle.T)
    assert sagitta.max() <= error * (1 + 1e-9)  # hypot leaves eps * 2.0 of a sagitta of 1e-6
    assert sagitta.max() > 0.4 * error  # and no more pieces than it takes, but for rounding up
    np.testing.assert_array_equal(polygon[0], polygon[-1])


def test_polyline_of_a_chord_error_below_rounding_is_not_coarse():
    assert len(chain((1e3, 0), (0, 1e3), bulges=np.array([np.tan(np.pi / 8)])).polyline(1e-8)) > 1e5


def test_polyline_of_straight_lines_is_the_vertices():
    np.testing.assert_array_equal(square().polyline(1e-9), square().points)


@pytest.mark.parametrize("angle", np.radians([0.0, 30.0, 45.0, 137.0, 270.0]))
def test_box_of_a_turned_semicircle(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    c = Curve(np.array([[1.0, 0.0], [-1.0, 0.0]]) @ turn.T, np.ones(1))
    sampled = c.at(np.zeros(10001, np.int64), np.linspace(0, 1, 10001))
    # Sampling at steps of pi/1e4 misses an extreme by at most step^2/8.
    np.testing.assert_allclose(c.box[0], sampled.min(axis=0), atol=1.3e-8)
    np.testing.assert_allclose(c.box[1], sampled.max(axis=0), atol=1.3e-8)
    assert np.all(c.box[0] <= sampled.min(axis=0) + 4 * EPS)


def test_box_of_an_arc_that_ends_on_an_axis():
    quarter = chain((1, 0), (0, 1), bulges=np.array([np.tan(np.pi / 8)]))
    np.testing.assert_allclose(quarter.box, [[0, 0], [1, 1]], atol=4 * EPS)


def test_region_turns_its_loops_and_subtracts_holes():
    region = Region(square(0, 4).reversed(), (circle(1.0, (2, 2)),))
    assert region.outer.signed_area > 0 > region.holes[0].signed_area
    assert region.area == pytest.approx(16.0 - np.pi, rel=10 * EPS)
    with pytest.raises(GeometryError, match="closed"):
        Region(chain((0, 0), (1, 0)))


def test_parts_by_name_and_by_side():
    outer = Curve(square().points, np.zeros(4), names=("", "glued", "", ""), name="frame")
    region = Region(outer, (circle(0.2, (0.5, 0.5)),))
    masks = {name: part((region,), name) for name in part_names((region,))}
    np.testing.assert_array_equal(masks["bottom"][0], [True, False, False, False])
    np.testing.assert_array_equal(masks["left"][0], [False, False, False, True])
    np.testing.assert_array_equal(masks["glued"][0], [False, True, False, False])
    assert masks["frame"][0].all() and not masks["frame"][1].any()
    assert masks["inner"][1].all() and not masks["inner"][0].any()
    assert all(mask.all() for mask in masks["boundary"])
    assert not any(mask.any() for mask in part((region,), "no such name"))


def test_a_name_of_the_file_goes_before_the_side():
    outer = Curve(square().points, np.zeros(4), names=("top", "", "", ""))
    np.testing.assert_array_equal(part((Region(outer),), "top")[0], [True, False, False, False])


def test_unnamed_parts_are_not_found_by_the_empty_name():
    assert not part((Region(square()),), "")[0].any()


def test_wrong_counts_are_refused():
    with pytest.raises(ValueError, match="one more point"):
        Curve(np.zeros((3, 2)), np.zeros(3))
