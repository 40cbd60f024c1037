"""Level sets against brute force: NumPy distances, shapely signs, closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomnode.geometry.curves import Curve, Region, arc_centre
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.levelset import SLACK, LevelSet, _measure, _nearest, _off2, _pieces

EPS = np.finfo(float).eps
ROUNDING = 1e-14
"""Of the size (here of order 1): some ten operations, each with an error of eps."""


def chain(*points, bulges=None):
    points = np.array(points, float)
    return Curve(points, np.zeros(len(points) - 1) if bulges is None else np.asarray(bulges, float))


def circle(r=1.0, centre=(0.0, 0.0), parts=2):
    t = np.linspace(0.0, 2.0 * np.pi, parts + 1)
    points = np.asarray(centre) + r * np.column_stack([np.cos(t), np.sin(t)])
    points[-1] = points[0]
    return Curve(points, np.full(parts, np.tan(0.5 * np.pi / parts)))


SQUARE = chain((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))
ELL = chain((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 0))
STAR = chain(
    *[(r * np.cos(t), r * np.sin(t)) for r, t in zip([1, 0.2] * 5, np.arange(10) * np.pi / 5, strict=True)],
    (1, 0),
)
TOOTH = chain((0, 0), (1, 0), (1, 0.1), (0.5, 0.02), (0.1, 0.9), (0, 0))


def brute(curves, xy):
    """Unsigned distance, one piece and one formula at a time."""
    return np.min([distance_of(c, k, xy) for c in curves for k in range(len(c.bulges))], axis=0).astype(float)


def distance_of(curve, k, xy):
    """(n,) Unsigned distance to piece k; in extended precision, as the centre of a flat arc is far away."""
    xy = np.asarray(xy, np.longdouble)
    a, b, bulge = (np.asarray(value, np.longdouble) for value in (*curve.points[k : k + 2], curve.bulges[k]))
    ends = np.minimum(np.hypot(*(xy - a).T), np.hypot(*(xy - b).T))
    if bulge == 0.0:
        t = (xy - a) @ (b - a) / np.sum((b - a) ** 2)
        cross = (b - a)[0] * (xy - a)[:, 1] - (b - a)[1] * (xy - a)[:, 0]
        inside, d = (t > 0) & (t < 1), np.abs(cross) / np.hypot(*(b - a))
    else:
        centre = arc_centre(a, b, bulge)
        d = np.abs(np.hypot(*(xy - centre).T) - np.hypot(*(a - centre)))
        start, sweep = np.arctan2(*(a - centre)[::-1]), 4 * np.arctan(bulge)
        along = np.mod((np.arctan2(*(xy - centre).T[::-1]) - start) * np.sign(sweep), 2 * np.pi)
        inside = along < abs(sweep)
    return np.where(inside, np.minimum(ends, d), ends)


def scattered(region, n=4000, seed=0):
    """Random points, and the awkward ones: level with vertices and collinear with edges."""
    low, high = region.box
    random = np.random.default_rng(seed).uniform(low - 0.5, high + 0.5, (n, 2))
    p, q = region.outer.points[:-1], region.outer.points[1:]
    t = np.linspace(-1.5, 2.5, 41)[:, None, None]
    extended = (p + t * (q - p)).reshape(-1, 2)
    x, y = np.unique(region.outer.points[:, 0]), np.unique(region.outer.points[:, 1])
    level = np.stack(
        np.meshgrid(np.concatenate([x, random[:40, 0]]), np.concatenate([y, random[:40, 1]])), -1
    )
    return np.vstack([random, extended, level.reshape(-1, 2)])


@pytest.mark.parametrize("outer", [SQUARE, ELL, STAR, TOOTH], ids=["square", "ell", "star", "tooth"])
@pytest.mark.parametrize("angle", [0.0, 0.37])
def test_polygons_have_the_sign_of_shapely_and_the_distance_of_brute_force(outer, angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    region = Region(Curve(outer.points @ turn.T, outer.bulges))
    xy = scattered(region)
    phi = LevelSet.of_regions([region]).distance(xy)
    polygon = shapely.Polygon(region.outer.points)
    np.testing.assert_allclose(np.abs(phi), brute(region.loops, xy), atol=ROUNDING)
    clear = np.abs(phi) > ROUNDING  # nearer than that both predicates see rounding only
    np.testing.assert_array_equal(phi[clear] > 0, shapely.contains_xy(polygon, xy[clear]))


def test_ring_with_arcs_inside_and_outside():
    ring = Region(circle(0.5, parts=3), (circle(0.25, parts=2),))
    xy = np.vstack([np.random.default_rng(0).uniform(-0.7, 0.7, (5000, 2)), [[0, 0], [0.375, 0], [0, 0.6]]])
    r = np.hypot(*xy.T)
    found = LevelSet.of_regions([ring]).query(xy)
    np.testing.assert_allclose(found.distance, np.minimum(0.5 - r, r - 0.25), atol=ROUNDING)
    assert set(found.curve) == {0, 1}
    np.testing.assert_allclose(np.hypot(*found.point.T), np.where(found.curve == 0, 0.5, 0.25), atol=ROUNDING)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.floats(-2.5, 2.5), min_size=1, max_size=4),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
)
def test_chains_of_arcs_have_the_distance_of_brute_force(bulges, point):
    # The centre of an arc with a bulge below 1e-3 is so far away that the oracle's eleven bits more do not do.
    bulges = [b if abs(b) > 1e-3 else 0.0 for b in bulges]
    curve = chain(*[(k, 0.3 * k * k % 1) for k in range(len(bulges) + 1)], bulges=bulges)
    xy = np.array([point])
    phi = LevelSet.of_curve(curve).distance(xy)
    np.testing.assert_allclose(np.abs(phi), brute([curve], xy), atol=1e-13)


@pytest.mark.parametrize("bulge", [1e-3, 1e-6, 1e-9, 1e-12, 0.0])
def test_flat_arcs_lose_no_digits(bulge):
    # At mid-chord the arc is bulge/2 below a unit chord turning left.
    curve = chain((0, 0), (1, 0), bulges=[bulge])
    found = LevelSet.of_curve(curve).query(np.array([[0.5, 0.0], [0.5, 0.3], [0.5, -0.5 * bulge]]))
    np.testing.assert_allclose(found.distance, [0.5 * bulge, 0.3 + 0.5 * bulge, 0.0], atol=2 * EPS)
    np.testing.assert_allclose(found.normal, [[0, 1]] * 3, atol=4 * EPS)
    np.testing.assert_allclose(found.s, 0.5, atol=1e-14)


@pytest.mark.parametrize("region", [Region(STAR), Region(ELL, (circle(0.2, (0.5, 0.5)),))])
def test_the_gradient_has_unit_length_off_the_medial_axis(region):
    levelset = LevelSet.of_regions([region])
    xy, step = scattered(region, 2000), 1e-6
    phi, normal = levelset.distance(xy), levelset.normal(xy)
    ahead, behind = levelset.distance(xy + step * normal), levelset.distance(xy - step * normal)
    np.testing.assert_allclose(np.hypot(*normal.T), 1.0, atol=ROUNDING)
    # Towards the curve the distance falls by exactly the step, everywhere.
    inward = np.where(phi > 0, phi - behind, ahead - phi)
    off = np.abs(phi) > step
    np.testing.assert_allclose(inward[off], step, atol=ROUNDING)


def test_the_normal_points_from_the_closest_point():
    region = Region(ELL, (circle(0.2, (0.5, 0.5)),))
    found = LevelSet.of_regions([region]).query(scattered(region))
    away = found.point + found.distance[:, None] * found.normal
    np.testing.assert_allclose(away, scattered(region), atol=ROUNDING)


def test_closest_gives_the_place_on_the_curve():
    curve = chain((0, 0), (1, 0), (1, 1), bulges=[0.0, -2.0])
    xy = np.random.default_rng(2).uniform(-2, 3, (1000, 2))
    point, _, piece, s = LevelSet.of_curve(curve).closest(xy)
    np.testing.assert_allclose(curve.at(piece, s), point, atol=ROUNDING)


def test_a_node_exactly_on_the_curve_has_its_left_normal():
    found = LevelSet.of_curve(SQUARE).query(np.array([[0.5, 0.0], [1.0, 0.25], [0.0, 0.0]]))
    np.testing.assert_array_equal(found.distance, 0.0)
    np.testing.assert_allclose(found.normal, [[0, 1], [-1, 0], [np.sqrt(0.5)] * 2], atol=2 * EPS)


def test_past_a_corner_the_normal_is_radial():
    phi, normal = (f(np.array([[-3.0, -4.0]])) for f in (LevelSet.of_curve(SQUARE).distance,
                                                         LevelSet.of_curve(SQUARE).normal))  # fmt: skip
    np.testing.assert_allclose(phi, -5.0)
    np.testing.assert_allclose(normal, [[0.6, 0.8]])


def test_centre_of_a_circle_is_defined():
    found = LevelSet.of_curve(circle(2.0, (1.0, 1.0), 4)).query(np.array([[1.0, 1.0]]))
    np.testing.assert_allclose(found.distance, 2.0)
    np.testing.assert_allclose(np.hypot(*found.normal.T), 1.0)


def test_clockwise_closed_curve_is_positive_outside():
    assert LevelSet.of_curve(SQUARE.reversed()).distance(np.array([[0.5, 0.5]]))[0] == -0.5
    assert LevelSet.of_regions([Region(SQUARE.reversed())]).distance(np.array([[0.5, 0.5]]))[0] == 0.5


def test_an_open_curve_is_positive_on_its_left_also_past_its_ends():
    crack = LevelSet.of_curve(chain((0, 0), (1, 0)))
    xy = np.array([[0.5, 0.1], [0.5, -0.1], [1.3, 0.4], [1.3, -0.4], [-0.3, 0.4], [2.0, 0.0]])
    np.testing.assert_allclose(crack.distance(xy), [0.1, -0.1, 0.5, -0.5, 0.5, 1.0])


@pytest.mark.parametrize(("way_in", "way_out", "past"), [(0.25, 0.15, 1.0), (0.15, 0.25, -1.0)])
def test_a_cusp_of_two_tangent_arcs_speaks_for_the_points_past_it(way_in, way_out, past):
    # Both arcs touch the x axis at the origin from above. Back below the way in is a turn to the right,
    # which leaves the points past the tip on the left.
    points = np.array([[-0.5, way_in], [0.0, 0.0], [-0.5, way_out]])
    curve = Curve(points, np.array([bulge_along(points[0], points[1]), -bulge_along(points[2], points[1])]))
    np.testing.assert_allclose(curve.tangents[1][0], -curve.tangents[0][1], atol=4 * EPS)
    phi = LevelSet.of_curve(curve).distance(np.array([[0.3, 0.0], [0.3, 0.01], [0.3, -0.01]]))
    np.testing.assert_allclose(phi, past * np.hypot(0.3, [0.0, 0.01, 0.01]))


def bulge_along(start, end):
    """Bulge of the arc from start that arrives at end along +x."""
    return np.tan(0.5 * -np.arctan2(*(end - start)[::-1]))


def test_a_hole_touching_an_outer_corner_does_not_speak_for_the_outside():
    hole = chain((0, 0), (0.5, 0.2), (0.2, 0.5), (0, 0))
    phi = LevelSet.of_regions([Region(SQUARE, (hole,))]).distance(np.array([[-0.3, -0.4], [0.2, 0.2]]))
    assert phi[0] == pytest.approx(-0.5) and phi[1] < 0


def test_two_regions_side_by_side_are_material_on_both_sides():
    right = Region(Curve(SQUARE.points + [1.0, 0.0], SQUARE.bulges))
    found = LevelSet.of_regions([Region(SQUARE), right]).query(
        np.array([[0.9, 0.5], [1.0, 0.5], [1.1, 0.5], [2.5, 0.5]])
    )
    np.testing.assert_allclose(found.distance, [0.1, 0.0, 0.1, -0.5], atol=ROUNDING)
    assert found.curve[2] == found.curve[3] == 1


def test_the_answer_does_not_depend_on_the_order_of_the_points():
    xy = scattered(Region(STAR))
    shuffled = np.random.default_rng(0).permutation(len(xy))
    levelset = LevelSet.of_curve(STAR)
    forth, back = levelset.query(xy), levelset.query(xy[shuffled])
    for one, other in zip(forth, back, strict=True):
        np.testing.assert_array_equal(one[shuffled], other)


def test_the_jit_and_the_interpreter_agree():
    xy = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    pieces = _pieces([STAR])
    plain = getattr(_measure, "py_func", _measure)
    for x, y in xy:
        for k in range(len(STAR.bulges)):
            np.testing.assert_allclose(
                _measure(pieces.rows[k], x, y), plain(pieces.rows[k], x, y), rtol=1e-14
            )


@pytest.mark.twin("levelset._measure", "levelset._nearest", "levelset._off2")
def test_distance_to_each_piece_and_the_nearest_of_them_agree_with_numpy():
    """Lines and arcs, one beyond a semicircle; which vertex is nearest, the turn there, distances to chords."""
    curve = chain((0, 0), (1, 0), (1.5, 1), (0.3, 0.8), (-0.5, 1.2), bulges=[0.0, 1.7, -0.4, 0.02])
    pieces, stack, waiting = _pieces([curve]), np.empty(64, np.int64), np.empty(64)
    leave, arrive = curve.tangents
    turn = np.abs(np.arctan2(arrive[:-1, 0] * leave[1:, 1] - arrive[:-1, 1] * leave[1:, 0],
                             np.sum(arrive[:-1] * leave[1:], axis=1)))  # fmt: skip
    turn = np.concatenate([[0.0], turn, [0.0]])
    xy = np.random.default_rng(5).uniform(-1.5, 2.5, (300, 2))
    distance = np.array([distance_of(curve, k, xy) for k in range(4)]).astype(float)
    corners = np.hypot(*(xy[:, None] - curve.points).transpose(2, 0, 1))
    seen = np.zeros(3, dtype=int)
    for i, (x, y) in enumerate(xy):
        for k in range(4):
            ends = corners[i, k : k + 2]
            vertex = int(np.argmin(ends)) if ends.min() - distance[k, i] < 1e-14 else -1
            d, at, turned = _measure(pieces.rows[k], x, y)
            assert at == vertex and d == pytest.approx(distance[k, i], rel=0, abs=1e-13)
            assert turned == pytest.approx(turn[k + vertex] if vertex >= 0 else 0.0, rel=0, abs=1e-13)
            seen[vertex] += 1
        piece, _, far = _nearest(pieces, x, y, i % 4, stack, waiting)
        assert far == pytest.approx(distance[:, i].min(), rel=0, abs=1e-13)
        assert distance[piece, i] == pytest.approx(far, rel=0, abs=1e-13)
        a, b = pieces.chords[1:, :2], pieces.chords[1:, 2:4]
        t = np.clip(np.sum(([x, y] - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1), 0.0, 1.0)
        off = [np.sqrt(_off2(pieces.chords, k, x, y)) for k in range(1, len(pieces.chords))]
        np.testing.assert_allclose(off, np.hypot(*([x, y] - a - t[:, None] * (b - a)).T), rtol=0, atol=1e-13)
    assert np.all(seen > 50)


def test_no_piece_is_farther_from_the_chords_above_it_than_they_say():
    """Of lines, arcs and a loop of its own that is no neighbour, in a tree with places for eight pieces."""
    bent = chain((0, 0), (1, 0), (1.5, 1), (0.3, 0.8), (-0.5, 1.2), bulges=[0.0, 1.7, -0.4, 0.02])
    curves = [bent, circle(0.3, (5.0, 5.0), 2)]
    pieces = _pieces(curves)
    leaves = len(pieces.chords) // 2
    assert leaves == 8
    owners = [(curve, k) for curve in curves for k in range(len(curve.bulges))]
    for leaf, (curve, k) in enumerate(owners):
        points = curve.at(np.full(50, k), np.linspace(0.0, 1.0, 50))
        node = leaves + leaf
        while node > 0:
            off = np.sqrt([_off2(pieces.chords, node, x, y) for x, y in points])
            assert np.all(off <= pieces.chords[node, SLACK] + 1e-14)
            node //= 2
    empty = [_off2(pieces.chords, leaves + leaf, 0.0, 0.0) for leaf in (6, 7)]
    assert np.all(np.array(empty) > 1e299)


@pytest.mark.twin("levelset._distance")
def test_many_pieces_have_the_distance_of_brute_force():
    """A wavy outline of 2,000 segments with 300 in a hole: whatever the search leaves out is farther."""
    rng = np.random.default_rng(2)
    t, u = np.linspace(0, 2 * np.pi, 2001), np.linspace(2 * np.pi, 0, 301)
    ring = (1.0 + 0.1 * np.cos(9 * t) + 0.002 * rng.random(2001))[:, None] * np.column_stack(
        [np.cos(t), np.sin(t)]
    )
    hole = (0.4 + 0.1 * np.cos(5 * u))[:, None] * np.column_stack([np.cos(u), np.sin(u)])
    ring[-1], hole[-1] = ring[0], hole[0]
    region = Region(chain(*ring), (chain(*hole),))
    xy = rng.uniform(-1.5, 1.5, (1000, 2))
    phi = LevelSet.of_regions([region]).distance(xy)
    np.testing.assert_allclose(np.abs(phi), brute(region.loops, xy), rtol=0, atol=1e-13)
    polygon = shapely.Polygon(ring, [hole])
    np.testing.assert_array_equal(phi > 0, shapely.contains_xy(polygon, xy))
    np.testing.assert_array_equal(phi, LevelSet.of_regions([region]).query(xy).distance)
    both = LevelSet.of_regions([region, Region(SQUARE)])
    np.testing.assert_array_equal(both.distance(xy), both.query(xy).distance)


def test_pieces_without_length_and_no_regions_are_refused():
    with pytest.raises(GeometryError, match="at least one region"):
        LevelSet.of_regions([])
    with np.errstate(invalid="ignore"), pytest.raises(GeometryError, match="without length"):
        LevelSet.of_curve(chain((0, 0), (1, 0), (1, 0)))
