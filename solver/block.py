"""Forces of a block of uncut elements, or of integration points, in a form that the compiler turns into vector code.

A block is one flat array of rows of ``BLOCK`` numbers. Gathering displacements and scattering forces cannot be
vectorised where nodes are numbered freely; all arithmetic in between can, if it has no branch: the series of the
law alone is taken here, and the few points beyond its limit are done again by
:func:`phantomnode.solver.hencky.first_piola`. Products and sums may be contracted to fused multiply-adds.

With the gradient of a bilinear quadrilateral at its centre, the nodes across a diagonal have opposite gradients,
grad N_3 = -grad N_1 and grad N_4 = -grad N_2, and the hourglass vector is gamma_I = h_I - s . grad N_I with
h = (1, -1, 1, -1) and s = sum h_I x_I. So u_1 - u_3, u_2 - u_4 and h . u are all that an element needs to know:

    H = (u_1 - u_3) grad N_1 + (u_2 - u_4) grad N_2,    q = h . u - H s,
    f_I = -(V P - k q s^T) grad N_I - k q h_I.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.hencky import SERIES_LIMIT, atanh_series, first_piola, pull_back, strain_measures

Floats = NDArray[np.float64]

BLOCK = 128
"""Elements or points in a block: its rows stay in the first-level cache."""

LANES = 8
"""Blocks are computed in whole vectors of so many numbers; what lies beyond the last element is not used."""

D1X, D1Y, D2X, D2Y, HX, HY = (BLOCK * row for row in range(6))
"""Of an element: u_1 - u_3, u_2 - u_4 and h . u, m."""

G1X, G1Y, G2X, G2Y, SX, SY, LAME, SHEAR, STIFFNESS = (BLOCK * row for row in range(6, 15))
"""Its constants: grad N_1 and grad N_2, 1/m; s, m; V lambda and V mu, N; hourglass stiffness k, N/m."""

CONSTANTS = 9

A1X, A1Y, A2X, A2Y, CX, CY = (BLOCK * row for row in range(15, 21))
"""Its results: (V P - k q s^T) grad N_1, the same with grad N_2, and k q, N/m."""

BEYOND = 21 * BLOCK
"""What must not exceed SERIES_LIMIT for the series to hold."""

ROOM = 22 * BLOCK

POINT_LAME, POINT_SHEAR = 8 * BLOCK, 9 * BLOCK
"""Of a point: lambda and mu times its weight, N, behind u_x and u_y of its four nodes in turn, m."""

POINT_STRESS = 10 * BLOCK
"""Its weight times P11, P12, P21, P22, N/m. The results -w P grad N_I, N/m, take the place of the displacements."""


@kernel(inline="always")
def series_piola(
    h11: float, h12: float, h21: float, h22: float, lame: float, shear: float
) -> tuple[float, float, float, float, float]:
    """First Piola-Kirchhoff stress P11, P12, P21, P22 by the series, and what must not exceed its limit."""
    half, b12, inverse, y, z, j1 = strain_measures(h11, h12, h21, h22)
    z2 = z * z
    mean = (lame + shear) * (2.0 * z * atanh_series(z2))
    factor = shear * (2.0 * atanh_series(y) * inverse)
    d, t12 = factor * half, factor * b12
    p11, p12, p21, p22 = pull_back(mean + d, mean - d, t12, h11, h12, h21, h22, 1.0 + j1)
    return p11, p12, p21, p22, y + z2


@kernel(inline="always")
def gradient_of(
    d1x: float, d1y: float, d2x: float, d2y: float, g1x: float, g1y: float, g2x: float, g2y: float
) -> tuple[float, float, float, float]:
    """H11, H12, H21, H22 from the differences across the diagonals."""
    return d1x * g1x + d2x * g2x, d1x * g1y + d2x * g2y, d1y * g1x + d2y * g2x, d1y * g1y + d2y * g2y


@kernel(inline="always")
def forces_of(
    p11: float, p12: float, p21: float, p22: float, g1x: float, g1y: float, g2x: float, g2y: float
) -> tuple[float, float, float, float]:
    """P grad N_1 and P grad N_2."""
    return p11 * g1x + p12 * g1y, p21 * g1x + p22 * g1y, p11 * g2x + p12 * g2y, p21 * g2x + p22 * g2y


@kernel(fastmath={"contract"})
def element_block(block: Floats, count: int) -> int:
    """Results of the first ``count`` elements from their differences and constants; how many are unsound (J <= 0)."""
    beyond = 0
    for k in range(LANES * ((count + LANES - 1) // LANES)):
        g1x, g1y, g2x, g2y = block[G1X + k], block[G1Y + k], block[G2X + k], block[G2Y + k]
        sx, sy, stiffness = block[SX + k], block[SY + k], block[STIFFNESS + k]
        h11, h12, h21, h22 = gradient_of(
            block[D1X + k], block[D1Y + k], block[D2X + k], block[D2Y + k], g1x, g1y, g2x, g2y
        )
        p11, p12, p21, p22, limit = series_piola(h11, h12, h21, h22, block[LAME + k], block[SHEAR + k])
        cx = stiffness * (block[HX + k] - h11 * sx - h12 * sy)
        cy = stiffness * (block[HY + k] - h21 * sx - h22 * sy)
        a1x, a1y, a2x, a2y = forces_of(
            p11 - cx * sx, p12 - cx * sy, p21 - cy * sx, p22 - cy * sy, g1x, g1y, g2x, g2y
        )
        block[A1X + k], block[A1Y + k], block[A2X + k], block[A2Y + k] = a1x, a1y, a2x, a2y
        block[CX + k], block[CY + k], block[BEYOND + k] = cx, cy, limit
        beyond += not limit <= SERIES_LIMIT
    return elements_beyond(block, count) if beyond > 0 else 0


@kernel(fastmath={"contract"})
def row_block(
    block: Floats, constants: Floats, low_x: Floats, low_y: Floats, high_x: Floats, high_y: Floats
) -> int:
    """Results of equal elements in a row from the displacements along its sides; how many are unsound (J <= 0).

    constants (9,); low_x, low_y, high_x, high_y (count + 1,), m. Elements that follow each other by a shift are
    parallelograms, so that s = 0.
    """
    g1x, g1y, g2x, g2y = constants[0], constants[1], constants[2], constants[3]
    lame, shear, stiffness = constants[6], constants[7], constants[8]
    beyond = 0
    for k in range(len(low_x) - 1):
        u1, u2, u3, u4 = low_x[k], low_x[k + 1], high_x[k + 1], high_x[k]
        v1, v2, v3, v4 = low_y[k], low_y[k + 1], high_y[k + 1], high_y[k]
        h11, h12, h21, h22 = gradient_of(u1 - u3, v1 - v3, u2 - u4, v2 - v4, g1x, g1y, g2x, g2y)
        p11, p12, p21, p22, limit = series_piola(h11, h12, h21, h22, lame, shear)
        a1x, a1y, a2x, a2y = forces_of(p11, p12, p21, p22, g1x, g1y, g2x, g2y)
        block[A1X + k], block[A1Y + k], block[A2X + k], block[A2Y + k] = a1x, a1y, a2x, a2y
        block[CX + k], block[CY + k] = (
            stiffness * ((u1 - u2) + (u3 - u4)),
            stiffness * ((v1 - v2) + (v3 - v4)),
        )
        block[BEYOND + k] = limit
        beyond += not limit <= SERIES_LIMIT
    return row_beyond(block, constants, low_x, low_y, high_x, high_y) if beyond > 0 else 0


@kernel
def row_beyond(
    block: Floats, constants: Floats, low_x: Floats, low_y: Floats, high_x: Floats, high_y: Floats
) -> int:
    """Do the elements of a row beyond the limit of the series again; how many are unsound."""
    count = len(low_x) - 1
    for k in range(count):
        block[D1X + k], block[D1Y + k] = low_x[k] - high_x[k + 1], low_y[k] - high_y[k + 1]
        block[D2X + k], block[D2Y + k] = low_x[k + 1] - high_x[k], low_y[k + 1] - high_y[k]
        block[SX + k], block[SY + k] = 0.0, 0.0
        block[G1X + k], block[G1Y + k] = constants[0], constants[1]
        block[G2X + k], block[G2Y + k] = constants[2], constants[3]
        block[LAME + k], block[SHEAR + k] = constants[6], constants[7]
    return elements_beyond(block, count)


@kernel
def elements_beyond(block: Floats, count: int) -> int:
    """Do the elements beyond the limit of the series again by the full law; how many are unsound."""
    unsound = 0
    for k in range(count):
        if block[BEYOND + k] <= SERIES_LIMIT:
            continue
        g1x, g1y, g2x, g2y = block[G1X + k], block[G1Y + k], block[G2X + k], block[G2Y + k]
        sx, sy, cx, cy = block[SX + k], block[SY + k], block[CX + k], block[CY + k]
        h11, h12, h21, h22 = gradient_of(
            block[D1X + k], block[D1Y + k], block[D2X + k], block[D2Y + k], g1x, g1y, g2x, g2y
        )
        unsound += not is_sound(h11, h12, h21, h22)
        p11, p12, p21, p22 = first_piola(h11, h12, h21, h22, block[LAME + k], block[SHEAR + k])
        block[A1X + k], block[A1Y + k], block[A2X + k], block[A2Y + k] = forces_of(
            p11 - cx * sx, p12 - cx * sy, p21 - cy * sx, p22 - cy * sy, g1x, g1y, g2x, g2y
        )
    return unsound


@kernel
def is_sound(h11: float, h12: float, h21: float, h22: float) -> bool:
    """Whether J = det(I + H) is positive and finite."""
    return 0.0 < 1.0 + (h11 + h22 + (h11 * h22 - h12 * h21)) < math.inf


@kernel(inline="always")
def point_gradient(
    block: Floats, k: int,
    g1x: float, g1y: float, g2x: float, g2y: float, g3x: float, g3y: float, g4x: float, g4y: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """H11, H12, H21, H22 at point k of the block from the gradients of its nodes."""
    u1, u2, u3, u4 = block[k], block[2 * BLOCK + k], block[4 * BLOCK + k], block[6 * BLOCK + k]
    v1, v2, v3, v4 = block[BLOCK + k], block[3 * BLOCK + k], block[5 * BLOCK + k], block[7 * BLOCK + k]
    h11, h12 = (u1 * g1x + u2 * g2x) + (u3 * g3x + u4 * g4x), (u1 * g1y + u2 * g2y) + (u3 * g3y + u4 * g4y)
    h21, h22 = (v1 * g1x + v2 * g2x) + (v3 * g3x + v4 * g4x), (v1 * g1y + v2 * g2y) + (v3 * g3y + v4 * g4y)
    return h11, h12, h21, h22


@kernel(fastmath={"contract"})
def point_block(block: Floats, gradient: Floats, start: int, count: int) -> int:
    """Results of points from the displacements of their nodes; how many are unsound.

    The (8, p) gradients of all points, 1/m, are those of the four nodes in turn, x before y; the block holds the
    points from ``start`` on.
    """
    g1x, g1y = gradient[0, start : start + count], gradient[1, start : start + count]
    g2x, g2y = gradient[2, start : start + count], gradient[3, start : start + count]
    g3x, g3y = gradient[4, start : start + count], gradient[5, start : start + count]
    g4x, g4y = gradient[6, start : start + count], gradient[7, start : start + count]
    beyond = 0
    for k in range(count):
        h11, h12, h21, h22 = point_gradient(
            block, k, g1x[k], g1y[k], g2x[k], g2y[k], g3x[k], g3y[k], g4x[k], g4y[k]
        )
        p11, p12, p21, p22, limit = series_piola(
            h11, h12, h21, h22, block[POINT_LAME + k], block[POINT_SHEAR + k]
        )
        block[POINT_STRESS + k], block[POINT_STRESS + BLOCK + k] = p11, p12
        block[POINT_STRESS + 2 * BLOCK + k], block[POINT_STRESS + 3 * BLOCK + k] = p21, p22
        block[BEYOND + k] = limit
        beyond += not limit <= SERIES_LIMIT
    unsound = points_beyond(block, gradient, start, count) if beyond > 0 else 0
    for i in range(4):
        spread(block, i, gradient[2 * i, start : start + count], gradient[2 * i + 1, start : start + count])
    return unsound


@kernel
def points_beyond(block: Floats, gradient: Floats, start: int, count: int) -> int:
    """Stresses of the points beyond the limit of the series by the full law; how many are unsound."""
    unsound = 0
    for k in range(count):
        if block[BEYOND + k] <= SERIES_LIMIT:
            continue
        g = gradient[:, start + k]
        h11, h12, h21, h22 = point_gradient(block, k, g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7])
        unsound += not is_sound(h11, h12, h21, h22)
        p11, p12, p21, p22 = first_piola(h11, h12, h21, h22, block[POINT_LAME + k], block[POINT_SHEAR + k])
        block[POINT_STRESS + k], block[POINT_STRESS + BLOCK + k] = p11, p12
        block[POINT_STRESS + 2 * BLOCK + k], block[POINT_STRESS + 3 * BLOCK + k] = p21, p22
    return unsound


@kernel(fastmath={"contract"})
def spread(block: Floats, node: int, gx: Floats, gy: Floats) -> None:
    """-P grad N of one of the nodes of all points, in place of its displacements."""
    p11, p12 = block[POINT_STRESS:], block[POINT_STRESS + BLOCK :]
    p21, p22 = block[POINT_STRESS + 2 * BLOCK :], block[POINT_STRESS + 3 * BLOCK :]
    fx, fy = block[2 * node * BLOCK :], block[(2 * node + 1) * BLOCK :]
    for k in range(len(gx)):
        fx[k], fy[k] = -(p11[k] * gx[k] + p12[k] * gy[k]), -(p21[k] * gx[k] + p22[k] * gy[k])
