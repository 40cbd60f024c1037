"""Uncut and cut elements: Flanagan-Belytschko's figures, a NumPy twin, energy gradients, invariances."""

from __future__ import annotations

import numpy as np
import pytest

from phantomnode.solver.cut_elements import add_cut_forces, cut_energy, fragment_elements
from phantomnode.solver.q4 import (
    displacement_gradient,
    element_energies,
    element_gradient,
    hourglass_mode,
    one_point_elements,
)
from phantomnode.solver.stress import cut_stress, element_stress, von_mises
from phantomnode.solver.uncut import add_element_forces

LAME, SHEAR, RHO = 5.8e9, 3.8e9, 7800.0
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
ONE = np.arange(4)[None]
LOCAL = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def grid(columns, rows, distortion=0.0, seed=0):
    """Nodes and elements of a unit-cell grid with randomly shifted nodes."""
    rng = np.random.default_rng(seed)
    x = np.array([(i, j) for j in range(rows + 1) for i in range(columns + 1)], dtype=float)
    first = np.array([j * (columns + 1) + i for j in range(rows) for i in range(columns)])
    quads = first[:, None] + np.array([0, 1, columns + 2, columns + 1])
    return x + distortion * rng.uniform(-1, 1, x.shape), quads


def gradients_at(corners, local):
    """Gradients of the bilinear functions, written out once more."""
    by_local = 0.25 * LOCAL * (1.0 + LOCAL[:, ::-1] * local[::-1])
    return by_local @ np.linalg.inv(corners.T @ by_local)


def cut_of(corners, triangles_local):
    """One cut element with three points on each triangle, given in local coordinates of a parallelogram."""
    rule = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
    points = [rule @ np.array(t) for t in triangles_local]
    jacobian = np.linalg.det(corners.T @ (0.25 * LOCAL))
    areas = [0.5 * abs(np.linalg.det(np.diff(np.array(t), axis=0))) * jacobian for t in triangles_local]
    gradient = np.array([gradients_at(corners, p) for group in points for p in group])
    first, weight = np.array([0, len(gradient)]), np.repeat(np.array(areas) / 3, 3)
    return fragment_elements(ONE, first, gradient, weight, LAME, SHEAR, RHO)


def twin_forces(elements, u):
    """Forces of the uncut elements by NumPy: eigenvalues instead of series, one einsum a step."""
    h = np.einsum("mia,mib->mab", u[elements.nodes], elements.gradient)
    f = np.eye(2) + h
    values, vectors = np.linalg.eigh(f @ f.transpose(0, 2, 1))
    log_b = np.einsum("mik,mk,mjk->mij", vectors, np.log(values), vectors)
    log_j = 0.5 * np.trace(log_b, axis1=1, axis2=2)
    tau = elements.lame[:, None, None] * log_j[:, None, None] * np.eye(2)
    tau = tau + elements.shear[:, None, None] * log_b
    piola = tau @ np.linalg.inv(f).transpose(0, 2, 1)
    corner = np.einsum("m,mab,mib->mia", elements.volume, piola, elements.gradient)
    mode = np.einsum("mi,mia->ma", elements.gamma, u[elements.nodes])
    corner += np.einsum("m,mi,ma->mia", elements.hourglass, elements.gamma, mode)
    force = np.zeros_like(u)
    np.subtract.at(force, elements.nodes, corner)
    return force


def test_unit_square_of_flanagan_and_belytschko():
    e = one_point_elements(ONE, SQUARE[None], LAME, SHEAR, RHO, kappa=0.1)
    assert e.volume[0] == 1.0 and e.mass[0] == RHO
    np.testing.assert_array_equal(e.gamma[0], [1.0, -1.0, 1.0, -1.0])
    assert e.hourglass[0] == pytest.approx(0.1 * (LAME + 2 * SHEAR) / 4, rel=1e-15)
    np.testing.assert_array_equal(e.gradient[0], 0.5 * LOCAL)


def test_hourglass_mode_sees_no_linear_field_on_a_distorted_element():
    x, quads = grid(3, 3, 0.25)
    e = one_point_elements(quads, x[quads], LAME, SHEAR, RHO)
    linear = x @ np.array([[0.3, -2.0], [1.0, 0.7]]) + [4.0, 5.0]
    assert np.abs(np.einsum("mi,mia->ma", e.gamma, linear[quads])).max() < 1e-14  # some ten roundings of 10
    area = 0.5 * abs(np.linalg.det([x[quads[0, 2]] - x[quads[0, 0]], x[quads[0, 3]] - x[quads[0, 1]]]))
    assert e.volume[0] == pytest.approx(area, rel=1e-14)


@pytest.mark.twin(
    "uncut.add_uncut_forces", "uncut.add_strip", "uncut.gather", "uncut.scatter", "q4.smallest_element_jacobian",
    "block.element_block", "block.elements_beyond", "block.series_piola", "block.is_sound",
)  # fmt: skip
@pytest.mark.parametrize("columns", [1, 127, 128, 129, 300])
def test_forces_agree_with_the_numpy_twin(columns):
    """Around the length of a block, with strains on both sides of the limit of the series."""
    x, quads = grid(columns, 1, 0.2)
    rng = np.random.default_rng(columns)
    e = one_point_elements(quads, x[quads], LAME, SHEAR * rng.uniform(1, 2, columns), RHO)
    u = 0.15 * rng.uniform(-1, 1, x.shape)
    u[:, 0] += 1.2 * x[:, 0] * (x[:, 0] > 0.5 * columns)  # half of them stretched to more than twice
    force = np.zeros_like(u)
    smallest = add_element_forces(e, u, force)
    expected = twin_forces(e, u)
    # 1e-14 is found, of which H = grad u has most: EPS times displacements of up to 360.
    assert np.abs(force - expected).max() < 1e-13 * np.abs(expected).max()
    assert smallest == pytest.approx(element_stress(e, u)[2].min(), rel=1e-14)


def strain_energy(f, lame, shear):
    """lambda/2 (ln J)^2 + mu |ln V|^2 by eigenvalues, and P = tau F^-T; (p, 2, 2) F."""
    values, vectors = np.linalg.eigh(f @ f.transpose(0, 2, 1))
    logs = np.log(values)
    log_b = np.einsum("pik,pk,pjk->pij", vectors, logs, vectors)
    log_j = 0.5 * logs.sum(axis=1)
    energy = 0.5 * lame * log_j**2 + 0.25 * shear * np.sum(logs**2, axis=1)
    tau = (lame * log_j)[:, None, None] * np.eye(2) + shear[:, None, None] * log_b
    return energy, tau @ np.linalg.inv(f).transpose(0, 2, 1), tau, log_b


@pytest.mark.twin("q4.displacement_gradient", "q4.element_gradient", "q4.hourglass_mode")
def test_gradient_and_hourglass_mode_agree_with_numpy():
    x, quads = grid(60, 1, 0.2)
    e = one_point_elements(quads, x[quads], LAME, SHEAR, RHO)
    u = 0.15 * np.random.default_rng(6).uniform(-1, 1, x.shape)
    h = np.einsum("mia,mib->mab", u[quads], e.gradient)
    mode = np.einsum("mi,mia->ma", e.gamma, u[quads])
    for k in (0, 59):
        for gradient in (displacement_gradient(e.nodes[k], e.gradient[k], u), element_gradient(e, k, u)):
            np.testing.assert_allclose(gradient, h[k].ravel(), rtol=0, atol=1e-13 * np.abs(h).max())
        found = hourglass_mode(e, k, u)
        np.testing.assert_allclose(found, mode[k], rtol=0, atol=1e-13 * np.abs(u).max())


def random_cut_elements(count=90):
    """More points than one block holds, three to nine an element; strains on both sides of the series' limit."""
    rng = np.random.default_rng(12)
    x, quads = grid(count, 1, 0.1)
    first = np.concatenate([[0], np.cumsum(3 * rng.integers(1, 4, count))])
    owner = np.repeat(np.arange(count), np.diff(first))
    gradient = np.array([gradients_at(x[quads[e]], rng.uniform(-0.9, 0.9, 2)) for e in owner])
    moduli = LAME * rng.uniform(1, 2, count), SHEAR * rng.uniform(1, 2, count)
    cut = fragment_elements(quads, first, gradient, rng.uniform(0.1, 0.3, len(owner)), *moduli, RHO)
    u = 0.1 * rng.uniform(-1, 1, x.shape)
    u[:, 0] += 1.2 * x[:, 0] * (x[:, 0] > 0.5 * count)
    return cut, owner, u


@pytest.mark.twin(
    "cut_elements.add_point_forces", "cut_elements.gather_points", "cut_elements.scatter_points",
    "cut_elements.add_at", "block.spread",
    "block.point_block", "block.points_beyond", "block.point_gradient",
    "cut_elements.cut_energy", "stress.set_point_states", "stress.state_block",
    "stress.states_beyond", "stress.set_row", "stress.store", "q4.smallest_jacobian",
)  # fmt: skip
def test_cut_elements_agree_with_the_numpy_twin():
    cut, of, u = random_cut_elements()
    assert len(cut.weight) > 2 * 128
    f = np.eye(2) + np.einsum("pia,pib->pab", u[cut.nodes[of]], cut.gradient)
    energy, piola, tau, log_b = strain_energy(f, cut.lame[of], cut.shear[of])
    expected, force = np.zeros_like(u), np.zeros_like(u)
    corner = np.einsum("p,pab,pib->pia", cut.weight, piola, cut.gradient)
    np.subtract.at(expected, cut.nodes[of], corner)
    smallest = add_cut_forces(cut, u, force)
    j = np.linalg.det(f)
    assert smallest == pytest.approx(j.min(), rel=1e-13)
    scale = np.abs(corner).max()  # of what the nodes sum up
    assert np.abs(force - expected).max() < 1e-13 * scale
    assert cut_energy(cut, u) == pytest.approx(cut.weight @ energy, rel=1e-13)
    stress, strain, ratio, mises = cut_stress(cut, u)
    sigma = (tau / j[:, None, None])[:, [0, 1, 0], [0, 1, 1]]
    assert np.abs(stress[:, [0, 1, 3]] - sigma).max() < 1e-13 * np.abs(sigma).max()
    assert np.abs(strain[:, [0, 1, 3]] - 0.5 * log_b[:, [0, 1, 0], [0, 1, 1]]).max() < 1e-13
    np.testing.assert_allclose(mises, von_mises(stress), rtol=1e-13)
    np.testing.assert_allclose(ratio, j, rtol=1e-13)


@pytest.mark.twin("q4.element_energies", "stress.set_element_states")
def test_energies_and_states_of_uncut_elements_agree_with_the_numpy_twin():
    x, quads = grid(40, 3, 0.2)
    rng = np.random.default_rng(1)
    e = one_point_elements(quads, x[quads], LAME, SHEAR * rng.uniform(1, 2, len(quads)), RHO)
    u = 0.15 * rng.uniform(-1, 1, x.shape)
    f = np.eye(2) + np.einsum("mia,mib->mab", u[e.nodes], e.gradient)
    internal, hourglass = element_energies(e, u)
    energy, _, tau, log_b = strain_energy(f, e.lame, e.shear)
    assert internal == pytest.approx(e.volume @ energy, rel=1e-13)
    stress, strain, ratio, mises = element_stress(e, u)
    j = np.linalg.det(f)
    sigma = (tau / j[:, None, None])[:, [0, 1, 0], [0, 1, 1]]
    assert np.abs(stress[:, [0, 1, 3]] - sigma).max() < 1e-13 * np.abs(sigma).max()
    assert np.abs(strain[:, [0, 1, 3]] - 0.5 * log_b[:, [0, 1, 0], [0, 1, 1]]).max() < 1e-13
    np.testing.assert_allclose(mises, von_mises(stress), rtol=1e-13)
    np.testing.assert_allclose(ratio, j, rtol=1e-13)
    mode = np.einsum("mi,mia->ma", e.gamma, u[e.nodes])
    assert hourglass == pytest.approx(0.5 * e.hourglass @ np.sum(mode**2, axis=1), rel=1e-13)


def directional(energy, u, direction, step):
    """Fourth-order central difference of an energy."""
    value = [energy(u + k * step * direction) for k in (-2, -1, 1, 2)]
    return (value[0] - 8 * value[1] + 8 * value[2] - value[3]) / (12 * step)


@pytest.mark.parametrize("size", [1e-4, 0.1, 0.25])
def test_element_forces_are_the_gradient_of_the_energies(size):
    x, quads = grid(4, 3, 0.15, seed=2)
    rng = np.random.default_rng(11)
    e = one_point_elements(quads, x[quads], LAME, SHEAR, RHO)
    u, direction = size * rng.uniform(-1, 1, x.shape), rng.normal(size=x.shape)
    force = np.zeros_like(u)
    add_element_forces(e, u, force)
    slope = directional(lambda w: sum(element_energies(e, w)), u, direction, 1e-4)
    # Fourth order in a step of 1e-4, and EPS W/step: 1e-9 of the force scale E |direction|.
    assert slope == pytest.approx(-np.sum(force * direction), abs=1e-9 * LAME * len(x))


def test_cut_forces_are_the_gradient_of_the_energy():
    corners = np.array([[0.0, 0.0], [1.0, 0.1], [1.2, 1.2], [0.2, 1.1]])
    cut = cut_of(corners, [[(-1, -1), (0.3, -1), (-1, 0.6)], [(0.3, -1), (0.3, 0.2), (-1, 0.6)]])
    rng = np.random.default_rng(4)
    u, direction = 0.2 * rng.uniform(-1, 1, (4, 2)), rng.normal(size=(4, 2))
    force = np.zeros((4, 2))
    assert 0.0 < add_cut_forces(cut, u, force) == pytest.approx(cut_stress(cut, u)[2].min(), rel=1e-14)
    slope = directional(lambda w: cut_energy(cut, w), u, direction, 1e-4)
    assert slope == pytest.approx(-np.sum(force * direction), abs=1e-9 * LAME)


@pytest.mark.parametrize("angle", [0.3, 2.0, np.pi])
def test_rigid_motion_makes_no_force(angle):
    c, s = np.cos(angle), np.sin(angle)
    x, quads = grid(3, 2, 0.2)
    u = x @ np.array([[c, s], [-s, c]]) - x + [10.0, -3.0]
    force = np.zeros_like(u)
    add_element_forces(one_point_elements(quads, x[quads], LAME, SHEAR, RHO), u, force)
    assert np.abs(force).max() < 1e-13 * LAME  # displacements of about 13, some ten roundings
    u, force = SQUARE @ np.array([[c, s], [-s, c]]) - SQUARE, np.zeros((4, 2))
    add_cut_forces(cut_of(SQUARE, [LOCAL[:3], LOCAL[[0, 2, 3]]]), u, force)
    assert np.abs(force).max() < 1e-14 * LAME


def test_internal_forces_keep_momentum_and_angular_momentum():
    x, quads = grid(4, 4, 0.2)
    u = 0.2 * np.random.default_rng(1).uniform(-1, 1, x.shape)
    force = np.zeros_like(u)
    add_element_forces(one_point_elements(quads, x[quads], LAME, SHEAR, RHO, kappa=0.0), u, force)
    y = x + u
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()
    assert abs(np.sum(y[:, 0] * force[:, 1] - y[:, 1] * force[:, 0])) < 1e-13 * np.abs(force).sum() * 4


def test_patch_of_uniform_stretch_is_in_equilibrium_inside():
    x, quads = grid(4, 4, 0.2)
    u = x @ np.array([[0.5, 0.1], [-0.2, 0.3]])
    force = np.zeros_like(u)
    add_element_forces(one_point_elements(quads, x[quads], LAME, SHEAR, RHO), u, force)
    inside = [j * 5 + i for j in (1, 2, 3) for i in (1, 2, 3)]
    assert np.abs(force[inside]).max() < 1e-13 * np.abs(force).max() * 10


def test_a_single_cut_triangle_has_the_rigid_modes_only():
    """Three points on one triangle: the eight degrees of freedom lose three rigid modes and no other."""
    cut = cut_of(SQUARE, [[(-1, -1), (0.2, -1), (-1, 0.1)]])
    step, stiffness = 1e-6, np.zeros((8, 8))
    for k in range(8):
        u, force = np.zeros(8), np.zeros((4, 2))
        u[k] = step
        add_cut_forces(cut, u.reshape(4, 2), force)
        stiffness[:, k] = -force.ravel() / step
    values = np.abs(np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T)))
    values.sort()
    # The difference quotient leaves about `step` of the stiffness; the least elastic one is above 1e-3.
    assert values[2] < 10 * step * values[-1] and values[3] > 1e-3 * values[-1]


def test_whole_cell_as_two_triangles_weighs_the_same():
    cut = cut_of(SQUARE, [LOCAL[:3], LOCAL[[0, 2, 3]]])
    assert cut.mass[0] == pytest.approx(RHO, rel=1e-15) and cut.weight.sum() == pytest.approx(1.0, rel=1e-15)


def test_stresses_of_uniform_fields():
    e = one_point_elements(ONE, SQUARE[None], 5.769230769e9, 3.846153846e9, RHO)
    u = SQUARE * [0.5, 0.0]
    for stress, strain, j, _ in (element_stress(e, u), cut_stress(cut_of(SQUARE, [LOCAL[:3]]), u)):
        assert stress.shape[1] == 4 and strain[0, 0] == pytest.approx(np.log(1.5), rel=1e-14)
        assert j[0] == pytest.approx(1.5, rel=1e-15) and strain[0, 1] == pytest.approx(0.0, abs=1e-15)
    # Section 7 of the formulation, confined stretch 1.5; constants given to ten digits.
    stress = element_stress(e, u)[0]
    np.testing.assert_allclose(stress[0], [3.638789e9, 1.559481e9, 1.559481e9, 0.0], rtol=2e-7, atol=1.0)
    assert von_mises(stress)[0] == pytest.approx(stress[0, 0] - stress[0, 1], rel=1e-14)
    assert von_mises(np.array([[0.0, 0.0, 0.0, 1.0]]))[0] == pytest.approx(np.sqrt(3.0), rel=1e-15)


def test_inverted_and_lost_elements_are_told_apart():
    e = one_point_elements(ONE, SQUARE[None], LAME, SHEAR, RHO)
    assert add_element_forces(e, SQUARE * [-1.5, 0.0], np.zeros((4, 2))) == pytest.approx(-0.5)
    assert np.isnan(add_element_forces(e, SQUARE * [np.nan, 0.0], np.zeros((4, 2))))


def test_empty_lists():
    none, force = np.empty((0, 4), dtype=np.int64), np.zeros((4, 2))
    e = one_point_elements(none, np.empty((0, 4, 2)), LAME, SHEAR, RHO)
    cut = fragment_elements(none, np.zeros(1, int), np.empty((0, 4, 2)), np.empty(0), LAME, SHEAR, RHO)
    assert add_element_forces(e, force, force) == np.inf and add_cut_forces(cut, force, force) == np.inf
    assert element_energies(e, force) == (0.0, 0.0) and cut_energy(cut, force) == 0.0
    assert element_stress(e, force)[0].shape == (0, 4)


def test_clockwise_corners_and_pointless_elements_are_refused():
    with pytest.raises(ValueError, match="element 0 has area -1; give its corners counter-clockwise"):
        one_point_elements(ONE, SQUARE[None, ::-1], LAME, SHEAR, RHO)
    with pytest.raises(ValueError, match="cut element 0 has no integration point"):
        fragment_elements(ONE, np.array([0, 0]), np.empty((0, 4, 2)), np.empty(0), LAME, SHEAR, RHO)
