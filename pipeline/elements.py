"""Element lists of the model from cut meshes: integration points, hourglass control, viscosity, scaled mass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import gradients, local_gradients, shape, to_local
from phantomnode.geometry.doubling import CutMesh
from phantomnode.geometry.grid import chunks
from phantomnode.pipeline.boundaries import constant_gravity
from phantomnode.pipeline.schema import Case, Hourglass, Material
from phantomnode.solver.cut_elements import fragment_elements
from phantomnode.solver.damping import bulk_points, hourglass_viscosity
from phantomnode.solver.kinds import shared_kinds
from phantomnode.solver.mass_scaling import lumped_mass
from phantomnode.solver.model import NO_BULK_VISCOSITY, NO_POINTS, CutElements, Damping, Elements
from phantomnode.solver.q4 import as_points, one_point_elements

if TYPE_CHECKING:
    from phantomnode.pipeline.prepare import Body

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

THREE_POINTS = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0
"""Three points a triangle, exact for quadratic functions, with a third of the area each."""

ONE_POINT = np.full((1, 3), 1.0 / 3.0)
"""One point a triangle, exact for linear functions; sound on fans about a centroid only (geometry/fans.py)."""

GAUSS2 = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(3.0)

EDGE_POINTS, EDGE_WEIGHTS = np.polynomial.legendre.leggauss(5)

SKEW = 1e-9
"""A cell whose diagonals bisect each other up to this part of its size has gradients linear in x and y."""


def lame_constants(material: Material) -> tuple[float, float]:
    """Lame's lambda and mu, Pa."""
    shear = material.E / (2.0 * (1.0 + material.nu))
    return 2.0 * shear * material.nu / (1.0 - 2.0 * material.nu), shear


def hourglass_control(case: Case) -> tuple[float, float]:
    """Stiffness and viscosity of the hourglass modes; none with full integration."""
    if case.integration.uncut == "full":
        return 0.0, 0.0
    if isinstance(case.hourglass, Hourglass):
        return case.hourglass.stiffness, case.hourglass.viscosity
    return case.hourglass, 0.0


def weight(mass: Floats, gravity: Floats) -> Floats:
    """(n, 2) Forces of constant gravity (2,), m/s^2, on (n,) masses, kg/m, by columns; empty without gravity, N/m."""
    return np.asfortranarray(mass[:, None] * gravity) if np.any(gravity) else np.zeros((0, 2))


class ElementLists(NamedTuple):
    """The elements of all bodies: x (n, 2), m; mass (n,) true lumped mass, kg/m; load (n, 2) by constant
    gravity, N/m, empty where there is none; the lists of the model.
    """

    x: Floats
    mass: Floats
    load: Floats
    elements: Elements
    cut_elements: CutElements
    full: CutElements
    damping: Damping


def element_lists(case: Case, bodies: Sequence[Body]) -> ElementLists:
    """The elements of all bodies behind each other; gravity pulls at their true mass."""
    material = {body.name: case.material[case.body[body.name].material] for body in bodies}
    points, kappa = case.integration.cut, hourglass_control(case)[0]
    own = joined_elements([uncut_elements(b.mesh, b.nodes.start, material[b.name], kappa) for b in bodies])
    cut = joined_cut_elements([cut_elements(b.mesh, b.nodes.start, material[b.name], points) for b in bodies])
    meshes = [body.mesh for body in bodies]
    x = meshes[0].xy if len(meshes) == 1 else np.vstack([mesh.xy for mesh in meshes])
    elements = shared_kinds(own, x)
    del own
    mass = lumped_mass(len(x), elements, cut)
    cut = stiffened(case, meshes, cut)
    full = full_elements(elements, x) if case.integration.uncut == "full" else NO_POINTS
    load = weight(mass, constant_gravity(case))
    return ElementLists(x, mass, load, elements, cut, full, damping_of(case, meshes, elements, full, cut))


def uncut_elements(mesh: CutMesh, first_node: int, material: Material, kappa: float) -> Elements:
    """The uncut elements of one body, in the order of the mesh."""
    lame, shear = lame_constants(material)
    numbers = np.flatnonzero(~mesh.cut)
    m = len(numbers)
    whole = Elements(
        np.empty((m, 4), np.uint32), np.arange(m, dtype=np.uint32), np.empty((10, m)), np.empty(m)
    )
    for rows in chunks(m):  # what is worked out on the way would take twice the room of the result
        nodes = mesh.nodes(numbers[rows])
        some = one_point_elements(nodes + first_node, mesh.xy[nodes], lame, shear, material.rho, kappa)
        whole.nodes[rows], whole.constants[:, rows], whole.mass[rows] = some.nodes, some.constants, some.mass
    return whole


def full_elements(elements: Elements, x: Floats) -> CutElements:
    """Uncut elements with 2 x 2 Gauss points each.

    Parameters
    ----------
    elements : Elements
    x : (n, 2) float64, metres
        Nodes of the model.
    """
    m = len(elements.nodes)
    corners = np.repeat(x[elements.nodes], 4, axis=0)
    local = np.tile(GAUSS2, (m, 1))
    jacobian = np.linalg.det(np.einsum("kia,kib->kab", local_gradients(local), corners))
    points = fragment_elements(
        elements.nodes,
        4 * np.arange(m + 1),
        gradients(corners, local),
        jacobian,
        elements.lame,
        elements.shear,
        1.0,
    )
    return points._replace(mass=elements.mass)


def cut_elements(mesh: CutMesh, first_node: int, material: Material, points_per_triangle: int) -> CutElements:
    """The cut elements of one body, with one or three integration points on each triangle of the fragment."""
    rule = THREE_POINTS if points_per_triangle == 3 else ONE_POINT
    count = len(rule)
    elements = np.flatnonzero(mesh.cut)
    per_element = np.bincount(mesh.triangle_element, minlength=len(mesh.elements))[elements]
    points = np.einsum("pk,tka->tpa", rule, mesh.triangles).reshape(-1, 2)
    owner = np.repeat(mesh.triangle_element, count)
    corners = mesh.xy[mesh.elements[owner]]
    weight = np.repeat(_areas(mesh.triangles) / count, count)
    lame, shear = lame_constants(material)
    gradient = gradients(corners, to_local(corners, points))
    return fragment_elements(
        mesh.nodes(elements) + first_node,
        np.concatenate([[0], np.cumsum(count * per_element)]),
        gradient
        + _mended(mesh, elements, gradient, weight)[np.repeat(np.arange(len(elements)), count * per_element)],
        weight,
        lame,
        shear,
        material.rho,
    )


def _areas(triangles: Floats) -> Floats:
    """(t,) Areas of (t, 3, 2) triangles, m^2."""
    side1, side2 = np.moveaxis(triangles[:, 1:] - triangles[:, :1], 1, 0)
    return np.asarray(0.5 * (side1[:, 0] * side2[:, 1] - side1[:, 1] * side2[:, 0]))


def _mended(mesh: CutMesh, elements: Ints, gradient: Floats, weight: Floats) -> Floats:
    """(c, 4, 2) What makes the gradients of each cut element sum to the integral over its fragment, 1/m.

    In a cell that is no parallelogram (a relocated node, a mapped grid) gradients are rational functions, which
    no rule integrates exactly, so that the pieces of a cut cell would not add up to the cell and a constant stress
    would push its nodes. The integral of grad N over the fragment is that of N n along its outline, which is
    right on every edge that cells share; the difference goes along the hourglass vector, so that linear
    fields keep their gradients.
    """
    mended = np.zeros((len(elements), 4, 2))
    corners = mesh.xy[mesh.elements[elements]]
    skew = np.abs(corners[:, 0] - corners[:, 1] + corners[:, 2] - corners[:, 3]).max(axis=1)
    crooked = skew > SKEW * np.ptp(corners, axis=1).max(axis=1)
    of_triangle = np.searchsorted(elements, mesh.triangle_element)
    owner = np.repeat(of_triangle, len(weight) // max(len(of_triangle), 1))
    chosen = crooked[of_triangle]
    if not chosen.any():
        return mended
    of_triangle, triangles = of_triangle[chosen], mesh.triangles[chosen]
    sides = np.roll(triangles, -1, axis=1) - triangles
    points = triangles[:, :, None] + 0.5 * (1.0 + EDGE_POINTS)[:, None] * sides[:, :, None]
    repeated = np.repeat(corners[of_triangle], points.shape[1] * points.shape[2], axis=0)
    n = shape(to_local(repeated, points.reshape(-1, 2))).reshape(*points.shape[:3], 4)
    normal = np.stack([sides[..., 1], -sides[..., 0]], axis=-1)
    np.add.at(mended, of_triangle, np.einsum("g,tegi,tea->tia", 0.5 * EDGE_WEIGHTS, n, normal))
    inside = crooked[owner]
    np.subtract.at(mended, owner[inside], weight[inside, None, None] * gradient[inside])
    which = np.unique(of_triangle)
    gamma = _hourglass_vectors(corners[which])
    along = np.einsum("mi,mia->ma", gamma, mended[which]) / np.einsum("mi,mi->m", gamma, gamma)[:, None]
    mended[which] = np.einsum("mi,ma->mia", gamma, along / mesh.area[elements[which], None])
    return mended


def _hourglass_vectors(corners: Floats) -> Floats:
    """(m, 4) The vector that is orthogonal to 1, x and y at (m, 4, 2) corners."""
    h = np.array([1.0, -1.0, 1.0, -1.0])
    centre = gradients(corners, np.zeros((len(corners), 2)))
    return np.asarray(h - np.einsum("mia,ma->mi", centre, np.einsum("i,mia->ma", h, corners)))


def stiffened(case: Case, meshes: list[CutMesh], cut: CutElements) -> CutElements:
    """Small cut elements with alpha times the internal force (Eq. 30) and the mass, so that the step stays.

    The integration weights are scaled: stress and strain at the points stay what they are, force and energy do not.
    """
    table = case.integration
    fraction = np.concatenate([mesh.cut_fraction for mesh in meshes])
    factor = np.where(fraction < table.alpha_below, table.alpha, 1.0)
    return cut._replace(weight=cut.weight * np.repeat(factor, np.diff(cut.first)), mass=cut.mass * factor)


def damping_of(
    case: Case, meshes: list[CutMesh], elements: Elements, full: CutElements, cut: CutElements
) -> Damping:
    """Mass damping, bulk and hourglass viscosity of the case; elements and their masses before mass scaling."""
    viscosity, bulk = hourglass_control(case)[1], case.damping.bulk_viscosity
    points = NO_BULK_VISCOSITY
    if bulk.linear > 0.0 or bulk.quadratic > 0.0:
        uncut = full if len(full.weight) else as_points(elements)
        cells = [np.sqrt(mesh.area / mesh.fraction) for mesh in meshes]
        length = np.concatenate(
            [side[~mesh.cut] for side, mesh in zip(cells, meshes, strict=True)]
            + [side[mesh.cut] for side, mesh in zip(cells, meshes, strict=True)]
        )
        points = bulk_points(joined_cut_elements([uncut, cut]), length, bulk.linear, bulk.quadratic)
    return Damping(
        mass=case.damping.mass,
        hourglass=hourglass_viscosity(elements, viscosity) if viscosity > 0.0 else np.zeros(0),
        bulk=points,
    )


def joined_elements(parts: list[Elements]) -> Elements:
    """The lists of several bodies behind each other; that of a single one as it is."""
    if len(parts) == 1:
        return parts[0]
    nodes, kind, constants, mass = zip(*parts, strict=True)
    first = np.cumsum([0, *(table.shape[1] for table in constants[:-1])], dtype=np.uint32)
    return Elements(
        np.concatenate(nodes),
        np.concatenate([own + start for own, start in zip(kind, first, strict=True)]),
        np.concatenate(constants, axis=1),
        np.concatenate(mass),
    )


def joined_cut_elements(parts: list[CutElements]) -> CutElements:
    """The lists of several bodies behind each other."""
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    offsets = np.cumsum([0, *(len(p.weight) for p in parts[:-1])])
    ends = [p.first[1:] + offset for p, offset in zip(parts, offsets, strict=True)]
    result = CutElements(*(np.ascontiguousarray(column) for column in joined))
    return result._replace(first=np.concatenate([[0], *ends]).astype(np.int64))
