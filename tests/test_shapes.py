from __future__ import annotations

import numpy as np
import pytest

from phantomnode.geometry.curves import Geometry, part_names
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.shapes import circle, graph, placed, polygon, polyline, rectangle, ring

ROUNDING = 1e-14
"""A few dozen roundings of numbers of size one."""


def test_rectangle_has_its_sides_by_name() -> None:
    region = rectangle((1.0, 2.0), (4.0, 3.0))
    assert region.area == 3.0
    middles = {name: region.outer.points[k : k + 2].mean(axis=0) for k, name in enumerate(region.outer.names)}
    expected = {"bottom": (2.5, 2.0), "right": (4.0, 2.5), "top": (2.5, 3.0), "left": (1.0, 2.5)}
    assert {name: tuple(middle) for name, middle in middles.items()} == expected


def test_circle_is_two_half_circles_of_exact_area() -> None:
    region = circle((3.0, -1.0), 0.4)
    assert region.outer.bulges.tolist() == [1.0, 1.0]
    assert region.area == pytest.approx(np.pi * 0.16, rel=ROUNDING)


def test_ring_has_its_loops_by_name() -> None:
    region = ring((0.5, 0.92), 0.4, 0.3)
    assert region.area == pytest.approx(np.pi * (0.16 - 0.09), rel=10 * ROUNDING)
    assert region.holes[0].signed_area < 0.0
    assert {"outer", "inner"} <= set(part_names((region,)))


def test_polygon_runs_either_way_and_may_repeat_its_first_corner() -> None:
    clockwise = [(0, 0), (0, 1), (1, 1), (1, 0)]
    assert polygon(clockwise).area == 1.0
    assert polygon([*clockwise, (0, 0)]).outer.points.shape == (5, 2)


def test_polyline_is_closed_when_the_last_point_is_the_first() -> None:
    assert not polyline([(0, 0), (1, 0), (1, 1)]).closed
    assert polyline([(0, 0), (1, 0), (1, 1), (0, 0)]).closed


@pytest.mark.parametrize("chord_error", [1e-3, 1e-5, 1e-7])
def test_graph_keeps_the_chord_error_and_does_not_waste_lines(chord_error: float) -> None:
    curve = graph(lambda x: 0.5 + 0.05 * np.sin(2.5 * np.pi * x), 0.0, 1.0, chord_error)
    x = np.linspace(0.0, 1.0, 20001)
    miss = np.abs(np.interp(x, *curve.points.T) - (0.5 + 0.05 * np.sin(2.5 * np.pi * x)))
    assert miss.max() <= chord_error * np.hypot(
        1.0, 0.05 * 2.5 * np.pi
    )  # vertical distance over chord distance
    # n equal lines of width w leave k w^2/8 (k: curvature); halving overshoots by at most 2, 16 are the start.
    assert len(curve.bulges) <= max(16, 2.0 * np.sqrt(0.05 * (2.5 * np.pi) ** 2 / (8.0 * chord_error)) + 1)


def test_graph_of_a_constant_needs_no_array_from_the_function() -> None:
    assert graph(lambda x: np.float64(0.4), 0.0, 1.0, 1e-6).points[:, 1].tolist() == [0.4] * 17  # type: ignore[arg-type,return-value]


def test_placed_scales_then_rotates_then_moves_and_keeps_arcs_and_names() -> None:
    geometry = Geometry((ring((1.0, 0.0), 0.4, 0.3),), (polyline([(1, 0), (2, 0)]),), ("a note",))
    moved = placed(geometry, move=(10.0, 20.0), rotate=90.0, scale=2.0)
    assert moved.curves[0].points.tolist() == [[10.0, 22.0], [10.0, 24.0]]  # right angles are exact
    assert moved.regions[0].area == pytest.approx(4.0 * geometry.regions[0].area, rel=10 * ROUNDING)
    assert np.allclose(moved.regions[0].box, [[9.2, 21.2], [10.8, 22.8]], atol=30 * ROUNDING)
    assert moved.regions[0].outer.names == ("outer", "outer") and moved.notes == ("a note",)
    assert placed(geometry, rotate=-270.0).curves[0].points.tolist() == [[0.0, 1.0], [0.0, 2.0]]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rectangle((0, 0), (0, 1)), "low < high"),
        (lambda: rectangle((0, 0), (np.inf, 1)), "finite"),
        (lambda: rectangle((0, 0, 0), (1, 1)), "pairs"),
        (lambda: rectangle("ab", (1, 1)), "pairs"),
        (lambda: circle((0, 0), 0.0), "radius of a circle must be positive"),
        (lambda: circle((0, np.nan), 1.0), "finite"),
        (lambda: circle((0, 0), np.nan), "positive"),
        (lambda: ring((0, 0), 0.3, 0.4), "inner_radius < outer_radius"),
        (lambda: ring((0, 0), 0.3, -0.1), "positive"),
        (lambda: polygon([(0, 0), (1, 0)]), "at least 3"),
        (lambda: polygon([(0, 0), (1, 0), (1, 0), (0, 1)]), r"repeats the point \(1, 0\)"),
        (lambda: polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), r"crosses itself at \(0.5, 0.5\)"),
        (lambda: polygon([(0, 0), (1, 0), (2, 0)]), "crosses itself"),
        (lambda: polyline([(0, 0)]), "at least 2"),
        (lambda: polyline([(0, 0), (np.nan, 1)]), "finite"),
        (lambda: graph(np.sin, 1.0, 0.0, 1e-3), "x0 < x1"),
        (lambda: graph(np.sin, 0.0, 1.0, 0.0), "chord error"),
        (lambda: graph(np.log, -1.0, 1.0, 1e-3), "not finite near its parameter -1"),
        (lambda: graph(np.sin, 0.0, 1.0, 1e-16), "more than 200000 lines"),
        (lambda: placed(Geometry(), scale=0.0), "scale"),
        (lambda: placed(Geometry(), rotate=np.inf), "rotate"),
        (lambda: placed(Geometry(), move=(np.nan, 0.0)), "finite"),
    ],
)
def test_bad_shapes_are_refused(make, message) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(GeometryError, match=message):
        make()
