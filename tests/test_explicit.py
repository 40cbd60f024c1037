"""The explicit run: conservation, order of the energy error, reactions and work, guards, resuming."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from phantomnode.pipeline.elements import weight
from phantomnode.solver import explicit
from phantomnode.solver.cut_elements import fragment_elements
from phantomnode.solver.explicit import RunStopped, frames
from phantomnode.solver.model import Contact, Model
from phantomnode.solver.q4 import one_point_elements
from phantomnode.solver.stress import element_stress
from phantomnode.solver.timestep import stable_step

YOUNG, NU, RHO = 1e10, 0.3, 7800.0
LAME = YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
SHEAR = YOUNG / (2 * (1 + NU))
SPEED = np.sqrt((LAME + 2 * SHEAR) / RHO)
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)


class Motion:
    """Prescribed displacements as functions of time."""

    def __init__(self, *functions):
        self.functions = functions

    def increments(self, first_step, steps, dt):
        t = np.arange(first_step, first_step + steps + 1) * dt
        columns = [np.diff(f(t)) for f in self.functions]
        return np.column_stack(columns) if columns else np.zeros((steps, 0))


STILL = Motion()


def grid(columns, rows, h, low=(0.0, 0.0)):
    x = np.array([(i, j) for j in range(rows + 1) for i in range(columns + 1)], dtype=float) * h + low
    first = np.array([j * (columns + 1) + i for j in range(rows) for i in range(columns)])
    return x, first[:, None] + np.array([0, 1, columns + 2, columns + 1])


def outline(columns, rows, first=0):
    """Element and corners of every boundary edge, counter-clockwise."""
    bottom = [(first + c, 0, 1) for c in range(columns)]
    right = [(first + (r + 1) * columns - 1, 1, 2) for r in range(rows)]
    top = [(first + (rows - 1) * columns + c, 2, 3) for c in reversed(range(columns))]
    left = [(first + r * columns, 3, 0) for r in reversed(range(rows))]
    return bottom + right + top + left


def surface_contact(x, quads, slave, master, penalty, reach):
    """Contact between two closed outlines (none where both are empty)."""
    unit = np.eye(4)
    edges = np.array(slave, dtype=int).reshape(-1, 3)
    parents, a, b = edges.T
    length = np.hypot(*(x[quads[parents, b]] - x[quads[parents, a]]).T)
    shape = (1 - GAUSS)[None, :, None] * unit[a][:, None] + GAUSS[None, :, None] * unit[b][:, None]
    master = np.array(master, dtype=int).reshape(-1, 3)
    s, g = len(master), 2 * len(edges)
    pairs = 1 if s else 0
    return Contact(
        np.repeat(quads[parents], 2, axis=0), shape.reshape(g, 4), np.repeat(length / 2, 2),
        np.array([0, g])[: pairs + 1], quads[master[:, 0]], unit[master[:, 1]], unit[master[:, 2]],
        np.roll(np.arange(s), 1), np.roll(np.arange(s), -1), np.array([0, s])[: pairs + 1],
        np.full(pairs, penalty), np.full(pairs, reach), np.zeros(g),
    )  # fmt: skip


def model_of(x, quads, contact=None, channel=None, load=(0.0, 0.0), kappa=0.1):
    elements = one_point_elements(quads, x[quads], LAME, SHEAR, RHO, kappa)
    cut = fragment_elements(quads[:0], np.zeros(1, int), np.empty((0, 4, 2)), np.empty(0), LAME, SHEAR, RHO)
    mass = np.bincount(quads.ravel(), weights=np.repeat(0.25 * elements.mass, 4), minlength=len(x))
    channel = np.asarray(np.full(x.shape, -1) if channel is None else channel, dtype=np.int32)
    if contact is None:
        contact = surface_contact(x, quads, [], [], 0.0, 1.0)
    return Model(
        x, mass, weight(mass, np.array(load)), channel, int(channel.max()) + 1, elements, cut, contact
    )


def two_blocks(n=4, gap=2e-3, speed=20.0, penalty=10 * YOUNG):
    """A block falls on a wider one, a little off its middle; both free."""
    h = 1.0 / n
    x1, q1 = grid(n + 1, n, h)
    x2, q2 = grid(n, n, h, low=(0.4 * h, 1.0 + gap))
    x, quads = np.vstack([x1, x2]), np.vstack([q1, q2 + len(x1)])
    contact = surface_contact(x, quads, outline(n, n, len(q1)), outline(n + 1, n), penalty, h)
    velocity = np.zeros_like(x)
    velocity[len(x1) :, 1] = -speed
    return model_of(x, quads, contact), velocity, np.arange(len(x)) >= len(x1)


def last_of(stream):
    for frame in stream:
        last = frame
    return last


def test_free_flight_is_uniform():
    x, quads = grid(3, 3, 0.1)
    model = model_of(x, quads)
    velocity = np.tile([3.0, -2.0], (len(x), 1))
    frame = last_of(frames(model, velocity, 1e-5, [1000], STILL, 1e-6))
    # A thousand additions, each rounded to EPS of the position; strains of EPS times stiffness.
    np.testing.assert_allclose(frame.u, 1000 * 1e-5 * velocity, rtol=1e-11)
    np.testing.assert_allclose(frame.v, velocity, rtol=1e-10)
    assert frame.time == pytest.approx(1e-2) and frame.step == 1000 and frame.energy_error < 1e-12


def test_gravity_gives_the_parabola_and_its_work():
    """The half kick makes a constant force exact: u = g t^2/2, v = g t at every step."""
    x, quads = grid(2, 2, 0.1)
    model = model_of(x, quads, load=(0.0, -9.81))
    for frame in frames(model, np.zeros_like(x), 2e-5, [1, 7, 500], STILL, 1e-6):
        np.testing.assert_allclose(frame.u[:, 1], -0.5 * 9.81 * frame.time**2, rtol=1e-11)
        np.testing.assert_allclose(frame.v[:, 1], -9.81 * frame.time, rtol=1e-11)
        assert frame.energies.external_work == pytest.approx(frame.energies.kinetic, rel=1e-10)


def test_impact_keeps_momentum_and_the_impulse_is_what_is_exchanged():
    model, velocity, above = two_blocks()
    dt = stable_step(model).dt
    before = (model.mass[:, None] * velocity).sum(axis=0)
    touched = 0.0
    for frame in frames(model, velocity, dt, np.arange(0, 800, 20), STILL, 0.05):
        momentum = model.mass[:, None] * frame.v
        np.testing.assert_allclose(momentum.sum(axis=0), before, atol=1e-12 * abs(before[1]))
        gained = momentum[above].sum(axis=0) - before
        np.testing.assert_allclose(frame.pair_impulse[0], gained, atol=1e-12 * abs(before[1]))
        touched = max(touched, np.hypot(*frame.pair_force[0]))
    assert 0.0 < touched <= frame.pair_peak[0]
    # They let go, and more than the plastic impact would give (equal velocities, masses 5 : 4) was exchanged.
    assert not np.any(frame.gap > 0.0) and frame.pair_impulse[0, 1] > 5 / 9 * abs(before[1])


def test_energy_error_of_an_impact_falls_with_the_step_squared():
    model, velocity, _ = two_blocks()
    dt, end = stable_step(model).dt, 3e-3
    steps = dt / np.array([2.0, 4.0, 8.0, 16.0])
    errors = []
    for step in steps:
        count = round(end / step)
        at = np.linspace(0, count, 41).astype(int)
        errors.append(max(frame.energy_error for frame in frames(model, velocity, step, at, STILL, 0.05)))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    # Leapfrog is of second order; the kink of the contact law at touch scatters single values.
    assert 1.6 < slope < 2.6
    assert errors[-1] < 1e-4


def held(x, bottom_and_top):
    """Channels: x and y of the bottom, then x and y of the top."""
    channel = np.full(x.shape, -1)
    for k, level in enumerate(bottom_and_top):
        channel[x[:, 1] == level] = [2 * k, 2 * k + 1]
    return channel


def test_reactions_do_the_work_and_balance_the_momentum():
    """A block between a clamped base and a top that moves smoothly: balance of second order in dt."""
    x, quads = grid(4, 4, 0.25)
    model = model_of(x, quads, channel=held(x, (0.0, 1.0)), load=(50.0, 0.0))
    still = lambda t: 0.0 * t  # noqa: E731
    motion = Motion(
        still, still, lambda t: 0.03 * np.sin(900 * t) ** 2, lambda t: -0.05 * np.sin(600 * t) ** 2
    )
    base = 0.25 * stable_step(model).dt
    errors, unbalance = [], []
    for dt in base / np.array([1.0, 2.0, 4.0]):
        worst = 0.0
        impulse, before = 0.0, None
        for frame in frames(model, np.zeros_like(x), dt, np.arange(0, round(4e-3 / dt)), motion, 0.1):
            worst = max(worst, frame.energy_error)
            total = frame.reaction[0::2].sum() + model.load[:, 0].sum(), frame.reaction[1::2].sum()
            if before is not None:
                impulse = impulse + 0.5 * dt * (np.array(total) + before)
            before = np.array(total)
        momentum = (model.mass[:, None] * frame.v).sum(axis=0)
        errors.append(worst)
        unbalance.append(np.abs(impulse - momentum).max())
    slope = np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0]
    assert 1.7 < slope < 2.5 and errors[-1] < 1e-3
    # The reaction of a frame lags by half a step of the prescribed acceleration: first order at least.
    assert unbalance[-1] < 0.6 * unbalance[0]


def test_a_body_held_everywhere_needs_its_mass_times_the_acceleration():
    x, quads = grid(2, 2, 0.5)
    channel = np.zeros(x.shape, dtype=int) + [0, 1]
    model = model_of(x, quads, channel=channel)
    acceleration = 300.0
    motion = Motion(lambda t: 0.5 * acceleration * t**2, lambda t: 0.0 * t)
    frame = last_of(frames(model, np.zeros_like(x), 1e-5, [50], motion, 0.05))
    assert frame.reaction[0] == pytest.approx(acceleration * RHO, rel=1e-9)  # differences of u of 1e-7
    assert frame.energies.external_work == pytest.approx(frame.energies.kinetic, rel=2e-2)
    assert frame.energy_error < 1e-9


def test_two_bars_exchange_their_velocities():
    """Sides held: a one-dimensional elastic impact with contact time 2 L/c and stress rho c V/2."""
    h, n, speed = 0.0125, 160, 5.0
    x1, q1 = grid(n, 1, h)
    x2, q2 = grid(n, 1, h, low=(n * h + 1e-9, 0.0))
    x, quads = np.vstack([x1, x2]), np.vstack([q1, q2 + len(x1)])
    slave, master = [(2 * n - n, 3, 0)], [(n - 1, 1, 2)]
    contact = surface_contact(x, quads, slave, master, 100 * YOUNG, h)
    contact = contact._replace(previous=np.array([-1]), following=np.array([-1]))
    channel = np.full(x.shape, -1)
    channel[:, 1] = 0
    model = model_of(x, quads, contact, channel)
    velocity = np.zeros_like(x)
    velocity[: len(x1), 0] = speed
    dt, length = stable_step(model).dt, n * h
    duration = 2 * length / SPEED
    motion = Motion(lambda t: 0.0 * t)
    history = list(frames(model, velocity, dt, range(round(1.3 * duration / dt)), motion, 0.05))
    time = np.array([frame.time for frame in history])
    impulse = np.array([frame.pair_impulse[0, 0] for frame in history])
    first, last = np.searchsorted(time, [0.2 * duration, 0.8 * duration])
    mean = (impulse[last] - impulse[first]) / (time[last] - time[first]) / h
    # The grid's dispersion and the penalty make the force ring; over the plateau it averages out to a percent.
    assert mean == pytest.approx(RHO * SPEED * speed / 2, rel=0.01)
    closed = [frame.time for frame in history if frame.pair_force[0, 0] > 0.0]
    assert closed[-1] == pytest.approx(duration, rel=0.02)  # the front is some cells of 320 wide
    mean = [np.average(history[-1].v[part, 0], weights=model.mass[part])
            for part in (slice(0, len(x1)), slice(len(x1), None))]  # fmt: skip
    assert mean == pytest.approx([0.0, speed], abs=0.03 * speed)  # ringing left behind carries the rest


def test_frames_do_not_change_the_run():
    """Any number of frames, and so of restarts of the loop and of the search: the same bits."""
    model, velocity, _ = two_blocks()
    dt = stable_step(model).dt
    few = last_of(frames(model, velocity, dt, [300], STILL, 0.05))
    many = list(frames(model, velocity, dt, list(range(301)), STILL, 0.05))
    assert [frame.step for frame in many] == list(range(301))
    for name in ("u", "v", "gap", "pair_force", "pair_impulse", "pair_peak", "reaction"):
        np.testing.assert_array_equal(getattr(many[-1], name), getattr(few, name))
    assert many[-1].energies == few.energies


def test_resuming_gives_the_same_bits():
    model, velocity, _ = two_blocks()
    dt = stable_step(model).dt
    whole = list(frames(model, velocity, dt, [0, 100, 200, 300], STILL, 0.05))
    resumed = list(frames(model, velocity, dt, [0, 100, 200, 300], STILL, 0.05, resume=whole[1]))
    assert [frame.step for frame in resumed] == [200, 300]
    for a, b in zip(resumed, whole[2:], strict=True):
        for one, other in zip(a.state, b.state, strict=True):
            np.testing.assert_array_equal(one, other)
        assert a.energy_error == b.energy_error


def test_a_run_goes_on_from_the_frames_between_too(monkeypatch):
    """Looks at the guards every 70 steps, questions every 16: neither changes a bit, nor does an end between."""
    model, velocity, _ = two_blocks()
    dt = stable_step(model).dt
    monkeypatch.setattr(explicit, "LOOK_STEPS", (1, 70))
    monkeypatch.setattr(explicit, "ASK_WORK", 16 * len(model.elements.kind))
    arguments = model, velocity, dt, [0, 100, 300], STILL, 0.05
    whole = list(frames(*arguments))
    every = list(frames(*arguments, looks=True))
    assert [frame.step for frame in every] == [0, 70, 100, 170, 240, 300]
    asked = iter([False] * 12 + [True])
    short = list(frames(*arguments, looks=True, ended=lambda: next(asked)))
    assert [frame.step for frame in short] == [0, 70, 100, 170]
    for frame in short[1:]:
        end = last_of(frames(*arguments, resume=frame))
        for one, other in zip(end.state, whole[-1].state, strict=True):
            np.testing.assert_array_equal(one, other)
            assert one.flags.f_contiguous == other.flags.f_contiguous
        assert (end.energies, end.energy_error) == (whole[-1].energies, whole[-1].energy_error)


def test_the_initial_frame_is_given_only_where_it_is_asked_for():
    x, quads = grid(1, 1, 1.0)
    model = model_of(x, quads)
    assert [f.step for f in frames(model, 0 * x, 1e-5, [3], STILL, 0.05)] == [3]
    assert [f.step for f in frames(model, 0 * x, 1e-5, [0], STILL, 0.05)] == [0]
    assert list(frames(model, 0 * x, 1e-5, [], STILL, 0.05)) == []


def test_too_long_a_step_is_stopped_with_the_last_good_frame():
    model, velocity, _ = two_blocks()
    dt = 3.0 * stable_step(model).dt
    with pytest.raises(RunStopped, match="energy error|inverted|finite") as stop:
        list(frames(model, velocity, dt, np.arange(0, 2000, 10), STILL, 0.05))
    assert stop.value.last_good.energy_error <= 0.05 or stop.value.last_good.step < 64
    assert "smaller time step" in stop.value.advice


def test_an_inverted_element_is_named_with_its_place():
    x, quads = grid(2, 2, 0.5)
    model = model_of(x, quads, channel=held(x, (0.0, 1.0)))
    still = lambda t: 0.0 * t  # noqa: E731
    motion = Motion(still, still, still, lambda t: -4000.0 * t)
    with pytest.raises(RunStopped, match=r"element [23] \(at x = 0\.[27]5, y = 0\.75 .* is inverted, J = -"):
        list(frames(model, np.zeros_like(x), 5e-5, range(0, 40, 1), motion, np.inf))


def test_lost_numbers_are_reported_as_such():
    x, quads = grid(1, 1, 1.0)
    model = model_of(x, quads)
    velocity = np.zeros_like(x)
    velocity[0, 0] = np.nan
    with pytest.raises(RunStopped, match="no longer finite"):
        list(frames(model, velocity, 1e-5, [10], STILL, 0.05))


def test_massless_nodes_and_pairs_without_reach_are_refused():
    x, quads = grid(1, 1, 1.0)
    lonely = model_of(np.vstack([x, [[5.0, 5.0]]]), quads)
    with pytest.raises(ValueError, match="node 4 has no mass"):
        list(frames(lonely, np.zeros((5, 2)), 1e-5, [1], STILL, 0.05))
    model, velocity, _ = two_blocks()
    model = model._replace(contact=model.contact._replace(reach=np.zeros(1)))
    with pytest.raises(ValueError, match="contact pair 0 has no reach"):
        list(frames(model, velocity, 1e-5, [1], STILL, 0.05))


def test_uniform_squeeze_of_a_column_is_the_confined_closed_form():
    """Sides held, top pushed slowly to a stretch of 0.5: Cauchy stress (lambda + 2 mu) ln(s)/s."""
    x, quads = grid(1, 4, 0.25)
    channel = held(x, (0.0, 1.0))
    channel[:, 0] = 0
    model = model_of(x, quads, channel=channel)
    still = lambda t: 0.0 * t  # noqa: E731
    end = 0.1
    motion = Motion(still, still, still, lambda t: -0.25 * (1 - np.cos(np.pi * t / end)))
    dt = 0.4 * stable_step(model).dt  # the column gets stiffer and shorter as it is squeezed
    frame = last_of(frames(model, np.zeros_like(x), dt, [round(end / dt)], motion, 0.05))
    stress = element_stress(model.elements, frame.u)[0]
    exact = (LAME + 2 * SHEAR) * np.log(0.5) / 0.5
    # A tenth of a second is 76 transits of the wave: what is left of inertia is below 1e-3.
    np.testing.assert_allclose(stress[:, 1], exact, rtol=1e-3)
    assert frame.reaction[3] == pytest.approx(0.25 * exact, rel=1e-3)


WITHOUT_JIT = """
import sys; sys.path.insert(0, {folder!r})
import numpy as np, test_explicit as t
model, velocity, _ = t.two_blocks(n=2, gap=1e-4)
frame = t.last_of(t.frames(model, velocity, t.stable_step(model).dt, [25], t.STILL, 0.05))
np.savez({file!r}, u=frame.u, v=frame.v, peak=frame.pair_peak, impulse=frame.pair_impulse)
"""


def test_kernels_agree_with_their_plain_python_selves(tmp_path):
    """The same 25 steps of an impact with the compiler switched off."""
    file = tmp_path / "plain.npz"
    code = WITHOUT_JIT.format(folder=os.path.dirname(__file__), file=str(file))
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"NUMBA_DISABLE_JIT": "1"})
    model, velocity, _ = two_blocks(n=2, gap=1e-4)
    frame = last_of(frames(model, velocity, stable_step(model).dt, [25], STILL, 0.05))
    plain = np.load(file)
    assert frame.pair_peak[0] > 0.0
    # The same operations in the same order, up to libm's powers: some roundings, amplified over 25 steps.
    for name, value in (("u", frame.u), ("v", frame.v), ("peak", frame.pair_peak)):
        np.testing.assert_allclose(value, plain[name], rtol=0, atol=1e-12 * np.abs(value).max())
    np.testing.assert_allclose(frame.pair_impulse, plain["impulse"], rtol=0, atol=1e-6)
