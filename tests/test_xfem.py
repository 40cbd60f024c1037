"""Classic X-FEM: against an assembly of Eq. 7 as it stands, patch test, masses, step, runs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from phantomnode.geometry.bilinear import gradients, shape, to_local
from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.prepare import prepare
from phantomnode.pipeline.run import run
from phantomnode.pipeline.xfem import (
    MassMatrix,
    _basis,
    _consistent_mass,
    copy_signs,
    inverse_transformation,
    stable_xfem_step,
    transformation,
    xfem_mass,
)
from phantomnode.solver.cut_elements import add_cut_forces
from phantomnode.solver.stress import cut_stress, element_stress
from phantomnode.solver.uncut import add_element_forces
from phantomnode.solver.xfem import frames, heaviside_basis

E, NU, RHO = 3.0e9, 0.3, 1200.0
LAME, SHEAR = E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), E / (2.0 * (1.0 + NU))
SLANTED = [[-0.1, 0.41], [1.6, 0.63]]
MASSES = [
    ("consistent", "heaviside"),
    ("lumped", "heaviside"),
    ("lumped", "shifted"),
    ("block-diagonal", "heaviside"),
]


def case(counts=(3, 1), height=1.0, line=SLANTED, **keys):
    """A block 1.5 m wide with an interface through it."""
    return case_from_table(
        {
            "time": {"end": 1e-3},
            "material": {"m": {"E": E, "nu": NU, "rho": RHO}},
            "body": {
                "block": {
                    "geometry": {"rectangle": {"low": [0.0, 0.0], "high": [1.5, height]}},
                    "grid": {"kind": "cartesian", "counts": list(counts), "aligned": True},
                    "material": "m",
                }
            },
            "interface": {"cut": {"body": "block", "geometry": {"polyline": {"points": line}}}},
            **keys,
        }
    )


def level(points):
    """Positive on the left of SLANTED."""
    (x0, y0), (x1, y1) = SLANTED
    return (x1 - x0) * (points[..., 1] - y0) - (y1 - y0) * (points[..., 0] - x0)


def first_piola(h):
    """(2, 2) P = tau F^-T of the Hencky law by eigenvectors of B."""
    f = np.eye(2) + h
    values, vectors = np.linalg.eigh(f @ f.T)
    strain = vectors @ np.diag(0.5 * np.log(values)) @ vectors.T
    return (LAME * np.trace(strain) * np.eye(2) + 2.0 * SHEAR * strain) @ np.linalg.inv(f).T


def triangle_rule(order=6):
    """Gauss points of a square folded onto a triangle: another rule than that of the code."""
    x, w = np.polynomial.legendre.leggauss(order)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    r, s = (a.ravel() for a in np.meshgrid(x, x))
    weight = np.outer(w, w).ravel() * r
    return np.column_stack([1.0 - r, r * (1.0 - s), r * s]), 2.0 * weight


@pytest.mark.parametrize("shifted", [False, True])
def test_forces_and_mass_are_those_of_equation_7(shifted: bool) -> None:
    """All cells are cut, so that the enriched field can be assembled as it stands in the paper."""
    body = prepare(case()).bodies[0]
    model = prepare(case()).model
    mesh, basis = body.mesh, _basis(body, shifted)
    grid, quads = body.grid.xy, body.grid.quads
    nodes = len(grid)
    assert basis.standard_count == basis.enriched_count == nodes
    rng = np.random.default_rng(1)
    d, a = rng.uniform(-0.03, 0.03, (2, nodes, 2))
    node_sign = np.where(level(grid) > 0.0, 1.0, -1.0) if shifted else np.zeros(nodes)
    points3 = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0
    force, mass = np.zeros((2, nodes, 2)), np.zeros((2 * nodes, 2 * nodes))
    for triangle, element in zip(mesh.triangles, mesh.triangle_element, strict=True):
        quad = quads[mesh.cell[element]]
        corners = grid[quad]
        side1, side2 = triangle[1] - triangle[0], triangle[2] - triangle[0]
        area = 0.5 * (side1[0] * side2[1] - side1[1] * side2[0])
        heaviside = np.sign(level(triangle.mean(axis=0))) - node_sign[quad]
        for point in points3 @ triangle:
            dn = gradients(corners[None], to_local(corners[None], point[None]))[0]
            h = (d[quad] + heaviside[:, None] * a[quad]).T @ dn
            p = -area / 3.0 * first_piola(h)
            force[0, quad] += dn @ p.T
            force[1, quad] += heaviside[:, None] * (dn @ p.T)
        for weights, weight in zip(*triangle_rule(), strict=True):
            n = shape(to_local(corners[None], (weights @ triangle)[None]))[0]
            both = np.zeros(2 * nodes)
            both[quad], both[nodes + quad] = n, heaviside * n
            mass += RHO * area * weight * np.outer(both, both)
    t = transformation(basis)
    ours, u = np.zeros((len(mesh.xy), 2)), t @ np.vstack([d, a])
    add_cut_forces(model.cut_elements, u, ours)
    # Eigenvectors of B on one side, a series on the other.
    assert np.allclose(t.T @ ours, force.reshape(-1, 2), rtol=0.0, atol=1e-13 * np.abs(force).max())
    assert np.allclose((t.T @ _consistent_mass(body) @ t).toarray(), mass, rtol=0.0, atol=1e-13 * mass.max())
    lumped = np.concatenate([mass[:nodes, :nodes].sum(axis=1), mass[nodes:, nodes:].sum(axis=1)])
    table = case(xfem={"mass": "lumped", "enrichment": "shifted" if shifted else "heaviside"}).xfem
    in_basis = (t.T @ xfem_mass(table, (body,), model).matrix @ t).toarray()
    assert np.allclose(in_basis, np.diag(lumped), rtol=0.0, atol=1e-13 * mass.max())


@pytest.mark.parametrize("shifted", [False, True])
def test_transformation_and_its_inverse(shifted: bool) -> None:
    basis = _basis(prepare(case((4, 5))).bodies[0], shifted)
    product = transformation(basis) @ inverse_transformation(basis)
    assert np.allclose(product.toarray(), np.eye(len(basis.standard)), atol=1e-15)


def test_patch_of_two_constant_strains_with_a_jump() -> None:
    """Each side has its own constant strain: stress constant, no force on nodes inside either side."""
    prepared = prepare(case((5, 6)))
    body, model = prepared.bodies[0], prepared.model
    mesh, basis = body.mesh, _basis(body, shifted=False)
    component = np.zeros(len(mesh.xy), dtype=int)
    component[mesh.elements] = mesh.component[:, None]
    upper = level(mesh.xy) > 0.0
    plus = component == component[np.flatnonzero(upper & mesh.real & (basis.enriched < 0))[0]]
    gradient = {True: np.array([[0.02, -0.01], [0.03, 0.01]]), False: np.array([[-0.01, 0.02], [0.0, -0.02]])}
    jump = {True: np.array([0.3, 0.1]), False: np.zeros(2)}
    u = np.where(
        plus[:, None], mesh.xy @ gradient[True].T + jump[True], mesh.xy @ gradient[False].T + jump[False]
    )
    dofs = inverse_transformation(basis) @ u
    k = int(np.argmax(basis.enriched >= 0))
    at = mesh.xy[k]
    expected = 0.5 * ((gradient[True] - gradient[False]) @ at + jump[True])
    assert np.allclose(dofs[basis.standard_count + basis.enriched[k]], expected, atol=1e-15)

    uncut, cut = element_stress(model.elements, u)[0], cut_stress(model.cut_elements, u)[0]
    owner = np.repeat(np.flatnonzero(mesh.cut), np.diff(model.cut_elements.first))
    stress = np.concatenate([uncut, cut])
    side = plus[mesh.elements[:, 0]]
    side = np.concatenate([side[~mesh.cut], side[owner]])
    for which in (True, False):
        h = gradient[which]
        cauchy = first_piola(h) @ (np.eye(2) + h).T / np.linalg.det(np.eye(2) + h)
        rows = stress[side == which][:, [0, 1, 3]]
        assert np.allclose(rows, [cauchy[0, 0], cauchy[1, 1], cauchy[0, 1]], rtol=0.0, atol=1e-10 * E)
    force = np.zeros_like(u)
    add_element_forces(model.elements, u, force)
    add_cut_forces(model.cut_elements, u, force)
    touching = np.zeros(len(u), dtype=bool)
    touching[mesh.elements[mesh.segments.element]] = True  # elements on the boundary or the interface
    assert (~touching).any()
    assert np.abs(force[~touching]).max() < 1e-10 * np.abs(force).max()


@pytest.mark.parametrize("mass", MASSES)
def test_masses_add_up_and_only_lumping_ties_the_sides(mass) -> None:
    given = case((4, 5), method="xfem", xfem={"mass": mass[0], "enrichment": mass[1]})
    prepared = prepare(given)
    matrix = prepared.xfem.matrix.toarray()
    assert matrix.sum() == pytest.approx(RHO * 1.5, rel=1e-12)
    assert prepared.model.mass.sum() == pytest.approx(RHO * 1.5, rel=1e-12)
    assert np.allclose(matrix, matrix.T, atol=1e-15 * matrix.max()) and np.linalg.eigvalsh(matrix)[0] > 0.0
    mesh = prepared.bodies[0].mesh
    component = np.zeros(len(mesh.xy), dtype=int)
    component[mesh.elements] = mesh.component[:, None]
    tied = np.abs(matrix[component[:, None] != component[None]]).max() / matrix.max()
    assert (tied > 1e-3) == (mass[0] == "lumped")
    assert tied == 0.0 or mass[0] == "lumped"


def test_the_block_diagonal_mass_is_that_of_phantom_nodes() -> None:
    """2 x 2 blocks sum_e m_e/4 [[1, H], [H, H^2]] over the parts of the cells at a node, in the basis (d, a)."""
    prepared = prepare(case((4, 5), method="xfem", xfem={"mass": "block-diagonal"}))
    body = prepared.bodies[0]
    basis, mesh = _basis(body, shifted=False), body.mesh
    blocks = np.zeros((len(mesh.xy), len(mesh.xy)))
    for element, area in zip(mesh.elements, mesh.area, strict=True):
        for node in element:
            row = np.zeros(len(mesh.xy))
            row[basis.standard[node]] = 1.0
            if basis.enriched[node] >= 0:
                row[basis.standard_count + basis.enriched[node]] = basis.factor[node]
            blocks += 0.25 * RHO * area * np.outer(row, row)
    t = transformation(basis)
    assert np.allclose(
        (t.T @ prepared.xfem.matrix @ t).toarray(), blocks, rtol=0.0, atol=1e-13 * blocks.max()
    )


@pytest.mark.parametrize("mass", MASSES)
def test_the_step_is_that_of_the_largest_frequency(mass) -> None:
    """1e-3 is the tolerance of Lanczos' method."""
    keys = {"method": "xfem", "xfem": {"mass": mass[0], "enrichment": mass[1]}}
    prepared = prepare(
        case((3, 4), boundary={"base": {"on": "block.bottom", "velocity": {"y": 1.0}}}, **keys)
    )
    model, free = prepared.model, np.flatnonzero(prepared.model.channel.ravel() < 0)
    stiffness = np.zeros((2 * len(model.x), 2 * len(model.x)))
    for k in range(len(stiffness)):
        u, force = np.zeros_like(model.x), np.zeros_like(model.x)
        u.ravel()[k] = 1e-7
        add_element_forces(model.elements, u, force)
        add_cut_forces(model.cut_elements, u, force)
        stiffness[:, k] = -force.ravel() / 1e-7
    mass_matrix = np.kron(prepared.xfem.matrix.toarray(), np.eye(2))
    some = np.ix_(free, free)
    largest = eigh(0.5 * (stiffness + stiffness.T)[some], mass_matrix[some], eigvals_only=True)[-1]
    estimate = stable_xfem_step(model, prepared.xfem, 0.85)
    assert estimate.element_frequency == pytest.approx(np.sqrt(largest), rel=1e-3)
    assert estimate.dt == 0.85 * 2.0 / estimate.element_frequency


def test_prescribed_degrees_of_freedom_enter_the_system() -> None:
    """M a = f in the free rows, with the coupling to what is prescribed."""
    rng = np.random.default_rng(2)
    prepared = prepare(case((3, 4), method="xfem"))
    channel = np.where(rng.uniform(size=prepared.model.x.shape) < 0.3, 0, -1)
    mass = MassMatrix(prepared.xfem.matrix, channel)
    force, given = rng.normal(size=(2, *channel.shape))
    a = mass.acceleration(force, given)
    assert np.array_equal(a[channel >= 0], given[channel >= 0])
    miss = np.abs(mass.matrix.toarray() @ a - force)[channel < 0]
    assert miss.max() < 1e-12
    assert np.allclose(mass.momentum(a), mass.matrix.toarray() @ a, atol=1e-12 * mass.matrix.max())


@pytest.mark.parametrize("mass", MASSES)
def test_a_block_falls_freely(mass) -> None:
    """Gravity accelerates every node alike, whatever the mass matrix; energy is kept to rounding."""
    keys = {"method": "xfem", "xfem": {"mass": mass[0], "enrichment": mass[1]}, "gravity": [0.0, -10.0]}
    prepared = prepare(case((3, 4), **keys))
    arguments = (prepared.velocity, prepared.dt, [0, 200], prepared.motion, 0.05)
    last = list(frames(prepared.model, prepared.xfem, *arguments))[-1]
    assert np.allclose(last.v, [0.0, -10.0 * last.time], rtol=0.0, atol=1e-8 * 10.0 * last.time)
    assert last.energy_error < 1e-8


def test_energy_error_falls_with_the_square_of_the_step() -> None:
    """A block whose halves collide with nothing: started with a linear velocity field, it oscillates."""
    errors = []
    for part in (0.4, 0.2):
        prepared = prepare(case((3, 4), method="xfem", xfem={"mass": "lumped"}))
        velocity = 20.0 * (prepared.model.x - [0.75, 0.5])
        dt = part * prepared.dt
        steps = np.arange(0, round(100 / part), 4)
        run_of = frames(prepared.model, prepared.xfem, velocity, dt, steps, prepared.motion, 0.05)
        errors.append(max(frame.energy_error for frame in run_of))
    assert 1.8 <= np.log2(errors[0] / errors[1]) <= 2.2


def test_an_unstable_step_stops_the_run(tmp_path) -> None:
    keys = {"method": "xfem", "boundary": {"top": {"on": "block.top", "velocity": {"y": 1.0}}}}
    time = {"end": 0.2, "step": 1e-3, "force": True}
    summary = run(case((3, 4), **keys | {"time": time}), tmp_path / "results")
    assert summary.status == "stopped" and summary.figures["reason"]
    with pytest.raises(CaseError, match=r"time\.step: 0\.001 s is unstable"):
        prepare(case((3, 4), **keys | {"time": time | {"force": False}}))


def test_signs_of_the_copies() -> None:
    mesh = prepare(case((4, 5))).bodies[0].mesh
    signs = copy_signs(mesh)
    _, copy, count = np.unique(mesh.grid_node, return_inverse=True, return_counts=True)
    twice = count[copy] == 2
    assert np.all(np.abs(signs[twice]) == 1)
    real = twice & mesh.real & (np.abs(level(mesh.xy)) > 1e-6)  # not moved onto the interface
    assert np.array_equal(signs[real], np.where(level(mesh.xy[real]) > 0.0, 1, -1))


def test_enrichment_needs_one_copy_on_each_side() -> None:
    real = np.array([True, False, True])
    with pytest.raises(ValueError, match="one copy on each side"):
        heaviside_basis(np.array([0, 0, 0]), np.array([1, -1, 1]), real, False)
    with pytest.raises(ValueError, match="one copy on each side"):
        heaviside_basis(np.array([0, 0, 1]), np.array([1, 1, 0]), real, False)
    basis = heaviside_basis(np.array([0, 0, 1]), np.array([1, -1, 0]), real, True)
    assert basis.factor.tolist() == [0.0, -2.0, 0.0] and basis.enriched.tolist() == [0, 0, -1]


def test_crossing_interfaces_are_refused() -> None:
    crossing = {"other": {"body": "block", "geometry": {"polyline": {"points": [[0.7, -0.1], [0.8, 1.1]]}}}}
    cut = {"cut": {"body": "block", "geometry": {"polyline": {"points": SLANTED}}}}
    given = case((4, 5), interface=cut | crossing, method="xfem", xfem={"mass": "lumped"})
    with pytest.raises(CaseError, match="method: classic X-FEM has one jump at a node"):
        prepare(given)
