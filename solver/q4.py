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
from phantomnode.solver.model import Elements

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

HOURGLASS_SHAPE = np.array([1.0, -1.0, 1.0, -1.0])


def one_point_elements(
    nodes: Ints, corners: Floats, lame: ArrayLike, shear: ArrayLike, rho: ArrayLike, kappa: float = 0.1
) -> Elements:
    """Reference quantities of uncut elements.

    Parameters
    ----------
    nodes : (m, 4) int64
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
    gradient = b / area[:, None, None]
    gamma = HOURGLASS_SHAPE - np.einsum(
        "mia,ma->mi", gradient, np.einsum("i,mia->ma", HOURGLASS_SHAPE, corners)
    )
    wave_modulus = np.broadcast_to(np.asarray(lame) + 2.0 * np.asarray(shear), m)
    hourglass = kappa / 8.0 * wave_modulus * np.einsum("mia,mia->m", b, b) / area
    return Elements(
        nodes=np.ascontiguousarray(nodes, dtype=np.int64).reshape(m, 4),
        gradient=np.ascontiguousarray(gradient),
        volume=np.ascontiguousarray(area),
        gamma=np.ascontiguousarray(gamma),
        hourglass=np.ascontiguousarray(hourglass),
        lame=_each(lame, m),
        shear=_each(shear, m),
        mass=_each(rho, m) * area,
    )


def _each(value: ArrayLike, m: int) -> Floats:
    """(m,) A number for each element, as an array of its own."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), (m,)).copy()


@kernel
def displacement_gradient(nodes: Ints, gradient: Floats, u: Floats) -> tuple[float, float, float, float]:
    """H_ij = sum_I u_i^I dN_I/dX_j from the (4,) nodes and the (4, 2) gradient: H11, H12, H21, H22."""
    h11, h12, h21, h22 = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        ux, uy = u[nodes[i], 0], u[nodes[i], 1]
        h11 += gradient[i, 0] * ux
        h12 += gradient[i, 1] * ux
        h21 += gradient[i, 0] * uy
        h22 += gradient[i, 1] * uy
    return h11, h12, h21, h22


@kernel
def hourglass_mode(nodes: Ints, gamma: Floats, u: Floats) -> tuple[float, float]:
    """Hourglass mode gamma . u in both directions, metres."""
    qx, qy = 0.0, 0.0
    for i in range(4):
        qx += gamma[i] * u[nodes[i], 0]
        qy += gamma[i] * u[nodes[i], 1]
    return qx, qy


@kernel
def smallest_jacobian(nodes: Ints, first: Ints, gradient: Floats, u: Floats) -> float:
    """Smallest J = det F of the points first[e] .. first[e + 1] of each element, NaN where one is not finite.

    Parameters
    ----------
    nodes : (e, 4) int64
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
def element_energies(elements: Elements, u: Floats) -> tuple[float, float]:
    """Internal and hourglass energy of the uncut elements, J/m."""
    internal, hourglass = 0.0, 0.0
    for e in range(len(elements.volume)):
        h11, h12, h21, h22 = displacement_gradient(elements.nodes[e], elements.gradient[e], u)
        qx, qy = hourglass_mode(elements.nodes[e], elements.gamma[e], u)
        density = energy_density(h11, h12, h21, h22, elements.lame[e], elements.shear[e])
        internal += elements.volume[e] * density
        hourglass += 0.5 * elements.hourglass[e] * (qx * qx + qy * qy)
    return internal, hourglass
