"""Friction: gradient of its energy in stick, Coulomb's law in slip, momentum, objectivity, anchors, the incline."""

from __future__ import annotations

import numpy as np
import pytest
from test_contact import NOTCH, SQUARE, point_contact, quad_contact
from test_explicit import Motion, grid, outline

from phantomnode.pipeline.elements import weight
from phantomnode.solver.contact import add_contact_forces, contact_energy, depth_at, nearest_segment
from phantomnode.solver.cut_elements import fragment_elements
from phantomnode.solver.explicit import frames
from phantomnode.solver.friction import add_friction_forces, friction_power
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import initial_state
from phantomnode.solver.model import Contact, Model, State
from phantomnode.solver.q4 import one_point_elements
from phantomnode.solver.search import build_candidates, prepare_search, segment_ends
from phantomnode.solver.timestep import stable_step

STUCK = 1e6
"""A coefficient at which nothing slips."""


def rubbing(contact, friction, ratio=1.0):
    return contact._replace(
        friction=np.full(len(contact.penalty), friction), tangential_penalty=ratio * contact.penalty
    )


def state_of(contact, x):
    g, n, k = len(contact.slave_weight), len(x), len(contact.penalty)
    return State(
        np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(0), np.zeros(1),
        np.zeros((k, 2)), np.zeros((k, 2)), np.zeros(k), np.full(g, -1e300), np.zeros((g, 2)), np.zeros(2),
        np.ones(1), np.full(g, -1), np.zeros(g), np.zeros((g, 2)), np.zeros((n, 2)), np.zeros(1), np.zeros(1),
        np.zeros((0, 2)), np.zeros(1),
    )  # fmt: skip


def evaluate(contact, x, state, u):
    """Normal and friction forces at u; the anchors go on from where they are."""
    state.u[:], state.force[:] = u, 0.0
    lists = build_candidates(contact, prepare_search(contact), x, state.u)
    state.gap[:] = -1e300
    add_contact_forces(contact, lists, x, state.u, state.force, state.pair_force, state.gap, state.normal)
    add_friction_forces(contact, lists, x, state)
    return contact_energy(contact, state.gap) + state.stick[0]


def moment(y, force):
    return np.sum(y[:, 0] * force[:, 1] - y[:, 1] * force[:, 0])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("ratio", [0.3, 1.0])
def test_stick_is_the_gradient_of_its_energy(seed, ratio):
    """Elements, interior points, vertices and free ends; anchors left behind on other segments."""
    rng = np.random.default_rng(seed)
    contact, x = quad_contact(rng)
    contact = rubbing(contact, STUCK, ratio)
    state = state_of(contact, x)
    evaluate(contact, x, state, 0.05 * rng.uniform(-1, 1, x.shape))
    u, direction = state.u + 0.15 * rng.uniform(-1, 1, x.shape), rng.normal(size=x.shape)
    evaluate(contact, x, state, u)
    force, closed = state.force.copy(), state.gap > 0.0
    step = 1e-6
    energy = [evaluate(contact, x, state, u + sign * step * direction) for sign in (1.0, -1.0)]
    slope = (energy[0] - energy[1]) / (2.0 * step)
    assert np.sum(closed) >= 3
    # Central differences: step^2 times changes of curvature, and EPS energy/step: 1e-8 of the forces.
    assert slope == pytest.approx(-np.sum(force * direction), rel=1e-7, abs=1e-8 * np.abs(force).sum())
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()
    assert abs(moment(x + u, force)) < 1e-13 * np.abs(force).sum() * 4
    np.testing.assert_allclose(state.pair_force[0], state.force[4:].sum(axis=0), rtol=1e-12)


def dragged(polygon, path, friction, depth_closed=True, reach=0.3):
    """A point is dragged along a path over a fixed polygon; the states after each place."""
    contact, x = point_contact(path[:1], polygon, reach, depth_closed)
    contact, seen = rubbing(contact, friction), []
    state = state_of(contact, x)
    for point in path:
        u = np.zeros_like(x)
        u[0] = point - x[0]
        evaluate(contact, x, state, u)
        seen.append(State(*(field.copy() for field in state)))
    return contact, x, seen


def test_stick_then_slip_on_a_straight_side():
    """Energy eps_t w d^2/2 while it sticks; mu times the normal force when it slips, against the motion."""
    path = np.column_stack([0.5 + np.linspace(0.0, 0.02, 21), np.full(21, 0.99)])
    contact, x, seen = dragged(SQUARE, path, 0.5)
    k = contact.penalty[0] * contact.slave_weight[0]
    for point, state in zip(path, seen, strict=True):
        moved = point[0] - 0.5
        spring = min(moved, 0.5 * 0.01)
        np.testing.assert_allclose(state.tangential[0], [-k * spring, 0.0], rtol=1e-10, atol=1e-6)
        assert state.stick[0] == pytest.approx(0.5 * k * spring**2, rel=1e-10, abs=1e-6)
        assert state.force[0, 1] == pytest.approx(k * 0.01, rel=1e-12)
    assert seen[-1].anchor_at[0] == pytest.approx(0.5 - 0.015, abs=1e-12)  # segment 2 runs from right to left


def test_turning_back_unloads_the_spring():
    there = np.linspace(0.0, 0.02, 21)
    path = np.column_stack([0.5 + np.concatenate([there, there[::-1]]), np.full(42, 0.99)])
    contact, _, seen = dragged(SQUARE, path, 0.5)
    limit = 0.5 * 0.01 * contact.penalty[0] * contact.slave_weight[0]
    np.testing.assert_allclose(
        [seen[20].tangential[0, 0], seen[-1].tangential[0, 0]], [-limit, limit], rtol=1e-9
    )


@pytest.mark.parametrize("step", [0.003, 0.05, 0.4])
def test_sliding_over_many_segments_drags_the_anchor_along(step):
    """A chord of a circle of 120 lines: Coulomb's force at every place, whatever the distance a step."""
    angle = np.linspace(0.0, 2.0 * np.pi, 121)[:-1]
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    at = np.arange(0.1, 5.0, step)
    path = 0.97 * np.column_stack([np.cos(at), np.sin(at)])
    contact, x, seen = dragged(circle, path, 0.3)
    for state, a in zip(
        seen[1:] if step > 0.01 else seen[5:], at[1:] if step > 0.01 else at[5:], strict=True
    ):
        normal_force = contact.penalty[0] * contact.slave_weight[0] * state.gap[0]
        assert np.hypot(*state.tangential[0]) == pytest.approx(0.3 * normal_force, rel=1e-9)
        along = state.tangential[0] @ [-np.sin(a), np.cos(a)]
        assert along == pytest.approx(-0.3 * normal_force, rel=2e-3)  # the chord is 0.009 long, a line 0.052
        assert abs(state.force.sum(axis=0)).max() < 1e-12 * np.abs(state.force).sum()


def test_the_energy_has_no_jump_over_vertices():
    """Stuck, dragged under the notch: energy is continuous and the work of the force, vertex and all."""
    path = np.column_stack([np.linspace(0.8, 1.2, 4001), np.full(4001, 0.42)])
    contact, x, seen = dragged(NOTCH, path, STUCK)
    energy = np.array([contact_energy(contact, state.gap) + state.stick[0] for state in seen])
    fx = np.array([state.force[0, 0] for state in seen])
    work = -np.cumsum(0.5 * (fx[1:] + fx[:-1]) * np.diff(path[:, 0]))
    # The trapezium errs at the two places where the normal turns, by a force jump times half a step each.
    np.testing.assert_allclose(energy[1:] - energy[0], work, atol=1e-3 * np.ptp(energy))


def test_forces_turn_with_the_bodies():
    """Objective: a rotation of everything rotates the forces and leaves the energy."""
    rng = np.random.default_rng(5)
    contact, x = quad_contact(rng)
    contact, u = rubbing(contact, 0.4), 0.05 * rng.uniform(-1, 1, x.shape)
    slid = 0.1 * rng.uniform(-1, 1, x.shape)
    plain, turned = state_of(contact, x), state_of(contact, x)
    for displaced, angle in ((u, 0.7), (u + slid, 2.1)):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        a = evaluate(contact, x, plain, displaced)
        b = evaluate(contact, x, turned, (x + displaced) @ turn.T - x)
        assert a == pytest.approx(b, rel=1e-11)
        scale = np.abs(plain.force).max()
        np.testing.assert_allclose(turned.force, plain.force @ turn.T, atol=1e-11 * scale)


def twin(contact, x, u, gap, anchor, anchor_at):
    """Friction of points on ONE segment's straight line each, in plain NumPy: forces and spring energy."""
    force, energy, y = np.zeros_like(x), 0.0, x + u
    segments = np.arange(len(contact.following))
    ends = segment_ends(contact, 0, len(segments), x, u)
    for g in np.flatnonzero(gap > 0.0):
        p = contact.slave_shape[g] @ y[contact.slave_nodes[g]]
        _, s, t = nearest_segment(ends, segments, 0, len(segments), *p)
        depth, nx, ny, t = depth_at(contact, s, t, *p, x, u)

        def carriers(s, t):
            return contact.master_nodes[s], (1 - t) * contact.start_shape[s] + t * contact.end_shape[s]

        c = p + depth * np.array([nx, ny])
        nodes, share = carriers(anchor[g], anchor_at[g])
        q = share @ y[nodes]
        k = contact.tangential_penalty[0] * contact.slave_weight[g]
        np.add.at(force, contact.slave_nodes[g], np.outer(contact.slave_shape[g], k * (q - c)))
        np.add.at(force, nodes, np.outer(share, k * (p - q)))
        nodes, share = carriers(s, t)
        np.add.at(force, nodes, np.outer(share, k * (c - p)))
        energy += 0.5 * k * (np.sum((p - q) ** 2) - np.sum((p - c) ** 2))
    return force, energy


@pytest.mark.twin("friction.stick_or_slip", "friction.add_friction_forces", "friction.friction_power")
@pytest.mark.parametrize("seed", range(3))
def test_twin_in_numpy(seed):
    rng = np.random.default_rng(seed)
    contact, x = quad_contact(rng)
    contact, state = rubbing(contact, 0.5, 0.7), state_of(contact, x)
    for _ in range(3):
        evaluate(contact, x, state, 0.06 * rng.uniform(-1, 1, x.shape))
        force, energy = twin(contact, x, state.u, state.gap, state.anchor, state.anchor_at)
        np.testing.assert_allclose(state.friction_force, force, atol=1e-13 * np.abs(state.force).max())
        # Of the energies whose difference the spring's is.
        assert state.stick[0] == pytest.approx(energy, abs=1e-13 * contact_energy(contact, state.gap))
        v = rng.normal(size=x.shape)
        power = state.friction_force * v
        assert friction_power(state.friction_force, v) == pytest.approx(
            power.sum(), abs=1e-13 * np.abs(power).sum()
        )
        limit = 0.5 * contact.penalty[0] * contact.slave_weight * np.maximum(state.gap, 0.0)
        assert np.all(np.hypot(*state.tangential.T) <= limit * (1.0 + 1e-9) + 1e-3)


def test_an_open_point_lets_its_anchor_go():
    path = np.array([[0.5, 0.99], [0.505, 0.99], [0.505, 1.01], [0.6, 0.99]])
    _, _, seen = dragged(SQUARE, path, STUCK)
    assert seen[1].tangential[0, 0] < 0.0
    assert seen[2].anchor[0] == -1 and not seen[2].tangential.any() and seen[2].stick[0] == 0.0
    assert seen[3].stick[0] == pytest.approx(0.0, abs=1e-20)


def test_an_anchor_on_another_surface_is_let_go():
    """Two masters that are not linked: a point that jumps from one to the other starts anew there."""
    contact, x = point_contact([[0.5, 0.99]], SQUARE, 0.1)
    contact = rubbing(contact, STUCK)._replace(previous=np.full(4, -1), following=np.full(4, -1))
    state = state_of(contact, x)
    evaluate(contact, x, state, np.zeros_like(x))
    u = np.zeros_like(x)
    u[0] = [0.49, -0.5]
    evaluate(contact, x, state, u)
    assert state.anchor[0] == 1 and not state.tangential.any()


YOUNG, NU, RHO, G = 1e7, 0.3, 1000.0, 10.0


def block_on_a_rigid_plane(friction, incline, length=6.0, n=8):
    """A block of 2 m x 0.25 m on a plane of two massless held nodes; gravity is turned instead of the plane.

    Nothing damps it, so it must not be set to rattle: it starts as deep as it rests, it is flat, so that the
    moment of the friction is small, and the penalty is soft, so that it is nearly rigid on its springs.
    """
    h = 0.25
    x, quads = grid(n, 1, h)
    penalty = 0.05 * YOUNG / h
    x = x - [0.0, RHO * h * G * np.cos(incline) / penalty]
    plane = np.array([[length, 0.0], [-1.0, 0.0]])
    edges = np.array(outline(n, 1)[:n])
    unit, gauss = np.eye(4), 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    shape = (1 - gauss)[None, :, None] * unit[edges[:, 1]][:, None]
    shape = shape + gauss[None, :, None] * unit[edges[:, 2]][:, None]
    a, b = len(x), len(x) + 1
    contact = Contact(
        np.repeat(quads[edges[:, 0]], 2, axis=0), shape.reshape(-1, 4), np.full(2 * n, h / 2),
        np.array([0, 2 * n]), np.array([[a, b, b, b]]), unit[:1], unit[1:2], np.array([-1]), np.array([-1]),
        np.array([0, 1]), np.array([penalty]), np.array([h]), np.zeros(2 * n),
    )  # fmt: skip
    lame, shear = YOUNG * NU / ((1 + NU) * (1 - 2 * NU)), YOUNG / (2 * (1 + NU))
    elements = one_point_elements(quads, x[quads], lame, shear, RHO, 0.1)
    mass = np.bincount(quads.ravel(), np.repeat(0.25 * elements.mass, 4), minlength=b + 1)
    channel = np.full((b + 1, 2), -1, dtype=np.int32)
    channel[[a, b]] = [0, 1]
    cut = fragment_elements(quads[:0], np.zeros(1, int), np.empty((0, 4, 2)), np.empty(0), lame, shear, RHO)
    load = weight(mass, G * np.array([np.sin(incline), -np.cos(incline)]))
    model = Model(np.vstack([x, plane]), mass, load, channel, 2, elements, cut, rubbing(contact, friction))
    return model, Motion(np.zeros_like, np.zeros_like)


def slid(friction, incline, end, **size):
    """Frames of the block over the time, its mean displacement and velocity along the plane."""
    model, motion = block_on_a_rigid_plane(friction, incline, **size)
    dt = stable_step(model, 0.5).dt
    steps = int(end / dt)
    at = np.unique(np.linspace(0, steps, 101).astype(int))
    seen = list(frames(model, np.zeros_like(model.x), dt, at, motion, 0.05))
    share = model.mass / model.mass.sum()
    return model, seen, np.array([[f.time, share @ f.u[:, 0], share @ f.v[:, 0]] for f in seen])


def test_a_block_on_an_incline_sticks_below_the_angle_of_friction():
    mu = 0.4
    _, seen, along = slid(mu, np.arctan(mu) - 0.05, 1.0)
    # Set on at once, a spring overshoots to twice its rest, past what friction bears: it slips first, by the
    # order of the depth of 1e-3 m; then it sticks. Free, or with a little less friction, it would be 0.1 m away.
    late = along[:, 0] > 0.5
    assert np.abs(along[:, 1]).max() < 5e-3
    assert np.ptp(along[late, 1]) < 2e-4
    assert abs(np.polyfit(along[late, 0], along[late, 2], 1)[0]) < 2e-3 * G
    lost = [f.energies.friction for f in seen]
    assert lost[-1] - lost[len(lost) // 2] < 5e-2 * lost[-1]


def test_a_block_on_an_incline_slides_above_the_angle_of_friction():
    mu, incline = 0.4, np.arctan(0.4) + 0.15
    model, seen, along = slid(mu, incline, 2.0)
    late = along[:, 0] > 0.2
    acceleration = np.polyfit(along[late, 0], along[late, 2], 1)[0]
    exact = G * (np.sin(incline) - mu * np.cos(incline))
    assert acceleration == pytest.approx(exact, rel=0.01)
    first, last = seen[0].energies, seen[-1].energies
    lost = (
        (last.external_work - first.external_work)
        - (last.kinetic - first.kinetic)
        - (last.internal + last.hourglass + last.contact - first.internal - first.hourglass - first.contact)
    )
    assert last.friction == pytest.approx(lost, rel=1e-6)
    # Coulomb: mu N times the way, N the weight across the plane; the block rattles as it is set on: 1 %.
    assert last.friction == pytest.approx(mu * 500 * G * np.cos(incline) * along[-1, 1], rel=0.01)
    dissipated = np.array([f.energies.friction for f in seen])
    assert np.all(np.diff(dissipated) > -1e-6 * dissipated[-1])


def test_a_run_goes_on_to_the_bit_with_its_anchors():
    model, motion = block_on_a_rigid_plane(0.3, 0.5)
    dt = stable_step(model).dt
    start = np.zeros_like(model.x)
    whole = list(frames(model, start, dt, [0, 40, 80], motion, 0.05))
    resumed = list(frames(model, start, dt, [0, 40, 80], motion, 0.05, resume=whole[1]))
    for a, b in zip(whole[2].state, resumed[0].state, strict=True):
        np.testing.assert_array_equal(a, b)
    assert whole[2].energies == resumed[0].energies


def test_the_step_is_stable_with_friction():
    """Stuck and slipping, soft and stiff tangential springs: the energy error stays small at the full step."""
    for friction, ratio in ((0.5, 1.0), (2.0, 1.0), (0.5, 10.0)):
        model, motion = block_on_a_rigid_plane(friction, 0.6)
        model = model._replace(contact=rubbing(model.contact, friction, ratio))
        dt = stable_step(model).dt
        *_, last = frames(model, np.zeros_like(model.x), dt, [0, 2000], motion, 0.05)
        assert last.energy_error < 1e-2


def test_without_friction_nothing_is_kept():
    model, _ = block_on_a_rigid_plane(0.0, 0.3)
    state = initial_state(model, np.zeros_like(model.x), prepare_layout(model))
    assert len(state.anchor) == len(state.tangential) == len(state.friction_force) == 0
