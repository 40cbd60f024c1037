from __future__ import annotations

import numpy as np
import pytest

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import arc_pieces, flatten, trace
from phantomnode.geometry.loops import assemble, join
from phantomnode.geometry.nesting import nest
from phantomnode.geometry.shapes import circle, polygon, polyline, rectangle


def line(*points: tuple[float, float], name: str = "") -> Curve:
    return Curve(np.array(points, dtype=float), np.zeros(len(points) - 1), (name,) * (len(points) - 1))


def square(low: float, high: float) -> Curve:
    return rectangle((low, low), (high, high)).outer


def sides(corners: list[tuple[float, float]], order: tuple[int, ...], turned: tuple[int, ...]) -> list[Curve]:
    lines = [line(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return [lines[k].reversed() if k in turned else lines[k] for k in order]


UNIT = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]


def test_pieces_in_any_order_and_direction_become_one_region() -> None:
    geometry = assemble(sides(UNIT, (2, 0, 3, 1), (0, 3)))
    assert len(geometry.regions) == 1 and not geometry.curves and not geometry.notes
    assert geometry.regions[0].area == 1.0


def test_ends_an_ulp_apart_become_one_vertex_to_the_bit() -> None:
    pieces = [line((0, 0), (1, 0)), line((np.nextafter(1, 2), 0), (1, 1)), line((1, 1), (1e-17, 1e-17))]
    (region,) = assemble(pieces).regions
    assert len(region.outer.points) == 4 and region.outer.closed


@pytest.mark.parametrize(
    ("gap", "closes", "noted"), [(1e-10, True, 0), (1e-8, True, 1), (1e-5, True, 1), (1e-3, False, 0)]
)
def test_a_gap_is_closed_up_to_1e_4_of_the_diagonal_and_noted(gap: float, closes: bool, noted: int) -> None:
    geometry = assemble([*sides(UNIT, (0, 1, 2), ()), line((0.0, 1.0), (0.0, gap * np.sqrt(2.0)))])
    assert bool(geometry.regions) is closes and len(geometry.findings) == noted


def test_names_stay_with_their_pieces_and_name_the_chain_where_they_agree() -> None:
    geometry = assemble(
        [line((0, 0), (1, 0), name="a"), line((1, 1), (1, 0), name="b"), line((1, 1), (0, 0), name="b")]
    )
    loop = geometry.regions[0].outer
    assert dict(zip(loop.names, loop.chords.round(12), strict=True)).keys() == {"a", "b"} and loop.name == ""
    assert loop.names.count("b") == 2 and loop.lengths[loop.names.index("a")] == 1.0
    assert assemble([line((0, 0), (1, 0), name="crack")]).curves[0].name == "crack"


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_an_open_chain_runs_as_its_pieces_do_in_any_order(order: tuple[int, ...]) -> None:
    (chain,) = assemble(sides(UNIT, order, ())).curves
    assert chain.points.tolist() == [list(corner) for corner in UNIT]


def test_nesting_alternates_between_material_and_hole() -> None:
    loops = [square(3, 4), square(0, 10), square(2, 5), square(1, 9), square(6, 7)]
    regions = sorted(assemble(loops).regions, key=lambda region: -region.area)
    assert [region.area for region in regions] == [100.0 - 64.0, 9.0 - 1.0, 1.0]
    assert [len(region.holes) for region in regions] == [1, 1, 0]


def test_a_hole_that_touches_the_outline_in_a_point_is_a_hole() -> None:
    (region,) = assemble([circle((0, 0), 1.0).outer, circle((0.5, 0), 0.5).outer]).regions
    assert region.area == pytest.approx(np.pi * 0.75, rel=1e-14)  # rounding


def test_two_loops_that_touch_in_a_corner_are_two_regions() -> None:
    assert [r.area for r in assemble([square(0, 1), square(1, 2)]).regions] == [1.0, 1.0]
    pieces = [
        *sides(UNIT, (0, 1, 2, 3), ()),
        *sides([(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)], (0, 1, 2, 3), ()),
    ]
    assert [r.area for r in assemble(pieces).regions] == [1.0, 1.0]


def test_pieces_drawn_twice_and_of_no_length_are_noted() -> None:
    pieces = [*sides(UNIT, (0, 1, 2, 3, 1), ()), line((1, 0), (0, 0)), line((0, 0), (0, 0))]
    geometry = assemble(pieces)
    assert len(geometry.regions) == 1
    assert [(f.kind, f.at) for f in geometry.findings] == [
        ("twice", (1.0, 0.0)),
        ("twice", (1.0, 0.0)),
        ("short", (0.0, 0.0)),
    ]


def test_a_line_and_an_arc_between_the_same_ends_are_not_the_same_curve() -> None:
    half = Curve(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.ones(1))
    (region,) = assemble([half, line((-1, 0), (1, 0))]).regions
    assert region.area == pytest.approx(0.5 * np.pi, rel=1e-14)  # rounding


def test_chains_end_where_they_branch() -> None:
    chains = join([line((0, 0), (1, 0)), line((1, 0), (2, 0)), line((1, 0), (1, 1))])
    assert len(chains.open) == 3 and not chains.findings


def test_a_short_open_curve_is_not_closed_upon_itself() -> None:
    short = 5e-5  # below the widest gap of 1e-4 of the diagonal
    geometry = assemble([square(0, 1), line((0.5, 0.5), (0.5 + short, 0.5), (0.5 + short, 0.5 + short))])
    assert len(geometry.regions) == 1 and len(geometry.curves) == 1


@pytest.mark.parametrize(
    ("loops", "where"),
    [
        ([polyline([(0, 0), (2, 2), (2, 0), (0, 2), (0, 0)])], r"crosses itself at \(1, 1\)"),
        ([polyline([(0, 0), (1, 0), (1, 1), (0.5, 0), (0, 1), (0, 0)])], r"crosses itself at \(0.5, 0\)"),
        ([square(0, 2), square(1, 3)], r"cross or share a stretch at \((2, 1|1, 2)\)"),
        ([square(0, 2), rectangle((1, 0), (2, 1)).outer], "cross or share a stretch"),
        ([circle((0, 0), 1).outer, circle((1, 0), 1).outer], "cross or share a stretch"),
    ],
)
def test_outlines_that_cross_are_refused_with_the_place(loops: list[Curve], where: str) -> None:
    with pytest.raises(GeometryError, match=where):
        nest(loops)
    geometry = assemble(loops)
    assert not geometry.regions and len(geometry.curves) == len(loops) and len(geometry.wrong) == 1


def test_a_polygon_from_many_short_lines_joins_fast_and_exactly() -> None:
    corners = np.column_stack([f(np.linspace(0, 2 * np.pi, 3000, endpoint=False)) for f in (np.cos, np.sin)])
    order = np.random.default_rng(1).permutation(3000)
    pieces = [line(tuple(corners[k]), tuple(corners[(k + 1) % 3000])) for k in order]
    (region,) = assemble(pieces).regions
    assert region.area == pytest.approx(polygon(corners).area, rel=1e-13)  # 3000 roundings


def circle_by(speed: float):  # type: ignore[no-untyped-def]
    """A circle about (2, 1) run through unevenly, as a rational spline does."""
    return lambda t: np.column_stack(
        [2.0 + 0.3 * np.cos(t + speed * np.sin(t)), 1.0 + 0.3 * np.sin(t + speed * np.sin(t))]
    )


@pytest.mark.parametrize("end", [0.4, np.pi, 4.0, 2.0 * np.pi])
def test_a_free_form_curve_that_is_an_arc_becomes_one(end: float) -> None:
    points, bulges = trace(circle_by(0.2), np.array([0.0, end]), 1e-6)
    assert len(bulges) == (1 if end <= np.pi else 2)
    sweep = end + 0.2 * np.sin(end)
    assert 4.0 * np.arctan(bulges).sum() == pytest.approx(
        sweep, rel=1e-10
    )  # from points that are rounded at 1e-16
    assert np.hypot(*(points - [2.0, 1.0]).T) == pytest.approx(0.3, rel=1e-12)


def test_a_free_form_curve_that_is_straight_becomes_a_line() -> None:
    points, bulges = trace(lambda t: np.column_stack([t**3, 2.0 * t**3]), np.array([0.0, 1.0]), 1e-6)
    assert points.tolist() == [[0.0, 0.0], [1.0, 2.0]] and bulges.tolist() == [0.0]


def test_a_line_run_to_and_fro_is_not_taken_for_a_line() -> None:
    points, _ = trace(lambda t: np.column_stack([np.sin(t), 0.0 * t]), np.array([0.0, np.pi]), 1e-6)
    assert points[:, 0].max() > 0.999


def test_flattening_an_ellipse_keeps_the_chord_error() -> None:
    points = flatten(
        lambda t: np.column_stack([3.0 * np.cos(t), np.sin(t)]), np.array([0.0, 2 * np.pi]), 1e-5
    )
    middles = 0.5 * (points[1:] + points[:-1])
    inside = 1.0 - np.hypot(middles[:, 0] / 3.0, middles[:, 1])
    assert 0.0 < inside.max() <= 1e-5  # at the end of the short axis the scaled distance is the distance
    assert len(points) < 2500


@pytest.mark.parametrize("sweep", [0.1, -3.0, np.pi, 5.0, -2.0 * np.pi])
def test_arc_pieces_turn_by_the_sweep_about_the_centre(sweep: float) -> None:
    centre, start = np.array([1.0, 2.0]), np.array([2.0, 2.0])
    end = start if abs(sweep) == 2 * np.pi else centre + [np.cos(sweep), np.sin(sweep)]
    points, bulges = arc_pieces(start, end, centre, sweep)
    curve = Curve(points, bulges)
    assert curve.angles.sum() == pytest.approx(sweep, rel=1e-14)
    assert curve.lengths.sum() == pytest.approx(abs(sweep), rel=1e-14)


def test_no_loops_are_no_regions() -> None:
    assert nest([]) == ()  # a damaged face whose edges have no length
