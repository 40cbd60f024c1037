"""Stresses and strains of a displacement field, for the output.

As forces are (block.py), they are worked out for a block of points at a time, by the series of the law in vector
code; the few points beyond its limit are done again by the full law.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.block import BLOCK
from phantomnode.solver.hencky import SERIES_LIMIT, atanh_series, cauchy, hencky_strain, strain_measures
from phantomnode.solver.model import V_LAME, V_SHEAR, VOLUME, CutElements, Elements
from phantomnode.solver.q4 import displacement_gradient, element_gradient

Floats = NDArray[np.float64]
Reals = NDArray[np.floating[Any]]

H11, H12, H21, H22, LAME, SHEAR = (BLOCK * row for row in range(6))
"""Of a point: H = F - I, and lambda and mu, Pa."""

S11, S22, S33, S12, E11, E22, E12, J, MISES = (BLOCK * row for row in range(6, 15))
"""Its results: Cauchy stress, Pa; Hencky strain; det F; von Mises stress, Pa."""

BEYOND = 15 * BLOCK
"""What must not exceed SERIES_LIMIT for the series to hold."""

ROOM = 16 * BLOCK


class States(NamedTuple):
    """Where states of p points are written, in float64 or float32.

    cauchy (p, 4 or more) stress xx, yy, zz, xy, Pa; hencky (p, 4 or more) strain xx, yy, zz (which is zero), xy;
    j (p,) det F; mises (p,) von Mises stress, Pa.
    """

    cauchy: Reals
    hencky: Reals
    j: Reals
    mises: Reals


@kernel(fastmath={"contract"})
def state_block(block: Floats, count: int) -> None:
    """The states of the first ``count`` points from their gradients and moduli."""
    beyond = 0
    for k in range(count):
        h11, h12, h21, h22 = block[H11 + k], block[H12 + k], block[H21 + k], block[H22 + k]
        lame, shear = block[LAME + k], block[SHEAR + k]
        half, b12, inverse, y, z, _ = strain_measures(h11, h12, h21, h22)
        z2 = z * z
        log_j, factor = 2.0 * z * atanh_series(z2), 2.0 * atanh_series(y) * inverse
        d, c12 = factor * half, factor * b12
        j = (1.0 + h11) * (1.0 + h22) - h12 * h21
        per_area, mean = 1.0 / j, (lame + shear) * log_j
        set_row(
            block, k, (mean + shear * d) * per_area, (mean - shear * d) * per_area, lame * log_j * per_area,
            shear * c12 * per_area, 0.5 * (log_j + d), 0.5 * (log_j - d), 0.5 * c12, j,
        )  # fmt: skip
        block[BEYOND + k] = y + z2
        beyond += not y + z2 <= SERIES_LIMIT
    if beyond > 0:
        states_beyond(block, count)


@kernel
def states_beyond(block: Floats, count: int) -> None:
    """Do the points beyond the limit of the series again by the full law."""
    for k in range(count):
        if block[BEYOND + k] <= SERIES_LIMIT:
            continue
        h11, h12, h21, h22 = block[H11 + k], block[H12 + k], block[H21 + k], block[H22 + k]
        s11, s22, s33, s12 = cauchy(h11, h12, h21, h22, block[LAME + k], block[SHEAR + k])
        e11, e22, e12 = hencky_strain(h11, h12, h21, h22)
        set_row(block, k, s11, s22, s33, s12, e11, e22, e12, (1.0 + h11) * (1.0 + h22) - h12 * h21)


@kernel(inline="always")
def set_row(
    block: Floats, k: int,
    s11: float, s22: float, s33: float, s12: float, e11: float, e22: float, e12: float, j: float,
) -> None:  # fmt: skip
    """The results of one point of the block."""
    block[S11 + k], block[S22 + k], block[S33 + k], block[S12 + k] = s11, s22, s33, s12
    block[E11 + k], block[E22 + k], block[E12 + k], block[J + k] = e11, e22, e12, j
    a, b, c = s11 - s22, s22 - s33, s33 - s11
    block[MISES + k] = math.sqrt(0.5 * (a * a + b * b + c * c) + 3.0 * s12 * s12)


@kernel
def store(block: Floats, start: int, count: int, states: States) -> None:
    """Write the results of the block to the states from ``start`` on."""
    for k in range(count):
        p = start + k
        states.cauchy[p, 0], states.cauchy[p, 1] = block[S11 + k], block[S22 + k]
        states.cauchy[p, 2], states.cauchy[p, 3] = block[S33 + k], block[S12 + k]
        states.hencky[p, 0], states.hencky[p, 1] = block[E11 + k], block[E22 + k]
        states.hencky[p, 2], states.hencky[p, 3] = 0.0, block[E12 + k]
        states.j[p], states.mises[p] = block[J + k], block[MISES + k]


@kernel(nogil=True)  # frames are written beside the run
def set_element_states(elements: Elements, u: Floats, states: States) -> None:
    """The states of all uncut elements."""
    block, c, total = np.zeros(ROOM), elements.constants, len(elements.kind)
    for start in range(0, total, BLOCK):
        count = min(BLOCK, total - start)
        for k in range(count):
            kind = elements.kind[start + k]
            h11, h12, h21, h22 = element_gradient(elements, start + k, u)
            block[H11 + k], block[H12 + k], block[H21 + k], block[H22 + k] = h11, h12, h21, h22
            block[LAME + k] = c[V_LAME, kind] / c[VOLUME, kind]
            block[SHEAR + k] = c[V_SHEAR, kind] / c[VOLUME, kind]
        state_block(block, count)
        store(block, start, count, states)


@kernel(nogil=True)
def set_point_states(cut: CutElements, u: Floats, states: States) -> None:
    """The states at all integration points of the cut elements."""
    block, held, first = np.zeros(ROOM), 0, 0
    for e in range(len(cut.nodes)):
        for p in range(cut.first[e], cut.first[e + 1]):
            h11, h12, h21, h22 = displacement_gradient(cut.nodes[e], cut.gradient[p], u)
            block[H11 + held], block[H12 + held], block[H21 + held], block[H22 + held] = h11, h12, h21, h22
            block[LAME + held], block[SHEAR + held] = cut.lame[e], cut.shear[e]
            held += 1
            if held == BLOCK:
                state_block(block, held)
                store(block, first, held, states)
                held, first = 0, p + 1
    state_block(block, held)
    store(block, first, held, states)


def room_for(points: int) -> States:
    """Room for the states of so many points, float64."""
    return States(np.empty((points, 4)), np.empty((points, 4)), np.empty(points), np.empty(points))


def element_stress(elements: Elements, u: Floats) -> States:
    """Stress and strain of the uncut elements from (n, 2) displacements, m."""
    states = room_for(len(elements.kind))
    set_element_states(elements, np.asfortranarray(u), states)
    return states


def cut_stress(cut: CutElements, u: Floats) -> States:
    """The same at each integration point of the cut elements."""
    states = room_for(len(cut.weight))
    set_point_states(cut, np.asfortranarray(u), states)
    return states


def von_mises(cauchy: Reals) -> Floats:
    """(m,) von Mises stress, Pa, of (m, 4) Cauchy stresses xx, yy, zz, xy."""
    xx, yy, zz, xy = cauchy.T.astype(np.float64, copy=False)
    return np.asarray(np.sqrt(0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * xy**2))
