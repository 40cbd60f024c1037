"""Contact: signed distance against brute force, exact gradient, momentum, and a search that misses nothing."""

from __future__ import annotations

import numpy as np
import pytest

from phantomnode.solver.contact import OPEN, add_contact_forces, contact_energy
from phantomnode.solver.model import Contact
from phantomnode.solver.search import build_candidates, outdated, prepare_search

PENALTY = 1e12


def point_contact(points, polygon, reach, closed=True):
    """Slave points and master vertices that are nodes of their own: any configuration, by displacements.

    The polygon runs counter-clockwise, so that its material is on the left.
    """
    g, s = len(points), len(polygon) if closed else len(polygon) - 1
    start = g + np.arange(s)
    end = g + (np.arange(s) + 1) % len(polygon)
    first, second = np.eye(4)[np.zeros(max(g, s), int)], np.eye(4)[np.ones(max(g, s), int)]
    previous, following = np.arange(s) - 1, np.arange(s) + 1
    previous[:1], following[s - 1 :] = (s - 1, 0) if closed else (-1, -1)
    contact = Contact(
        np.repeat(np.arange(g)[:, None], 4, axis=1), first[:g].copy(), np.full(g, 0.01), np.array([0, g]),
        np.column_stack([start, end, end, end]), first[:s].copy(), second[:s].copy(), previous, following,
        np.array([0, s]), np.array([PENALTY]), np.array([reach]), np.zeros(g),
    )  # fmt: skip
    return contact, np.vstack([np.reshape(points, (g, 2)), polygon]).astype(float)


def forces_at(contact, x, u, candidates=None):
    if candidates is None:
        candidates = build_candidates(contact, prepare_search(contact), x, u)
    points, pairs = len(contact.slave_weight), len(contact.penalty)
    force, pair_force = np.zeros_like(x), np.zeros((pairs, 2))
    gap, normal = np.full(points, OPEN), np.zeros((points, 2))
    add_contact_forces(contact, candidates, x, u, force, pair_force, gap, normal)
    return force, pair_force, gap, normal


def depth_of(points, polygon, reach, closed=True, **_):
    contact, x = point_contact(points, polygon, reach, closed)
    force, _, gap, normal = forces_at(contact, x, np.zeros_like(x))
    return gap, normal, force


def signed_depth(point, polygon):
    """Distance from the boundary of a simple closed polygon, positive inside (crossing number): the oracle."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    d = b - a
    t = np.clip(np.sum((point - a) * d, axis=1) / np.sum(d * d, axis=1), 0.0, 1.0)
    distance = np.hypot(*(point - a - t[:, None] * d).T).min()
    spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    crossing = a[spans, 0] + (point[1] - a[spans, 1]) / d[spans, 1] * d[spans, 0]
    return distance if np.sum(crossing > point[0]) % 2 else -distance


def star(corners, rng):
    """A random star-shaped polygon, counter-clockwise, with convex and concave vertices."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners - 4))
    angle = np.sort(np.concatenate([angle, [0.1, 1.7, 3.2, 4.8]]))
    return (rng.uniform(0.5, 1.5, corners) * [np.cos(angle), np.sin(angle)]).T


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
NOTCH = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 0.5], [0.0, 1.0]])


def test_interior_of_a_segment():
    gap, normal, force = depth_of([[0.5, 0.98]], SQUARE, 0.1)
    assert gap[0] == pytest.approx(0.02, rel=1e-14)
    np.testing.assert_allclose(normal[0], [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(force[0], [0.0, PENALTY * 0.01 * 0.02], rtol=1e-13)
    np.testing.assert_allclose(force[[3, 4]], [[0.0, -1e8], [0.0, -1e8]], rtol=1e-13)


def test_outside_and_beyond_reach_are_open():
    gap, _, force = depth_of([[0.5, 1.02], [1.02, 1.02], [0.5, 0.5]], SQUARE, 0.1)
    assert np.all(gap == OPEN) and not force.any()


def test_concave_vertex_pushes_along_the_radius():
    """Below the notch's tip both segments are closest at their common vertex: the direction is radial."""
    point = np.array([1.02, 0.4])
    gap, normal, force = depth_of([point], NOTCH, 0.2)
    radius = [1.0, 0.5] - point
    assert gap[0] == pytest.approx(np.hypot(*radius), rel=1e-14)
    np.testing.assert_allclose(normal[0], radius / np.hypot(*radius), rtol=1e-14)
    np.testing.assert_allclose(force[1 + 3], -force[0], rtol=1e-14)  # all of it on the vertex


def test_point_outside_a_convex_vertex_is_open():
    gap, _, _ = depth_of([[1.01, 1.01], [-0.01, -0.02]], SQUARE, 0.1)
    assert np.all(gap == OPEN)


def test_point_exactly_on_a_vertex_or_a_segment_has_no_force():
    gap, _, force = depth_of([[1.0, 1.0], [1.0, 0.5], [1.0, 0.5]], NOTCH, 0.1)
    assert not force.any() and np.all((gap == OPEN) | (gap < 1e-15))


def test_equal_distance_takes_the_lowest_number():
    gap, normal, _ = depth_of([[0.95, 0.95]], SQUARE, 0.1)
    assert gap[0] == pytest.approx(0.05, rel=1e-13)
    np.testing.assert_array_equal(normal[0], [1.0, 0.0])  # segment 1 (right), not 2 (top)


def test_beyond_a_free_end_the_segments_own_normal_decides():
    line = np.array([[1.0, 0.0], [0.0, 0.0]])  # material below
    gap, normal, force = depth_of([[1.03, -0.02], [1.03, 0.02]], line, 0.1, closed=False)
    assert gap[0] == pytest.approx(0.02, rel=1e-13) and gap[1] == OPEN
    np.testing.assert_allclose(normal[0], [0.0, 1.0], atol=1e-15)
    moment = force[0, 1] * 1.03 + force[2, 1] * 1.0
    assert moment == pytest.approx(0.0, abs=1e-12 * PENALTY)


def test_signed_distance_agrees_with_brute_force():
    """4000 points against 20 random polygons, near and far; 1e-14: a few roundings of lengths of about 1."""
    rng, reach = np.random.default_rng(8), 0.3
    closed = 0
    for _ in range(20):
        polygon, points = star(24, rng), rng.uniform(-1.6, 1.6, (200, 2))
        gap, _, _ = depth_of(points, polygon, reach)
        exact = np.array([signed_depth(p, polygon) for p in points])
        inside = (exact > 0.0) & (exact <= reach)
        np.testing.assert_allclose(gap[inside], exact[inside], atol=1e-14)
        assert np.all(gap[~inside] == OPEN)
        closed += int(inside.sum())
    assert closed > 500


def quad_contact(rng):
    """Slave and master points inside distorted elements: every shape function takes part."""
    corner = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

    def shape(local):
        return 0.25 * np.prod(1.0 + corner * np.asarray(local)[:, None, :], axis=-1)

    x = np.vstack([corner, corner * [1.0, 0.5] + [0.2, 0.8]]) + 0.05 * rng.uniform(-1, 1, (8, 2))
    ends = np.array([[0.9, 0.4], [0.3, 0.5], [0.1, 0.7], [-0.4, 0.6], [-0.9, 0.8]])
    slave = np.column_stack([np.linspace(-0.9, 0.8, 9), np.full(9, -0.9)])
    contact = Contact(
        np.tile(np.arange(4, 8), (9, 1)), shape(slave), rng.uniform(0.1, 0.3, 9), np.array([0, 9]),
        np.tile(np.arange(4), (4, 1)), shape(ends[:-1]), shape(ends[1:]), np.array([-1, 0, 1, 2]),
        np.array([1, 2, 3, -1]), np.array([0, 4]), np.array([PENALTY]), np.array([0.8]), np.zeros(9),
    )  # fmt: skip
    return contact, x


@pytest.mark.parametrize("seed", range(8))
def test_forces_are_the_gradient_of_the_contact_energy(seed):
    """On elements, with interior points, vertices and free ends closed at once."""
    rng = np.random.default_rng(seed)
    contact, x = quad_contact(rng)
    u, direction = 0.05 * rng.uniform(-1, 1, x.shape), rng.normal(size=x.shape)
    force, pair_force, gap, _ = forces_at(contact, x, u)
    assert np.sum(gap > 0.0) >= 3
    step = 1e-6

    def energy(w):
        return contact_energy(contact, forces_at(contact, x, w)[2])

    slope = (energy(u + step * direction) - energy(u - step * direction)) / (2 * step)
    # Central differences: step^2 times curvature changes, and EPS energy/step: 1e-8 of the forces.
    assert slope == pytest.approx(-np.sum(force * direction), rel=1e-7, abs=1e-8 * np.abs(force).sum())
    np.testing.assert_allclose(pair_force[0], force[4:].sum(axis=0), rtol=1e-13)
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * np.abs(force).sum()
    y = x + u
    moment = np.sum(y[:, 0] * force[:, 1] - y[:, 1] * force[:, 0])
    assert abs(moment) < 1e-14 * np.abs(force).sum() * 4


def test_gradient_through_vertices():
    """Along a path past the notch's vertex the energy never jumps and its slope is the force."""
    path = np.column_stack([np.linspace(0.8, 1.2, 2001), np.full(2001, 0.42)])
    contact, x = point_contact(path[:1], NOTCH, 0.3)
    energy, work = [], []
    for point in path:
        u = np.zeros_like(x)
        u[0] = point - x[0]
        force, _, gap, _ = forces_at(contact, x, u)
        energy.append(contact_energy(contact, gap))
        work.append(-force[0, 0])
    slope = np.gradient(energy, path[:, 0])
    # The normal turns at two points of the path: there the difference quotient averages both sides.
    np.testing.assert_allclose(slope[1:-1], work[1:-1], atol=2e-3 * np.abs(work).max())


def test_stale_lists_give_the_same_bits_as_fresh_ones():
    """As long as the lists are not outdated, forces and gaps are those of lists built on the spot."""
    rng = np.random.default_rng(12)
    polygon = star(40, rng)
    contact, x = point_contact(rng.uniform(-1.5, 1.5, (150, 2)), polygon, 0.1)
    search, u = prepare_search(contact), np.zeros_like(x)
    lists = build_candidates(contact, search, x, u)
    kept = 0
    for _ in range(300):
        u = u + 0.004 * rng.uniform(-1, 1, x.shape) + [0.05, 0.02]  # the common part is no reason to rebuild
        if outdated(search, lists, u):
            lists = build_candidates(contact, search, x, u)
        else:
            kept += 1
        for stale, fresh in zip(forces_at(contact, x, u, lists), forces_at(contact, x, u), strict=True):
            np.testing.assert_array_equal(stale, fresh)
    assert kept > 150


@pytest.mark.parametrize("cells_per_step", [0.01, 0.5, 3.0])
def test_no_pair_is_missed_at_any_sliding_speed(cells_per_step):
    """A point slides at a depth of a tenth of a cell over 200 segments, and back."""
    h, n = 0.1, 200
    line = np.column_stack([np.linspace(n * h, 0.0, n + 1), np.zeros(n + 1)])
    contact, x = point_contact([[0.05, -0.1 * h]], line, h, closed=False)
    search = prepare_search(contact)
    lists = build_candidates(contact, search, x, np.zeros_like(x))
    there = np.arange(0.0, (n - 1) * h, cells_per_step * h)
    for shift in np.concatenate([there, there[::-1]]):
        u = np.zeros_like(x)
        u[0, 0] = shift
        if outdated(search, lists, u):
            lists = build_candidates(contact, search, x, u)
        assert forces_at(contact, x, u, lists)[2][0] == pytest.approx(0.1 * h, rel=1e-12)


def test_cost_follows_the_points_near_a_master():
    h, n = 0.01, 2000
    line = np.column_stack([np.linspace(n * h, 0.0, n + 1), np.zeros(n + 1)])
    near = np.column_stack([np.linspace(1.0, 2.0, 50), np.full(50, -0.2 * h)])
    far = np.column_stack([np.linspace(0.0, 20.0, 5000), np.full(5000, 3 * h)])
    contact, x = point_contact(np.vstack([near, far]), line, h, closed=False)
    lists = build_candidates(contact, prepare_search(contact), x, np.zeros_like(x))
    count = lists.near_first[1]
    np.testing.assert_array_equal(lists.near[:count], np.arange(50))
    # Within reach + skin = 1.5 cells to either side: three to four segments a point.
    assert lists.first[count] <= 5 * count
    for i in range(count):
        assert np.all(np.diff(lists.segments[lists.first[i] : lists.first[i + 1]]) > 0)


def test_no_pairs_no_points_no_masters():
    none = np.empty((0, 4), dtype=np.int64)
    empty = np.empty(0, dtype=np.int64)
    x = np.zeros((4, 2))
    for pairs in (0, 1):
        contact = Contact(
            none, np.empty((0, 4)), np.empty(0), np.zeros(pairs + 1, int), none, np.empty((0, 4)),
            np.empty((0, 4)), empty, empty, np.zeros(pairs + 1, int), np.ones(pairs), np.ones(pairs), np.zeros(0),
        )  # fmt: skip
        force, pair_force, gap, _ = forces_at(contact, x, x)
        assert not force.any() and pair_force.shape == (pairs, 2) and not pair_force.any() and len(gap) == 0
        search = prepare_search(contact)
        assert not outdated(search, build_candidates(contact, search, x, x), x)
        assert contact_energy(contact, gap) == 0.0


def test_two_pairs_keep_apart():
    """The same square as master of two pairs with different penalties: each point feels its own."""
    one, x = point_contact([[0.5, 0.98], [0.4, 0.99]], SQUARE, 0.1)
    two = one._replace(
        slave_first=np.array([0, 1, 2]),
        master_nodes=np.vstack([one.master_nodes] * 2),
        start_shape=np.vstack([one.start_shape] * 2),
        end_shape=np.vstack([one.end_shape] * 2),
        previous=np.concatenate([one.previous, one.previous + 4]),
        following=np.concatenate([one.following, one.following + 4]),
        master_first=np.array([0, 4, 8]),
        penalty=np.array([1e12, 3e12]),
        reach=np.array([0.1, 0.1]),
        offset=np.zeros(2),
    )
    _, pair_force, gap, _ = forces_at(two, x, np.zeros_like(x))
    np.testing.assert_allclose(gap, [0.02, 0.01], rtol=1e-13)
    np.testing.assert_allclose(pair_force[:, 1], [2e8, 3e8], rtol=1e-13)
    assert contact_energy(two, gap) == pytest.approx(0.5 * 0.01 * (1e12 * 4e-4 + 3e12 * 1e-4), rel=1e-13)


def test_an_overlap_at_the_start_can_count_as_touching():
    """With the depth at the start as offset nothing pushes; deeper, only what is added does."""
    contact, x = point_contact([[0.5, 0.98]], SQUARE, 0.1)
    contact = contact._replace(offset=np.array([0.02]))
    _, _, gap, _ = forces_at(contact, x, np.zeros_like(x))
    assert gap[0] <= 1e-16  # rounding of 1 - 0.98
    u = np.zeros_like(x)
    u[0, 1] = -0.005
    _, pair_force, gap, _ = forces_at(contact, x, u)
    np.testing.assert_allclose(gap, [0.005], rtol=1e-12)
    np.testing.assert_allclose(pair_force[0, 1], PENALTY * 0.01 * 0.005, rtol=1e-12)


def test_the_search_finds_every_pair_that_brute_force_finds():
    """10,000 configurations: random points, polygons, reaches, displacements; bins against all pairs."""
    rng = np.random.default_rng(21)
    found = 0
    for _ in range(10_000):
        corners, points = int(rng.integers(5, 24)), int(rng.integers(1, 8))
        polygon = star(corners, rng) * rng.uniform(0.1, 3.0, 2)
        reach = float(10.0 ** rng.uniform(-2.0, 0.0))
        contact, x = point_contact(rng.uniform(-2.0, 2.0, (points, 2)), polygon, reach)
        u = rng.uniform(-0.3, 0.3, x.shape)
        lists = build_candidates(contact, prepare_search(contact), x, u)
        y = x + u
        a, b = y[points:], np.roll(y[points:], -1, axis=0)
        d = b - a
        r = y[:points, None] - a
        t = np.clip(np.sum(r * d, axis=2) / np.sum(d * d, axis=1), 0.0, 1.0)
        near = np.hypot(*np.moveaxis(r - t[..., None] * d, 2, 0)) <= reach
        seen = np.zeros_like(near)
        for i in range(lists.near_first[1]):
            seen[lists.near[i], lists.segments[lists.first[i] : lists.first[i + 1]]] = True
        assert np.all(seen[near])
        found += int(near.sum())
    assert found > 15_000


@pytest.mark.parametrize("cells_per_step", [0.1, 0.3, 0.5])
def test_a_projectile_is_never_missed(cells_per_step):
    """Points shot at a closed polygon at up to half a cell a step, from anywhere: each is met before it is through.

    A step of half a reach lands within the reach whatever the phase, and the force of that depth is there.
    """
    rng, h = np.random.default_rng(4), 0.1
    angle = np.linspace(0.0, 2.0 * np.pi, 80)[:-1]
    target = np.column_stack([np.cos(angle), np.sin(angle)])
    aim = rng.uniform(0.0, 2.0 * np.pi, 200)
    start = (1.3 + h * rng.uniform(0, 1, (200, 1))) * np.column_stack([np.cos(aim), np.sin(aim)])
    contact, x = point_contact(start, target, h)
    direction = -start / np.hypot(*start.T)[:, None]
    search, u = prepare_search(contact), np.zeros_like(x)
    lists, met = build_candidates(contact, search, x, u), np.zeros(200, dtype=bool)
    for _ in range(int(np.ceil(0.45 / (cells_per_step * h)))):
        u[:200] += cells_per_step * h * direction
        if outdated(search, lists, u):
            lists = build_candidates(contact, search, x, u)
        gap = forces_at(contact, x, u, lists)[2]
        deep = np.array([signed_depth(p, target) for p in (x + u)[:200]])
        inside = (deep > 0.0) & (deep <= h)
        np.testing.assert_allclose(gap[inside], deep[inside], atol=1e-13)
        met |= gap > 0.0
    assert met.all()
