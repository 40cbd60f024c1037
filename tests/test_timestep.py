"""The stable step: closed form for a square, and a safe bound, not a wasteful one, with contact closed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from phantomnode.geometry.bilinear import gradients, to_local
from phantomnode.solver.cut_elements import fragment_elements
from phantomnode.solver.explicit import initial_state
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import advance
from phantomnode.solver.model import Contact, Model
from phantomnode.solver.q4 import one_point_elements
from phantomnode.solver.timestep import contact_rates, stable_step

LAME, SHEAR, RHO = 5.769e9, 3.846e9, 7800.0
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
RULE = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
LOCAL = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def grid(columns, rows, low=(0.0, 0.0), h=1.0):
    x = np.array([(i, j) for j in range(rows + 1) for i in range(columns + 1)], dtype=float) * h + low
    first = np.array([j * (columns + 1) + i for j in range(rows) for i in range(columns)])
    return x, first[:, None] + np.array([0, 1, columns + 2, columns + 1])


def no_contact():
    none, empty, zero = np.empty((0, 4), dtype=np.int64), np.empty(0, dtype=np.int64), np.zeros(1, int)
    shapes = np.empty((0, 4))
    return Contact(
        none, shapes, np.empty(0), zero, none, shapes, shapes, empty, empty, zero, *(np.empty(0),) * 3
    )


def no_cut():
    return fragment_elements(
        np.empty((0, 4), int), np.zeros(1, int), np.empty((0, 4, 2)), np.empty(0), LAME, SHEAR, RHO
    )


def model_of(x, elements, cut, contact):
    mass = np.zeros(len(x))
    for group in (elements, cut):
        np.add.at(mass, group.nodes, 0.25 * group.mass[:, None])
    return Model(x, mass, np.zeros((0, 2)), np.full(x.shape, -1, dtype=np.int32), 0, elements, cut, contact)


def lower_fragments(quads, corners, height):
    """Lower parts, from eta = -1 to ``height`` (one each), of parallelograms as two triangles each."""
    points, weights = [], []
    for corner, eta in zip(corners, height, strict=True):
        area = np.linalg.det(corner.T @ (0.25 * LOCAL)) * (eta + 1.0)
        box = LOCAL.copy()
        box[2:, 1] = eta
        for triangle in (box[:3], box[[0, 2, 3]]):
            for p in RULE @ triangle:
                by_local = 0.25 * LOCAL * (1.0 + LOCAL[:, ::-1] * p[::-1])
                points.append(by_local @ np.linalg.inv(corner.T @ by_local))
                weights.append(area / 3.0)
    first = 6 * np.arange(len(quads) + 1)
    return fragment_elements(quads, first, np.array(points), np.array(weights), LAME, SHEAR, RHO)


def stacked(penalty, seed, overlap=1e-6):
    """A row of uncut cells below, a row of cut ones above, pressed a little into each other all along."""
    rng = np.random.default_rng(seed)
    n, h = 5, 0.2
    x1, q1 = grid(n, 2, h=h)
    x2, q2 = grid(n, 1, low=(0.07, 2 * h - overlap), h=h)
    x, q2 = np.vstack([x1, x2]), q2 + len(x1)
    elements = one_point_elements(q1, x[q1], LAME, SHEAR, RHO)
    cut = lower_fragments(q2, x[q2], rng.uniform(-0.9, 0.9, n))
    top = q1[-n:]
    contact = Contact(
        np.repeat(q2, 2, axis=0), np.tile(np.column_stack([1 - GAUSS, GAUSS, 0 * GAUSS, 0 * GAUSS]), (n, 1)),
        np.full(2 * n, h / 2), np.array([0, 2 * n]), top[::-1].copy(), np.tile(np.eye(4)[2], (n, 1)),
        np.tile(np.eye(4)[3], (n, 1)), np.arange(n) - 1, np.append(np.arange(1, n), -1), np.array([0, n]),
        np.array([penalty]), np.array([h]), np.zeros(2 * n),
    )  # fmt: skip
    return model_of(x, elements, cut, contact)


def random_cut(seed):
    """Two rows of cells pressed together: sizes, shapes, slanted cuts, penalty, friction, hourglass at random."""
    rng = np.random.default_rng(seed)
    n, h, overlap = int(rng.integers(2, 6)), 0.2, 1e-6
    aspect = rng.uniform(0.5, 2.0)
    x1, q1 = grid(n, 2, h=h)
    x2, q2 = grid(n, 1, low=(rng.uniform(0.0, 0.5) * h, 2 * h - overlap), h=h)
    x1[:, 1] = 2 * h + aspect * (x1[:, 1] - 2 * h)
    x2[n + 1 :] += 0.2 * h * rng.uniform(-1, 1, (n + 1, 2))
    x, q2 = np.vstack([x1, x2]), q2 + len(x1)
    elements = one_point_elements(q1, x[q1], LAME, SHEAR, RHO, kappa=rng.uniform(0.0, 0.2))
    points, weights, first = [], [], [0]
    for corner in x[q2]:
        low, high = rng.uniform(-0.98, 0.95, 2)
        if rng.random() < 0.3:  # a corner is left, on the left or on the right of the lower edge
            part = (
                [[(-1, -1), (1, -1), (-1, high)]] if rng.random() < 0.5 else [[(-1, -1), (1, -1), (1, high)]]
            )
        else:
            part = [[(-1, -1), (1, -1), (1, high)], [(-1, -1), (1, high), (-1, low)]]
        physical = [shape_of(np.array(t, dtype=float)) @ corner for t in part]
        for triangle in physical:
            a, b = triangle[1] - triangle[0], triangle[2] - triangle[0]
            at = RULE @ triangle
            points.append(
                gradients(np.repeat(corner[None], 3, 0), to_local(np.repeat(corner[None], 3, 0), at))
            )
            weights += [(a[0] * b[1] - a[1] * b[0]) / 6.0] * 3
        first.append(len(weights))
    cut = fragment_elements(q2, np.array(first), np.vstack(points), np.array(weights), LAME, SHEAR, RHO)
    penalty, top = 10.0 ** rng.uniform(9, 14), q1[-n:]
    contact = Contact(
        np.repeat(q2, 2, axis=0), np.tile(np.column_stack([1 - GAUSS, GAUSS, 0 * GAUSS, 0 * GAUSS]), (n, 1)),
        np.full(2 * n, h / 2), np.array([0, 2 * n]), top[::-1].copy(), np.tile(np.eye(4)[2], (n, 1)),
        np.tile(np.eye(4)[3], (n, 1)), np.arange(n) - 1, np.append(np.arange(1, n), -1), np.array([0, n]),
        np.array([penalty]), np.array([h]), np.zeros(2 * n), friction=np.array([rng.choice([0.0, 0.3, 1.5])]),
        tangential_penalty=np.array([penalty * rng.choice([0.3, 1.0, 3.0])]),
    )  # fmt: skip
    return model_of(x, elements, cut, contact)


def shape_of(local):
    """Bilinear functions at (k, 2) local points, once more."""
    return 0.25 * np.prod(1.0 + LOCAL[None] * local[:, None], axis=2)


def tangent(model, state, layout, step=1e-8):
    """(2n, 2n) Minus the slope of the forces at rest, by central differences, with the anchors as they are."""
    keep = [field.copy() for field in (state.anchor, state.anchor_at)]
    columns = []
    for k in range(model.x.size):
        side = []
        for sign in (1.0, -1.0):
            state.anchor[:], state.anchor_at[:] = keep
            state.u[:] = 0.0
            state.u.flat[k] = sign * step
            advance(model, layout, state, 0.0, np.zeros((0, 0)))
            side.append(state.force.ravel().copy())
        columns.append((side[1] - side[0]) / (2 * step))
    state.anchor[:], state.anchor_at[:] = keep
    return np.column_stack(columns)


def assembled_stiffness(model):
    """With every slave point closed and stuck."""
    layout = prepare_layout(model)
    state = initial_state(model, np.zeros_like(model.x), layout)
    assert np.all(state.gap > 0.0)
    return tangent(model, state, layout)


class Springs(NamedTuple):
    """The slave points of :func:`random_cut`; its interface is flat, along x.

    along, across : (g, 2n) motion of each point against the master in x and in y, which opens its gap; normal,
    tangential, slip : (g,) eps w, eps_t w and mu eps w, Pa.
    """

    along: np.ndarray
    across: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray
    slip: np.ndarray

    def stiffness(self, closed, stuck, sense):
        """(2n, 2n) Tangent with some points closed and some of these stuck; the others slip to x * sense.

        The friction -sense mu eps g of a slipping point follows its gap alone: rows of x, columns of y.
        """
        normal, tangential, slip = (
            np.where(on, k, 0.0)[:, None]
            for on, k in (
                (closed, self.normal),
                (closed & stuck, self.tangential),
                (closed & ~stuck, sense * self.slip),
            )
        )
        along, across = self.along, self.across
        return across.T @ (normal * across) + along.T @ (tangential * along) - along.T @ (slip * across)


def springs(model):
    """All of them closed; a point beyond the end of the master sees its last segment extended."""
    contact = model.contact
    at = np.einsum("gi,gi->g", contact.slave_shape, model.x[contact.slave_nodes][:, :, 0])
    x = model.x[contact.master_nodes][:, :, 0]
    start, end = (np.einsum("si,si->s", side, x) for side in (contact.start_shape, contact.end_shape))
    rows = np.zeros((len(at), len(model.x)))
    for g, row in enumerate(rows):
        s = int(np.argmin(np.abs(at[g] - 0.5 * (start + end))))
        t = (at[g] - start[s]) / (end[s] - start[s])
        row[contact.slave_nodes[g]] += contact.slave_shape[g]
        row[contact.master_nodes[s]] -= (1.0 - t) * contact.start_shape[s] + t * contact.end_shape[s]
    penalty, mu = contact.penalty[0], contact.friction[0]
    moduli = (penalty, contact.tangential_penalty[0] if mu > 0.0 else 0.0, mu * penalty)
    parts = [np.kron(rows, axis) for axis in np.eye(2)]
    return Springs(*parts, *(modulus * contact.slave_weight for modulus in moduli))


def power_iteration(matrix, rounds=4000):
    """The largest eigenvalue of a symmetric matrix of positive ones."""
    vector = np.random.default_rng(0).normal(size=len(matrix))
    for _ in range(rounds):
        vector = matrix @ vector
        vector /= np.linalg.norm(vector)
    return vector @ matrix @ vector


def states_of_friction(count, rng):
    """(closed, stuck, sense) of so many points: all slip one way, or the other, and mixes of all there is."""
    yes, no = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    yield yes, no, 1.0
    yield yes, no, -1.0
    yield yes, no, rng.choice([1.0, -1.0], count)
    for closed in (yes, yes, rng.random(count) < 0.7, rng.random(count) < 0.7):
        yield closed, rng.random(count) < 0.4, rng.choice([1.0, -1.0], count)


def test_estimate_is_safe_and_within_two_for_200_random_cuts():
    """All points stuck, all slipping either way, and mixes of open, stuck and slipping points.

    The tangent of slip is not symmetric. Where its eigenvalues are complex the system itself flutters, and grows
    at any step, which no step can cure; the limit of the step is 2/sqrt(|lambda|) of the largest all the same.
    The estimate is below that of every state, and at least half of the smallest.
    """
    ratios = []
    for seed in range(200):
        model, rng = random_cut(seed), np.random.default_rng(seed)
        scale = 1.0 / np.sqrt(np.repeat(model.mass, 2))
        matrix = scale[:, None] * assembled_stiffness(model) * scale
        assert np.abs(matrix - matrix.T).max() < 1e-6 * np.abs(matrix).max()  # differences: about 1e-7
        largest = [np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1]]
        if seed < 5:  # the two ways agree; the eigenvalues can be close to each other, so some digits only
            assert power_iteration(matrix) == pytest.approx(largest[0], rel=1e-3)
        held = springs(model)
        yes = np.ones(len(held.normal), dtype=bool)
        bodies = matrix - scale[:, None] * held.stiffness(yes, yes, 1.0) * scale
        if model.contact.friction[0] > 0.0:
            for state in states_of_friction(len(yes), rng):
                slipping = bodies + scale[:, None] * held.stiffness(*state) * scale
                largest.append(np.abs(np.linalg.eigvals(slipping)).max())
        ratios.append(2.0 / np.sqrt(max(largest)) / stable_step(model, safety=1.0).dt)
    assert min(ratios) > 1.0 - 1e-6 and max(ratios) < 2.0


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_tangent_of_slip_is_that_of_the_kernel(sense):
    """All anchors lie behind their points: the product's forces, by differences, against the matrix above."""
    seen = 0
    for seed in range(12):
        model = random_cut(seed)
        if not model.contact.friction[0] > 0.0:
            continue
        layout = prepare_layout(model)
        state = initial_state(model, np.zeros_like(model.x), layout)
        assert np.all(state.anchor >= 0)
        held, seen = springs(model), seen + 1
        yes = np.ones(len(state.anchor), dtype=bool)
        bodies = tangent(model, state, layout) - held.stiffness(yes, yes, sense)
        # Half a segment behind, where mu eps g/eps_t is some 1e-6 m; segments run to the left.
        state.anchor_at[:] += 0.5 * sense
        # The place on a segment at that distance is right to 1e-6 of it where the anchor is 1e5 times as far, so the
        # gap is moved by half; the normal force is off by that distance from its point: mu eps g/(eps_t h), 5e-5.
        found = tangent(model, state, layout, 5e-7) - bodies
        wanted = held.stiffness(yes, ~yes, sense)
        assert np.abs(found - wanted).max() < 2e-4 * np.abs(wanted).max()
        assert np.abs(wanted - wanted.T).max() > 0.1 * np.abs(wanted).max()
    assert seen >= 6


def true_limit(model):
    """2/omega of the assembled model, linearised by differences of the forces."""
    layout = prepare_layout(model)
    state = initial_state(model, np.zeros_like(model.x), layout)
    assert model.contact.penalty[0] == 0.0 or np.all(
        state.gap[:-1] > 0.0
    )  # the last may stand beyond the end
    size, step = model.x.size, 1e-8
    stiffness = np.empty((size, size))
    for k in range(size):
        side = []
        for sign in (1.0, -1.0):
            state.u[:] = 0.0
            state.u.flat[k] = sign * step
            advance(model, layout, state, 0.0, np.zeros((0, 0)))
            side.append(state.force.ravel().copy())
        stiffness[:, k] = (side[1] - side[0]) / (2 * step)
    scale = 1.0 / np.sqrt(np.repeat(model.mass, 2))
    vector = np.random.default_rng(0).normal(size=size)
    for _ in range(3000):  # power iteration
        vector = scale * (stiffness @ (scale * vector))
        vector /= np.linalg.norm(vector)
    return 2.0 / np.sqrt(vector @ (scale * (stiffness @ (scale * vector))))


@pytest.mark.parametrize("h", [1.0, 0.01])
def test_square_element_in_closed_form(h):
    """Stiffest mode of a one-point square: dilation, omega^2 = 8 (lambda + mu)/(rho h^2)."""
    x, quads = grid(1, 1, h=h)
    model = model_of(x, one_point_elements(quads, x[quads], LAME, SHEAR, RHO), no_cut(), no_contact())
    estimate = stable_step(model, safety=1.0)
    omega = np.sqrt(8 * (LAME + SHEAR) / RHO) / h
    assert estimate.element_frequency == pytest.approx(omega, rel=1e-12)
    assert estimate.dt == pytest.approx(2.0 / omega, rel=1e-12) and estimate.contact_frequency == 0.0
    assert stable_step(model).dt == pytest.approx(0.85 * estimate.dt, rel=1e-15)


def test_the_stiffest_element_is_found_among_many_of_a_kind():
    x, quads = grid(300, 250)
    shear = np.full(len(quads), SHEAR)
    shear[70000] *= 1.01
    model = model_of(x, one_point_elements(quads, x[quads], LAME, shear, RHO), no_cut(), no_contact())
    assert stable_step(model).element == 70000


def test_cut_elements_are_numbered_behind_the_uncut_ones():
    """A whole cell by three-point triangles has stiffer bending modes than the one-point element."""
    model = stacked(0.0, 1)
    estimate = stable_step(model)
    assert estimate.element >= len(model.elements.kind)


def test_a_thin_lone_fragment_keeps_a_step_of_half_a_cell():
    """Paper, end of 2.2: the mass is spread evenly, so the step does not vanish with the fragment."""
    speed = np.sqrt((LAME + 2 * SHEAR) / RHO)
    x, quads = grid(1, 1)
    none = one_point_elements(np.empty((0, 4), int), np.empty((0, 4, 2)), LAME, SHEAR, RHO)
    for height in (-1 + 1e-6, -0.99, -0.5, 0.0, 0.9):
        cut = lower_fragments(quads, x[quads], [height])
        assert stable_step(model_of(x, none, cut, no_contact()), safety=1.0).dt > 0.555 / speed


@pytest.mark.parametrize("penalty", [0.0, 1e10, 1e12, 1e14])
@pytest.mark.parametrize("seed", [1, 2])
def test_bound_is_safe_and_within_a_factor_of_two(penalty, seed):
    """The formulation found the true limit at 1.03 .. 1.72 times the bound in 40 random cuts."""
    model = stacked(penalty, seed)
    ratio = true_limit(model) / stable_step(model, safety=1.0).dt
    assert 1.0 - 1e-6 < ratio < 2.0  # the stiffness is a difference quotient, good to about 1e-7


def test_a_coarse_slave_on_a_fine_master_counts_with_its_whole_points():
    """One point of a long slave segment presses on a short master side: its weight counts, not that side's length."""
    x1, q1 = grid(8, 1, h=0.05)
    x2, q2 = grid(1, 1, low=(0.0, 0.05 - 1e-6), h=0.4)
    x, q2 = np.vstack([x1, x2]), q2 + len(x1)
    quads = np.vstack([q1, q2])
    contact = Contact(
        np.repeat(q2, 2, axis=0), np.column_stack([1 - GAUSS, GAUSS, 0 * GAUSS, 0 * GAUSS]),
        np.full(2, 0.2), np.array([0, 2]), q1[::-1].copy(), np.tile(np.eye(4)[2], (8, 1)),
        np.tile(np.eye(4)[3], (8, 1)), np.arange(8) - 1, np.append(np.arange(1, 8), -1), np.array([0, 8]),
        np.array([1e13]), np.array([0.05]), np.zeros(2),
    )  # fmt: skip
    model = model_of(x, one_point_elements(quads, x[quads], LAME, SHEAR, RHO), no_cut(), contact)
    ratio = true_limit(model) / stable_step(model, safety=1.0).dt
    assert 1.0 - 1e-6 < ratio < 2.0


def test_a_model_without_elements_is_refused():
    x, quads = grid(1, 1)
    none = one_point_elements(quads[:0], x[quads[:0]], LAME, SHEAR, RHO)
    with pytest.raises(ValueError, match="no element"):
        stable_step(model_of(x, none, no_cut(), no_contact()))


def cornered(seed):
    """Corners that stand alone, one to three of them on one node at most, on a row of uncut and of cut cells."""
    model, rng = random_cut(seed), np.random.default_rng(1000 + seed)
    contact, weight = model.contact, 0.2 * rng.uniform(0.02, 0.5)
    count = int(rng.integers(1, 4))
    # Of the upper row, wherever they stand on the master: all at a place of one node, or spread.
    owner = rng.integers(len(contact.slave_nodes), size=count) if rng.random() < 0.5 else np.zeros(count, int)
    corners = Contact(
        contact.slave_nodes[owner], contact.slave_shape[owner], np.full(count, weight), np.array([0, count]),
        contact.master_nodes, contact.start_shape, contact.end_shape, contact.previous, contact.following,
        contact.master_first, contact.penalty, contact.reach, np.zeros(count), pair=np.array([0]),
        sign=np.ones(1), crowd=np.array([count * weight]),
    )  # fmt: skip
    return model._replace(contact=corners)


def test_estimate_is_safe_where_corners_alone_touch():
    """One to three corners, all closed, at random places of 60 random rows: never above what is stable."""
    ratios = []
    for seed in range(60):
        model = cornered(seed)
        scale = 1.0 / np.sqrt(np.repeat(model.mass, 2))
        matrix = scale[:, None] * assembled_stiffness(model) * scale
        largest = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1]
        ratios.append(2.0 / np.sqrt(largest) / stable_step(model, safety=1.0).dt)
    assert min(ratios) > 1.0 - 1e-6 and np.median(ratios) < 2.0


def test_a_rigid_side_is_not_parted_from_the_other():
    """A pair with an obstacle beside a pair of bodies: each spring of the obstacle counts once, with one side."""
    model = stacked(1e12, 3)
    alone = contact_rates(model)
    heavy = model.mass.copy()
    heavy[model.contact.master_nodes] = 0.0  # as of an obstacle
    rigid = contact_rates(model._replace(mass=heavy))
    slave = np.unique(model.contact.slave_nodes)
    rows = np.zeros(len(heavy))
    np.add.at(
        rows,
        model.contact.slave_nodes,
        1e12 * model.contact.slave_weight[:, None] * model.contact.slave_shape,
    )
    np.testing.assert_allclose(rigid[slave], rows[slave] / model.mass[slave], rtol=1e-12)
    assert np.all(rigid[slave] <= alone[slave]) and rigid[slave].max() < alone[slave].max()
