"""Kernels of damping against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from test_explicit import RHO, SPEED, grid, model_of

from phantomnode.solver.damping import (
    add_bulk_viscosity,
    add_hourglass_viscosity,
    bulk_points,
    damp,
    hourglass_viscosity,
)
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import initial_state
from phantomnode.solver.model import NO_DAMPING, CutElements
from phantomnode.solver.q4 import as_points


def damped(model, mass=0.0, linear=0.0, quadratic=0.0, hourglass=0.0):
    damping = NO_DAMPING._replace(mass=mass)
    e = model.elements
    if linear or quadratic:
        damping = damping._replace(bulk=bulk_points(as_points(e), np.sqrt(e.volume), linear, quadratic))
    if hourglass:
        damping = damping._replace(hourglass=hourglass_viscosity(e, hourglass))
    return model._replace(damping=damping)


def distorted(seed=0):
    x, quads = grid(5, 4, 0.2)
    rng = np.random.default_rng(seed)
    x = x + 0.03 * rng.uniform(-1, 1, x.shape)
    return model_of(x, quads), 0.03 * rng.uniform(-1, 1, x.shape), 10.0 * rng.uniform(-1, 1, x.shape)


@pytest.mark.twin("damping.add_bulk_viscosity")
def test_bulk_viscosity_agrees_with_its_numpy_twin():
    model, u, v = distorted()
    model = damped(model, linear=0.06, quadratic=1.2)
    e = model.elements
    f = np.eye(2) + np.einsum("mia,mib->mab", u[e.nodes], e.gradient)
    rate = np.einsum("mia,mib->mab", v[e.nodes], e.gradient)
    j = np.linalg.det(f)
    cofactor = j[:, None, None] * np.linalg.inv(f).transpose(0, 2, 1)
    falling = np.maximum(-np.einsum("mab,mab->m", cofactor, rate), 0.0)
    assert 3 < np.count_nonzero(falling) < len(j) - 3
    length = np.sqrt(e.volume)
    q = RHO * length * falling * (0.06 * SPEED + 1.44 * length * falling)
    expected = np.zeros_like(u)
    np.add.at(expected, e.nodes, np.einsum("m,mab,mib->mia", e.volume * q, cofactor, e.gradient))
    force = np.zeros_like(u)
    add_bulk_viscosity(model.damping.bulk, u, v, force)
    assert np.abs(force - expected).max() < 1e-13 * np.abs(expected).max()
    assert np.sum(force * v) < 0.0  # it takes energy


def test_bulk_viscosity_of_cut_elements_agrees_with_its_numpy_twin():
    """Elements of three and of four points, of two lengths."""
    rng = np.random.default_rng(8)
    nodes, first = np.array([[0, 1, 2, 3], [1, 4, 5, 2]]), np.array([0, 3, 7])
    owner, weight, gradient = np.repeat([0, 1], [3, 4]), rng.uniform(1, 2, 7), rng.normal(size=(7, 4, 2))
    cut = CutElements(nodes, first, gradient, weight, *(rng.uniform(1, 2, 2) for _ in range(3)))
    bulk = bulk_points(cut, np.array([0.5, 0.7]), 0.1, 2.0)
    u, v = 0.05 * rng.normal(size=(6, 2)), rng.normal(size=(6, 2))
    rho = cut.mass / np.array([weight[:3].sum(), weight[3:].sum()])
    speed, length = np.sqrt((cut.lame + 2 * cut.shear) / rho), np.array([0.5, 0.7])
    f = np.eye(2) + np.einsum("pia,pib->pab", u[nodes[owner]], gradient)
    cofactor = np.linalg.det(f)[:, None, None] * np.linalg.inv(f).transpose(0, 2, 1)
    rate = np.maximum(-np.einsum("pab,pia,pib->p", cofactor, v[nodes[owner]], gradient), 0.0)
    q = (rho * length)[owner] * rate * (0.1 * speed[owner] + 4.0 * length[owner] * rate)
    expected, force = np.zeros_like(u), np.zeros_like(u)
    np.add.at(expected, nodes[owner], np.einsum("p,pab,pib->pia", weight * q, cofactor, gradient))
    add_bulk_viscosity(bulk, u, v, force)
    assert 0 < np.count_nonzero(rate) < 7
    assert np.abs(force - expected).max() < 1e-13 * np.abs(expected).max()


@pytest.mark.twin("damping.add_hourglass_viscosity")
def test_hourglass_viscosity_agrees_with_its_numpy_twin():
    model, _, v = distorted()
    e = model.elements
    viscosity = hourglass_viscosity(e, 0.05)
    b = e.gradient * e.volume[:, None, None]
    np.testing.assert_allclose(
        viscosity, 0.05 * RHO * SPEED * np.sqrt(2 * np.einsum("mia,mia->m", b, b)) / 8, rtol=1e-13
    )
    mode = np.einsum("mi,mia->ma", e.gamma, v[e.nodes])
    expected = np.zeros_like(v)
    np.subtract.at(expected, e.nodes, np.einsum("m,mi,ma->mia", viscosity, e.gamma, mode))
    force = np.zeros_like(v)
    add_hourglass_viscosity(e, viscosity, v, force)
    assert np.abs(force - expected).max() < 1e-13 * np.abs(expected).max()
    np.testing.assert_allclose(hourglass_viscosity(one_square(), 1.0), RHO * SPEED * 0.3 / 4, rtol=1e-14)


def one_square():
    x, quads = grid(1, 1, 0.3)
    return model_of(x, quads).elements


@pytest.mark.twin("damping.damp")
def test_mass_damping_agrees_with_its_numpy_twin():
    model, u, v = distorted()
    channel = np.full(u.shape, -1, dtype=np.int32)
    channel[:4, 0] = 0
    model = damped(model._replace(channel=channel, channels=1), mass=700.0, linear=0.06, hourglass=0.05)
    state = initial_state(model, v, prepare_layout(model))
    state.u[:] = u
    rng = np.random.default_rng(5)
    state.force[:], state.viscous[:] = rng.normal(size=u.shape), rng.normal(size=u.shape)
    before, m, kick, dt, increment = state.force.copy(), model.mass[:, None], 3e-5, 3e-5, 1e-4
    free = channel < 0
    after = (v * (1.0 - 350.0 * kick) + kick * before / m) / (1.0 + 350.0 * kick)
    mean = np.where(free, 0.5 * (v + after), 0.5 * (v + increment / dt))
    drag = -700.0 * m * mean
    damp(700.0, model.mass, channel, state, kick, dt, np.array([increment]))
    np.testing.assert_allclose(state.force, before + drag, rtol=1e-13)
    np.testing.assert_allclose((v + kick * state.force / m)[free], after[free], rtol=1e-12)
    lost = -kick * np.sum((drag + state.viscous) * mean)
    assert state.dissipated[0] == pytest.approx(lost, rel=1e-13)


def test_bulk_viscosity_needs_compression():
    x, quads = grid(3, 3, 0.1)
    model = damped(model_of(x, quads), linear=0.06, quadratic=1.2)
    force = np.zeros_like(x)
    add_bulk_viscosity(model.damping.bulk, 0.0 * x, 5.0 * x, force)
    assert not force.any()
    turn = np.column_stack([-x[:, 1], x[:, 0]])  # a spin, and a shear that keeps the volume
    for v in (turn, np.column_stack([x[:, 1], 0.0 * x[:, 0]])):
        add_bulk_viscosity(model.damping.bulk, 0.0 * x, v, force)
    assert np.abs(force).max() < 1e-9  # rounding of rates of 1
