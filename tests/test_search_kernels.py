"""Kernels of the search against plain NumPy: numbers of segments and bins, true and false agree exactly."""

from __future__ import annotations

import numpy as np
import pytest
from test_contact import point_contact, quad_contact, star
from test_self_contact import along_curve, folded

from phantomnode.solver.search import (
    bin_grid,
    bin_range,
    build_candidates,
    closest,
    fill_bins,
    grown,
    movement_box,
    outdated,
    own_neighbourhood,
    place_ends,
    position,
    prepare_search,
    rows_of,
    segment_ends,
)


def ends_of(contact, y):
    """(s, 4) Ends of the master segments with the nodes at y."""
    shapes = contact.start_shape, contact.end_shape
    return np.hstack([np.einsum("si,sia->sa", shape, y[contact.master_nodes]) for shape in shapes])


def points_of(contact, y):
    return np.einsum("gi,gia->ga", contact.slave_shape, y[contact.slave_nodes])


def places(p, a, b):
    """(g, s) Squared distance of points p from segments a-b, and the place there from 0 to 1."""
    d, r = b - a, p[:, None] - a
    square = np.sum(d * d, axis=1)
    t = np.clip(np.sum(r * d, axis=2) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return np.sum((r - t[..., None] * d) ** 2, axis=2), t


def two_pairs(rng):
    """Random points and a polygon, of which each of two pairs has a part and a reach of its own."""
    contact, x = point_contact(rng.uniform(-1.6, 1.6, (60, 2)), star(24, rng), 0.1)
    contact = contact._replace(
        slave_first=np.array([0, 25, 60]),
        master_first=np.array([0, 10, 24]),
        penalty=np.array([1e12, 3e12]),
        reach=rng.uniform(0.05, 0.3, 2),
    )
    return contact, x, 0.05 * rng.uniform(-1, 1, x.shape)


@pytest.mark.twin("search.position", "search.segment_ends")
def test_positions_of_points_and_ends():
    contact, x = quad_contact(np.random.default_rng(2))
    u = 0.1 * np.random.default_rng(3).uniform(-1, 1, x.shape)
    found = [position(*of, x, u) for of in zip(contact.slave_nodes, contact.slave_shape, strict=True)]
    np.testing.assert_allclose(found, points_of(contact, x + u), rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        segment_ends(contact, 1, 4, x, u), ends_of(contact, x + u)[1:], rtol=0, atol=1e-13
    )


@pytest.mark.twin("search.closest")
def test_closest_place_on_a_segment():
    """Beside the segment, beyond either end, and a segment without length; lengths of order 1."""
    rng = np.random.default_rng(4)
    p, a, b = rng.uniform(-1, 1, (3, 400, 2))
    b[:20] = a[:20]
    for i in range(400):
        d2, t = places(p[i : i + 1], a[i : i + 1], b[i : i + 1])
        assert closest(*p[i], *a[i], *b[i]) == pytest.approx((d2[0, 0], t[0, 0]), rel=0, abs=1e-13)


@pytest.mark.twin("search.movement_box")
def test_box_of_movements():
    rng = np.random.default_rng(5)
    nodes, u, built = rng.permutation(9), rng.normal(size=(9, 2)), rng.normal(size=(9, 2))
    moved = u[nodes[2:8]] - built[2:8]
    expected = np.column_stack([moved.min(axis=0), moved.max(axis=0)]).ravel()
    assert movement_box(nodes, 2, 8, u, built) == tuple(expected)
    assert movement_box(nodes, 3, 3, u, built) == (np.inf, -np.inf, np.inf, -np.inf)


@pytest.mark.twin("search.outdated")
def test_lists_are_outdated_once_a_slave_and_a_master_node_may_have_parted_by_the_skin():
    rng, found = np.random.default_rng(6), []
    for _ in range(200):
        contact, x, u = two_pairs(rng)
        search = prepare_search(contact)
        lists, expected = build_candidates(contact, search, x, u), False
        u = u + rng.uniform(0.0, 0.06) * rng.uniform(-1, 1, x.shape) + rng.normal(size=2)
        for k in range(2):
            slave = slice(*search.slave_first[k : k + 2])
            master = slice(*search.master_first[k : k + 2])
            moved = (u[search.slave_nodes] - lists.built_slave)[slave]
            other = (u[search.master_nodes] - lists.built_master)[master]
            apart = np.abs(moved[:, None] - other).max(axis=(0, 1))
            expected |= bool(apart @ apart > search.skin[k] ** 2)
        assert outdated(search, lists, u) == expected
        found.append(expected)
    assert 50 < sum(found) < 150


@pytest.mark.twin("search.bin_grid")
@pytest.mark.parametrize("margin", [1e-3, 0.1, 5.0])
def test_grid_of_bins(margin):
    ends = np.random.default_rng(7).uniform(-1, 1, (30, 4)) * [3.0, 1.0, 3.0, 1.0]
    corners = ends.reshape(-1, 2)
    low, span = corners.min(axis=0) - margin, np.ptp(corners, axis=0) + 2.0 * margin
    size = max(2.0 * margin, np.sqrt(span.prod() / 120.0), span.max() / 120.0)
    *found, columns, rows = bin_grid(ends, margin)
    np.testing.assert_allclose(found, [*low, size], rtol=1e-13)
    assert [columns, rows] == (np.floor(span / size) + 1).tolist()


@pytest.mark.twin("search.bin_range")
def test_bins_of_an_interval():
    rng = np.random.default_rng(8)
    for low, wide in rng.uniform(0, 3, (200, 2)) - [0.5, -0.3]:  # what it is asked for reaches into the grid
        first, last = np.floor((np.array([low, low + wide]) + 0.2) / 0.15)
        assert bin_range(low, low + wide, -0.2, 0.15, 9) == (max(first, 0), min(last, 8))


@pytest.mark.twin("search.fill_bins")
def test_segments_of_each_bin():
    """A segment is in all bins that its box with the margin touches."""
    ends, margin = np.random.default_rng(9).uniform(0, 1, (40, 4)), 0.03
    x0, y0, size, columns, rows = bin_grid(ends, margin)
    corners = ends.reshape(-1, 2, 2)
    low = np.floor((corners.min(axis=1) - margin - [x0, y0]) / size)
    high = np.floor((corners.max(axis=1) + margin - [x0, y0]) / size)
    j, i = (axis.ravel()[:, None] for axis in np.mgrid[:rows, :columns])
    touched = (low[:, 0] <= i) & (i <= high[:, 0]) & (low[:, 1] <= j) & (j <= high[:, 1])
    first, members = fill_bins(ends, margin, x0, y0, size, columns, rows)
    assert first.tolist() == [0, *np.cumsum(touched.sum(axis=1))]
    assert members.tolist() == np.nonzero(touched)[1].tolist()


@pytest.mark.twin("search.grown", "search.rows_of")
def test_longer_lists_and_chosen_rows():
    values, rows = np.arange(5), np.array([4, 0, 0, 2])
    assert grown(values, 5) is values or np.array_equal(grown(values, 5), values)
    for needed, length in ((6, 10), (23, 23)):
        longer = grown(values, needed)
        assert len(longer) == length and np.array_equal(longer[:5], values)
    table = np.random.default_rng(10).normal(size=(5, 2))
    assert np.array_equal(rows_of(table, rows), table[rows])


def own(contact, g, s):
    """Whether segment s is wholly within the excluded distance of point g along their curve."""
    apart = along_curve(contact, s, 0.5, g)
    same = contact.slave_place[g, 0] == contact.master_place[s, 0]
    return bool(same and apart + contact.master_place[s, 2] < contact.exclusion[0])


@pytest.mark.twin("search.own_neighbourhood")
def test_own_neighbourhood_on_closed_open_and_other_curves():
    contact, _, _ = folded(np.random.default_rng(0))
    place = contact.master_place.copy()
    place[20:, 0] = 1.0
    opened = contact.master_place.copy()
    opened[:, 3] = np.inf
    for case in (contact, contact._replace(master_place=place), contact._replace(master_place=opened)):
        found = [[own_neighbourhood(case, 0, g, s) for s in range(40)] for g in range(80)]
        assert found == [[own(case, g, s) for s in range(40)] for g in range(80)]
    assert not own_neighbourhood(contact._replace(exclusion=np.zeros(0)), 0, 0, 0)


def assert_candidates(contact, x, u, hidden):
    """The lists are all segments within reach + skin; ``hidden`` (g, s) ones excepted."""
    search = prepare_search(contact)
    lists, ends = build_candidates(contact, search, x, u), ends_of(contact, x + u)
    square, _ = places(points_of(contact, x + u), ends[:, :2], ends[:, 2:])
    pair_of_point = np.repeat([*range(len(contact.penalty))], np.diff(contact.slave_first))
    pair_of_segment = np.repeat([*range(len(contact.penalty))], np.diff(contact.master_first))
    margin = (contact.reach + search.skin)[pair_of_point][:, None]
    wanted = (square <= margin**2) & (pair_of_point[:, None] == pair_of_segment) & ~hidden
    near = np.flatnonzero(wanted.any(axis=1))
    count = lists.near_first[-1]
    assert lists.near[:count].tolist() == near.tolist()
    assert lists.near_first.tolist() == [0, *np.searchsorted(near, contact.slave_first[1:])]
    assert lists.first[: count + 1].tolist() == [0, *np.cumsum(wanted[near].sum(axis=1))]
    assert lists.segments[: lists.first[count]].tolist() == np.nonzero(wanted)[1].tolist()
    assert lists.wanted.tolist() == np.flatnonzero(wanted.any(axis=0)).tolist()
    np.testing.assert_allclose(lists.ends, ends, rtol=0, atol=1e-13)
    place_ends(contact, lists, x, u + 0.25)
    np.testing.assert_allclose(lists.ends[lists.wanted], ends[lists.wanted] + 0.25, rtol=0, atol=1e-13)
    assert np.array_equal(lists.built_slave, u[search.slave_nodes])
    assert np.array_equal(lists.built_master, u[search.master_nodes])
    return len(near)


@pytest.mark.twin("search.build_candidates", "search.listed", "search.place_ends")
def test_candidates_are_the_segments_within_reach_and_skin():
    rng, found = np.random.default_rng(11), 0
    for _ in range(50):
        contact, x, u = two_pairs(rng)
        found += assert_candidates(contact, x, u, np.zeros((60, 24), dtype=bool))
        folds, x, u = folded(rng, rough=0.04)
        hidden = np.array([[own(folds, g, s) for s in range(40)] for g in range(80)])
        found += assert_candidates(folds, x, u, hidden)
    assert found > 2000
