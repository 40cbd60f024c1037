"""Contact through the whole pipeline against closed and reference solutions, quasi-static and at large sliding."""

from __future__ import annotations

import numpy as np
import pytest
from physics import (
    LAME,
    NU,
    SHEAR,
    YOUNG,
    cartesian,
    disc,
    held_frames,
    mean_force,
    mean_point_pressure,
    mean_pressure,
    prepared_case,
    rectangle,
    run_frames,
    smooth,
    total_energy,
)
from scipy.optimize import brentq
from statics import forces

PENALTY = 100.0 * YOUNG
RAMP, HOLD = 0.025, 0.015
"""Ramp and hold of the patch tests, s: 20 periods of the block, then the mean of 10; 2e-5 of the force rings."""

PAIR_100E = {"penalty": {"times_E": 100.0}}


def squeezed(interfaces):
    """Force and pressure on a unit block between frictionless platens, pushed 0.1 m, its sides free.

    Uniaxial plane strain of the Hencky law, tau_x = 0, in series with the springs of the interfaces,
    eps g on the reference length (the solver's energy eps w g^2/2 with reference weights).

    Returns
    -------
    force, N/m; pressure, Pa, per current length.
    """
    force, s, side = squeezed_state(interfaces)
    return force, force / side


def squeezed_state(interfaces):
    """Force, N/m, and the stretches along and across it."""

    def across(s):
        return s ** (-LAME / (LAME + 2.0 * SHEAR))

    def force(s):
        tau = LAME * np.log(s * across(s)) + 2.0 * SHEAR * np.log(s)
        return -tau / s

    s = brentq(lambda s: 0.1 - (1.0 - s) - interfaces * force(s) / PENALTY, 0.9, 0.99)
    return force(s), s, across(s)


def pressed(*tables, **more):
    """The case between platens, and its frames of the hold."""
    prepared = pressed_case(*tables, **more)
    return prepared, held_frames(prepared, RAMP)


def pressed_case(bodies, contact, bottom, top, **more):
    """The bodies between platens without friction; the upper one comes down by 0.1 m and stays."""
    boundary = {
        "below": {"on": bottom, "displacement": {"y": 0.0}},
        "above": {"on": top, "displacement": {"y": smooth(-0.1, RAMP)}},
    }
    return prepared_case(bodies, RAMP + HOLD, contact=contact, boundary=boundary, **more)


def split_block(counts, y):
    prepared = split_block_case(counts, y)
    return prepared, held_frames(prepared, RAMP)


def split_block_case(counts, y):
    """A unit block that a straight interface splits."""
    return pressed_case(
        {"block": rectangle((0.0, 0.0), (1.0, 1.0), cartesian(1.0 / counts))},
        {"mid": {"slave": "mid_line.plus", "master": "mid_line.minus", **PAIR_100E}},
        "block.bottom",
        "block.top",
        interface={
            "mid_line": {"body": "block", "geometry": {"polyline": {"points": [[-0.1, y], [1.1, y]]}}}
        },
    )


def stacked(heights, grids, **pair):
    """Blocks of unit width on top of each other, each on its own grid."""
    levels = np.concatenate([[0.0], np.cumsum(heights)])
    bodies = {
        f"b{k}": rectangle((0.0, levels[k]), (1.0, levels[k + 1]), grid) for k, grid in enumerate(grids)
    }
    contact = {
        f"c{k}": {"slave": f"b{k + 1}.bottom", "master": f"b{k}.top", **PAIR_100E, **pair}
        for k in range(len(heights) - 1)
    }
    shared = {"whole": cartesian(0.1, box=[[0.0, 0.0], [1.0, 1.0]])}
    return pressed(bodies, contact, "b0.bottom", f"b{len(heights) - 1}.top", grid=shared)


MATCHING = [(11, 0.5), (10, 0.5), (10, 0.5137), (10, 0.4863)]
"""Cells a side, and the height of the interface: in the cells, on a grid line, off it with relocated corners."""


@pytest.mark.parametrize(("counts", "y"), MATCHING)
def test_the_closed_form_is_the_equilibrium_of_matching_sides(counts, y):
    """Put at the closed form, no free node is pushed: 1e-12 of the pressure on a cell.

    Crooked corner cells included: their slave points and masters have the integrals of the shape functions.
    """
    prepared = split_block_case(counts, y)
    model, mesh = prepared.model, prepared.bodies[0].mesh
    force, s, side = squeezed_state(1)
    upper = np.zeros(len(model.x), dtype=bool)
    upper[
        mesh.elements[mesh.component == mesh.component[np.argmax(model.x[mesh.elements].mean(axis=1)[:, 1])]]
    ] = True
    u = np.column_stack([(side - 1.0) * model.x[:, 0], (s - 1.0) * model.x[:, 1] - upper * force / PENALTY])
    pushed = np.where(model.channel < 0, forces(model, u), 0.0)
    assert np.abs(pushed).max() < 1e-12 * force / counts


@pytest.mark.parametrize(("counts", "y"), MATCHING)
def test_split_block_is_the_closed_form_on_matching_sides(counts, y):
    """In the cells, on a grid line, and off it: the uniform state is the equilibrium, so 1e-5 (what rings).

    1.268298e9 N/m and 1.213003e9 Pa is the same with a penalty per current length; 6e-4 off, below the 1e-3 asked.
    Where corner cells are relocated, 5e-4: a phantom node hangs on a sliver there and rings longer than the rest.
    """
    prepared, held = split_block(counts, y)
    force, pressure = squeezed(1)
    assert mean_force(held)[1] == pytest.approx(force, rel=1e-5)
    assert force == pytest.approx(1.268298e9, rel=1e-3)
    rough = 5e-4 if prepared.bodies[0].relocated else 1e-5
    np.testing.assert_allclose(mean_pressure(prepared, held)[1], pressure, rtol=rough)
    assert pressure == pytest.approx(1.213003e9, rel=1e-3)
    reactions = np.mean([frame.reaction for frame in held], axis=0)
    np.testing.assert_allclose(reactions, [force, -force], rtol=1e-5)


@pytest.mark.parametrize(("points", "rough"), [(2, 0.1), (4, 0.01)])
def test_block_on_block_of_another_grid(points, rough):
    """11 cells on 14: the force within 1e-3, the pressure within 10 % (2 points a segment) or 1 % (4).

    The issue's figures; measured 5e-5 and 1e-6, 5.5 % and 0.7 %.
    """
    grids = [cartesian(1.0 / 11), cartesian(1.0 / 14)]
    prepared, held = stacked([0.5, 0.5], grids, points={"count": points})
    force, pressure = squeezed(1)
    assert mean_force(held)[1] == pytest.approx(force, rel=1e-3)
    np.testing.assert_allclose(mean_pressure(prepared, held)[1], pressure, rtol=rough)


def test_bodies_on_one_shared_grid_are_a_body_with_an_interface():
    """Two blocks cut out of the very same grid, which reaches beyond both: surfaces against void.

    The fragments, and so the numbers, are those of one block that the interface splits; 1e-9 for the order
    of the additions, over some thousand steps. Without points at the corners, which an interface has none of.
    """
    _, apart = stacked([0.5137, 0.4863], ["whole", "whole"], corners=False)
    _, inside = split_block(10, 0.5137)
    np.testing.assert_allclose(apart[-1].pair_force, inside[-1].pair_force, rtol=1e-9, atol=1.0)
    assert mean_force(apart)[1] == pytest.approx(squeezed(1)[0], rel=1e-5)


def test_surfaces_against_void_inside_cells_carry_the_closed_form():
    """Both surfaces of the pair run inside cells of two different grids that overlap each other."""
    lower = cartesian(0.1, box=[[0.0, 0.0], [1.0, 0.6]])
    upper = cartesian(0.1, box=[[0.0, 0.43], [1.0, 1.0]])
    prepared, held = stacked([0.5137, 0.4863], [lower, upper])
    assert all((body.mesh.fraction < 1.0).any() for body in prepared.bodies)
    assert mean_force(held)[1] == pytest.approx(squeezed(1)[0], rel=1e-5)


def test_several_pairs_at_once_carry_the_same_force():
    """Three blocks, two pairs: the force of the closed form with two springs in series, in both; 1e-4.

    Where the grids differ the springs of the points bend the surfaces a little: 5e-5.
    """
    _, held = stacked([0.3, 0.4, 0.3], [cartesian(0.1), cartesian(1.0 / 7), cartesian(0.1)])
    force, _ = squeezed(2)
    for pair in (0, 1):
        assert mean_force(held, pair)[1] == pytest.approx(force, rel=1e-3)


@pytest.mark.parametrize(
    ("left", "right", "rough"), [(0.45, 0.55, 1e-3), (0.3, 0.7, 4e-3), (0.02, 0.93, 4e-2)], ids=str
)
def test_slanted_interface_carries_a_hydrostatic_state(left, right, rough):
    """Compressed by the same stretch in x and y, a slanted frictionless interface leaves the state uniform.

    The upper platen goes down by the gap of the springs more. The force is within 1e-3 of the closed form at
    any slope; with masters that do not follow the shape functions of their cells it errs by 0.05, 0.7 and 4 %.
    """
    stretch, ramp = 0.95, 0.03
    tau = 2.0 * (LAME + SHEAR) * np.log(stretch)
    slope = right - left
    length = np.hypot(1.0, slope)
    gap = -tau / stretch / PENALTY
    ends = [[-0.1, left - 0.1 * slope], [1.1, right + 0.1 * slope]]
    moves = {
        "left": {"x": 0.0},
        "bottom": {"y": 0.0},
        "right": {"x": smooth(stretch - 1.0, ramp)},
        "top": {"y": smooth(stretch - 1.0 - gap * length, ramp)},
    }
    prepared = prepared_case(
        {"block": rectangle((0.0, 0.0), (1.0, 1.0), cartesian(1.0 / 11))},
        ramp + HOLD,
        interface={"line": {"body": "block", "geometry": {"polyline": {"points": ends}}}},
        contact={"pair": {"slave": "line.plus", "master": "line.minus", **PAIR_100E}},
        boundary={side: {"on": f"block.{side}", "displacement": move} for side, move in moves.items()},
    )
    held = held_frames(prepared, ramp)
    normal = np.array([-slope, 1.0]) / length
    np.testing.assert_allclose(
        mean_force(held), -tau / stretch * length * normal, rtol=0, atol=-1e-3 * tau / stretch * length
    )
    np.testing.assert_allclose(mean_pressure(prepared, held)[1], -tau / stretch**2, rtol=rough)


def spring_layer_peak(force, radius, modulus, penalty, count=300):
    """Peak pressure, Pa, of a parabola 1/(2 R) pressed on a half plane through springs eps, and half width, m.

    The displacement under a line load, -2/(pi E*) ln|x - s|, is integrated over cells of constant pressure;
    which cells touch is found by turns. Against plain Hertz, beta = E*/(eps a): .970 at .1, .920 at .3, .803
    at 1, .650 at 3.
    """
    hertz = np.sqrt(4.0 * force * radius / (np.pi * modulus))
    reach = hertz * (1.0 + 2.0 * min(2.0, modulus / (penalty * hertz)))
    x = (np.arange(count) + 0.5) / count * 2.0 * reach - reach
    width = 2.0 * reach / count
    far, near = x[:, None] - x + 0.5 * width, x[:, None] - x - 0.5 * width
    line = far * (np.log(np.abs(far)) - 1.0) - near * (np.log(np.abs(near)) - 1.0)
    compliance = -2.0 / (np.pi * modulus) * line + np.eye(count) / penalty
    touching = np.abs(x) < hertz
    while True:
        k = np.count_nonzero(touching)
        matrix = np.block(
            [[compliance[np.ix_(touching, touching)], -np.ones((k, 1))], [np.full((1, k), width), 0.0]]
        )
        solved = np.linalg.solve(matrix, np.append(-(x[touching] ** 2) / (2.0 * radius), force))
        pressure = np.zeros(count)
        pressure[touching] = solved[:-1]
        overlap = solved[-1] - x**2 / (2.0 * radius) - compliance @ pressure
        now = np.where(touching, pressure > 0.0, overlap > 0.0)
        if np.array_equal(now, touching):
            return pressure.max(), x[touching].max() + 0.5 * width
        touching = now


@pytest.mark.parametrize(("beta", "factor"), [(0.1, 0.970), (0.3, 0.920), (1.0, 0.803), (3.0, 0.650)])
def test_the_reference_of_the_spring_layer(beta, factor):
    modulus, radius, force = 1e10, 1.0, 1e6
    hertz = np.sqrt(4.0 * force * radius / (np.pi * modulus))
    peak, _ = spring_layer_peak(force, radius, modulus, modulus / (beta * hertz))
    assert peak / (2.0 * force / (np.pi * hertz)) == pytest.approx(factor, abs=1e-3)


def pressed_disc(cells, beta, centre, half_width=0.04):
    """A disc of 1 m radius on a rigid flat; ``cells`` to the half width of Hertz, about.

    Returns the ratio of the peak pressure to the reference, and the cells in the half width of the reference.
    """
    end, ramp, modulus = 0.03, 0.02, YOUNG / (1.0 - NU**2)
    force = 0.25 * np.pi * modulus * half_width**2
    down = force / (np.pi * modulus) * (2.0 * np.log(4.0 / half_width) - 1.0)
    x, y = centre
    cell = half_width / cells
    bodies = {
        "disc": disc((x, 1.0 + y), 1.0, cell),
        "flat": rectangle((-0.5, y - 0.1), (0.5, y), cartesian(0.1)),
    }
    contact = {
        "landing": {
            "slave": "disc.outer",
            "master": "flat.top",
            "penalty": {"value": modulus / (beta * half_width)},
        }
    }
    whole = {"body": "flat", "box": [[-1.0, -1.0], [1.0, 1.0]]}
    upper_half = {"body": "disc", "box": [[-2.0, 1.0 + y], [2.0, 3.0]]}
    boundary = {
        "rigid": {"on": whole, "displacement": {"x": 0.0, "y": 0.0}},
        "push": {"on": upper_half, "displacement": {"x": 0.0, "y": smooth(-down, ramp)}},
    }
    prepared = prepared_case(bodies, end, contact=contact, boundary=boundary)
    held = held_frames(prepared, ramp)
    pressure = mean_point_pressure(prepared, held)
    reference, a = spring_layer_peak(
        mean_force(held)[1], 1.0, modulus, float(prepared.model.contact.penalty[0])
    )
    return pressure.max() / reference, a / cell


def test_peak_pressure_of_a_cut_disc_on_a_flat():
    """3 % from 1.8 cells in the half width on (the issue's figure), with the default penalty of 5 E/h."""
    ratio, cells = pressed_disc(1.8, 0.12, (0.013, 0.0071))
    assert 1.8 < cells < 2.0 and ratio == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("beta", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("cells", [1.8, 2.4, 3.5])
def test_peak_pressure_of_cut_discs_wherever_the_cut_lies(cells, beta):
    for centre in ((0.0, 0.0), (0.013, 0.0071), (0.003, 0.011)):
        ratio, inside = pressed_disc(cells, beta, centre)
        print(f"beta {beta}, {inside:.2f} cells in the half width, centre {centre}: {ratio:.4f}")
        assert ratio == pytest.approx(1.0, abs=0.03)


def clamped_block(counts):
    """Example 4.1 of the paper: a unit block, split at half height, clamped and pushed 0.1 m from above."""
    end, ramp = 0.06, 0.04
    middle = {"polyline": {"points": [[-0.1, 0.5], [1.1, 0.5]]}}
    prepared = prepared_case(
        {"block": rectangle((0.0, 0.0), (1.0, 1.0), cartesian(1.0 / counts))},
        end,
        interface={"mid": {"body": "block", "geometry": middle}},
        contact={"pair": {"slave": "mid.plus", "master": "mid.minus", **PAIR_100E}},
        boundary={
            "below": {"on": "block.bottom", "displacement": {"x": 0.0, "y": 0.0}},
            "above": {"on": "block.top", "displacement": {"x": 0.0, "y": smooth(-0.1, ramp)}},
        },
    )
    return prepared, held_frames(prepared, ramp)


@pytest.mark.parametrize("counts", [11, 22])
def test_clamped_block_has_the_force_and_pressure_of_fine_conforming_elements(counts):
    """A static solution with conforming nine-node elements: 1.3314e9 N/m, 1.3740e9 Pa in the middle.

    1.5 % is the issue's figure; measured 0.1 % for the force and 0.4 % for the pressure.
    """
    prepared, held = clamped_block(counts)
    assert mean_force(held)[1] == pytest.approx(1.3314e9, rel=2e-3)
    x, pressure = mean_pressure(prepared, held)
    along = np.argsort(x)
    at = np.interp([x.min() + 0.5 * np.ptp(x)], x[along], pressure[along])
    np.testing.assert_allclose(at, 1.3740e9, rtol=5e-3)


@pytest.mark.parametrize(("slave", "master"), [("wave.plus", "wave.minus"), ("wave.minus", "wave.plus")])
def test_wavy_block_dragged_over_its_lower_half(slave, master):
    """Example 4.3 of the paper: dragged 1 m in 0.2 s over a sinusoidal interface, until the ends overhang.

    Points pass both ends of the master and the corners of the halves. 1 % of the largest work; measured
    0.01 % with the upper half as slave and 0.3 % with the lower one (the error falls with the step).
    """
    prepared = prepared_case(
        {"block": rectangle((0.0, 0.0), (2.0, 1.0), cartesian(0.05))},
        0.2,
        interface={"wave": {"body": "block", "geometry": {"function": "0.5 + 0.05*sin(5*pi*x/2)"}}},
        contact={"pair": {"slave": slave, "master": master, **PAIR_100E}},
        boundary={
            "base": {"on": "block.bottom", "displacement": {"x": 0.0, "y": 0.0}},
            "drag": {"on": "block.top", "displacement": {"x": "5*t", "y": 0.0}},
        },
    )
    sequence = list(run_frames(prepared, 400))
    work = max(abs(frame.energies.external_work) for frame in sequence)
    whole = total_energy(sequence[0])
    error = max(abs(total_energy(frame) - whole) for frame in sequence)
    print(f"{sequence[-1].step} steps, energy error {error / work:.2e} of the largest work {work:.4g} J/m")
    assert sequence[-1].time == pytest.approx(0.2) and error < 0.01 * work
    # Crest against crest at a drag of half a wave, 0.4 m: the largest work; trough in trough at 0.8 m: none left.
    drag = [5.0 * frame.time for frame in sequence]
    assert drag[int(np.argmax([frame.energies.internal for frame in sequence]))] == pytest.approx(
        0.4, abs=0.03
    )
    assert (
        min(f.energies.internal for f, d in zip(sequence, drag, strict=True) if 0.7 < d < 0.9) < 0.05 * work
    )
