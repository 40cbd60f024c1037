"""Corners of a master between the points of the slave: found where they are sharp, told how deep they stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_pairs import body, prepared_of, run

from phantomnode.pipeline.contact_tables import SlavePoints
from phantomnode.pipeline.corner_points import CUT_OFF, WEIGHT, cut_depth, cut_off
from phantomnode.pipeline.corners import deepest_corner, master_corners
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.fields import contact_lines
from phantomnode.pipeline.gaps import initial_gaps, master_ends
from phantomnode.pipeline.history import tangential_force
from phantomnode.pipeline.pairing import MasterSide, previous_of
from phantomnode.pipeline.summary import run_checks
from phantomnode.pipeline.tally import Tally
from phantomnode.solver.contact import add_contact_forces, contact_energy
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import initial_state
from phantomnode.solver.search import build_candidates, prepare_search

WEDGE = {"polyline": {"points": [[1.0, -0.6], [0.13, -0.02], [-1.0, -0.5]]}}


def over(obstacle, **pair):
    """A square of 0.8 m, its lower side at y = 0, above an obstacle with the material on its left."""
    block = body({"rectangle": {"low": [-0.4, 0.0], "high": [0.4, 0.8]}}, 0.1, aligned=True)
    return prepared_of(
        body={"block": block},
        rigid={"below": {"geometry": obstacle}},
        contact={"landing": {"slave": "block.bottom", "master": "below"} | pair},
    )


def moved(prepared, dx, dy):
    u = np.zeros_like(prepared.model.x)
    u[prepared.bodies[0].nodes] = (dx, dy)
    return u


@pytest.mark.parametrize(
    ("dx", "dy", "deep"),
    [
        (0.0, 0.0, 0.0),  # 0.02 above it
        (0.0, -0.05, 0.03),
        (0.013, -0.08, 0.06),  # between other points
        (0.6, -0.05, 0.0),  # beside the side that feels it
        (0.0, -0.3, 0.0),  # deeper than contact reaches: on the other side of the body, or through it
    ],
)
def test_a_wedge_is_seen_between_the_points_of_the_slave(dx, dy, deep):
    prepared = over(WEDGE)
    corners = master_corners(prepared, 0)
    assert len(corners.nodes) == 1
    found = deepest_corner(corners, prepared.model.x, moved(prepared, dx, dy))
    assert found == pytest.approx(deep, abs=1e-12)


@pytest.mark.parametrize(
    ("obstacle", "count"),
    [
        ({"circle": {"centre": [0.0, -0.5], "radius": 0.45}}, 0),  # flattened to chords
        ({"polyline": {"points": [[1.0, -0.1], [0.0, -0.2], [-1.0, -0.1]]}}, 0),  # a valley
        ({"polyline": {"points": [[1.0, -0.1], [0.0, -0.05], [-1.0, -0.1]]}}, 0),  # blunt
        (WEDGE, 1),
    ],
)
def test_only_sharp_corners_that_stick_out_count(obstacle, count):
    assert len(master_corners(over(obstacle), 0).nodes) == count


def test_the_summary_counts_corners(frame_of):
    prepared = over(WEDGE, corners=False)
    tally = Tally(prepared)
    points = len(prepared.model.contact.slave_weight)
    for step, down in enumerate((0.0, -0.05, -0.03)):
        tally.frame(
            frame_of(
                step,
                u=moved(prepared, 0.0, down),
                v=0.0 * prepared.model.x,
                gap=np.full(points, -1.0),
                reaction=np.zeros(prepared.model.channels),
            )  # fmt: skip
        )
    assert tally.penetration[0] == pytest.approx(0.03, abs=1e-12)
    check = next(c for c in run_checks(prepared, tally) if c.name == "penetration over cell size")
    assert (
        check.value == pytest.approx(0.3, abs=1e-11)
        and not check.passed
        and "corners = false" in check.advice
    )
    assert initial_gaps(prepared)[0].distance == pytest.approx(0.02, abs=1e-12)  # from the corner to the side


def test_self_contact_has_no_corners_of_another():
    square = body({"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}}, 0.1, aligned=True)
    prepared = prepared_of(body={"a": square}, contact={"own": {"slave": "a.outer", "master": "a.outer"}})
    assert len(master_corners(prepared, 0).nodes) == 0


# --- corners as points of contact -------------------------------------------------------------------------

UP = {"polyline": {"points": [[1.0, -0.6], [0.13, -0.02], [-1.0, -0.5]]}}
CELL, DEEP = 0.1, 0.01 * 0.1  # the cell of the block, and how deep a corner stands before it is felt


def landing(obstacle=UP, geometry=None, slave="block.bottom", step=None, end=0.03, **pair):
    """The block falls with 1 m/s on an obstacle; the frames of every step."""
    table = body(
        geometry or {"rectangle": {"low": [-0.4, 0.0], "high": [0.4, 0.8]}}, CELL, aligned=geometry is None
    )
    prepared = prepared_of(
        end=end,
        body={"block": table | {"initial_velocity": [0.0, -1.0]}},
        rigid={"below": {"geometry": obstacle}},
        contact={"landing": {"slave": slave, "master": "below"} | pair},
    )
    return prepared if step is None else replace(prepared, dt=step)


@pytest.mark.parametrize("shift", [0.0, 0.013, 0.037, 0.05])
def test_a_wedge_is_felt_wherever_it_meets_a_slave_segment(shift):
    """Gap 0.02 at 1 m/s: felt after 0.02 s and what a corner may stand deep, 0.001, at most, and two samples.

    Gauss points alone feel it up to 4e-2 later, as it stands between two of them. It never goes much deeper.
    """
    points = [[x + shift, y] for x, y in UP["polyline"]["points"]]
    prepared = landing({"polyline": {"points": points}}, end=0.05)
    seen = run(prepared, 1000)
    touched = next(f.time for f in seen if f.pair_force[0, 1] > 0.0)
    assert 0.02 < touched < 0.02 + DEEP + 2.5 * (0.05 / 1000 + prepared.dt)
    tally = Tally(prepared)
    for frame in seen:
        tally.frame(frame)
    assert DEEP < tally.corner_depth[0] < 0.15 * CELL


def test_a_corner_of_the_slave_is_felt_first():
    """A square on its tip: its corner touches the plane, not the Gauss point a fifth of a segment beside it."""
    tip = {"polygon": {"points": [[0.0, 0.011], [0.4, 0.411], [0.0, 0.811], [-0.4, 0.411]]}}
    floor = {"polyline": {"points": [[1.0, 0.0], [-1.0, 0.0]]}}
    prepared = landing(floor, tip, "block.outer")
    seen = run(prepared, 600)
    touched = next(f.time for f in seen if f.pair_force[0, 1] > 0.0)
    deep = 0.01 * prepared.bodies[0].grid.typical_size
    assert touched == pytest.approx(0.011 + deep, abs=2.5 * (0.03 / 600 + prepared.dt))


def test_corner_forces_are_the_slope_of_an_energy_and_leave_momentum_alone():
    """Against central differences, the wedge a body of its own; forces and moments of all nodes add up to nothing."""
    spike = {"polygon": {"points": [[0.13, 0.012], [-0.2, -0.5], [0.5, -0.5]]}}
    prepared = prepared_of(
        body={
            "block": body({"rectangle": {"low": [-0.4, 0.0], "high": [0.4, 0.8]}}, CELL, aligned=True),
            "spike": body(spike, 0.07),
        },
        contact={"pair": {"slave": "block.bottom", "master": "spike.outer", "overlap": "offset"}},
    )
    contact = prepared.model.contact
    model = prepared.model._replace(contact=contact._replace(offset=0.0 * contact.offset))
    assert len(prepared.pairs[0].corners) == 2
    rng = np.random.default_rng(5)
    u = 1e-4 * rng.normal(size=model.x.shape)

    def state_at(u):
        state = initial_state(model, np.zeros_like(model.x), prepare_layout(model))
        state.u[:] = u
        candidates = build_candidates(model.contact, prepare_search(model.contact), model.x, state.u)
        force = np.zeros_like(model.x)
        add_contact_forces(
            model.contact, candidates, model.x, state.u, force, state.pair_force, state.gap, state.normal
        )
        return force, contact_energy(model.contact, state.gap), state.gap

    force, _, gap = state_at(u)
    tip = slice(*model.contact.slave_first[prepared.pairs[0].corners[0] :][:2])
    assert gap[tip].max() > 0.01
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12 * np.abs(force).max())
    x = model.x + u
    moment = x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0]
    assert abs(moment.sum()) < 1e-12 * np.abs(moment).max()
    for node in np.flatnonzero(np.any(force != 0.0, axis=1)):
        for axis in (0, 1):
            step = np.zeros_like(u)
            step[node, axis] = 1e-8
            slope = (state_at(u + step)[1] - state_at(u - step)[1]) / 2e-8
            assert -slope == pytest.approx(force[node, axis], abs=1e-6 * np.abs(force).max())


def test_corners_show_in_the_pressure_of_the_nearest_segment():
    """Pressure times length adds up to the force of the pair, 2 % for the one normal that each segment has."""
    prepared = landing()
    frame = run(prepared, 600)[-1]
    lines = contact_lines(prepared, 0, frame)
    length = np.hypot(*(lines.ends[:, 1] - lines.ends[:, 0]).T)
    force = (lines.pressure * length)[:, None] * lines.normal
    assert frame.pair_force[0, 1] > 0.0
    assert force[:, 1].sum() == pytest.approx(frame.pair_force[0, 1], rel=0.02)
    assert np.nanmin(lines.gap) < 0.0


def test_friction_of_a_corner_acts_on_the_slave_as_that_of_points():
    """The obstacle moves to the right under the block: momentum of the block is the impulse it gets, in x too."""
    moving = {"geometry": UP, "velocity": {"x": 0.3}}
    prepared = prepared_of(
        end=0.04,
        body={
            "block": body({"rectangle": {"low": [-0.4, 0.0], "high": [0.4, 0.8]}}, CELL, aligned=True)
            | {"initial_velocity": [0.0, -1.0]}
        },
        rigid={"below": moving},
        contact={"landing": {"slave": "block.bottom", "master": "below", "friction": 0.3}},
    )
    frame = run(prepared, 200)[-1]
    gained = prepared.model.mass @ frame.v
    assert frame.pair_impulse[0, 0] > 0.0
    assert gained[0] == pytest.approx(frame.pair_impulse[0, 0], rel=1e-9)
    tally = tangential_force(prepared, prepared.pairs[0], frame)
    assert abs(tally[0]) <= 0.31 * np.hypot(*frame.pair_force[0])


def test_a_case_can_do_without_points_at_corners():
    without = landing(corners=False)
    assert without.pairs[0].corners == () and len(without.model.contact.crowd) == 0
    assert len(landing().pairs[0].corners) == 2  # the tip of the wedge, and the ends of the lower side


def test_corners_that_can_meet_on_one_node_share_their_weight():
    """Three tips within a cell weigh no more than one; ten cells apart each has its own."""

    def weights(distance):
        tips = [[0.0, 0.0], [0.01, -0.2]]
        points = [[1.2, -0.6]]
        for k in (1, 0, -1):
            points += [[tips[0][0] + k * distance, -0.02], [k * distance - 0.4 * distance, -0.02 - distance]]
        prepared = landing({"polyline": {"points": [*points[:-1], [-1.2, -0.6]]}})
        contact, k = prepared.model.contact, prepared.pairs[0].corners[0]
        return contact.slave_weight[contact.slave_first[k] : contact.slave_first[k + 1]], contact.crowd[k]

    near, crowd = weights(0.04)
    assert len(near) == 3 and crowd == pytest.approx(WEIGHT * CELL) == pytest.approx(near.sum())
    far, crowd = weights(0.45)
    assert len(far) == 3 and np.allclose(far, WEIGHT * CELL) and crowd == pytest.approx(WEIGHT * CELL)


def test_a_corner_far_inside_at_the_start_is_refused():
    deep = {"polyline": {"points": [[0.177, -0.6], [0.157, 0.03], [0.137, -0.6]]}}
    with pytest.raises(CaseError, match="overlap at the start by 0.03 m near .0.157, 0.03."):
        landing(deep)


@pytest.mark.parametrize("shift", [0.0, 0.0211, 0.05, 0.0789, 0.085])
def test_a_wedge_pushes_a_flat_face_back_and_not_aside(shift):
    """Wherever its tip stands on a segment, at and beside Gauss points (0.0211, 0.0789), too.

    Half its angle is 27 degrees: a point within the tip, pushed out through the flank, is pushed aside twice as hard.
    What is left, 6 %, is that of a block that is met beside its centre and turns: it grows with the shift.
    """
    wedge = {"polygon": {"points": [[shift, -0.004], [shift - 0.25, -0.5], [shift + 0.25, -0.5]]}}
    impulse = run(landing(wedge, end=0.05), 100)[-1].pair_impulse[0]
    assert impulse[1] > 900.0  # of 640 kg/m at 1 m/s: it bounces off
    assert abs(impulse[0]) < 0.06 * impulse[1]


def square_side():
    """The four sides of a unit square, counter-clockwise, on its corners; and these."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    nodes = np.array([[k, (k + 1) % 4, (k + 1) % 4, (k + 1) % 4] for k in range(4)])
    unit = np.eye(4)
    following = np.array([1, 2, 3, 0])
    side = MasterSide(
        nodes, np.repeat(unit[:1], 4, axis=0), np.repeat(unit[1:2], 4, axis=0), previous_of(following), following,
        np.tile([-2.0, 0.0, 0.0, np.inf], (4, 1)),
    )  # fmt: skip
    return side, corners


def test_corners_are_cut_off_by_a_segment_each():
    """A square becomes an octagon, whose sides follow each other; long cuts stop short of the next corner."""
    side, corners = square_side()
    for depth, cut in ((0.1, 0.1), (3.0, 0.45)):
        found = cut_off(side, corners, 0, depth)
        start, end = (
            np.einsum("si,sia->sa", shape, corners[found.nodes]) for shape in (found.start, found.end)
        )
        assert len(start) == 8 and sorted(found.following) == list(range(8))
        np.testing.assert_allclose(end, start[found.following], atol=1e-15)
        assert np.array_equal(found.previous[found.following], np.arange(8))
        length = np.hypot(*(end - start).T)
        np.testing.assert_allclose(length, np.repeat([1.0 - 2.0 * cut, cut * np.sqrt(2.0)], 4), rtol=1e-12)
        area = 0.5 * np.sum(start[:, 0] * end[:, 1] - end[:, 0] * start[:, 1])
        assert area == pytest.approx(1.0 - 2.0 * cut**2)


def test_a_corner_on_more_than_four_nodes_stays():
    """Sides in cells of their own, whose points take all four nodes: no segment could join them."""
    side, corners = square_side()
    apart = replace(
        side, nodes=np.arange(16).reshape(4, 4), start=np.full((4, 4), 0.25), end=np.full((4, 4), 0.25)
    )
    assert cut_off(apart, np.repeat(corners, 4, axis=0), 0, 0.1) is apart
    assert cut_off(side, corners, 0, 0.0) is side  # where slave points stand at the very ends


def test_a_face_that_slides_past_a_tip_is_pushed_along_its_normal():
    """A flank with a tip of 45 degrees on a flat face, .01 cells deep, in 500 places, over its edge, too.

    With one cut a point there is pushed aside at once, by 67 degrees: 9 % of the force of the whole face in the worst
    place, which let a pin in a slot be pulled. The turns of three cuts leave 3 %.
    """
    tip = {"polygon": {"points": [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]}}
    face = {"rectangle": {"low": [-0.5, -0.5], "high": [0.5, -0.001]}}
    prepared = prepared_of(
        body={"below": body(face, CELL, aligned=True), "tip": body(tip, CELL)},
        contact={"pair": {"slave": "below.top", "master": "tip.outer"}},
    )
    model, forces = prepared.model, []
    state = initial_state(model, np.zeros_like(model.x), prepare_layout(model))
    search, below = prepare_search(model.contact), prepared.bodies[0].nodes
    for along in np.linspace(-0.25, 0.25, 500):
        state.u[below] = (along, 0.001 + 0.01 * CELL)
        candidates, force = build_candidates(model.contact, search, model.x, state.u), np.zeros_like(model.x)
        add_contact_forces(
            model.contact, candidates, model.x, state.u, force, state.pair_force, state.gap, state.normal
        )
        forces.append(force[below].sum(axis=0))
    aside, back = np.abs(forces).T
    assert aside.max() < 0.04 * back.mean() and np.max(np.array(forces)[:, 1]) < 0.0


def test_cuts_end_before_the_first_slave_point():
    """Two Gauss points stand at 0.211 of a segment, three at 0.113; Newton-Cotes points at its ends."""
    cell, first = 0.2, 0.5 - np.sqrt(0.15)
    assert cut_depth(cell, SlavePoints()) == pytest.approx(CUT_OFF * cell)
    assert cut_depth(cell, SlavePoints(count=3)) == pytest.approx(0.9 * first * cell)
    assert cut_depth(cell, SlavePoints(rule="newton-cotes", count=3)) == 0.0


@pytest.mark.parametrize("cell", [0.1, 0.09, 0.07, 0.0553])
def test_the_tip_of_a_body_is_cut_off_wherever_its_cells_meet(cell):
    """A diamond whose tip is on a grid line between two cells, at a node, or within one: none stays sharp."""
    tip = {"polygon": {"points": [[0.0, -0.01], [-0.5, -0.51], [0.0, -1.01], [0.5, -0.51]]}}
    prepared = prepared_of(
        body={
            "block": body({"rectangle": {"low": [-0.4, 0.0], "high": [0.4, 0.8]}}, CELL, aligned=True),
            "diamond": body(tip, cell),
        },
        contact={"pair": {"slave": "block.bottom", "master": "diamond.outer"}},
    )
    contact = prepared.model.contact
    ends = master_ends(prepared, 0)
    following = contact.following[contact.master_first[0] : contact.master_first[1]]
    np.testing.assert_allclose(ends[following, 0], ends[:, 1], atol=1e-12)
    turns = ends[:, 1] - ends[:, 0]
    turns /= np.hypot(*turns.T)[:, None]
    assert (
        np.min(np.sum(turns * turns[following], axis=1)) > 0.5
    )  # 60 degrees at most, 45 where both cuts are alike
    assert ends[:, :, 1].max() < -0.01 - 0.5 * 0.1 * CELL  # the tip itself is the corner's


def test_the_summary_counts_corners_of_the_slave():
    """A square on its tip in a plane: its corner is all that touches."""
    tip = {"polygon": {"points": [[0.0, 0.011], [0.4, 0.411], [0.0, 0.811], [-0.4, 0.411]]}}
    prepared = landing({"polyline": {"points": [[1.0, 0.0], [-1.0, 0.0]]}}, tip, "block.outer", end=0.014)
    tally = Tally(prepared)
    for frame in run(prepared, 100):
        tally.frame(frame)
    assert 0.0005 < tally.penetration[0] < 0.1 * CELL and tally.corner_depth[0] == 0.0


def test_penalties_in_automatic_ones():
    auto, four, E = (landing(**{"penalty": p}) for p in ("auto", {"times_auto": 4.0}, {"times_E": 50.0}))
    np.testing.assert_allclose(four.model.contact.penalty, 4.0 * auto.model.contact.penalty, rtol=1e-14)
    np.testing.assert_allclose(
        E.model.contact.penalty, auto.model.contact.penalty, rtol=1e-12
    )  # 5 E/h, h = 0.1
