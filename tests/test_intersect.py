"""Crossings of curves with edges and with each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.grid import cartesian
from phantomnode.geometry.intersect import curve_edge_crossings, intersections
from phantomnode.geometry.levelset import LevelSet

EPS = np.finfo(float).eps


def chain(*points, bulges=None):
    points = np.array(points, float)
    return Curve(points, np.zeros(len(points) - 1) if bulges is None else np.asarray(bulges, float))


def circle(r, centre, parts=2, start=0.0):
    t = start + np.linspace(0.0, 2.0 * np.pi, parts + 1)
    points = np.asarray(centre) + r * np.column_stack([np.cos(t), np.sin(t)])
    points[-1] = points[0]
    return Curve(points, np.full(parts, np.tan(0.5 * np.pi / parts)))


def edges(grid):
    return grid.xy[grid.edges[:, 0]], grid.xy[grid.edges[:, 1]]


def crossed(curve, start, end):
    return curve_edge_crossings(curve, np.array([start], float), np.array([end], float))


UNIT = cartesian((-1, -1), (1, 1), cell=0.1, aligned=True)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.3, 0.8), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.integers(2, 6), st.floats(0, 6))
def test_a_circle_changes_sides_where_it_crosses(r, x, y, parts, start):
    curve = circle(r, (x, y), parts, start)
    a, b = edges(UNIT)
    found = curve_edge_crossings(curve, a, b)
    place = a[found.edge] + found.t[:, None] * (b - a)[found.edge]
    np.testing.assert_allclose(curve.at(found.piece, found.s), place, atol=1e-7)  # tangent edges: sqrt(eps)
    np.testing.assert_allclose(np.hypot(*(place - (x, y)).T), r, atol=20 * EPS)
    # The number of crossings of an edge is odd where its ends are on different sides. Ends on the curve are
    # on both; crossings at a vertex come twice.
    da, db = (np.hypot(*(p - (x, y)).T) - r for p in (a, b))
    clear = (np.abs(da) > 1e-9) & (np.abs(db) > 1e-9)
    vertex = (found.s < 1e-9) | (found.s > 1 - 1e-9)
    clear[found.edge[vertex]] = False
    count = np.bincount(found.edge, minlength=len(a))
    np.testing.assert_array_equal((count % 2 == 1)[clear], (da * db < 0)[clear])


def test_long_pieces_are_searched_in_parts_and_nothing_is_missed():
    diagonal = chain((-0.97, -0.93), (0.91, 0.95))
    a, b = edges(UNIT)
    found = curve_edge_crossings(diagonal, a, b)
    phi_a, phi_b = LevelSet.of_curve(diagonal).distance(a), LevelSet.of_curve(diagonal).distance(b)
    inside = np.all((a > -0.9) & (a < 0.9) & (b > -0.9) & (b < 0.9), axis=1)
    assert set(np.flatnonzero(inside & (phi_a * phi_b < 0))) <= set(found.edge)
    place = a[found.edge] + found.t[:, None] * (b - a)[found.edge]
    np.testing.assert_allclose(diagonal.at(found.piece, found.s), place, atol=10 * EPS)


def test_a_crossing_at_a_node_is_exactly_there_for_every_edge():
    a, b = edges(UNIT)
    found = curve_edge_crossings(chain((-0.35, -0.3), (0.25, 0.3)), a, b)  # through nodes nowhere
    assert np.all((found.t > 0.4) & (found.t < 0.6)) and len(found.t) == 6 + 7
    found = curve_edge_crossings(chain((-0.35, -0.35), (0.35, 0.35)), a, b)  # through seven nodes
    assert set(found.t) == {0.0, 1.0} and len(found.t) == 7 * 4


@pytest.mark.parametrize("nudge", [0.0, EPS, -EPS, 1e-16, -1e-14])
def test_a_node_within_rounding_of_the_line_is_on_it(nudge):
    line = chain((0.0, 0.5 + nudge), (1.0, 0.5 + nudge))
    up, down = crossed(line, (0.5, 0.5), (0.5, 0.6)), crossed(line, (0.5, 0.5), (0.5, 0.4))
    assert up.t == down.t == 0.0 and up.s == down.s == 0.5


@pytest.mark.parametrize("bulge", [0.0, 1e-14])
def test_an_edge_along_the_curve_reports_nothing(bulge):
    curve = chain((0, 0), (1, 0), bulges=[bulge])
    for start, end in (((0.2, 0), (0.3, 0)), ((-0.5, 0), (0.5, 0)), ((0, 0), (1, 0))):
        assert len(crossed(curve, start, end).t) == 0
    np.testing.assert_array_equal(crossed(curve, (0.5, 0.0), (0.5, 1.0)).t, 0.0)


def test_parallel_and_past_the_ends():
    curve = chain((0, 0), (1, 0))
    assert len(crossed(curve, (0.2, 0.1), (0.8, 0.1)).t) == 0
    assert len(crossed(curve, (1.1, -1), (1.1, 1)).t) == 0
    assert crossed(curve, (1.0, -1), (1.0, 1)).s == 1.0


def test_an_arc_over_an_edge_crosses_twice_touches_once_or_not_at_all():
    top = chain((1, 0), (-1, 0), bulges=[1.0])
    np.testing.assert_allclose(crossed(top, (-1, 0.6), (1, 0.6)).t, [0.1, 0.9], atol=4 * EPS)
    assert len(crossed(top, (-0.7, 1.0), (0.8, 1.0)).t) == 0  # touches between its ends
    np.testing.assert_array_equal(crossed(top, (0.0, 1.0), (0.8, 1.0)).t, [0.0])  # touches at a node
    assert len(crossed(top, (-1, 1.1), (1, 1.1)).t) == 0
    assert len(crossed(top, (-0.9, -0.1), (0.9, -0.1)).t) == 0  # the other half of the circle


def test_both_ends_of_a_chord_are_nodes_on_the_arc():
    top = chain((1, 0), (-1, 0), bulges=[1.0])
    np.testing.assert_allclose(crossed(top, (0.6, 0.8), (-0.6, 0.8)).t, [0.0, 1.0])


def test_a_vertex_on_an_edge_is_reported_by_both_pieces():
    found = crossed(chain((-1, -1), (0, 0), (1, 1)), (0, 1), (0, -1))
    np.testing.assert_array_equal(found.piece, [0, 1])
    np.testing.assert_array_equal(found.s, [1.0, 0.0])


def test_no_edges_and_curves_elsewhere():
    empty = np.zeros((0, 2))
    assert len(curve_edge_crossings(circle(1, (0, 0)), empty, empty).t) == 0
    assert len(curve_edge_crossings(circle(1, (9, 9)), *edges(UNIT)).t) == 0


def sorted_rows(points):
    return points[np.lexsort(np.round(points, 6).T)]


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (chain((0, 0), (1, 1)), chain((0, 1), (1, 0)), [[0.5, 0.5]]),
        (circle(1, (0, 0)), chain((-2, 0.6), (2, 0.6)), [[-0.8, 0.6], [0.8, 0.6]]),
        (circle(1, (0, 0)), circle(1, (1.2, 0), 3), [[0.6, -0.8], [0.6, 0.8]]),
        (circle(1, (0, 0), 3), circle(0.5, (1.5, 0), 5, 1.0), [[1, 0]]),
        (circle(1, (0, 0), 3), circle(0.5, (0, 0.5), 5, 1.0), [[0, 1]]),
        (circle(1, (0, 0)), circle(0.5, (0, 0)), np.zeros((0, 2))),
        (circle(1, (0, 0), 3), chain((-1, 1), (2, 1)), [[0, 1]]),
        (chain((0, 0), (1, 0)), chain((0.3, 0), (0.3, 1)), [[0.3, 0]]),
        (chain((0, 0), (1, 0)), chain((0.3, 1e-10), (0.3, 1)), [[0.3, 0]]),
        (chain((0, 0), (1, 0)), chain((1, 0), (2, 5)), [[1, 0]]),
        (chain((0, 0), (1, 0)), chain((0, 0.1), (1, 0.1)), np.zeros((0, 2))),
        (chain((0, 0), (2, 0)), chain((1, 0), (3, 0)), [[1, 0], [2, 0]]),
    ],
    ids=["cross", "line and circle", "circles", "circles touch outside", "circles touch inside", "concentric",
         "tangent line", "tee", "tee with a gap of rounding", "end on end", "parallel", "overlap"],
)  # fmt: skip
def test_intersections(first, second, expected):
    for a, b in ((first, second), (second, first)):
        points = intersections(a, b)
        # Touching curves are found within 1e-9 of the size; the rest to rounding.
        np.testing.assert_allclose(sorted_rows(points), expected, atol=5e-9)
