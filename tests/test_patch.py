"""Homogeneous fields through the whole pipeline: a cut body with an interface, a crack and relocated nodes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.prepare import prepare
from phantomnode.solver.explicit import energies
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import evaluate_forces, initial_state
from phantomnode.solver.stress import cut_stress, element_stress

YOUNG, NU = 1e10, 0.3
LAME = YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
SHEAR = YOUNG / (2 * (1 + NU))

OPTIONS = {
    "default": {},
    "full": {"integration": {"uncut": "full"}},
    "one point a triangle": {"integration": {"cut": 1}},
    "full and one": {"integration": {"uncut": "full", "cut": 1}},
    "alpha": {"integration": {"alpha": 10.0, "alpha_below": 0.3}},
    "viscous hourglass": {"hourglass": {"viscosity": 0.05}},
}
GRIDS = {
    "cartesian": {"kind": "cartesian", "cell": 0.11},
    "mapped": {
        "kind": "mapped",
        "bottom": {"polyline": {"points": [[-0.3, -0.3], [1.4, -0.2]]}},
        "right": {"polyline": {"points": [[1.4, -0.2], [1.5, 1.5]]}},
        "top": {"polyline": {"points": [[-0.4, 1.3], [1.5, 1.5]]}},
        "left": {"polyline": {"points": [[-0.3, -0.3], [-0.4, 1.3]]}},
        "counts": [15, 14],
    },
}
LATTICE = 2.0**-22 * 4.0
"""Of a cell: what snapping moves the corners of a fragment by, times the edges of a cell."""
AREA = 0.6 * 0.9
"""Of the tilted rectangle."""


@cache
def tilted(option="default", grid="cartesian"):
    """A rectangle turned by 17 degrees, split by an open curve, with a crack; its sides cut the grid."""
    table = {
        "time": {"end": 1e-3},
        "material": {"m": {"E": YOUNG, "nu": NU, "rho": 7800.0}},
        "body": {
            "block": {
                "geometry": {
                    "rectangle": {"low": [0.1, 0.0], "high": [1.0, 0.6]}, "rotate": 17.0,
                },
                "grid": GRIDS[grid],
                "material": "m",
            }
        },
        "interface": {
            "split": {
                "body": "block",
                "geometry": {"function": "0.35 + 0.05*sin(6*x)", "x": [-1.0, 2.0]},
            },
            "crack": {"body": "block", "geometry": {"polyline": {"points": [[0.4, 0.21], [0.71, 0.24]]}}},
        },
        **OPTIONS[option],
    }  # fmt: skip
    return prepare(case_from_table(table))


def state_at(prepared, u):
    model = prepared.model
    layout = prepare_layout(model)
    state = initial_state(model, np.zeros_like(model.x), layout)
    state.u[:] = u
    assert evaluate_forces(model, layout, state) == 0
    return state


def affine(prepared, f):
    return prepared.model.x @ (np.asarray(f) - np.eye(2)).T


def all_stresses(prepared, u):
    model = prepared.model
    uncut = cut_stress(model.full, u) if len(model.full.weight) else element_stress(model.elements, u)
    return np.vstack([uncut[0], cut_stress(model.cut_elements, u)[0]])


def piola(prepared, f):
    """P of the body from its nodal forces, sum f_I X_I = -V P; the area is that of the drawing."""
    force = state_at(prepared, affine(prepared, f)).force
    return -np.einsum("ia,ib->ab", force, prepared.model.x) / AREA


def kirchhoff(f):
    """By eigenvalues, NumPy alone."""
    values, vectors = np.linalg.eigh(f @ f.T)
    log_b = vectors @ np.diag(np.log(values)) @ vectors.T
    return LAME * 0.5 * np.trace(log_b) * np.eye(2) + SHEAR * log_b


def test_the_body_is_what_the_test_needs():
    mesh, body = tilted().bodies[0].mesh, tilted().bodies[0]
    assert mesh.area.sum() == pytest.approx(AREA, rel=1e-8)  # the lattice: 2^-22 of a cell
    assert body.relocated > 3 and np.unique(mesh.component).size == 2
    assert np.max(np.bincount(mesh.cell)) == 3 and mesh.fraction.min() < 0.3


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("kind", GRIDS)
@pytest.mark.parametrize(
    "f", [[[1.3, 0.2], [-0.1, 0.8]], [[1.0, 1.5], [0.0, 1.0]], [[1.0 + 1e-6, 0.0], [1e-6, 1.0]]]
)
def test_patch(option, kind, f):
    prepared = tilted(option, kind)
    mesh, f = prepared.bodies[0].mesh, np.array(f)
    u = affine(prepared, f)
    sigma, stress = kirchhoff(f) / np.linalg.det(f), all_stresses(prepared, u)
    # 1e-10 of the stress; at strains of 1e-6, of which H keeps ten digits, EPS E is 1e-10 too.
    small = 1e-10 * np.abs(sigma).max() + 4e-16 * YOUNG
    np.testing.assert_allclose(stress[:, [0, 1, 3]] - sigma[[0, 1, 0], [0, 1, 1]], 0.0, atol=small)

    # The copies of a node inside share what the pieces of its cells push, and that sums to nothing.
    if option == "alpha":
        return  # its pieces push alpha times
    force, grid = state_at(prepared, u).force, prepared.bodies[0].grid
    total = np.stack([np.bincount(mesh.grid_node, force[:, k], len(grid.xy)) for k in (0, 1)], axis=1)
    filled = np.bincount(mesh.cell, mesh.area, len(grid.quads)) > (1.0 - LATTICE) * grid.areas
    inside = np.bincount(grid.quads.ravel(), np.repeat(filled, 4), len(grid.xy)) == 4
    crossed = np.unique(grid.quads[np.unique(mesh.cell[mesh.cut])])
    assert inside.sum() > 12 and inside[crossed].sum() > 5
    rest, largest = np.hypot(*total[inside].T), np.abs(force).max()
    # Nothing is left but rounding: the cut stands on the straight edges that two cells have in common.
    assert rest.max() < 1e-12 * largest + 1e-15 * YOUNG


@pytest.mark.parametrize("option", ["default", "full", "one point a triangle"])
def test_uniaxial_stretch_with_free_sides(option):
    """Cauchy stress and the other stretch of plane strain; P through the nodal forces of the whole body."""
    for stretch, stress, side in (
        (1.5, 3.534179e9, 0.8404896),
        (2.0, 5.125862e9, 0.7429971),
        (3.0, 6.444101e9, 0.6244813),
    ):
        free = brentq(lambda s, a=stretch: kirchhoff(np.diag([a, s]))[1, 1], 0.1, 1.5, xtol=1e-15)
        assert free == pytest.approx(side, rel=1e-7)
        f = np.diag([stretch, free])
        stresses = all_stresses(tilted(option), affine(tilted(option), f))
        np.testing.assert_allclose(stresses[:, 0], stress, rtol=1e-6)
        np.testing.assert_allclose(stresses[:, [1, 3]], 0.0, atol=1e-6 * stress)
        p = piola(tilted(option), f)
        assert p[0, 0] == pytest.approx(stress * free, rel=1e-6)
        assert np.abs(p - np.diag([p[0, 0], 0.0])).max() < 1e-6 * stress


@pytest.mark.parametrize("option", ["default", "full", "one point a triangle"])
def test_simple_shear_and_confined_stretch(option):
    for f, s11, s22, s12 in (
        ([[1.0, 1.0], [0.0, 1.0]], 1.655419e9, None, 3.310838e9),
        ([[1.0, 2.0], [0.0, 1.0]], 4.794040e9, None, 4.794040e9),
        ([[1.5, 0.0], [0.0, 1.0]], 3.638789e9, 1.559481e9, 0.0),
    ):
        f = np.array(f)
        stresses = all_stresses(tilted(option), affine(tilted(option), f))
        np.testing.assert_allclose(stresses[:, 0], s11, rtol=1e-6)
        np.testing.assert_allclose(stresses[:, 3], s12, rtol=1e-6, atol=1e-6 * s11)
        if s22 is not None:
            np.testing.assert_allclose(stresses[:, 1], s22, rtol=1e-6)
        cauchy = piola(tilted(option), f) @ f.T / np.linalg.det(f)
        np.testing.assert_allclose(cauchy, kirchhoff(f) / np.linalg.det(f), atol=1e-6 * s11)


@pytest.mark.parametrize("option", ["default", "full", "one point a triangle", "alpha"])
@pytest.mark.parametrize("angle", [30, 90, 180, 360])
def test_rigid_rotation_gives_no_stress_no_force_and_no_energy(option, angle):
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    prepared = tilted(option)
    u = affine(prepared, [[c, -s], [s, c]])
    assert np.abs(all_stresses(prepared, u)).max() < 1e-9 * YOUNG
    state = state_at(prepared, u)
    assert np.abs(state.force).max() < 1e-9 * YOUNG * 0.11
    now = energies(prepared.model, state, 1e-6)
    # Strains of some EPS: their energy is E EPS^2; hourglass modes likewise.
    assert abs(now.internal) + abs(now.hourglass) < 1e-25 * YOUNG


def test_alpha_multiplies_energy_and_mass_of_small_elements_only():
    plain, prepared = tilted(), tilted("alpha")
    mesh = prepared.bodies[0].mesh
    small = mesh.fraction[mesh.cut] < 0.3
    factor = np.where(small, 10.0, 1.0)
    assert small.any() and not small.all()
    before, after = plain.model.cut_elements, prepared.model.cut_elements
    np.testing.assert_array_equal(after.mass, before.mass * factor)
    np.testing.assert_array_equal(after.weight, before.weight * np.repeat(factor, np.diff(before.first)))
    assert prepared.dt >= plain.dt * (1.0 - 1e-12)  # the mass goes along with the stiffness
    from phantomnode.pipeline.scaling import added_mass
    from phantomnode.pipeline.tally import alpha_energy

    u = affine(prepared, [[1.1, 0.1], [0.0, 1.0]])
    more = energies(prepared.model, state_at(prepared, u), 1.0).internal
    less = energies(plain.model, state_at(plain, u), 1.0).internal
    assert alpha_energy(prepared, u) == pytest.approx(more - less, rel=1e-9)
    assert alpha_energy(plain, u) == 0.0 == added_mass(plain.bodies[0], plain.model)
    added = 9.0 * 7800.0 * mesh.area[mesh.cut][small].sum()
    assert added_mass(prepared.bodies[0], prepared.model) == pytest.approx(added, rel=1e-9)
    np.testing.assert_array_equal(prepared.model.load, plain.model.load)
