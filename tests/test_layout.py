"""Rows of equal elements and strips for the threads: the same forces either way, the same bits at any count."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from test_elements import LAME, RHO, SHEAR, gradients_at, grid, twin_forces

from phantomnode.solver import layout as layouts
from phantomnode.solver.block import BLOCK
from phantomnode.solver.kinds import SHORTEST_ROW, shared_kinds
from phantomnode.solver.layout import scattered_lists, uncut_lists
from phantomnode.solver.model import V_LAME
from phantomnode.solver.motion import NODE_RANGE, move_by_threads
from phantomnode.solver.q4 import one_point_elements
from phantomnode.solver.uncut import add_row, add_uncut_forces


def uniform(columns, rows, h=0.01, low=(0.0, 0.0), rho=RHO):
    """A Cartesian grid away from the origin, where the rounding of positions makes all gradients differ."""
    x, quads = grid(columns, rows)
    x = np.asarray(low) + h * x
    return x, quads, one_point_elements(quads, x[quads], LAME, SHEAR, rho)


def forces(lists, u, threads=None):
    force = np.zeros(u.shape, order="F")
    assert add_uncut_forces(*lists, np.asfortranarray(u), force, threads) == 0
    return force


def waves(x, size):
    return size * np.column_stack([np.sin(40.0 * x[:, 1]), np.cos(50.0 * x[:, 0] + 3.0 * x[:, 1])])


@pytest.mark.parametrize("columns", [SHORTEST_ROW, 9, BLOCK, BLOCK + 1, 300])
@pytest.mark.parametrize("size", [1e-3, 4e-3])
@pytest.mark.twin(
    "uncut.add_row", "block.row_block", "block.row_beyond", "block.gradient_of", "block.forces_of"
)
def test_rows_make_the_forces_of_numpy_and_of_scattered_elements(columns, size):
    """Around the length of a block; at the larger size with strains on both sides of the limit of the series."""
    x, _, e = uniform(columns, 5, low=(3.0, -7.0))
    u = waves(x, size)
    rows, scattered = uncut_lists(shared_kinds(e, x))
    assert rows.length.tolist() == [columns] * 5 and len(scattered.nodes) == 0 and len(rows.constants) == 1
    expected = twin_forces(e, u)
    # Positions of 7 m round to 1e-15 m, of which 1e-13 remains in a cell of 0.01 m.
    scale = 4e-13 * np.abs(expected).max()
    assert np.abs(forces((rows, scattered), u) - expected).max() < scale
    assert np.abs(forces(scattered_lists(e), u) - expected).max() < scale
    exact = uniform(columns, 5, h=2.0**-7, low=(3.0, -7.0))
    lists = uncut_lists(shared_kinds(exact[2], exact[0]))
    twin = twin_forces(exact[2], u)
    assert np.abs(forces(lists, u) - twin).max() < 1e-13 * np.abs(twin).max()


def test_forces_of_a_row_go_to_both_of_its_sides():
    a1, a2, c = np.random.default_rng(3).normal(size=(3, 7))
    low, high = np.zeros((2, 8))
    add_row(a1, a2, c, low, high)
    expected = np.zeros((2, 8))
    expected[0, :-1] -= a1 + c
    expected[0, 1:] += c - a2
    expected[1, 1:] += a1 - c
    expected[1, :-1] += a2 + c
    np.testing.assert_allclose([low, high], expected, rtol=0, atol=1e-14)


def test_constants_hold_gradients_and_hourglass_vectors():
    """gamma = h - s . grad N, and gradients across a diagonal are opposite, on crooked elements too."""
    x, quads = grid(4, 3, 0.25)
    e, corners = one_point_elements(quads, x[quads], LAME, SHEAR, RHO), x[quads]
    gradient = np.array([gradients_at(each, np.zeros(2)) for each in corners])
    np.testing.assert_allclose(e.gradient, gradient, rtol=0, atol=1e-14)
    h = np.array([1.0, -1.0, 1.0, -1.0])
    gamma = h - np.einsum("mia,ma->mi", gradient, np.einsum("i,mia->ma", h, corners))
    np.testing.assert_allclose(e.gamma, gamma, rtol=0, atol=1e-14)
    np.testing.assert_allclose([e.lame, e.shear], np.tile([[LAME], [SHEAR]], 12), rtol=3e-16)


def test_elements_of_a_row_share_a_kind_and_others_keep_theirs():
    """Three rows of one kind and eight other elements; kinds in another order give the same forces."""
    x, quads, e = uniform(9, 3)
    x[23] += 0.001
    e = one_point_elements(quads, x[quads], LAME, SHEAR, RHO)
    shared = shared_kinds(e, x)
    assert shared.kind.dtype == np.uint32 and shared.constants.shape == (10, 9)
    np.testing.assert_array_equal(
        shared.kind.reshape(3, 9)[1:], [[1, 2, 3, 4, *[0] * 5], [5, 6, 7, 8, *[0] * 5]]
    )
    np.testing.assert_allclose(shared.gradient, e.gradient, rtol=0, atol=1e-11)
    u, backwards = (
        waves(x, 1e-4),
        shared._replace(kind=8 - shared.kind, constants=shared.constants[:, ::-1].copy()),
    )
    scattered = uncut_lists(shared)[1]
    assert scattered.constants is shared.constants
    assert np.array_equal(forces(uncut_lists(shared), u), forces(uncut_lists(backwards), u))


def broken_row(name):
    """A grid of 40 x 3 cells in which the middle row is not one of equal elements."""
    x, quads, e = uniform(40, 3)
    middle = np.arange(40, 80)
    if name == "a stiffer element":
        e.constants[V_LAME, 60] *= 1.0 + 1e-9
    elif name == "a node of another number":
        quads[60, 1] = quads[61, 0] = 0
        e.nodes[:] = quads
    elif name == "a cell of another size":
        x[np.isclose(x[:, 0], 0.2), 0] += 1e-9
        e = one_point_elements(quads, x[quads], LAME, SHEAR, RHO)
    elif name == "a graded row":
        x[:, 0] = np.cumsum(np.concatenate([[0.0], 0.01 * (1.0 + 1e-9 * np.arange(40))]))[
            np.arange(len(x)) % 41
        ]
        e = one_point_elements(quads, x[quads], LAME, SHEAR, RHO)
    return x, e, middle


@pytest.mark.parametrize(
    "name", ["a stiffer element", "a node of another number", "a cell of another size", "a graded row"]
)
def test_only_equal_elements_with_nodes_in_a_row_make_one(name):
    x, e, middle = broken_row(name)
    rows, scattered = uncut_lists(shared_kinds(e, x))
    assert rows.length.sum() + len(scattered.nodes) == 120 and rows.length.max(initial=0) <= 40
    assert not (40 in rows.length and len(rows.length) == 3)
    u = waves(x, 1e-3)
    np.testing.assert_allclose(
        forces((rows, scattered), u), twin_forces(e, u), rtol=0, atol=1e-12 * np.abs(twin_forces(e, u)).max()
    )


@pytest.mark.twin("uncut.add_by_threads")
@pytest.mark.parametrize("crooked", [0.0, 0.2])
def test_forces_are_the_same_to_the_bit_at_any_number_of_threads(crooked):
    x, quads = grid(64, 160, crooked)
    e = one_point_elements(quads, x[quads], LAME, SHEAR, RHO)
    lists, u = uncut_lists(shared_kinds(e, x)), waves(0.01 * x, 0.1)
    assert len(lists[0].strip) == 6 and len(lists[0].low) == (0 if crooked else 160)
    serial = forces(lists, u)
    before = numba.get_num_threads()
    try:
        for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):
            numba.set_num_threads(threads)
            force = np.zeros_like(serial)
            assert add_uncut_forces(*lists, np.asfortranarray(u), force, threads) == 0
            assert np.array_equal(force, serial)
    finally:
        numba.set_num_threads(before)


@pytest.mark.twin("motion.move_by_threads")
def test_nodes_move_the_same_to_the_bit_by_threads():
    rng, n = np.random.default_rng(5), 2 * NODE_RANGE + 77
    mobility, load = rng.uniform(1, 2, n), np.asfortranarray(rng.normal(size=(n, 2)))
    u, v, force = (np.asfortranarray(rng.normal(size=(n, 2))) for _ in range(3))
    expected = v + 0.3 * (force * mobility[:, None])
    after = u + 0.4 * expected
    move_by_threads(mobility, load, u, v, force, 0.3, 0.4)
    assert np.array_equal(v, expected) and np.array_equal(u, after) and np.array_equal(force, load)


@pytest.mark.parametrize("behind", [0, 40, 130, 500])
def test_a_ring_falls_into_strips_whose_last_one_may_touch_the_first(monkeypatch, behind):
    """120 sectors of 5 cells that close on themselves, and a body behind them."""
    monkeypatch.setattr(layouts, "STRIP_ELEMENTS", 16)
    sector, cell = np.divmod(np.arange(600), 5)
    first, after = sector * 6 + cell, (sector + 1) % 120 * 6 + cell
    ring = np.column_stack([first, first + 1, after + 1, after])
    quads = np.vstack([ring, grid(1, behind, 1.0)[1] + 720]) if behind else ring
    bounds = layouts._strips(quads, np.arange(0, len(quads), 5))
    assert len(bounds) - 1 > 10
    for parity in (0, 1):
        strips = [quads[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)][parity::2]
        assert sum(len(np.unique(strip)) for strip in strips) == len(np.unique(np.vstack(strips)))


def test_strips_share_nodes_with_their_neighbours_only(monkeypatch):
    """Long rows: a strip of fewer elements than a row would share nodes with the one after the next."""
    monkeypatch.setattr(layouts, "STRIP_ELEMENTS", 16)
    for columns, rows, most in ((10, 200, 64), (1000, 3, 3), (3, 400, 64)):
        x, quads, e = uniform(columns, rows)
        lists = uncut_lists(shared_kinds(e, x))
        bounds = np.cumsum([0, *(lists[0].length)])[lists[0].strip] if len(lists[0].low) else lists[1].strip
        assert len(bounds) - 1 <= most and bounds[0] == 0 and bounds[-1] == len(quads)
        seen = [set(quads[a:b].ravel().tolist()) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
        for s in range(len(seen)):
            for other in range(s + 2, len(seen)):
                assert not seen[s] & seen[other]


def test_unsound_elements_are_counted():
    """One turned inside out, one that is not a number; in a row and alone."""
    x, quads, e = uniform(12, 2)
    for lists in (uncut_lists(shared_kinds(e, x)), scattered_lists(e)):
        u = np.zeros(x.shape, order="F")
        force = np.zeros_like(u)
        u[0] = [0.03, 0.03]
        assert add_uncut_forces(*lists, u, force, None) == 1
        u[quads[-1, 2]] = np.nan
        assert add_uncut_forces(*lists, u, force, None) == 2


def test_no_elements():
    x, _, e = uniform(5, 1)
    none = e.some(slice(0))
    assert not forces(uncut_lists(shared_kinds(none, x)), np.zeros_like(x)).any()
