"""Classic X-FEM of a prepared case: signs of the node copies, mass matrices, factorisation, stable step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from phantomnode.geometry.bilinear import local_gradients, shape, to_local
from phantomnode.geometry.doubling import CutMesh
from phantomnode.pipeline.boundaries import constant_gravity
from phantomnode.pipeline.elements import weight
from phantomnode.pipeline.errors import CaseError
from phantomnode.solver.cut_elements import add_cut_forces
from phantomnode.solver.model import Model
from phantomnode.solver.timestep import StepEstimate
from phantomnode.solver.uncut import add_element_forces
from phantomnode.solver.xfem import Basis, heaviside_basis

if TYPE_CHECKING:
    from phantomnode.pipeline.prepare import Body
    from phantomnode.pipeline.schema import Case, Xfem

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GAUSS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(3.0)

A, B = 0.445948490915965, 0.091576213509771
TRIANGLE_POINTS = np.array([np.roll([1.0 - 2.0 * c, c, c], k) for c in (A, B) for k in range(3)])
TRIANGLE_WEIGHTS = np.repeat([0.223381589678011, 0.109951743655322], 3)
"""Six points a triangle, exact to degree 4, that of N_I N_J (Strang and Fix; Dunavant 1985)."""

TRIAL_DISPLACEMENT = 1e-7
"""Of the smallest cell: so small that forces are linear, to 1e-7, and far above rounding."""

LANCZOS_TOLERANCE = 1e-3
"""Relative error of the largest eigenvalue; the safety of the step is 0.15."""


@dataclass
class MassMatrix:
    """A mass matrix over the node copies, factorised for the free degrees of freedom.

    Attributes
    ----------
    matrix : (n, n) csc_array, kg/m
    channel : (n, 2) int32
        Negative where a degree of freedom is free.
    """

    matrix: csc_array
    channel: NDArray[np.int32]
    _free: list[Ints] = field(init=False, repr=False)
    _factors: list[Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._free = [np.flatnonzero(self.channel[:, axis] < 0) for axis in (0, 1)]
        self._factors = [
            splu(csc_array(self.matrix[free][:, free])) if len(free) else None for free in self._free
        ]

    def momentum(self, v: Floats) -> Floats:
        """(n, 2) M v."""
        return np.asarray(self.matrix @ v)

    def acceleration(self, force: Floats, prescribed: Floats) -> Floats:
        """(n, 2) Accelerations with M a = force on the free degrees of freedom, the others as prescribed."""
        a = np.where(self.channel >= 0, prescribed, 0.0)
        right = force - self.matrix @ a
        for axis, (free, factor) in enumerate(zip(self._free, self._factors, strict=True)):
            if len(free):
                a[free, axis] = factor.solve(right[free, axis])
        return a


def classic_xfem(
    case: Case, bodies: tuple[Body, ...], model: Model
) -> tuple[Model, StepEstimate, MassMatrix]:
    """The model, the stable step and the mass matrix of classic X-FEM, from the model of phantom nodes.

    The nodal masses of the model become those that tell linear momentum: sum m_k v_k is what a translation
    tests, so that the centre of mass and gravity are those of the X-FEM system.
    """
    if model.loads.rows or len(model.supports.stiffness):
        raise CaseError(
            f'{case.name}: method = "xfem": classic X-FEM runs without tractions, pressures, gravity that changes '
            "with time and surfaces held by springs (a boundary through the inside of cells); take method = "
            '"phantom", or leave them out'
        )
    mass = xfem_mass(case.xfem, bodies, model)
    nodal = mass.momentum(np.ones((len(model.x), 2)))[:, 0]
    if len(model.load):
        model = model._replace(load=weight(nodal, constant_gravity(case)))
    model = model._replace(mass=nodal)
    return model, stable_xfem_step(model, mass, case.time.safety), mass


def xfem_mass(table: Xfem, bodies: tuple[Body, ...], model: Model) -> MassMatrix:
    """The mass matrix of classic X-FEM in the basis of the node copies.

    With T, u = T (d, a), it is T^-T M T^-1, where M is the mass in the basis of X-FEM:

    - "consistent": the consistent mass; no basis matters, and the two sides have nothing in common.
    - "lumped": row sums within the block of d and within the block of a. Its sides are tied to each other.
    - "block-diagonal": blocks of 2 x 2, one for d_I and a_I of each node, from a quarter of each part of a cell
      at each corner (Menouillard et al., Int. J. Numer. Meth. Engng 74 (2008) 447-474). In the basis of the
      copies these blocks are the lumped mass of phantom nodes.

    Parameters
    ----------
    table : Xfem
    bodies : tuple of Body
    model : Model
        With the lumped mass of phantom nodes.

    Raises
    ------
    CaseError
        Where Heaviside enrichment cannot describe how the nodes are doubled.
    """
    if table.mass == "block-diagonal":
        return MassMatrix(csc_array(diags_array(model.mass)), model.channel)
    consistent = _joined([_consistent_mass(body) for body in bodies], bodies)
    if table.mass == "consistent":
        return MassMatrix(consistent, model.channel)
    bases = [_basis(body, table.enrichment == "shifted") for body in bodies]
    transform = _joined([transformation(basis) for basis in bases], bodies)
    inverse = _joined([inverse_transformation(basis) for basis in bases], bodies)
    standard = np.concatenate([np.arange(len(b.standard)) < b.standard_count for b in bases])
    lumped = np.zeros(len(standard))
    in_basis = csc_array(transform.T @ consistent @ transform)
    for block in (standard, ~standard):
        lumped[block] = in_basis[block][:, block].sum(axis=1)
    return MassMatrix(csc_array(inverse.T @ diags_array(lumped) @ inverse), model.channel)


def transformation(basis: Basis) -> csc_array:
    """(n, n) T: values at the copies from (d, a)."""
    n, enriched = len(basis.standard), np.flatnonzero(basis.enriched >= 0)
    rows = np.concatenate([np.arange(n), enriched])
    columns = np.concatenate([basis.standard, basis.standard_count + basis.enriched[enriched]])
    values = np.concatenate([np.ones(n), basis.factor[enriched]])
    return csc_array((values, (rows, columns)), shape=(n, n))


def inverse_transformation(basis: Basis) -> csc_array:
    """(n, n) T^-1: of two copies, d = (f2 u1 - f1 u2)/(f2 - f1) and a = (u2 - u1)/(f2 - f1)."""
    n, enriched = len(basis.standard), basis.enriched
    single = np.flatnonzero(enriched < 0)
    pairs = np.argsort(enriched, kind="stable")[len(single) :].reshape(-1, 2)
    f1, f2 = basis.factor[pairs].T
    d, a = basis.standard[pairs[:, 0]], basis.standard_count + enriched[pairs[:, 0]]
    rows = np.concatenate([basis.standard[single], d, d, a, a])
    columns = np.concatenate([single, *(pairs[:, k] for k in (0, 1, 0, 1))])
    jump = f2 - f1
    values = np.concatenate([np.ones(len(single)), f2 / jump, -f1 / jump, -1.0 / jump, 1.0 / jump])
    return csc_array((values, (rows, columns)), shape=(n, n))


def stable_xfem_step(model: Model, mass: MassMatrix, safety: float) -> StepEstimate:
    """The stable step of the assembled system, 2/omega of its largest frequency, by Lanczos' method."""
    free = model.channel < 0
    size = TRIAL_DISPLACEMENT * float(np.sqrt(model.elements.volume.min(initial=np.inf)))

    def stiffness(vector: Floats) -> Floats:
        u, force = np.zeros(free.shape), np.zeros(free.shape)
        scale = size / float(np.max(np.abs(vector)))
        u[free] = scale * vector.ravel()
        add_element_forces(model.elements, u, force)
        add_cut_forces(model.cut_elements, u, force)
        return np.asarray(-force[free] / scale)

    def inertia(vector: Floats) -> Floats:
        v = np.zeros(free.shape)
        v[free] = vector.ravel()
        return mass.momentum(v)[free]

    def inverse(vector: Floats) -> Floats:
        force = np.zeros(free.shape)
        force[free] = vector.ravel()
        return mass.acceleration(force, np.zeros(free.shape))[free]

    count = int(free.sum())
    operators = [LinearOperator((count, count), matvec=f, dtype=float) for f in (stiffness, inertia, inverse)]
    start = np.random.default_rng(0).uniform(-1.0, 1.0, count)  # the same step in every run
    largest = eigsh(
        operators[0], 1, operators[1], which="LM", Minv=operators[2], v0=start, tol=LANCZOS_TOLERANCE,
        return_eigenvectors=False,
    )  # fmt: skip
    frequency = float(np.sqrt(largest[0]))
    return StepEstimate(safety * 2.0 / frequency, frequency, 0.0, -1)


def _joined(parts: list[csc_array], bodies: tuple[Body, ...]) -> csc_array:
    """The matrices of the bodies as blocks of one."""
    triplets = [part.tocoo() for part in parts]
    starts = [body.nodes.start for body in bodies]
    rows, columns = (
        np.concatenate([t.coords[k] + start for t, start in zip(triplets, starts, strict=True)])
        for k in (0, 1)
    )
    n = bodies[-1].nodes.stop
    return csc_array((np.concatenate([t.data for t in triplets]), (rows, columns)), shape=(n, n))


def _consistent_mass(body: Body) -> csc_array:
    """(n, n) rho times the integral of N_I N_J over the material of every element."""
    mesh, n = body.mesh, len(body.mesh.xy)
    blocks = np.zeros((len(mesh.elements), 4, 4))
    whole = np.flatnonzero(~mesh.cut)
    corners = mesh.xy[mesh.elements[whole]]
    jacobian = np.einsum("gia,mib->mgab", local_gradients(GAUSS), corners)
    at_gauss = shape(GAUSS)
    blocks[whole] = np.einsum("mg,gi,gj->mij", np.linalg.det(jacobian), at_gauss, at_gauss)
    points = np.einsum("pk,tka->tpa", TRIANGLE_POINTS, mesh.triangles)
    parent = np.repeat(mesh.xy[mesh.elements[mesh.triangle_element]], len(TRIANGLE_WEIGHTS), axis=0)
    shapes = shape(to_local(parent, points.reshape(-1, 2))).reshape(*points.shape[:2], 4)
    side1, side2 = np.moveaxis(mesh.triangles[:, 1:] - mesh.triangles[:, :1], 1, 0)
    area = 0.5 * (side1[:, 0] * side2[:, 1] - side1[:, 1] * side2[:, 0])
    parts = np.einsum("t,p,tpi,tpj->tij", area, TRIANGLE_WEIGHTS, shapes, shapes)
    np.add.at(blocks, mesh.triangle_element, parts)
    rows = np.repeat(mesh.elements, 4, axis=1).ravel()
    columns = np.tile(mesh.elements, (1, 4)).ravel()
    return csc_array((body.rho * blocks.ravel(), (rows, columns)), shape=(n, n))


def _basis(body: Body, shifted: bool) -> Basis:
    """The Heaviside enrichment of a body."""
    mesh = body.mesh
    try:
        return heaviside_basis(mesh.grid_node, copy_signs(mesh), mesh.real, shifted)
    except ValueError:
        raise CaseError(
            f"method: classic X-FEM has one jump at a node, but the interfaces of {body.name} (or its thin parts) "
            'divide some node otherwise; take method = "phantom", or one interface that cuts the body through'
        ) from None


def copy_signs(mesh: CutMesh) -> Ints:
    """(n,) H of the elements of each node that touch an interface: +1 on its left, -1; 0 where none or both."""
    segments = mesh.segments
    seen = np.zeros((len(mesh.xy), 2), dtype=bool)
    for k, side in enumerate((1, -1)):
        touching = segments.element[segments.side == side]
        seen[mesh.elements[touching], k] = True
    return seen[:, 0].astype(np.int64) - seen[:, 1]
