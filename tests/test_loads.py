"""Loads and weak supports on surfaces that no grid line follows: kernels, closed forms, rates, balance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import diags_array
from scipy.sparse.linalg import eigsh
from statics import (
    NU,
    RHO,
    YOUNG,
    Points,
    equilibrium,
    forces,
    linear_equilibrium,
    norm,
    one_body,
    rate,
    stiffness,
)

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.quadrature import surface_points
from phantomnode.pipeline.run import march
from phantomnode.pipeline.tally import Tally
from phantomnode.solver.explicit import frames
from phantomnode.solver.model import Loads
from phantomnode.solver.stress import cut_stress, element_stress
from phantomnode.solver.surface_loads import (
    add_loads,
    add_support_forces,
    load_power,
    support_energy,
    support_stiffness,
)
from phantomnode.solver.timestep import stable_step

RING = {"ring": {"centre": [0.013, 0.007], "outer": 0.5, "inner": 0.25}}
PLATE = {"polygon": {"points": [[0.0, 0.0], [0.91, 0.13], [0.8, 0.77], [-0.1, 0.6]]}}


def cartesian(cell, **more):
    return {"kind": "cartesian", "cell": cell, **more}


@pytest.fixture(scope="module")
def loaded():
    """A tilted plate with everything at once: follower, dead pressure, traction, gravity(t), weak and strong."""
    return one_body(
        PLATE,
        cartesian(0.17),
        gravity=["3e4*t/1e-3", -9.81],
        boundary={
            "push": {"on": "part.outer", "pressure": "2e8*sin(2000*t)**2"},
            "dead": {"on": "part.outer", "pressure": "1e8*sin(1500*t)**2", "follower": False},
            "pull": {"on": "part.outer", "traction": {"x": "3e7*(1 - cos(900*t))", "y": 0.0}},
            "hold": {"on": "part.outer", "displacement": {"y": "1e-3*sin(700*t)**2"}, "penalty": {"times_E": 10.0}},
            "grip": {
                "on": {"body": "part", "box": [[-0.11, 0.2], [0.05, 0.7]]},
                "velocity": {"x": "0.4*sin(2000*t)"},
            },
        },
    )  # fmt: skip


def random_field(model, size, seed=0):
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, model.x.shape)


# ---------------------------------------------------------------- kernels against NumPy twins and gradients


def twin_of_loads(loads: Loads, value, x, u):
    """Forces and resultants of all rows in NumPy."""
    force, applied = np.zeros_like(x), np.zeros((loads.rows, 2))
    f = loads.coefficient * value[loads.row]
    np.add.at(force, (loads.node, loads.axis), f)
    np.add.at(applied, (loads.row, loads.axis), f)
    line = np.einsum("qi,qia->qa", loads.point_slope, (x + u)[loads.point_nodes])
    at_points = value[loads.point_row][:, None] * np.column_stack([-line[:, 1], line[:, 0]])
    np.add.at(force, loads.point_nodes, loads.point_shape[:, :, None] * at_points[:, None])
    np.add.at(applied, loads.point_row, at_points)
    return force, applied, at_points


def test_load_kernels_agree_with_numpy(loaded):
    model = loaded.model
    loads, u, v = model.loads, random_field(model, 0.05), random_field(model, 3.0, 1)
    value = np.random.default_rng(2).uniform(-1e8, 1e8, loads.rows)
    force, applied = np.ones_like(u), np.full((loads.rows, 2), 7.0)
    at_points = np.full((len(loads.point_row), 2), 7.0)
    add_loads(loads, value, model.x, u, force, applied, at_points)
    expected = twin_of_loads(loads, value, model.x, u)
    scale = np.abs(expected[0]).max()
    np.testing.assert_allclose(force - 1.0, expected[0], atol=1e-13 * scale)
    np.testing.assert_allclose(applied, expected[1], atol=1e-13 * np.abs(applied).max())
    np.testing.assert_allclose(at_points, expected[2], atol=1e-13 * np.abs(at_points).max())
    power = np.sum(expected[0] * v)
    assert load_power(loads, value, at_points, v) == pytest.approx(power, abs=1e-13 * scale * v.size * 3)


def test_support_kernel_is_the_gradient_of_its_energy_and_agrees_with_numpy(loaded):
    supports, u = loaded.model.supports, random_field(loaded.model, 1e-3)
    held = np.random.default_rng(5).uniform(-1e-3, 1e-3, loaded.model.channels)
    force, reaction = np.zeros_like(u), np.full(loaded.model.channels, 7.0)
    add_support_forces(supports, held, u, force, reaction)
    on = supports.channel >= 0
    assert on[:, 1].all() and not on[:, 0].any()
    here = np.einsum("pi,pi->p", supports.shape, u[supports.nodes][:, :, 1])
    pull = -supports.stiffness * (here - held[supports.channel[:, 1]])
    expected = np.zeros_like(u)
    np.add.at(expected[:, 1], supports.nodes, supports.shape * pull[:, None])
    np.testing.assert_allclose(force, expected, atol=1e-13 * np.abs(expected).max())
    assert reaction[supports.channel[0, 1]] == pytest.approx(pull.sum(), rel=1e-12)
    direction = random_field(loaded.model, 1e-3, 3)
    change = [support_energy(supports, held, u + s * direction) for s in (-1.0, 1.0)]  # quadratic: exact
    assert (change[1] - change[0]) / 2.0 == pytest.approx(-np.sum(force * direction), rel=1e-11)


def test_a_follower_pressure_on_a_closed_curve_is_the_gradient_of_the_area_and_has_no_resultant():
    model = one_body(RING, cartesian(0.13), boundary={"p": {"on": "part.outer", "pressure": 1.0}}).model
    loads, pressure = model.loads, 3e6

    def enclosed(u):
        here = (model.x + u)[loads.point_nodes]
        point = np.einsum("qi,qia->qa", loads.point_shape, here)
        line = np.einsum("qi,qia->qa", loads.point_slope, here)
        return 0.5 * np.sum(point[:, 0] * line[:, 1] - point[:, 1] * line[:, 0])

    assert enclosed(0.0 * model.x) == pytest.approx(np.pi * 0.25, rel=0.02)
    u, direction = random_field(model, 0.02), random_field(model, 1.0, 4)
    force, applied = np.zeros_like(u), np.zeros((1, 2))
    add_loads(loads, np.array([pressure]), model.x, u, force, applied, np.zeros((len(loads.point_row), 2)))
    size = np.abs(force).sum()
    assert np.abs(applied).max() < 1e-13 * size
    here = model.x + u
    assert abs(np.sum(here[:, 0] * force[:, 1] - here[:, 1] * force[:, 0])) < 1e-13 * size
    change = enclosed(u + 1e-3 * direction) - enclosed(u - 1e-3 * direction)  # quadratic: exact
    assert np.sum(force * direction) == pytest.approx(-pressure * change / 2e-3, rel=1e-10)


def test_surface_points_measure_lengths_and_reproduce_places(loaded):
    body = loaded.bodies[0]
    chosen = np.arange(len(body.mesh.segments.ends))
    points = surface_points(body, chosen)
    ends = body.mesh.segments.ends
    assert points.length.sum() == pytest.approx(body.regions[0].outer.lengths.sum(), rel=1e-6)  # lattice
    np.testing.assert_allclose(points.shape.sum(axis=1), 1.0, atol=1e-14)
    line = np.einsum("qi,qia->qa", points.slope, body.mesh.xy[points.nodes])
    np.testing.assert_allclose(line, np.repeat(0.5 * (ends[:, 1] - ends[:, 0]), 2, axis=0), atol=1e-14)
    place = np.einsum("qi,qia->qa", points.shape, body.mesh.xy[points.nodes]).reshape(-1, 2, 2).mean(axis=1)
    np.testing.assert_allclose(place, ends.mean(axis=1), atol=1e-14)


def test_dead_and_follower_pressure_agree_on_the_undeformed_body():
    tables = {"p": {"on": "part.outer", "pressure": 1.0}}
    follower = one_body(PLATE, cartesian(0.17), boundary=tables).model
    tables["p"]["follower"] = False
    dead = one_body(PLATE, cartesian(0.17), boundary=tables).model
    zero = np.zeros_like(dead.x)
    one, other = forces(follower, zero, [1e6]), forces(dead, zero, [1e6])
    np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(one).max())
    moved = random_field(dead, 0.02)
    with_load, without = forces(dead, moved, [1e6]), forces(dead, moved, [0.0])
    np.testing.assert_allclose(with_load - without, other, atol=1e-6 * np.abs(other).max())  # dead: as before


def test_classic_xfem_takes_no_loads():
    with pytest.raises(CaseError, match="classic X-FEM runs without tractions"):
        one_body(PLATE, cartesian(0.17), method="xfem", boundary={"p": {"on": "part.outer", "pressure": 1.0}})


# ------------------------------------------------------------------------------ closed forms of statics

STRETCH = {1.5: (3.534179e9, 0.8404896), 2.0: (5.125862e9, 0.7429971)}
"""Uniaxial plane strain, side free: Cauchy stress, Pa, and the other stretch (E = 10 GPa, nu = 0.3)."""


@pytest.mark.parametrize("stretch", STRETCH)
@pytest.mark.parametrize("kind", ["traction", "follower"])
def test_a_bar_under_traction_or_follower_pressure_has_the_closed_form_stretch(stretch, kind):
    """A bar that no grid line follows, on weak rollers; every element has the same stress."""
    cauchy, across = STRETCH[stretch]
    pull = {"traction": {"x": 1.0}} if kind == "traction" else {"pressure": 1.0}
    case = one_body(
        {"rectangle": {"low": [0.03, 0.04], "high": [0.93, 0.36]}},
        cartesian(0.2, box=[[-0.1, -0.1], [1.1, 0.5]]),
        relocation={"distance": 0.0},  # rectangular cells, in which every integral is exact
        boundary={
            "left": {"on": "part.left", "displacement": {"x": 0.0}},
            "base": {"on": "part.bottom", "displacement": {"y": 0.0}},
            "pull": {"on": "part.right", **pull},
        },
    )
    assert {b.kind for b in case.boundaries} == {"weak", "load"}
    # A dead traction is per reference length: the bar gets thinner. Kernel figures have seven digits.
    value = [cauchy * across] if kind == "traction" else [-cauchy]
    u = equilibrium(case.model, value, np.zeros_like(case.model.x))
    for stress, _, j in (element_stress(case.model.elements, u), cut_stress(case.model.cut_elements, u)):
        np.testing.assert_allclose(stress[:, 0], cauchy, rtol=1e-6)
        np.testing.assert_allclose(stress[:, [1, 3]], 0.0, atol=1e-6 * cauchy)
        np.testing.assert_allclose(j, stretch * across, rtol=1e-6)


def lame_ring(points, pressure):
    """Displacement and stress xx, yy, xy of the ring under inner pressure at (p, 2) points (plane strain)."""
    inner, outer = 0.25, 0.5
    from_centre = points - np.array([0.013, 0.007])
    r = np.hypot(*from_centre.T)
    c, s = from_centre.T / r
    a = pressure * inner**2 / (outer**2 - inner**2)
    radial = (1 + NU) / YOUNG * (a * (1 - 2 * NU) * r + a * outer**2 / r)
    srr, stt = a * (1 - outer**2 / r**2), a * (1 + outer**2 / r**2)
    stress = [srr * c**2 + stt * s**2, srr * s**2 + stt * c**2, (srr - stt) * c * s]
    return radial[:, None] * np.column_stack([c, s]), np.column_stack(stress)


def test_the_closed_form_of_the_ring_has_the_known_figures():
    """formulation.md, section 7: u(a), u(b) and the hoop stress at a."""
    u, stress = lame_ring(np.array([[0.263, 0.007], [0.513, 0.007]]), 1e6)
    np.testing.assert_allclose(u[:, 0], [4.766667e-5, 3.033333e-5], rtol=1e-6)
    np.testing.assert_allclose(stress[0, 1], 1.666667e6, rtol=1e-6)


def ring_errors(cell):
    """Relative L2 errors of displacement and stress of the ring on a Cartesian grid."""
    pressure = 1e3  # small: what is left of finite strain is 1e-7
    case = one_body(RING, cartesian(cell), boundary={"p": {"on": "part.inner", "pressure": pressure}})
    u, points = linear_equilibrium(case.model, [pressure]), Points(case)
    applied, left = forces(case.model, 0.0 * u, [pressure]), forces(case.model, u, [pressure])
    assert np.abs(left).max() < 1e-5 * np.abs(applied).max()  # the kernels agree: it is their equilibrium
    exact, stress = lame_ring(points.x, pressure)[0], lame_ring(points.stress_x, pressure)[1]
    return (
        norm(points.displacement(u) - exact, points.weight) / norm(exact, points.weight),
        norm(points.stress(u) - stress, points.stress_weight) / norm(stress, points.stress_weight),
    )


def test_lame_ring_under_pressure_converges_with_the_rates_of_bilinear_elements():
    """An unfitted circle on four grids whose lines lie anywhere to it: rates 2 and 1 by theory."""
    cells = [1 / 11, 1 / 20, 1 / 37, 1 / 69]
    of_displacement, of_stress = zip(*(ring_errors(cell) for cell in cells), strict=True)
    assert rate(cells, of_displacement) >= 1.8 and rate(cells, of_stress) >= 0.9
    assert of_displacement[-1] < 2e-3 and of_stress[-1] < 0.02  # measured 9.9e-4 and 1.15e-2


def test_a_weak_clamp_converges_to_the_strong_one():
    """The same clamp on a grid line, by springs of 20 E/h and by nodes: the slip falls with h."""
    cells, slips = [0.1, 0.05, 0.025], []
    for cell in cells:
        tips = []
        for weak in (True, False):
            case = one_body(
                {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 0.4]}},
                cartesian(cell, aligned=True),
                boundary={
                    "clamp": {"on": "part.left", "displacement": {"x": 0.0, "y": 0.0}, "weak": weak},
                    "pull": {"on": "part.right", "traction": {"x": 1e5, "y": 2e4}},
                },
            )
            assert case.boundaries[0].kind == ("weak" if weak else "held")
            u = linear_equilibrium(case.model, [1e5, 2e4])
            tips.append(u[np.isclose(case.model.x[:, 0], 1.0)].mean(axis=0))
        slips.append(np.hypot(*(tips[0] - tips[1])) / np.hypot(*tips[1]))
    assert rate(cells, slips) > 0.8 and slips[-1] < 0.01


def test_a_weak_support_bears_the_weight():
    """Equilibrium: the springs of a slanted edge carry the weight and the traction."""
    case = one_body(
        PLATE,
        cartesian(0.11),
        gravity=[0.0, -1000.0],
        boundary={"hold": {"on": "part.outer", "displacement": {"x": 0.0, "y": 0.0}}},
    )
    u = linear_equilibrium(case.model)
    reaction = np.zeros(2)
    add_support_forces(case.model.supports, np.zeros(2), u, np.zeros_like(u), reaction)
    weight = 1000.0 * RHO * case.bodies[0].mesh.area.sum()
    np.testing.assert_allclose(reaction, [0.0, weight], atol=1e-7 * weight)


def test_the_stable_step_covers_the_springs():
    """The estimate is never above 2 over the true highest frequency, whatever the penalty."""
    for times in (1.0, 30.0, 1000.0):
        case = one_body(
            PLATE,
            cartesian(0.11),
            boundary={
                "hold": {
                    "on": "part.outer",
                    "displacement": {"x": 0.0, "y": 0.0},
                    "penalty": {"times_E": times},
                }
            },
        )
        matrix, half = stiffness(case.model), np.repeat(case.model.mass, 2) ** -0.5
        highest = eigsh(diags_array(half) @ matrix @ diags_array(half), 1, return_eigenvectors=False)[0]
        limit, estimate = 2.0 / np.sqrt(highest), stable_step(case.model, safety=1.0).dt
        assert 0.4 * limit < estimate < limit * (1 + 1e-9)
        assert np.all(support_stiffness(case.model.supports, len(case.model.x)) >= 0.0)


# ------------------------------------------------------------------------------------------- in motion


def run(prepared, dt, steps_at, **more):
    return list(frames(prepared.model, prepared.velocity, dt, steps_at, prepared.motion, 1.0, **more))


def test_the_balance_of_all_loads_closes_with_the_step_squared(loaded):
    base = stable_step(loaded.model, 0.25).dt
    end, steps = 2e-3, base / np.array([1.0, 2.0, 4.0])
    errors = []
    for dt in steps:
        count = round(end / dt)
        history = run(loaded, dt, np.unique(np.linspace(0, count, 81).astype(int)))
        largest = history[-1].largest_energy
        errors.append(max(frame.energy_error * frame.largest_energy for frame in history) / largest)
    assert 1.7 < rate(steps, errors) < 2.4 and errors[-1] < 1e-3


def test_impulses_of_loads_and_springs_are_the_change_of_momentum():
    case = one_body(
        PLATE,
        cartesian(0.17),
        gravity=["1e4*sin(3000*t)", 0.0],
        boundary={
            "push": {"on": "part.outer", "pressure": "1e8*t/1e-3"},
            "pull": {"on": "part.outer", "traction": {"x": 1e7}},
            "hold": {"on": "part.outer", "displacement": {"x": "1e-3*t", "y": 0.0}},
        },
    )
    tally = Tally(case)
    ending, _ = march(case, [tally])
    assert ending.status == "done"
    momentum = tally.momentum(case.bodies[0])
    assert momentum.error is not None and momentum.error < 1e-11
    assert np.hypot(*momentum.end) > 10.0


def test_gravity_that_grows_gives_the_cubic():
    """g = k t: u = k t^3/6; sums of the central difference scheme differ by k dt^2 t/6."""
    case = one_body(RING, cartesian(0.13), gravity=[0.0, "-5e3*t"])
    dt = 1e-5
    frame = run(case, dt, [400])[0]
    t = frame.time
    np.testing.assert_allclose(frame.u[:, 1], -5e3 * (t**3 - dt**2 * t) / 6.0, rtol=1e-9)
    np.testing.assert_allclose(frame.u[:, 0], 0.0, atol=1e-15)
    assert frame.energies.external_work == pytest.approx(frame.energies.kinetic, rel=1e-10)


def test_chunks_and_resuming_change_no_bit(loaded):
    dt = loaded.dt
    whole = run(loaded, dt, [200])
    parts = run(loaded, dt, list(range(0, 201, 7)) + [200])
    again = run(loaded, dt, [200], resume=parts[10])
    for other in (parts[-1], again[-1]):
        for one, two in zip(whole[0].state, other.state, strict=True):
            np.testing.assert_array_equal(one, two)
        assert whole[0].energies == other.energies


def test_the_ring_breathes_to_the_closed_form():
    """Through the explicit run: a smooth ramp over eight periods leaves the static state within a percent."""
    ramp = "min(t/0.015, 1)"
    case = one_body(
        RING,
        cartesian(0.025),
        time={"end": 0.02},
        boundary={"p": {"on": "part.inner", "pressure": f"1e6*{ramp}**3*(10 - 15*{ramp} + 6*{ramp}**2)"}},
    )
    tally = Tally(case)
    march(case, [tally])
    assert tally.last is not None
    points = Points(case)
    exact = lame_ring(points.x, 1e6)[0]
    error = norm(points.displacement(tally.last.u) - exact, points.weight) / norm(exact, points.weight)
    assert error < 0.01 and tally.energy_error_max < 1e-4
