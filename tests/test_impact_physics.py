"""Impacts through the whole pipeline against closed forms: bars, free discs, repeated and resumed runs."""

from __future__ import annotations

import numpy as np
import physics
import pytest
from physics import RHO, SPEED, disc, momentum, prepared_case, rectangle, run_frames, total_energy

WIDTH, CLOSING = 0.0168, 1.0
"""Width of the bars, m, and closing speed, m/s: slow, so that strains (4e-4) are small."""


def bars(short, long, end, cell=0.005, penalty=100.0):
    """Two bars along y, ends and sides inside the cells, held in x: waves run at c_d and in one dimension."""
    gap, x0 = 1e-5, 0.0131
    everywhere = [[-1.0, -9.0], [1.0, 9.0]]
    lower = physics.cartesian(cell, aligned=False)
    upper = physics.cartesian(1.07 * cell, aligned=False)
    bodies = {
        "below": rectangle((x0, -short), (x0 + WIDTH, 0.0), lower),
        "above": rectangle((x0, gap), (x0 + WIDTH, gap + long), upper, initial_velocity=[0.0, -CLOSING]),
    }
    pair = {"slave": "below.top", "master": "above.bottom", "penalty": {"times_E": penalty}}
    held = {b: {"on": {"body": b, "box": everywhere}, "displacement": {"x": 0.0}} for b in bodies}
    return prepared_case(bodies, end, contact={"impact": pair}, boundary=held)


@pytest.fixture(scope="module", params=[(1.0, 1.0), (1.0, 1.6)], ids=["same length", "different lengths"])
def impact(request):
    """Every step of an impact: lengths, times, force that the bars press with, last frame, the case."""
    short, long = request.param
    prepared = bars(short, long, 2.6 * short / SPEED)
    times, force = [], []
    for frame in run_frames(prepared, 10**6):
        times.append(frame.time)
        force.append(-frame.pair_force[0, 1])
    return short, long, np.array(times), np.array(force), frame, prepared


def test_stress_of_bars_in_impact(impact):
    """rho c V/2 between the arrival of the wave and its return; the mean, for the front rings.

    0.1 %: the front rings by 5 % (standard deviation), of which the mean keeps 4e-4.
    """
    short, _, times, force, _, _ = impact
    contact = 2.0 * short / SPEED
    plateau = force[(times > 0.2 * contact) & (times < 0.8 * contact)].mean()
    assert plateau / WIDTH == pytest.approx(0.5 * RHO * SPEED * CLOSING, rel=1e-3)


def test_contact_time_of_bars(impact):
    """2 L/c of the shorter bar, from half of the plateau to half of it: 1 % (the issue's figure).

    Measured: 0.02 % and 0.6 %, of which the penalty spring (it fills in E'/(2 c eps), E' = rho c^2) makes 0.6 %.
    """
    short, _, times, force, _, _ = impact
    touching = times[force > 0.25 * RHO * SPEED * CLOSING * WIDTH]
    assert touching[-1] - touching[0] == pytest.approx(2.0 * short / SPEED, rel=0.01)


def test_bars_exchange_their_velocities(impact):
    """The shorter bar takes the whole velocity of the other over its own length; then nothing presses.

    Equal bars exchange theirs. The impulse is rho A L V with L that of the shorter one; 1 % (the issue's).
    """
    short, long, _, force, last, prepared = impact
    full = RHO * WIDTH * short * CLOSING
    assert -last.pair_impulse[0, 1] == pytest.approx(full, rel=0.01)
    mass = prepared.model.mass
    below, above = (mass[b.nodes] @ last.v[b.nodes, 1] / mass[b.nodes].sum() for b in prepared.bodies)
    assert below == pytest.approx(-CLOSING, abs=0.01 * CLOSING)
    assert above == pytest.approx(-CLOSING * (1.0 - short / long), abs=0.01 * CLOSING)
    assert force[-1] < 0.01 * force.max()


def discs(step="auto", end=0.009, cell=0.04):
    """Three free discs on grids of their own that all hit each other, none of them head-on."""
    speed = 30.0
    bodies = {
        "left": disc((-0.3, -0.17), 0.25, cell, initial_velocity=[speed, 0.4 * speed]),
        "right": disc((0.29, -0.17), 0.2, 1.1 * cell, initial_velocity=[-speed, 0.5 * speed]),
        "top": disc((0.02, 0.35), 0.22, 0.93 * cell, initial_velocity=[-0.2 * speed, -1.2 * speed]),
    }
    pairs = [("right", "left"), ("top", "right"), ("top", "left")]
    contact = {a + b: {"slave": f"{a}.outer", "master": f"{b}.outer"} for a, b in pairs}
    return prepared_case(bodies, end, contact=contact, time={"end": end, "step": step})


def test_free_discs_keep_linear_and_angular_momentum():
    """Opposite forces along one line: momenta are kept to rounding, 1e-10 of the sum of |m v| and of |m x v|."""
    prepared = discs()
    mass, start = prepared.model.mass, None
    for frame in run_frames(prepared, 100):
        linear, angular = momentum(prepared, frame)
        if start is None:
            start = linear, angular
        speed, arm = np.hypot(*frame.v.T), np.hypot(*(prepared.model.x + frame.u).T)
        assert np.hypot(*(linear - start[0])) < 1e-10 * (mass @ speed)
        assert abs(angular - start[1]) < 1e-10 * abs(start[1]) < 1e-10 * (mass @ (arm * speed))
    assert np.all(frame.pair_peak > 1e6), "all three pairs have touched"
    assert not np.any(frame.pair_force), "and let go"


def test_energy_of_free_discs_at_the_automatic_step_and_a_tenth_of_it():
    """1e-3 (the issue's figure; measured 4e-4), and 1e-5 at a tenth of the step (measured 8e-6).

    Far below that the error of these discs falls more slowly than with the square of the step: their outlines
    are polygons, and a point that slides past a vertex of the master while it presses turns its force at once.
    """
    automatic = discs().dt
    for step, most in ((automatic, 1e-3), (0.1 * automatic, 1e-5)):
        assert max(frame.energy_error for frame in run_frames(discs(float(step)), 200)) < most


def discs_on_square(step="auto", end=0.004):
    """Two discs thrown askew at two sides of a free square: three free bodies, flat masters."""
    bodies = {
        "square": rectangle((-0.3, -0.3), (0.3, 0.3), physics.cartesian(0.0421, aligned=False)),
        "above": disc((0.03, 0.501), 0.2, 0.04, initial_velocity=[10.0, -30.0]),
        "right": disc((0.521, -0.04), 0.22, 0.043, initial_velocity=[-25.0, 8.0]),
    }
    contact = {
        "top": {"slave": "above.outer", "master": "square.top"},
        "side": {"slave": "right.outer", "master": "square.right"},
    }
    return prepared_case(bodies, end, contact=contact, time={"end": end, "step": step})


def test_energy_error_of_free_bodies_falls_with_the_square_of_the_step():
    """The slope over a decade of steps.

    A point that closes within a step leaves an error that depends on when in the step it closed, so that the
    error scatters by a factor of up to 2 from one step size to the next: twelve sizes are fitted.
    """
    sizes, errors = discs_on_square().dt / 10.0 ** np.linspace(0.0, 1.0, 12), []
    for size in sizes:
        errors.append(max(frame.energy_error for frame in run_frames(discs_on_square(float(size)), 200)))
    assert errors[0] < 1e-3
    assert 1.8 < np.polyfit(np.log(sizes), np.log(errors), 1)[0] < 2.2


@pytest.mark.slow
def test_energy_error_of_the_ring_impact_falls_with_the_square_of_the_step():
    """Through the first contact phase, eight step sizes from the automatic one to an eleventh of it."""
    from phantomnode.pipeline.case import load_case
    from phantomnode.pipeline.prepare import prepare

    sizes, errors = 1.3e-6 / np.sqrt(2.0) ** np.arange(8), []
    for size in sizes:
        prepared = prepare(load_case("ring_impact", [f"time.step={size}", "time.end=0.005"]))
        errors.append(max(frame.energy_error for frame in run_frames(prepared, 1000)))
    print("step, s; energy error:", *zip(sizes, errors, strict=True), sep="\n")
    assert 1.8 < np.polyfit(np.log(sizes), np.log(errors), 1)[0] < 2.2


def test_energy_is_balanced_at_every_time_of_an_impact():
    """Kinetic, stored and contact energy of the free discs exchange tenths of the whole and lose 1e-3 of it."""
    sequence = list(run_frames(discs(), 200))
    whole = total_energy(sequence[0])
    stored = [f.energies.internal + f.energies.contact for f in sequence]
    assert max(stored) > 0.1 * whole
    np.testing.assert_allclose([total_energy(f) for f in sequence], whole, rtol=1e-3)


def same_bits(a, b):
    return all(np.array_equal(one, other) for one, other in zip(a.state, b.state, strict=True))


def test_the_same_case_gives_the_same_bits():
    """Prepared twice from the table, and looked at at different times."""
    *_, first = run_frames(discs(), 7)
    *_, second = run_frames(discs(), 300)
    assert same_bits(first, second) and first.pair_peak[2] > 0.0
    assert (first.energies, first.reaction.tolist()) == (second.energies, second.reaction.tolist())


def test_a_run_resumed_while_in_contact_gives_the_same_bits():
    prepared = discs()
    whole = list(run_frames(prepared, 60))
    middle = next(frame for frame in whole if np.count_nonzero(frame.pair_force[:, 1]) >= 2)
    *_, resumed = run_frames(discs(), 9, resume=middle)
    assert same_bits(resumed, whole[-1])
    assert (resumed.energies, resumed.initial_energy) == (whole[-1].energies, whole[-1].initial_energy)
