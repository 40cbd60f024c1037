"""Every kernel has a NumPy twin; here those of the step, the nearest wall, the anchor, the level set's foot."""

from __future__ import annotations

import ast
import pkgutil
from importlib import import_module
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.registry import CPUDispatcher
from test_contact import NOTCH, SQUARE, point_contact, star
from test_damping_kernels import damped, distorted
from test_elements import twin_forces
from test_explicit import grid, model_of, two_blocks
from test_levelset import chain
from test_self_contact import along_curve, folded
from test_self_contact import twin as twin_contact

from phantomnode import geometry, solver
from phantomnode.geometry.curves import arc_centre
from phantomnode.geometry.levelset import LevelSet
from phantomnode.solver.contact import OPEN, reported
from phantomnode.solver.damping import add_bulk_viscosity, add_hourglass_viscosity, add_viscous_forces
from phantomnode.solver.friction import let_go, slide
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import (
    DONE,
    advance,
    evaluate_contact,
    evaluate_forces,
    find_accelerations,
    find_candidates,
    find_smallest_jacobian,
    initial_state,
    move,
)
from phantomnode.solver.search import build_candidates, nearest_wall, prepare_search


def kernels():
    """All compiled functions of solver and geometry, as module.function."""
    for package in (geometry, solver):
        for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
            for name, value in vars(import_module(module.name)).items():
                if isinstance(value, CPUDispatcher) and value.__module__ == module.name:
                    yield f"{module.name.rpartition('.')[2]}.{name}"


def twinned():
    """What tests say of themselves: ``@pytest.mark.twin("module.function", ...)``."""
    for file in Path(__file__).parent.glob("test_*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            for mark in getattr(node, "decorator_list", []):
                if ast.unparse(mark).startswith("pytest.mark.twin("):
                    yield from map(ast.literal_eval, mark.args)


@pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="without the compiler no kernel is told from a function"
)
def test_every_kernel_is_compared_with_numpy():
    """Directly, or through the function that does nothing else: the test says so by its mark."""
    assert set(kernels()) == set(twinned())


@pytest.mark.twin(
    "leapfrog.move",
    "leapfrog.react",
    "leapfrog.values_at",
    "leapfrog.prescribe",
    "motion.move_nodes",
    "motion.move_range",
    "motion.add_load",
)
def test_motion_agrees_with_numpy():
    """Velocity, displacement, reactions, impulses and works of one step; nodes free and prescribed."""
    rng = np.random.default_rng(7)
    x, quads = grid(3, 2, 0.1)
    channel = np.full(x.shape, -1)
    channel[:3, 0], channel[2:5, 1] = 0, 1
    model = model_of(x, quads, channel=channel, load=(3.0, -9.0))
    layout = prepare_layout(model)
    state = initial_state(model, rng.normal(size=x.shape), layout)
    extra = {name: rng.normal(size=2) for name in ("held", "rate", "support", "support_impulse")}
    state = state._replace(
        friction_force=rng.normal(size=x.shape), slip=np.ones(1), value=rng.normal(size=2),
        applied=rng.normal(size=(2, 2)), load_impulse=rng.normal(size=(2, 2)), pair_peak=np.ones(1),
        pair_force=rng.normal(size=(1, 2)), pair_impulse=rng.normal(size=(1, 2)), external=np.ones(1), **extra,
    )  # fmt: skip
    state.u[:], state.a[:], state.force[:] = rng.normal(size=(3, *x.shape))
    old = {name: np.copy(value) for name, value in state._asdict().items()}
    kick, dt, increment = 0.3, 0.4, rng.normal(size=2)
    move(model, layout, state, kick, dt, increment)

    held, rate = channel >= 0, increment / dt
    v = np.where(held, rate[channel], old["v"] + kick * old["force"] / model.mass[:, None])
    a = (v - old["v"]) / kick
    reaction = np.where(held, model.mass[:, None] * a - old["force"], 0.0)
    mean = 0.5 * (old["v"] + v)
    work = np.sum(reaction * mean) + np.sum(old["support"] * 0.5 * (old["rate"] + rate))
    expected = {
        "v": v,
        "u": old["u"] + np.where(held, increment[channel], dt * v),
        "a": np.where(held, a, old["a"]),
        "force": model.load,
        "reaction": [reaction[channel == c].sum() for c in (0, 1)],
        "external": old["external"] + kick * work,
        "slip": old["slip"] + kick * np.sum(old["friction_force"] * mean),
        "held": old["held"] + increment,
        "rate": rate,
        "support_impulse": old["support_impulse"] + kick * old["support"],
        "load_impulse": old["load_impulse"] + kick * old["applied"],
        "pair_impulse": old["pair_impulse"] + kick * old["pair_force"],
    }
    for name, value in (old | expected).items():
        scale = np.abs(value).max(initial=1.0)
        np.testing.assert_allclose(getattr(state, name), value, atol=1e-13 * scale, rtol=0, err_msg=name)


@pytest.mark.twin(
    "leapfrog.evaluate_elements", "leapfrog.evaluate_contact",
    "leapfrog.find_accelerations", "leapfrog.find_smallest_jacobian", "motion.reset",
)  # fmt: skip
def test_forces_and_accelerations_of_a_step_agree_with_numpy():
    """Two blocks that overlap: load, elements and contact add up; accelerations where free, peak of the pair."""
    rng = np.random.default_rng(9)
    model, velocity, above = two_blocks()
    channel = np.full(velocity.shape, -1, dtype=np.int32)
    channel[:2, 1] = 0
    load = np.asfortranarray(rng.normal(size=velocity.shape))
    model = model._replace(channel=channel, channels=1, load=load)
    layout = prepare_layout(model)
    state = initial_state(model, velocity, layout)
    state.u[above] -= [0.0, 0.02]
    state.u[:] += 1e-3 * rng.uniform(-1, 1, velocity.shape)
    before = state.a.copy()
    assert evaluate_forces(model, layout, state) == DONE
    candidates = find_candidates(model.contact, layout.search, model.x, state)
    evaluate_contact(model.contact, candidates, model.x, state)
    find_accelerations(channel, layout.inverse_mass, state.force, state.a)
    inner, contact = twin_forces(model.elements, state.u), twin_contact(model.contact, model.x + state.u)[0]
    expected, scale = load + inner + contact, max(np.abs(inner).max(), np.abs(contact).max())
    assert np.abs(contact).max() > 0.0
    assert np.abs(state.force - expected).max() < 1e-13 * scale
    np.testing.assert_allclose(
        state.a, np.where(channel < 0, state.force / model.mass[:, None], before), rtol=1e-13
    )
    assert state.pair_peak[0] == pytest.approx(np.hypot(*contact[above].sum(axis=0)), abs=1e-13 * scale)
    e = model.elements
    smallest = find_smallest_jacobian(e, model.full, model.cut_elements, state.u)
    f = np.eye(2) + np.einsum("mia,mib->mab", state.u[e.nodes], e.gradient)
    assert smallest == pytest.approx(np.linalg.det(f).min(), rel=1e-13)


@pytest.mark.twin("leapfrog.advance")
def test_a_run_agrees_with_numpy():
    """Central differences written out once more: two blocks that hit each other, one of them pushed."""
    model, v, above = two_blocks()
    channel = np.full(v.shape, -1, dtype=np.int32)
    channel[:2, 1] = 0
    model = model._replace(channel=channel, channels=1)
    layout, dt, steps = prepare_layout(model), 2e-6, 12
    state = initial_state(model, v, layout)
    state.u[above] -= [0.0, 0.004]
    x, u, impulse, peak = model.x, state.u.copy(), 0.0, 0.0
    increments = 1e-5 * np.random.default_rng(8).uniform(0, 1, (steps, 1))

    def forces(u):
        contact = twin_contact(model.contact, x + u)[0]
        return twin_forces(model.elements, u) + contact, contact[above].sum(axis=0)

    assert advance(model, layout, state, dt, np.zeros((0, 1))) == DONE
    assert advance(model, layout, state, dt, increments) == DONE
    force, on_slave = forces(u)
    for step, (push,) in enumerate(increments):
        kick = dt if step else 0.5 * dt
        impulse = impulse + kick * on_slave
        v = np.where(channel < 0, v + kick * force / model.mass[:, None], push / dt)
        u = u + dt * v
        force, on_slave = forces(u)
        peak = max(peak, np.hypot(*on_slave))
    assert state.clock.tolist() == [steps * dt, steps] and peak > 0.0
    # Of the largest value each; a force has the rounding of the displacements times the stiffness.
    for name, expected in (("u", u), ("v", v), ("force", force), ("pair_impulse", impulse[None])):
        np.testing.assert_allclose(
            getattr(state, name), expected, rtol=0, atol=1e-13 * np.abs(expected).max(), err_msg=name
        )
    assert state.pair_peak[0] == pytest.approx(peak, rel=1e-13)


@pytest.mark.twin("leapfrog.find_candidates")
def test_what_is_found_anew_is_open_until_its_forces_are_known():
    model, velocity, _ = two_blocks()
    layout = prepare_layout(model)
    state = initial_state(model, velocity, layout)
    state.gap[:] = 1.0
    found = find_candidates(model.contact, layout.search, model.x, state)
    expected = build_candidates(model.contact, layout.search, model.x, state.u)
    count = expected.near_first[-1]
    assert found.near_first.tolist() == expected.near_first.tolist() and count > 0
    for name, used in (("near", count), ("first", count + 1), ("segments", expected.first[count])):
        assert np.array_equal(getattr(found, name)[:used], getattr(expected, name)[:used])
    assert np.all(state.gap == OPEN)


@pytest.mark.twin("search.nearest_wall")
@pytest.mark.parametrize("seed", range(10))
def test_nearest_wall_agrees_with_numpy(seed):
    contact, x, u = folded(np.random.default_rng(seed), rough=0.04)
    y, walls = x + u, []
    a, b = y[contact.master_nodes[:, 0]], y[contact.master_nodes[:, 1]]
    d = b - a
    for g in range(len(contact.slave_weight)):
        p = contact.slave_shape[g] @ y[contact.slave_nodes[g]]
        t = np.clip(np.sum((p - a) * d, axis=1) / np.sum(d * d, axis=1), 0.0, 1.0)
        distance = np.hypot(*(p - a - t[:, None] * d).T)
        away = (a - p)[:, 0] * d[:, 1] - (a - p)[:, 1] * d[:, 0] > 0.0
        centre = np.array([along_curve(contact, s, 0.5, g) for s in range(len(a))])
        own = centre + contact.master_place[:, 2] < contact.exclusion[0]
        walls.append(distance[away & ~own & (distance < contact.reach[0])].min(initial=np.inf))
    assert nearest_wall(contact, 0, y) == pytest.approx(min(walls), rel=1e-13)


def crossings(c, radius, start, end):
    """Where the way from start to end leaves the circle about c: parameters, by the roots of a quadratic."""
    d = end - start
    roots = np.roots([d @ d, 2.0 * d @ (start - c), (start - c) @ (start - c) - radius**2])
    real = np.real(roots[np.abs(np.imag(roots)) == 0.0])
    return [t for t in real if 0.0 <= t <= 1.0 and d @ (start + t * d - c) > 0.0]


@pytest.mark.twin("friction.slide")
@pytest.mark.parametrize("seed", range(20))
def test_the_dragged_anchor_agrees_with_numpy(seed):
    """Over the vertices of a random polygon: the first place on the way that is as far as the radius."""
    rng = np.random.default_rng(seed)
    polygon = star(16, rng)
    contact, x = point_contact(NOTCH[:1], polygon, 0.3)
    n, moved = len(polygon), 0
    for _ in range(50):
        s, hops, t, at = int(rng.integers(n)), int(rng.integers(-6, 7)), *rng.uniform(0.01, 0.99, 2)
        anchor, radius = (s + hops) % n, rng.uniform(0.02, 0.6)
        forth = hops > 0 or (hops == 0 and at >= t)
        places = [polygon[i] + w * (polygon[(i + 1) % n] - polygon[i]) for i, w in ((s, t), (anchor, at))]
        between = np.arange(s + 1, s + hops + 1) if forth else np.arange(s, s + hops, -1)
        way = np.array([places[0], *polygon[between % n], places[1]])
        expected = places[1]
        if np.hypot(*(places[1] - places[0])) > radius:
            for start, end in zip(way, way[1:], strict=False):
                if found := crossings(places[0], radius, start, end):
                    expected, moved = start + min(found) * (end - start), moved + 1
                    break
        i, w = slide(contact, s, t, anchor, at, radius, x, np.zeros_like(x))
        got = polygon[i] + w * (polygon[(i + 1) % n] - polygon[i])
        assert np.hypot(*(got - expected)) < 1e-13
    assert moved > 15


@pytest.mark.twin("levelset._query", "levelset._foot", "levelset._fraction", "levelset._side")
@pytest.mark.parametrize("bulge", [-2.0, -0.7, -0.1, 0.0, 0.1, 0.7, 2.0])
def test_foot_normal_and_place_on_a_piece_agree_with_numpy(bulge):
    """Points put at a known place of a line or arc, at a known distance to the left."""
    rng = np.random.default_rng(3)
    a, b = np.array([0.2, -0.1]), np.array([1.1, 0.4])
    s, off = rng.uniform(0.02, 0.98, 400), rng.uniform(-0.05, 0.05, 400)
    if bulge == 0.0:
        d = b - a
        foot, normal = a + s[:, None] * d, np.tile([-d[1], d[0]] / np.hypot(*d), (400, 1))
    else:
        centre = arc_centre(a, b, np.asarray(bulge))
        angle = np.arctan2(*(a - centre)[::-1]) + s * 4.0 * np.arctan(bulge)
        outwards = np.column_stack([np.cos(angle), np.sin(angle)])
        foot, normal = centre + np.hypot(*(a - centre)) * outwards, -np.sign(bulge) * outwards
    found = LevelSet.of_curve(chain(a, b, bulges=[bulge])).query(foot + off[:, None] * normal)
    np.testing.assert_allclose(found.distance, off, atol=1e-13)
    np.testing.assert_allclose(found.normal, normal, atol=1e-13)
    np.testing.assert_allclose(found.point, foot, atol=1e-13)
    np.testing.assert_allclose(found.s, s, atol=1e-13)


@pytest.mark.twin("damping.add_viscous_forces")
def test_viscous_forces_are_the_sum_of_both_viscosities():
    """Each has a NumPy twin of its own; here they add up, in the force and in what damping books."""
    model, u, v = distorted()
    model = damped(model, linear=0.06, quadratic=1.2, hourglass=0.05)
    state = initial_state(model, v, prepare_layout(model))
    state.u[:], state.force[:] = u, np.ones_like(u)
    expected = np.zeros_like(u)
    add_bulk_viscosity(model.damping.bulk, u, v, expected)
    add_hourglass_viscosity(model.elements, model.damping.hourglass, v, expected)
    add_viscous_forces(model.damping, model.elements, state.u, state.v, state.viscous, state.force)
    scale = np.abs(expected).max()
    assert scale > 0.0
    np.testing.assert_allclose(state.viscous, expected, atol=1e-13 * scale, rtol=0)
    np.testing.assert_allclose(state.force, 1.0 + expected, atol=1e-13 * scale, rtol=0)


@pytest.mark.twin("friction.let_go")
def test_points_without_candidates_let_go_of_their_anchors():
    """Those that are near keep theirs; what stands behind the last pair in the list is not looked at."""
    contact, x = point_contact([[0.5, 0.98], [0.5, 9.0], [0.4, 0.99], [0.3, 9.0]], SQUARE, 0.1)
    model = model_of(*grid(1, 1, 1.0))
    state = initial_state(model, np.zeros((4, 2)), prepare_layout(model))
    state = state._replace(anchor=np.array([3, 2, 1, 0]), tangential=np.ones((4, 2)))
    candidates = build_candidates(contact, prepare_search(contact), x, np.zeros_like(x))
    let_go(candidates, state)
    near = np.isin(np.arange(4), candidates.near[: candidates.near_first[-1]])
    assert near.tolist() == [True, False, True, False]
    assert state.anchor.tolist() == np.where(near, [3, 2, 1, 0], -1).tolist()
    assert np.array_equal(state.tangential, np.where(near[:, None], np.ones((4, 2)), 0.0))


def contact_of_none():
    return model_of(*grid(1, 1, 1.0)).contact


@pytest.mark.twin("contact.reported")
def test_second_passes_are_reported_with_their_first():
    """Pairs 0 and 1 are the two passes of one pair, 2 stands alone; without two passes each is its own."""
    contact = contact_of_none()
    assert [reported(contact, k) for k in range(3)] == [(0, 1.0), (1, 1.0), (2, 1.0)]
    contact = contact._replace(pair=np.array([0, 0, 1]), sign=np.array([1.0, -1.0, 1.0]))
    assert [reported(contact, k) for k in range(3)] == [(0, 1.0), (0, -1.0), (1, 1.0)]
