"""Damping: decay in closed form, fronts that bulk viscosity spreads, and a balance that counts it."""

from __future__ import annotations

import numpy as np
import pytest
from test_damping_kernels import damped
from test_explicit import LAME, RHO, SHEAR, SPEED, STILL, Motion, grid, held, last_of, model_of

from phantomnode.solver.explicit import frames
from phantomnode.solver.mass_scaling import scale_mass
from phantomnode.solver.model import NO_DAMPING
from phantomnode.solver.stress import element_stress
from phantomnode.solver.timestep import stable_step


def test_free_flight_slows_down_exponentially_with_second_order():
    x, quads = grid(2, 2, 0.1)
    model = damped(model_of(x, quads), mass=300.0)
    v0, errors = np.tile([3.0, -2.0], (len(x), 1)), []
    for dt in (8e-6, 4e-6, 2e-6):
        frame = last_of(frames(model, v0, dt, [round(8e-3 / dt)], STILL, 1e-6))
        exact = v0 * np.exp(-300.0 * frame.time)
        errors.append(np.abs(frame.v - exact).max() / np.abs(exact).max())
        # What is lost and what is left are what was there, to rounding.
        kinetic = 0.5 * np.sum(model.mass[:, None] * v0**2)
        assert frame.energies.kinetic + frame.energies.damping == pytest.approx(kinetic, rel=1e-11)
    slope = np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0]
    assert 1.9 < slope < 2.1 and errors[-1] < 1e-6


def test_an_oscillation_decays_with_half_of_alpha():
    """The dilation of one square: u'' + alpha u' + w^2 u = 0, so that peaks fall with exp(-alpha t/2)."""
    x, quads = grid(1, 1, 1.0)
    model = model_of(x, quads)
    omega = np.sqrt(8 * (LAME + SHEAR) / RHO)
    alpha = 0.05 * omega
    model, mode = damped(model, mass=alpha), x - 0.5
    dt = 0.01 / omega
    stream = frames(model, 1e-4 * mode, dt, range(1, 12000, 4), STILL, 0.01)
    t, a = np.array([(f.time, np.sum(f.u * mode)) for f in stream]).T
    # Free of its oscillation: the envelope sqrt(u^2 + ((u' + alpha u/2)/w')^2) at the extrema of |u|.
    peaks = np.flatnonzero((np.abs(a[1:-1]) > np.abs(a[:-2])) & (np.abs(a[1:-1]) >= np.abs(a[2:]))) + 1
    rate = -np.polyfit(t[peaks], np.log(np.abs(a[peaks])), 1)[0]
    # Samples every 0.04/w miss a peak by up to 2e-4 of it, over 19 time constants; the strain of 1e-4 / w.
    assert len(peaks) > 30 and rate == pytest.approx(0.5 * alpha, rel=1e-3)


def piston(n, **damping):
    """A bar, sides held, whose left end moves at 20 m/s from the start on; stress over x when the front is at 0.6."""
    h = 1.0 / n
    x, quads = grid(n, 1, h)
    channel = np.full(x.shape, -1)
    channel[:, 1], channel[x[:, 0] == 0.0, 0] = 0, 1
    model = damped(model_of(x, quads, channel=channel), **damping)
    dt = stable_step(model, speed=20.0).dt
    motion = Motion(lambda t: 0.0 * t, lambda t: 20.0 * t)
    steps = round(0.6 / SPEED / dt)
    frame = last_of(frames(model, np.zeros_like(x), dt, [steps], motion, 1e-2))
    return model, frame, element_stress(model.elements, frame.u)[0][:, 0] / (RHO * SPEED * 20.0)


def test_bulk_viscosity_spreads_the_front_and_calms_what_follows():
    """Behind the front the stress is rho c V (plus 1.6 % by finite strain); without viscosity it rings."""
    n = 100
    _, plain, ringing = piston(n)
    _, frame, calm = piston(n, linear=0.06, quadratic=1.2)
    behind = slice(5, 45)
    plateau = -np.mean(calm[behind])
    assert plateau == pytest.approx(1.0, abs=0.03)
    overshoot = [-stress.min() - plateau for stress in (ringing, calm)]
    assert overshoot[0] > 0.25 and overshoot[1] < 0.5 * overshoot[0]
    spread = [np.std(stress[behind]) for stress in (ringing, calm)]
    assert spread[1] < 0.2 * spread[0]
    # The front stays within some cells all the same.
    front = [np.flatnonzero(-stress > level * plateau).max() for stress in (calm,) for level in (0.1, 0.9)]
    assert 1 <= front[0] - front[1] <= 12
    assert frame.energies.damping > 0.0 == plain.energies.damping
    assert frame.energy_error < 1e-3 and plain.energy_error < 1e-2


def hourglass_only(viscosity, kappa=0.0):
    x, quads = grid(1, 1, 1.0)
    model = damped(model_of(x, quads, kappa=kappa), hourglass=viscosity)
    return model, np.outer([1.0, -1.0, -1.0, 1.0], [1.0, 0.5])


def test_viscous_hourglass_control_damps_the_mode_and_books_it():
    """Without stiffness the mode slows down at 16 c/m, c = e rho c_d h/4: exp(-4 e c_d t/h)."""
    model, mode = hourglass_only(0.05)
    rate = 4.0 * 0.05 * SPEED
    dt = 1e-3 / rate
    v0 = 1e-3 * mode
    frame = last_of(frames(model, v0, dt, [1000], STILL, 1e-2))
    # Forces half a step behind: first order in rate dt.
    np.testing.assert_allclose(frame.v, v0 * np.exp(-rate * frame.time), rtol=2e-3)
    kinetic = 0.5 * np.sum(model.mass[:, None] * v0**2)
    assert frame.energies.kinetic + frame.energies.damping == pytest.approx(kinetic, rel=1e-9)
    assert frame.energies.hourglass == 0.0


@pytest.mark.parametrize(
    "damping",
    [{"mass": 500.0}, {"linear": 0.3, "quadratic": 1.2}, {"hourglass": 0.2}, {"mass": 500.0, "linear": 0.1}],
)
def test_the_balance_counts_what_damping_takes(damping):
    """A block between a clamped base and a moving top, driven hard; and a run in two pieces gives the same bits."""
    x, quads = grid(4, 4, 0.25)
    model = damped(model_of(x, quads, channel=held(x, (0.0, 1.0))), **damping)
    motion = Motion(
        *[lambda t: 0.0 * t] * 2,
        lambda t: 0.03 * np.sin(900 * t) ** 2,
        lambda t: -0.05 * np.sin(600 * t) ** 2,
    )
    dt = 0.25 * stable_step(model, speed=60.0).dt
    history = list(frames(model, np.zeros_like(x), dt, range(0, round(4e-3 / dt), 10), motion, 0.1))
    assert max(frame.energy_error for frame in history) < 1e-3
    lost = np.array([frame.energies.damping for frame in history])
    assert lost[-1] > 1e-4 * max(frame.energies.internal for frame in history)
    if "mass" in damping:
        assert np.all(np.diff(lost) >= 0.0)
    middle = history[len(history) // 2]
    again = last_of(frames(model, np.zeros_like(x), dt, [history[-1].step], motion, 0.1, middle))
    np.testing.assert_array_equal(again.u, history[-1].u)
    assert again.energies == history[-1].energies


@pytest.mark.parametrize(
    "damping", [{"linear": 0.5}, {"hourglass": 0.3}, {"linear": 0.06, "hourglass": 0.05}]
)
def test_viscosity_shortens_the_stable_step_as_estimated(damping):
    """M - dt/2 C - dt^2/4 K: at the estimate a run is stable, at twice the estimate it is not."""
    x, quads = grid(6, 6, 0.1)
    model = damped(model_of(x, quads), **damping)
    estimate, bare = stable_step(model, 1.0), stable_step(model._replace(damping=NO_DAMPING), 1.0)
    assert estimate.dt < bare.dt and estimate.xi > 0.0 == bare.xi
    w = np.hypot(estimate.element_frequency, estimate.contact_frequency)
    assert estimate.dt == pytest.approx(2.0 / w * (np.sqrt(1.0 + estimate.xi**2) - estimate.xi), rel=1e-12)
    v0 = 1e-6 * np.random.default_rng(2).uniform(-1, 1, x.shape)
    safe = last_of(frames(model, v0, 0.999 * estimate.dt, [2000], STILL, 0.2))
    assert np.abs(safe.v).max() < 2.0 * np.abs(v0).max()
    broken = False
    try:
        wild = last_of(frames(model, v0, 2.0 * estimate.dt, [500], STILL, 1e9))
        broken = not np.abs(wild.v).max() < 1e3 * np.abs(v0).max()
    except RuntimeError:
        broken = True
    assert broken


def test_quadratic_viscosity_counts_with_the_speed():
    x, quads = grid(3, 3, 0.1)
    model = damped(model_of(x, quads), quadratic=1.2)
    steps = [stable_step(model, speed=speed).dt for speed in (0.0, 10.0, 100.0)]
    assert steps[0] > steps[1] > steps[2]
    assert steps[0] == stable_step(model._replace(damping=NO_DAMPING)).dt


def test_mass_scaling_reaches_the_step_and_adds_mass_where_it_must():
    x, quads = grid(8, 4, 0.1)
    x[:, 0] = np.where(x[:, 0] > 0.55, 0.6 + 0.3 * (x[:, 0] - 0.6), x[:, 0])  # narrow columns on the right
    model = damped(model_of(x, quads, load=(0.0, -9.81)), linear=0.06)
    before = stable_step(model, 1.0)
    target = 1.8 * before.dt
    scaled = scale_mass(model, target)
    assert stable_step(scaled, 1.0).dt == pytest.approx(target, rel=1e-9)
    more = scaled.elements.mass / model.elements.mass
    wide = np.ptp(x[quads][..., 0], axis=1) > 0.09
    assert np.all(more[wide] == 1.0) and np.all(more[~wide] > 1.0)
    assert scaled.mass.sum() == pytest.approx(scaled.elements.mass.sum(), rel=1e-14)
    np.testing.assert_array_equal(scaled.load, model.load)
    v0 = 1e-6 * np.random.default_rng(2).uniform(-1, 1, x.shape)
    weightless = scaled._replace(load=0.0 * scaled.load)
    frame = last_of(frames(weightless, v0, 0.99 * target, [2000], STILL, 0.5))
    assert np.abs(frame.v).max() < 2e-6
    np.testing.assert_array_equal(scale_mass(model, 0.5 * before.dt).mass, model.mass)
