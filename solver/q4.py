"""Uncut elements: four nodes, one integration point, Flanagan-Belytschko hourglass stiffness.

Total Lagrangian: P = tau F^-T at the centre, nodal force f_I = -V P grad N_I (uncut.py). The hourglass force
f = -k gamma (gamma . u) has the energy k (gamma . u)^2/2 in each direction.

Source: D. P. Flanagan, T. Belytschko, A uniform strain hexahedron and quadrilateral with orthogonal hourglass
control, Int. J. Numer. Meth. Engng 17 (1981) 679-706.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.hencky import energy_density
from phantomnode.solver.model import HOURGLASS, V_LAME, V_SHEAR, CutElements, Elements, Nodes

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

HOURGLASS_SHAPE = np.array([1.0, -1.0, 1.0, -1.0])


def one_point_elements(
    nodes: Ints, corners: Floats, lame: ArrayLike, shear: ArrayLike, rho: ArrayLike, kappa: float = 0.1
) -> Elements:
    """Reference quantities of uncut elements, each a kind of its own.

    Parameters
    ----------
    nodes : (m, 4) integers
        Nodes of each element, counter-clockwise.
    corners : (m, 4, 2) float64, metres
        Their reference positions.
    lame, shear : float or (m,) float64, Pa
        lambda and mu.
    rho : float or (m,) float64, kg/m^3
    kappa : float
        Hourglass stiffness parameter of Flanagan and Belytschko (their equation 59); 0.05 .. 0.1 is sound.

    Raises
    ------
    ValueError
        Where an element has no positive area.
    """
    m = len(nodes)
    corners = np.asarray(corners, dtype=np.float64).reshape(m, 4, 2)
    x, y = corners[..., 0], corners[..., 1]
    # Flanagan and Belytschko's B_iI, the area times the gradient of N_I at the centre.
    b = 0.5 * np.stack(
        [np.roll(y, -1, axis=1) - np.roll(y, 1, axis=1), np.roll(x, 1, axis=1) - np.roll(x, -1, axis=1)],
        axis=-1,
    )
    area = np.sum(x * b[..., 0], axis=1)
    if m and not np.all(area > 0.0):
        worst = int(np.argmin(area))
        raise ValueError(f"element {worst} has area {area[worst]:g}; give its corners counter-clockwise")
    skew = np.einsum("i,mia->am", HOURGLASS_SHAPE, corners)
    lame, shear, rho = (
        np.broadcast_to(np.asarray(value, dtype=np.float64), m) for value in (lame, shear, rho)
    )
    stiffness = kappa / 8.0 * (lame + 2.0 * shear) * np.einsum("mia,mia->m", b, b) / area
    gradient = (b[:, :2] / area[:, None, None]).reshape(m, 4).T
    return Elements(
        nodes=np.ascontiguousarray(nodes, dtype=np.uint32).reshape(m, 4),
        kind=np.arange(m, dtype=np.uint32),
        constants=np.vstack([gradient, skew, area * lame, area * shear, stiffness, area]),
        mass=rho * area,
    )


@kernel
def displacement_gradient(nodes: Nodes, gradient: Floats, u: Floats) -> tuple[float, float, float, float]:
    """H_ij = sum_I u_i^I dN_I/dX_j from the (4,) nodes and the (4, 2) gradient: H11, H12, H21, H22."""
    h11, h12, h21, h22 = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        ux, uy = u[nodes[i], 0], u[nodes[i], 1]
        h11 += gradient[i, 0] * ux
        h12 += gradient[i, 1] * ux
        h21 += gradient[i, 0] * uy
        h22 += gradient[i, 1] * uy
    return h11, h12, h21, h22


@kernel(inline="always")
def element_gradient(elements: Elements, e: int, u: Floats) -> tuple[float, float, float, float]:
    """H11, H12, H21, H22 at the centre of an uncut element, from the differences across its diagonals."""
    n, c, k = elements.nodes[e], elements.constants, elements.kind[e]
    d1x, d1y = u[n[0], 0] - u[n[2], 0], u[n[0], 1] - u[n[2], 1]
    d2x, d2y = u[n[1], 0] - u[n[3], 0], u[n[1], 1] - u[n[3], 1]
    g1x, g1y, g2x, g2y = c[0, k], c[1, k], c[2, k], c[3, k]
    return d1x * g1x + d2x * g2x, d1x * g1y + d2x * g2y, d1y * g1x + d2y * g2x, d1y * g1y + d2y * g2y


@kernel(inline="always")
def hourglass_mode(elements: Elements, e: int, u: Floats) -> tuple[float, float]:
    """Hourglass mode gamma . u = h . u - H s of an uncut element in both directions, metres."""
    n, c, k = elements.nodes[e], elements.constants, elements.kind[e]
    h11, h12, h21, h22 = element_gradient(elements, e, u)
    qx = (u[n[0], 0] - u[n[1], 0]) + (u[n[2], 0] - u[n[3], 0])
    qy = (u[n[0], 1] - u[n[1], 1]) + (u[n[2], 1] - u[n[3], 1])
    return qx - h11 * c[4, k] - h12 * c[5, k], qy - h21 * c[4, k] - h22 * c[5, k]


@kernel
def smallest_jacobian(nodes: Nodes, first: Ints, gradient: Floats, u: Floats) -> float:
    """Smallest J = det F of the points first[e] .. first[e + 1] of each element, NaN where one is not finite.

    Parameters
    ----------
    nodes : (e, 4) uint32
    first : (e + 1,) int64
    gradient : (p, 4, 2) float64, 1/m
    u : (n, 2) float64, metres
    """
    smallest = math.inf
    for e in range(len(nodes)):
        for p in range(first[e], first[e + 1]):
            h11, h12, h21, h22 = displacement_gradient(nodes[e], gradient[p], u)
            j = 1.0 + (h11 + h22 + (h11 * h22 - h12 * h21))
            if not j < math.inf:
                return math.nan
            smallest = min(smallest, j)
    return smallest


@kernel
def smallest_element_jacobian(elements: Elements, u: Floats) -> float:
    """Smallest J of the uncut elements, NaN where one is not finite."""
    smallest = math.inf
    for e in range(len(elements.kind)):
        h11, h12, h21, h22 = element_gradient(elements, e, u)
        j = 1.0 + (h11 + h22 + (h11 * h22 - h12 * h21))
        if not j < math.inf:
            return math.nan
        smallest = min(smallest, j)
    return smallest


@kernel
def element_energies(elements: Elements, u: Floats) -> tuple[float, float]:
    """Internal and hourglass energy of the uncut elements, J/m."""
    internal, hourglass, c = 0.0, 0.0, elements.constants
    for e in range(len(elements.kind)):
        k = elements.kind[e]
        h11, h12, h21, h22 = element_gradient(elements, e, u)
        qx, qy = hourglass_mode(elements, e, u)
        internal += energy_density(h11, h12, h21, h22, c[V_LAME, k], c[V_SHEAR, k])
        hourglass += 0.5 * c[HOURGLASS, k] * (qx * qx + qy * qy)
    return internal, hourglass


def as_points(elements: Elements) -> CutElements:
    """Uncut elements as a list of integration points, one each."""
    e, first = elements, np.arange(len(elements.kind) + 1)
    return CutElements(e.nodes, first, e.gradient, e.volume, e.lame, e.shear, e.mass)
