"""Masters narrower than the points of their slaves stand apart: roundings and pins are corners to these."""

from __future__ import annotations

import numpy as np
import pytest
from test_corners import UP, landing
from test_pairs import body, prepared_of, run

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.closing import meeting_time
from phantomnode.pipeline.coarse import coarse_slaves
from phantomnode.pipeline.corner_points import WEIGHT
from phantomnode.pipeline.gaps import initial_gaps
from phantomnode.pipeline.preflight import text_report
from phantomnode.pipeline.prepare import prepare
from phantomnode.pipeline.rigid import _turning
from phantomnode.pipeline.summary import run_checks
from phantomnode.pipeline.tally import Tally
from phantomnode.pipeline.turning import EVERY, SHARP, most_turned, sharp, sharp_or_narrow

CELL = 0.1
LOWER_HALF = [[-0.02, -0.03], [0.02, -0.015]]


def closed(points):
    """Ends of the sides of a polygon, and their links."""
    points = np.asarray(points, dtype=float)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1), np.roll(np.arange(len(points)), -1)


def circle(radius, count, start=0.0):
    angle = start + 2.0 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("count", [40, 200, 5000])
def test_a_circle_is_narrow_where_it_turns_by_twenty_degrees_between_points(count):
    """By any number of chords; of very many, one vertex in 2.5 degrees."""
    ends, following = closed(circle(1.0, count))
    assert len(sharp_or_narrow(ends, following, 0.9 * SHARP)[0]) == 0
    found, rounding = sharp_or_narrow(ends, following, 1.3 * SHARP)
    assert len(set(rounding)) == 1  # the seam of the chain is none
    assert len(found) == pytest.approx(min(count, 2.0 * np.pi / EVERY), rel=0.05)
    step = np.max(np.diff([*found, found[0] + count])) * 2.0 * np.pi / count
    assert step < max(2.0 * np.pi / count, EVERY) * 1.5  # all around, the seam of the chain included
    assert most_turned(ends, following, 1.3 * SHARP) == pytest.approx(1.3 * SHARP, rel=0.2)


@pytest.mark.parametrize(
    ("name", "points", "narrow"),
    [
        ("a square in pieces", [[0, 0], [0.5, 0], [0.99, 0], [1, 0], [1, 1], [0, 1]], 0),
        ("a hole: it does not stick out", circle(1.0, 60)[::-1], 0),
        ("a zigzag that turns forth and back", [[k / 20, 0.002 * (k % 2)] for k in range(21)] + [[1, 1], [0, 1]], 0),
        ("a circle less than a tenth of the spacing", circle(0.01, 60), 60),
    ],
)  # fmt: skip
def test_what_is_straight_or_no_corner_stays(name, points, narrow):
    ends, following = closed(points)
    found, _ = sharp_or_narrow(ends, following, 0.4)
    assert len(set(found) - set(sharp(ends, following))) == narrow, name


def test_an_open_curve_is_followed_from_its_free_end():
    """A floor with a rounding in its middle: only this is narrow."""
    angle = np.radians(np.linspace(0.0, 90.0, 10))
    bend = np.column_stack([0.02 * np.sin(angle) - 0.02, 0.02 * np.cos(angle) - 0.02])
    points = np.vstack([[[-1.0, 0.0], [-0.5, 0.0]], bend, [[0.0, -1.0]]])[::-1]
    ends = np.stack([points[:-1], points[1:]], axis=1)
    following = np.array([*range(1, len(ends)), -1])
    found, rounding = sharp_or_narrow(ends, following, 0.1)
    assert len(set(rounding)) == 1
    assert len(found) > 0 and np.all(np.abs(ends[found, 1]).max(axis=1) < 0.021)
    assert len(sharp_or_narrow(ends, following, 0.0)[0]) == 0


@pytest.mark.parametrize("turns", [(19.0, 19.0), (15.0, 15.0, 15.0), (19.0, 15.0, 19.0)])
@pytest.mark.parametrize("pieces", [1, 50])
def test_a_short_rounding_between_long_flanks_is_one(turns, pieces):
    """Of edges of 2 mm between flanks of 1 m, in one piece or many, for points 58 mm apart; no vertex is sharp."""
    steps = np.radians(np.cumsum([-0.5 * sum(turns), *turns]))
    lengths = [1.0, *[0.002] * (len(turns) - 1), 1.0]
    points = np.cumsum(
        [[0.0, 0.0], *(n * np.array([np.cos(a), np.sin(a)]) for n, a in zip(lengths, steps, strict=True))],
        axis=0,
    )
    flank = np.linspace(0.0, 1.0, pieces + 1)[:, None]
    first, last = points[0] + flank * (points[1] - points[0]), points[-2] + flank * (points[-1] - points[-2])
    points = np.vstack([first, points[2:-2], last])
    ends, following = np.stack([points[:-1], points[1:]], axis=1), np.array([*range(1, len(points) - 1), -1])
    found, rounding = sharp_or_narrow(ends, following, 0.058)
    assert found.tolist() == [*range(pieces - 1, pieces - 1 + len(turns))] and len(set(rounding)) == 1
    assert most_turned(ends, following, 0.058) == pytest.approx(np.radians(sum(turns)))


def test_fillets_of_a_tip_s_neighbours_leave_it_its_weight():
    """Three corners 2.5 cells apart, two of them rounded: vertices of a rounding share the weight of one corner."""

    def fillet(x):
        angle = np.radians(np.linspace(0.0, 90.0, 12))
        return [[x + 0.02 * np.sin(a), -0.25 - 0.02 + 0.02 * np.cos(a)] for a in angle]

    right, left = fillet(0.23), [[-x, y] for x, y in reversed(fillet(0.23))]
    outline = [[0.25, -0.6], *reversed(right), [0.013, -0.02], *reversed(left), [-0.25, -0.6]]
    prepared = landing({"polyline": {"points": outline}})
    contact, k = prepared.model.contact, prepared.pairs[0].corners[0]
    weight = contact.slave_weight[contact.slave_first[k] : contact.slave_first[k + 1]]
    assert weight.max() == pytest.approx(WEIGHT * CELL) and np.sum(weight == weight.max()) == 1
    assert weight.sum() == pytest.approx(3.0 * WEIGHT * CELL) and contact.crowd[k] == pytest.approx(
        weight.sum()
    )


def test_an_obstacle_acts_the_same_however_its_flanks_are_drawn():
    """The wedge in three points, and with 2,000 pieces on each flank; the same but for the rounding of its places."""
    impulses = []
    for pieces in (1, 3, 2000):
        part = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        a, b, c = np.array(UP["polyline"]["points"])
        points = np.vstack([a + part * (b - a), (b + part * (c - b))[1:]])
        prepared = landing({"polyline": {"points": points.tolist()}}, end=0.05)
        impulses.append(run(prepared, 100)[-1].pair_impulse[0])
    np.testing.assert_allclose(impulses[1:], [impulses[0]] * 2, rtol=1e-6, atol=1e-6 * impulses[0][1])


@pytest.mark.parametrize("radius", [0.01, 0.04, 0.12])
@pytest.mark.parametrize("place", [0.0, 0.023, 0.05])
def test_a_pin_is_met_wherever_it_stands_between_slave_points(radius, place):
    """Gap 0.01 at 1 m/s: within one per cent of a cell, where Gauss points alone pass a thin pin by.

    The first two radii are narrow for points 0.058 apart; a pin of 0.12 is narrow, too, one of 0.2 would be followed.
    """
    pin = {"circle": {"centre": [place, -0.01 - radius], "radius": radius}}
    prepared = landing(pin, end=0.04)
    touched = next(f.time for f in run(prepared, 800) if f.pair_force[0, 1] > 0.0)
    assert 0.01 < touched < 0.01 + 0.01 * CELL + 2.5 * (0.04 / 800 + prepared.dt)


def slab_on_pin(cell=0.05, **pair):
    """A slab of coarse cells falls on a pin of fine ones, whose lower half is held."""
    return {
        "time": {"end": 6e-4},
        "material": {"steel": {"E": 210e9, "nu": 0.3, "rho": 7800.0}},
        "body": {
            "slab": {
                "geometry": {"rectangle": {"low": [-0.2, 0.0005], "high": [0.2, 0.2005]}},
                "grid": {"kind": "cartesian", "cell": cell},
                "material": "steel",
                "initial_velocity": [0.0, -5.0],
            },
            "pin": {
                "geometry": {"circle": {"centre": [0.0, -0.01], "radius": 0.01}},
                "grid": {"kind": "cartesian", "cell": 0.0025},
                "material": "steel",
            },
        },
        "contact": {"c": {"slave": "slab.outer", "master": "pin.outer"} | pair},
        "boundary": {"b": {"on": {"body": "pin", "box": LOWER_HALF}, "displacement": {"x": 0.0, "y": 0.0}}},
    }


def test_a_coarse_slab_does_not_pass_a_fine_pin_and_is_not_trusted():
    """It met nothing at all before: 0 phases, trusted. Gap over speed is 1e-4 s; cells of the pin count now."""
    prepared = prepare(case_from_table(slab_on_pin()))
    tally = Tally(prepared)
    seen = run(prepared, 600)
    for frame in seen:
        tally.frame(frame)
    touched = next(f.time for f in seen if f.pair_force[0, 1] > 0.0)
    assert 1e-4 < touched < 1e-4 + 0.01 * 0.0025 / 5.0 + 2.5 * (1e-6 + prepared.dt)
    assert tally.energy_error_max < 1e-4  # second order in the step; what other contacts of these tests keep
    check = next(c for c in run_checks(prepared, tally) if c.name == "penetration over cell size")
    assert not check.passed and "make pin.outer the slave" in check.advice
    assert tally.penetration[0] == pytest.approx(check.value * prepared.bodies[1].grid.typical_size)


def test_coarse_slaves_are_told_before_the_run():
    assert "are 20 times as large as those of the master: make pin.outer the slave" in " ".join(
        coarse_slaves(prepare(case_from_table(slab_on_pin())))
    )
    assert [*coarse_slaves(prepare(case_from_table(slab_on_pin(passes=2))))] == []
    swapped = slab_on_pin(slave="pin.outer", master="slab.outer")
    assert [*coarse_slaves(prepare(case_from_table(swapped)))] == []
    (told,) = coarse_slaves(landing({"circle": {"centre": [0.0, -0.06], "radius": 0.05}}))
    assert "below turns by 66 degrees between points of block.bottom, 0.058 m apart" in told
    assert "cells of 0.03 m do" in told
    assert [*coarse_slaves(landing({"circle": {"centre": [0.0, -0.9], "radius": 0.8}}))] == []


def test_cells_of_the_slave_do_not_cut_the_master_away():
    """Corners of a small block are cut off by a part of its own cells, however large those of the slave are."""
    small = {"rectangle": {"low": [-0.03, -0.02], "high": [0.03, 0.0]}}
    prepared = prepared_of(
        body={
            "slab": body({"rectangle": {"low": [-1.0, 0.001], "high": [1.0, 1.001]}}, 0.25),
            "block": body(small, 0.004, aligned=True),
        },
        contact={"c": {"slave": "slab.outer", "master": "block.outer"}},
    )
    (gap,) = initial_gaps(prepared)
    assert gap is not None and gap.distance == pytest.approx(
        0.001, abs=2e-7 * 0.25
    )  # the lattice of the slab's cells
    contact = prepared.model.contact
    for k in prepared.pairs[0].corners:
        assert contact.offset[contact.slave_first[k]] <= 0.01 * 0.004


NEVER = "by their first velocities the two never meet"


def test_bodies_that_part_are_told_and_those_at_rest_are_not():
    table = slab_on_pin(slave="pin.outer", master="slab.outer")
    for speed, told in ((5.0, True), (0.0, False), (-5.0, False)):
        table["body"]["slab"]["initial_velocity"] = [0.0, speed]
        assert (NEVER in text_report(prepare(case_from_table(table)))) is told


def test_a_ball_in_a_ring_meets_the_far_side_and_one_that_passes_is_told():
    """The nearest side of the ring is behind the ball: 1.4 m ahead at 10 m/s. Beside it a ball passes, .1 m away."""
    table = {
        "time": {"end": 1.0},
        "material": {"steel": {"E": 210e9, "nu": 0.3, "rho": 7800.0}},
        "body": {
            "ball": {
                "geometry": {"circle": {"centre": [-0.5, 0.0], "radius": 0.1}},
                "grid": {"kind": "cartesian", "cell": 0.05},
                "material": "steel",
                "initial_velocity": [10.0, 0.0],
            }
        },
        "rigid": {"wall": {"geometry": {"circle": {"centre": [0.0, 0.0], "radius": 1.0}}, "side": "right"}},
        "contact": {"c": {"slave": "ball.outer", "master": "wall"}},
    }
    prepared = prepare(case_from_table(table))
    (gap,) = initial_gaps(prepared)
    assert gap is not None and gap.distance == pytest.approx(0.4, rel=1e-4)
    assert meeting_time(prepared, 0, gap) == pytest.approx(0.14, rel=1e-3)
    assert NEVER not in text_report(prepared)
    table["rigid"]["wall"] = {"geometry": {"circle": {"centre": [1.0, 0.7], "radius": 0.5}}}
    assert NEVER in text_report(prepare(case_from_table(table)))


@pytest.mark.parametrize(
    ("name", "points", "closed_curve", "kept"),
    [
        ("a corner that is drawn twice", [[0, 0], [1, 0], [1, 0], [1, 1]], False, [0, 1, 3]),
        ("a line in pieces", [[0, 0], [0.3, 0], [0.7, 0], [1, 0]], False, [0, 3]),
        ("a way back", [[0, 0], [1, 0], [0, 0]], False, [0, 1, 2]),
        ("a square from a side on", [[0.5, 0], [1, 0], [1, 1], [0, 1], [0, 0], [0.5, 0]], True, [1, 2, 3, 4, 1]),
    ],
)  # fmt: skip
def test_vertices_of_obstacles_on_straight_lines_are_left_out(name, points, closed_curve, kept):
    points = np.array(points, dtype=float)
    np.testing.assert_array_equal(_turning(points, closed_curve), points[kept], err_msg=name)
