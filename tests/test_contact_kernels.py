"""Parts of the kernels of contact and friction against plain NumPy; the sums of forces are in their own tests."""

from __future__ import annotations

import numpy as np
import pytest
from test_contact import point_contact, quad_contact, signed_depth, star
from test_search_kernels import ends_of, places
from test_self_contact import along_curve, folded

from phantomnode.solver.contact import (
    add_recess_forces,
    depth_at,
    nearest_segment,
    outward_normal,
    recess,
    segment_normal,
)
from phantomnode.solver.friction import FARTHEST, add_on_master, at_distance, master_point, slide, way_to

TINY = 1e-40
"""The complex step: it cancels nothing, so derivatives are right to rounding."""


def right_normal(d):
    return np.array([d[1], -d[0]]) / np.hypot(*d)


@pytest.mark.twin("contact.outward_normal", "contact.segment_normal")
def test_normals_of_segments():
    contact, x = quad_contact(np.random.default_rng(0))
    u = 0.1 * np.random.default_rng(1).uniform(-1, 1, x.shape)
    for s, (ax, ay, bx, by) in enumerate(ends_of(contact, x + u)):
        expected = right_normal(np.array([bx - ax, by - ay]))
        np.testing.assert_allclose(outward_normal(ax, ay, bx, by), expected, rtol=0, atol=1e-13)
        np.testing.assert_allclose(segment_normal(contact, s, x, u), expected, rtol=0, atol=1e-13)
    assert outward_normal(1.0, 2.0, 1.0, 2.0) == (0.0, 0.0)


@pytest.mark.twin("contact.nearest_segment")
def test_nearest_of_some_segments():
    rng = np.random.default_rng(2)
    contact, x = point_contact(np.zeros((1, 2)), star(24, rng), 0.3)
    u = 0.05 * rng.uniform(-1, 1, x.shape)
    ends, segments = ends_of(contact, x + u), rng.permutation(24)
    for p in rng.uniform(-1.5, 1.5, (200, 2)):
        square, t = places(p[None], ends[segments[3:20], :2], ends[segments[3:20], 2:])
        d2, s, at = nearest_segment(ends, segments, 3, 20, *p)
        best = int(np.argmin(square))
        if t[0, best] in (0.0, 1.0):  # two segments end there: the first counts, where NumPy sees rounding
            best = int(np.flatnonzero(square[0] < square[0, best] + 1e-14)[0])
        assert s == segments[3 + best]
        assert (d2, at) == pytest.approx((square[0, best], t[0, best]), rel=0, abs=1e-13)
    assert nearest_segment(ends, segments, 5, 5, *p) == (np.inf, -1, 0.0)


@pytest.mark.twin("contact.depth_at")
def test_depth_in_a_closed_polygon_and_beyond_the_ends_of_an_open_one():
    """The sign is that of the crossing number; the way out leads to the closest point. Lengths of order 1."""
    rng = np.random.default_rng(3)
    polygon = star(24, rng)
    contact, x = point_contact(np.zeros((1, 2)), polygon, 0.3)
    still, ends, vertices = np.zeros_like(x), ends_of(contact, x), 0
    for p in rng.uniform(-1.5, 1.5, (400, 2)):
        square, t = places(p[None], ends[:, :2], ends[:, 2:])
        s = int(np.argmin(square))
        foot = ends[s, :2] + t[0, s] * (ends[s, 2:] - ends[s, :2])
        depth, *normal, at = depth_at(contact, s, t[0, s], *p, x, still)
        assert depth == pytest.approx(signed_depth(p, polygon), rel=0, abs=1e-13)
        np.testing.assert_allclose(depth * np.array(normal), foot - p, rtol=0, atol=1e-13)
        assert at == pytest.approx(t[0, s], rel=0, abs=1e-13)
        vertices += t[0, s] in (0.0, 1.0)
    assert 100 < vertices < 300
    contact, x = point_contact(np.zeros((1, 2)), polygon[:3], 0.3, closed=False)
    a, b = ends_of(contact, x).reshape(-1, 2, 2)[0]
    for p in a - 0.3 * (b - a) + rng.uniform(-0.1, 0.1, (20, 2)):
        expected = (
            (a - p) @ right_normal(b - a),
            *right_normal(b - a),
            (p - a) @ (b - a) / ((b - a) @ (b - a)),
        )
        assert depth_at(contact, 0, 0.0, *p, x, np.zeros_like(x)) == pytest.approx(expected, rel=0, abs=1e-13)


@pytest.mark.twin("contact.recess")
def test_recess_and_its_slope():
    """The slope is the derivative by t in the complex step; 0 from twice the exclusion on."""
    contact, _, _ = folded(np.random.default_rng(0))
    reach, exclusion = contact.reach[0], contact.exclusion[0]
    seen = np.zeros(3, dtype=int)
    for g in range(0, 80, 7):
        for s in range(40):
            for t in (0.0, 0.3, 0.8):
                back = reach * (2.0 - along_curve(contact, s, t + TINY * 1j, g) / exclusion)
                expected = (back.real, back.imag / TINY) if back.real > 0.0 else (0.0, 0.0)
                assert recess(contact, 0, g, s, t) == pytest.approx(expected, rel=1e-13, abs=1e-13 * reach)
                seen += [expected[0] == 0.0, expected[1] > 0.0, expected[1] < 0.0]
    assert np.all(seen > 50)
    assert recess(contact._replace(exclusion=np.zeros(1)), 0, 0, 0, 0.3) == (0.0, 0.0)
    assert recess(contact._replace(master_place=contact.master_place + 1.0), 0, 0, 0, 0.3) == (0.0, 0.0)


@pytest.mark.twin("contact.add_recess_forces")
def test_the_force_of_the_recess_is_along_the_gradient_of_the_place():
    rng = np.random.default_rng(4)
    contact, x = quad_contact(rng)
    u, pull = 0.05 * rng.uniform(-1, 1, x.shape), 3.0

    def place(y, g, s):
        p = contact.slave_shape[g] @ y[contact.slave_nodes[g]]
        a, b = (shape[s] @ y[contact.master_nodes[s]] for shape in (contact.start_shape, contact.end_shape))
        return (p - a) @ (b - a) / ((b - a) @ (b - a))

    for g, s in ((0, 3), (4, 1), (8, 0)):
        steps = TINY * 1j * np.eye(x.size).reshape(-1, *x.shape)
        slope = np.array([place(x + u + step, g, s).imag / TINY for step in steps]).reshape(x.shape)
        force, p = np.zeros_like(x), contact.slave_shape[g] @ (x + u)[contact.slave_nodes[g]]
        on_point = add_recess_forces(contact, g, s, pull, *p, x, u, force)
        scale = pull * np.abs(slope).max()
        np.testing.assert_allclose(force, pull * slope, rtol=0, atol=1e-13 * scale)
        np.testing.assert_allclose(on_point, pull * slope[4:].sum(axis=0), rtol=0, atol=1e-13 * scale)


@pytest.mark.twin("friction.master_point", "friction.add_on_master")
def test_points_of_the_master_and_forces_on_them():
    rng = np.random.default_rng(5)
    contact, x = quad_contact(rng)
    u, on = 0.05 * rng.uniform(-1, 1, x.shape), rng.normal(size=2)
    for s, t in ((0, 0.3), (3, 0.9), (2, -0.4)):
        share = (1.0 - t) * contact.start_shape[s] + t * contact.end_shape[s]
        place = share @ (x + u)[contact.master_nodes[s]]
        np.testing.assert_allclose(master_point(contact, s, t, x, u), place, rtol=0, atol=1e-13)
        force, part, expected = np.ones_like(x), np.zeros_like(x), np.zeros_like(x)
        np.add.at(expected, contact.master_nodes[s], np.outer(share, on))
        add_on_master(contact, s, t, *on, force, part)
        np.testing.assert_allclose(part, expected, rtol=0, atol=1e-13)
        np.testing.assert_allclose(force, 1.0 + expected, rtol=0, atol=1e-13)


def around(count):
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.mark.twin("friction.way_to")
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("count", [7, 2 * FARTHEST, 3 * FARTHEST])
def test_the_way_to_an_anchor_is_the_shorter_one(closed, count):
    """Forth where both are as long; none beyond so many segments, nor where the surface ends before."""
    contact, _ = point_contact(np.zeros((1, 2)), around(count), 0.1, closed)
    n = len(contact.following)
    for s in (0, 3, n - 1):
        for anchor in {
            *range(min(n, 12)),
            n // 2,
            s - FARTHEST - 1,
            s - FARTHEST,
            s + FARTHEST,
            s + FARTHEST + 1,
        }:
            if not 0 <= anchor < n or anchor == s:
                continue
            forth, back = (anchor - s, s - anchor) if not closed else ((anchor - s) % n, (s - anchor) % n)
            near = [way for way, hops in ((1, forth), (-1, back)) if 0 < hops <= FARTHEST]
            expected = min(near, key=lambda way: forth if way > 0 else back) if near else 0
            assert way_to(contact, s, 0.5, anchor, 0.5) == expected
        assert [way_to(contact, s, 0.5, s, at) for at in (0.4, 0.5, 0.6)] == [-1, 1, 1]


def test_an_anchor_that_is_too_far_starts_anew_at_the_point():
    contact, x = point_contact(np.zeros((1, 2)), around(3 * FARTHEST), 0.1)
    still = np.zeros_like(x)
    assert slide(contact, 0, 0.3, FARTHEST + 1, 0.7, 10.0, x, still) == (0, 0.3)
    assert slide(contact, 0, 0.3, FARTHEST, 0.7, 10.0, x, still) == (FARTHEST, 0.7)


@pytest.mark.twin("friction.at_distance")
def test_where_a_way_leaves_a_circle():
    """From a place inside: the greater root of a quadratic along the way, or all of the way."""
    rng, left = np.random.default_rng(6), 0
    for _ in range(300):
        a, b, c = rng.uniform(-1, 1, (3, 2))
        low, high = rng.uniform(-0.2, 1.2, 2)
        start, along = a + low * (b - a) - c, (high - low) * (b - a)
        radius = np.hypot(*start) * rng.uniform(1.0, 2.0)
        part = np.roots([along @ along, 2.0 * start @ along, start @ start - radius**2]).max()
        expected = low + min(part, 1.0) * (high - low)
        found = at_distance(*c, radius, *a, *b, low, high)
        # As a place: EPS of the lengths, over the cosine at which the way meets the circle.
        leaving = np.abs((start + min(part, 1.0) * along) @ along) / (radius * np.hypot(*along))
        assert abs(found - expected) * np.hypot(*(b - a)) * min(leaving, 1.0) < 1e-13
        left += found != high
    assert 50 < left < 250
    assert at_distance(*c, 1.0, *a, *a, 0.0, 1.0) == 1.0
