"""Contact pairs of the case file: slave points, passes, self contact, rigid obstacles, filtered pressure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.contact_tables import SlavePoints
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.fields import contact_lines
from phantomnode.pipeline.history import columns, row
from phantomnode.pipeline.pairing import point_rule
from phantomnode.pipeline.prepare import prepare
from phantomnode.pipeline.smoothing import hat_filter
from phantomnode.solver.explicit import frames
from phantomnode.solver.timestep import stable_step

YOUNG = 1e7

STEP = 5e-5
"""Of the runs that are held to a balance, s, a quarter to a sixth of the stable one: a flat impact of five cells
errs by 1e-2 of the energy at 2e-4 s, 6e-4 here, and falls with the square of the step."""


def material(**given):
    return {"soft": {"E": YOUNG, "nu": 0.3, "rho": 1000.0} | given}


def body(geometry, cell, velocity=(0.0, 0.0), aligned=False):
    return {
        "geometry": geometry,
        "grid": {"kind": "cartesian", "cell": cell, "aligned": aligned},
        "material": "soft",
        "initial_velocity": list(velocity),
    }


def rectangle(x0, y0, x1, y1):
    return {"rectangle": {"low": [x0, y0], "high": [x1, y1]}}


def prepared_of(end=1e-3, **tables):
    return prepare(case_from_table({"time": {"end": end}, "material": material()} | tables))


def run(prepared, count=20, velocity=None):
    steps = max(1, round(prepared.case.time.end / prepared.dt))
    at = np.unique(np.linspace(0, steps, count + 1).astype(int))
    start = prepared.velocity if velocity is None else velocity
    return list(frames(prepared.model, start, prepared.dt, at, prepared.motion, 0.05))


@pytest.mark.parametrize(
    ("rule", "count", "degree"),
    [*(("gauss", n, 2 * n - 1) for n in (1, 2, 3, 4, 7)), ("newton-cotes", 1, 1), ("newton-cotes", 3, 3),
     ("newton-cotes", 4, 3), ("newton-cotes", 5, 5), ("newton-cotes", 8, 7), ("newton-cotes", 10, 9)],
)  # fmt: skip
def test_rules_are_exact_to_their_degree_and_pull_nowhere(rule, count, degree):
    places, weights = point_rule(SlavePoints(rule=rule, count=count))
    assert len(places) == count and np.all(weights > 0.0)
    for power in range(degree + 1):
        assert weights @ places**power == pytest.approx(1.0 / (power + 1), rel=1e-13)


def stacked(**pair):
    """A block pressed on another of other cells, the interface within cells of neither."""
    return prepared_of(
        end=2e-3,
        body={
            "lower": body(rectangle(0, 0, 1, 0.5), 0.125, aligned=True),
            "upper": body(rectangle(0, 0.5, 1, 1), 0.1, (0.0, -1.0), aligned=True),
        },
        contact={"pair": {"slave": "upper.bottom", "master": "lower.top"} | pair},
    )


@pytest.mark.parametrize(
    "points",
    [
        {"rule": "gauss", "count": 1},
        {"rule": "gauss", "count": 3},
        {"rule": "newton-cotes", "count": 3},
        {"rule": "newton-cotes", "count": 4},
    ],
)
def test_a_flat_patch_bears_the_same_pressure_by_every_rule(points):
    """A uniform depth d gives the pressure eps d and the force eps d L, whatever the points."""
    prepared = stacked(points=points)
    u = np.zeros_like(prepared.model.x)
    u[prepared.bodies[1].nodes, 1] = -1e-3
    frame = run(prepared, 1)[0]._replace(u=u)
    contact = prepared.model.contact
    depth = 1e-3 - contact.offset  # corners are open: they feel less than they are allowed
    lines = contact_lines(prepared, 0, frame._replace(gap=depth))
    np.testing.assert_allclose(lines.pressure, contact.penalty[0] * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(lines.filtered, lines.pressure, rtol=1e-12)
    assert contact.slave_weight[prepared.pairs[0].points].sum() == pytest.approx(1.0, rel=1e-12)


def test_two_passes_bear_what_one_does():
    """A rigid push on a flat patch: the same force, shared by the points of both sides; momentum to rounding."""
    from phantomnode.solver.layout import prepare_layout
    from phantomnode.solver.leapfrog import advance, initial_state

    found = {}
    for passes in (1, 2):
        prepared = stacked(passes=passes)
        layout = prepare_layout(prepared.model)
        state = initial_state(prepared.model, prepared.velocity, layout)
        state.u[prepared.bodies[1].nodes, 1] = -1e-3
        advance(prepared.model, layout, state, 0.0, np.zeros((0, prepared.model.channels)))
        found[passes] = state
        assert state.pair_force.shape == (1, 2)
        lower, upper = (state.force[b.nodes].sum(axis=0) for b in prepared.bodies)
        rounding = 1e-12 * np.abs(upper).max()  # of the sums; the force has no part in x
        np.testing.assert_allclose(upper, state.pair_force[0], rtol=1e-12, atol=rounding)
        np.testing.assert_allclose(lower, -upper, rtol=1e-12, atol=rounding)
        assert len(prepared.pairs) == 1 and prepared.pairs[0].share == passes
    assert len(found[2].gap) > len(found[1].gap)
    np.testing.assert_allclose(found[2].pair_force, found[1].pair_force, rtol=1e-12, atol=rounding)


def test_a_run_in_two_passes_keeps_momentum_and_energy():
    prepared = stacked(passes=2, friction=0.3)
    prepared = replace(prepared, dt=STEP)
    seen = run(prepared)
    mass = prepared.model.mass[:, None]
    start, end = ((mass * f.v).sum(axis=0) for f in (seen[0], seen[-1]))
    assert np.abs(end - start).max() < 1e-12 * np.abs(start).max()
    assert max(f.energy_error for f in seen) < 1e-3
    upper = prepared.bodies[1].nodes
    gained = prepared.model.mass[upper] @ (seen[-1].v[upper] - seen[0].v[upper])
    np.testing.assert_allclose(seen[-1].pair_impulse[0], gained, atol=1e-10 * np.abs(gained).max())


def falling(obstacle, geometry=None, **pair):
    geometry = geometry or rectangle(-0.25, 0.0, 0.25, 0.5)
    return prepared_of(
        end=0.02,
        body={"block": body(geometry, 0.1, (0.0, -1.0), aligned=True)},
        contact={"pair": {"slave": "block.outer", "master": "floor"} | pair},
        rigid={"floor": obstacle},
    )


FLOOR = {"geometry": {"polyline": {"points": [[1.0, -0.001], [-1.0, -0.001]]}}}


def test_a_rigid_plane_throws_a_block_back():
    """A block and its mirror image meet at closing speed 2 v without a relative motion of the plane: contact
    ends after about twice the time of a wave through the block, and the impulse is that of the reaction."""
    prepared = falling(FLOOR)
    prepared = replace(prepared, dt=STEP)
    seen = run(prepared, 200)
    mass = prepared.model.mass
    assert mass.sum() == pytest.approx(1000.0 * 0.25, rel=1e-12)
    momentum = np.array([mass @ f.v[:, 1] for f in seen])
    assert momentum[-1] > 0.7 * 250.0  # the rest rings in the block
    force = np.array([f.pair_force[0, 1] for f in seen])
    reaction = np.array([row(prepared, f)[columns(prepared).index("reaction.floor.fy")] for f in seen])
    np.testing.assert_allclose(reaction, force, rtol=1e-12, atol=1e-9 * force.max())
    assert seen[-1].pair_impulse[0, 1] == pytest.approx(momentum[-1] - momentum[0], rel=1e-10)
    assert seen[-1].energies.external_work == 0.0
    assert max(f.energy_error for f in seen) < 1e-3


def test_a_rigid_plane_is_a_very_stiff_block():
    """The same block on a meshed one a thousand times stiffer and fixed: force within 1 %, same penalty.

    The stiff block gives way by a thousandth of the soft one's strain, and its waves are 30 times faster.
    """
    penalty = {"value": 5e8}
    rigid = falling(FLOOR, penalty=penalty)
    table = {
        "time": {"end": 0.02},
        "material": material() | {"hard": {"E": 1000 * YOUNG, "nu": 0.3, "rho": 1000.0}},
        "body": {
            "block": body(rectangle(-0.25, 0.0, 0.25, 0.5), 0.1, (0.0, -1.0), aligned=True),
            "floor": body(rectangle(-0.6, -0.201, 0.6, -0.001), 0.1, aligned=True) | {"material": "hard"},
        },
        "contact": {"pair": {"slave": "block.outer", "master": "floor.top", "penalty": penalty}},
        "boundary": {"base": {"on": "floor.bottom", "displacement": {"x": 0.0, "y": 0.0}}},
    }
    meshed = prepare(case_from_table(table))
    rigid = replace(rigid, dt=meshed.dt)  # a flat impact of five cells errs by a percent at the stable step
    impulse = [run(p, 50)[-1].pair_impulse[0, 1] for p in (rigid, meshed)]
    peak = [max(f.pair_impulse[0, 1] for f in run(p, 50)) for p in (rigid, meshed)]
    assert impulse[0] == pytest.approx(impulse[1], rel=0.01)
    assert peak[0] == pytest.approx(peak[1], rel=0.01)


def test_a_moved_obstacle_does_work():
    """A rigid plane pushed up against a block at rest: external work is what the block gets."""
    motion = {"velocity": {"y": 1.0, "x": 0.5}}
    prepared = falling(FLOOR | motion, friction=0.2)
    prepared = replace(prepared, dt=STEP)
    seen = run(prepared, 100, velocity=np.zeros_like(prepared.model.x))
    last = seen[-1].energies
    assert last.external_work > 50.0
    assert last.kinetic + last.internal + last.hourglass + last.contact + last.friction == pytest.approx(
        last.external_work, rel=1e-3
    )
    floor = prepared.rigids[0].nodes
    np.testing.assert_allclose(seen[-1].u[floor], np.tile([0.5, 1.0], (2, 1)) * seen[-1].time, rtol=1e-12)
    tangential = row(prepared, seen[-1])[columns(prepared).index("contact.pair.tx")]
    assert abs(tangential) <= 0.2 * abs(seen[-1].pair_force[0, 1]) * (1.0 + 1e-9)
    assert mass_speed(prepared, seen[-1]) > 0.01  # dragged along


def mass_speed(prepared, frame):
    return prepared.model.mass @ frame.v[:, 0] / prepared.model.mass.sum()


@pytest.mark.parametrize(
    ("obstacle", "fits"),
    [
        ({"geometry": {"circle": {"centre": [0.0, -0.501], "radius": 0.5}}}, True),
        ({"geometry": {"circle": {"centre": [0.0, 0.25], "radius": 0.5}}, "side": "right"}, True),
        ({"geometry": {"circle": {"centre": [0.0, 0.25], "radius": 0.5}}}, False),
        ({"geometry": {"function": "-0.01 - x**2", "x": [-1.0, 1.0]}, "side": "right"}, True),
        ({"geometry": {"function": "-0.01 - x**2", "x": [-1.0, 1.0]}}, False),
        ({"geometry": {"polyline": {"points": [[-1.0, -0.001], [1.0, -0.001]]}}}, False),
        ({"geometry": {"polyline": {"points": [[1, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]]}}}, False),
        ({"geometry": {"rectangle": {"low": [-1.0, -0.5], "high": [1.0, -0.001]}}}, True),
        ({"geometry": {"rectangle": {"low": [-1.0, -1.0], "high": [1.0, 1.0]}}}, False),
        ({"geometry": {"rectangle": {"low": [-1.0, -1.0], "high": [1.0, 1.0]}}, "side": "right"}, True),
        ({"geometry": {"polygon": {"points": [[0.0, -0.01], [1.0, -1.0], [-1.0, -1.0]]}}}, True),
        (
            {
                "geometry": {"polyline": {"points": [[1, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]]}},
                "side": "right",
            },
            True,
        ),
    ],
)
def test_the_side_of_an_obstacle(obstacle, fits):
    """Left of a curve, inside a closed one, or the other side where the case says so; else they overlap."""
    if fits:
        prepared = falling(obstacle)
        assert not (run(prepared, 1)[0].gap > 0.0).any()
    else:
        with pytest.raises(CaseError, match=r"overlap at the start .*floor\.side = \"right\""):
            falling(obstacle)


def test_an_obstacle_follows_its_curve():
    """Chord error: a thousandth of the cell of the body that touches it."""
    prepared = falling({"geometry": {"circle": {"centre": [0.0, -0.51], "radius": 0.5}}})
    rigid = prepared.rigids[0]
    middle = rigid.xy[rigid.segments].mean(axis=1)
    assert np.all(0.5 - np.hypot(*(middle - [0.0, -0.51]).T) <= 1e-3 * 0.1 * (1.0 + 1e-6))
    assert np.all(prepared.model.mass[rigid.nodes] == 0.0)


def test_the_step_is_that_of_the_body_and_its_springs():
    prepared = falling(FLOOR)
    assert np.isfinite(prepared.estimate.contact_frequency) and prepared.estimate.contact_frequency > 0.0
    assert stable_step(prepared.model).dt == prepared.estimate.dt


C_SHAPE = {
    "polygon": {
        "points": [[0, 0], [1, 0], [1, 0.2], [0.2, 0.2], [0.2, 0.4], [1, 0.4], [1, 0.6], [0, 0.6]],
    }
}


def jaws(cell=0.05, closing=4.0, **pair):
    """A C whose upper jaw is thrown against the lower one: the gap of 0.2 m closes at the tips."""
    prepared = prepared_of(
        end=0.12,
        body={"c": body(C_SHAPE, cell, aligned=True)},
        contact={"own": {"slave": "c.outer", "master": "c.outer"} | pair},
    )
    x, velocity = prepared.model.x, prepared.velocity
    velocity[:, 1] = np.where(x[:, 1] > 0.35, -closing, closing) * np.clip(x[:, 0] - 0.2, 0.0, None)
    velocity[(x[:, 1] > 0.2 + 1e-9) & (x[:, 1] < 0.4 - 1e-9)] = 0.0
    return prepared, velocity


def test_self_contact_starts_without_force():
    """Walls of 0.2 m between faces of one curve, corners, re-entrant corners: nothing touches at the start."""
    for cell in (0.05, 0.1, 0.03):
        prepared, velocity = jaws(cell)
        start = run(prepared, 1, velocity)[0]
        assert not (start.gap > 0.0).any()
        assert prepared.model.contact.reach[0] <= 0.1 + 1e-12  # half the wall


def test_self_contact_stops_the_jaws():
    """With contact the jaws meet and part again; momentum is exact; without it they pass through each other."""
    closed, velocity = jaws(friction=0.2)
    seen = run(closed, 60, velocity)
    mass = closed.model.mass
    momentum = [mass @ f.v for f in seen]
    scale = float(mass @ np.hypot(*velocity.T))
    assert np.abs(np.array(momentum) - momentum[0]).max() < 1e-11 * scale
    x = closed.model.x
    top = int(np.argmin(np.hypot(x[:, 0] - 1.0, x[:, 1] - 0.4)))
    bottom = int(np.argmin(np.hypot(x[:, 0] - 1.0, x[:, 1] - 0.2)))

    def opening(f):
        return float((x + f.u)[top, 1] - (x + f.u)[bottom, 1])

    gaps = [opening(f) for f in seen]
    assert any((f.gap > 0.0).any() for f in seen)
    assert min(gaps) > -0.02
    assert max(f.energy_error for f in seen) < 5e-3
    passing, velocity = jaws(penalty={"value": 1.0})
    free = run(passing, 60, velocity)
    assert min(opening(f) for f in free) < -0.05


def test_a_squeezed_ring_touches_itself():
    """A ring crushed between a rigid floor and a rigid stamp until its hole is shut along most of its length.

    The hole closes like a zip up to the creases at its ends, where the neighbourhood of points begins to be seen.
    """
    prepared = prepared_of(
        end=0.012,
        body={"ring": body({"ring": {"centre": [0.0, 0.0505], "outer": 0.05, "inner": 0.036}}, 0.005)},
        contact={
            "floor": {"slave": "ring.outer", "master": "floor"},
            "stamp": {"slave": "ring.outer", "master": "stamp"},
            "own": {"slave": "ring.inner", "master": "ring.inner"},
        },
        rigid={
            "floor": {"geometry": {"polyline": {"points": [[0.3, 0.0], [-0.3, 0.0]]}}},
            "stamp": {
                "geometry": {"polyline": {"points": [[-0.3, 0.101], [0.3, 0.101]]}},
                "velocity": {"y": -6.4},
            },
        },
    )
    seen = run(prepared, 60)
    own = prepared.pairs[2].points
    closed = [int((f.gap[own] > 0.0).sum()) for f in seen]
    assert closed[0] == 0 and max(closed) > 10
    assert max(f.gap[own].max() for f in seen) < 0.25 * 0.005
    assert max(f.energy_error for f in seen if f.step > 64) < 2e-3
    reactions = np.array([f.reaction[[1, 3]] for f in seen])
    assert reactions[-1, 0] > 0.0 > reactions[-1, 1]
    assert abs(seen[-1].pair_force[2]).max() < 0.05 * reactions[-1, 0]  # face on face: the sum over the curve


def test_a_thin_wall_is_warned_of():
    thin = {"polygon": {"points": [[0, 0], [1, 0], [1, 0.012], [0.012, 0.012], [0.012, 0.5], [0, 0.5]]}}
    prepared = prepared_of(
        body={"l": body(thin, 0.1)}, contact={"own": {"slave": "l.outer", "master": "l.outer"}}
    )
    assert any("a wall of l.outer is 0.01" in note for note in prepared.warnings)
    assert prepared.model.contact.reach[0] < 0.0061


def test_the_hat_filter_keeps_force_and_constants_and_smooths():
    """Random segments on an open and on a closed curve: force and constants to rounding, roughness down."""
    rng = np.random.default_rng(3)
    length = rng.uniform(0.02, 1.0, 60) * 0.1
    ends = np.cumsum(length)
    for whole in (np.inf, ends[-1]):
        rows, columns, weights = hat_filter(
            [(np.zeros(60), ends - 0.5 * length, length, np.full(60, whole))], 0.3
        )

        def smooth(value, rows=rows, columns=columns, weights=weights):
            return np.bincount(rows, weights * value[columns], 60)

        np.testing.assert_allclose(smooth(np.ones(60)), 1.0, rtol=1e-12)
        rough = 1.0 + 0.3 * rng.normal(size=60)
        assert length @ smooth(rough) == pytest.approx(length @ rough, rel=1e-13)
        assert smooth(rough).std() < 0.4 * rough.std()


def test_the_filter_goes_around_a_closed_curve():
    middle = (np.arange(20) + 0.5) * 0.1
    rows, columns, weights = hat_filter([(np.zeros(20), middle, np.full(20, 0.1), np.full(20, 2.0))], 0.25)
    pulse = np.zeros(20)
    pulse[0] = 1.0
    seen = np.bincount(rows, weights * pulse[columns], 20)
    np.testing.assert_allclose(seen[[1, 2]], seen[[-1, -2]], rtol=1e-12)
    assert seen[1] > 0.0
