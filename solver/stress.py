"""Stresses and strains of a displacement field, for the output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.hencky import cauchy, hencky_strain
from phantomnode.solver.model import V_LAME, V_SHEAR, VOLUME, CutElements, Elements
from phantomnode.solver.q4 import displacement_gradient, element_gradient

Floats = NDArray[np.float64]


@kernel(inline="always")
def set_state(
    at: int, h11: float, h12: float, h21: float, h22: float, lame: float, shear: float,
    stress: Floats, strain: Floats, jacobian: Floats,
) -> None:  # fmt: skip
    """Row ``at`` of the Cauchy stress (p, 4), the Hencky strain (p, 3) and J (p,)."""
    stress[at, 0], stress[at, 1], stress[at, 2], stress[at, 3] = cauchy(h11, h12, h21, h22, lame, shear)
    strain[at, 0], strain[at, 1], strain[at, 2] = hencky_strain(h11, h12, h21, h22)
    jacobian[at] = (1.0 + h11) * (1.0 + h22) - h12 * h21


@kernel(nogil=True)  # frames are written beside the run
def set_element_states(
    elements: Elements, u: Floats, stress: Floats, strain: Floats, jacobian: Floats
) -> None:
    """The states of all uncut elements."""
    c = elements.constants
    for e in range(len(elements.kind)):
        k = elements.kind[e]
        h11, h12, h21, h22 = element_gradient(elements, e, u)
        lame, shear = c[V_LAME, k] / c[VOLUME, k], c[V_SHEAR, k] / c[VOLUME, k]
        set_state(e, h11, h12, h21, h22, lame, shear, stress, strain, jacobian)


@kernel(nogil=True)
def set_point_states(cut: CutElements, u: Floats, stress: Floats, strain: Floats, jacobian: Floats) -> None:
    """The states at all integration points of the cut elements."""
    for e in range(len(cut.nodes)):
        for p in range(cut.first[e], cut.first[e + 1]):
            h11, h12, h21, h22 = displacement_gradient(cut.nodes[e], cut.gradient[p], u)
            set_state(p, h11, h12, h21, h22, cut.lame[e], cut.shear[e], stress, strain, jacobian)


def _room(points: int) -> tuple[Floats, Floats, Floats]:
    return np.empty((points, 4)), np.empty((points, 3)), np.empty(points)


def element_stress(elements: Elements, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Stress and strain of the uncut elements.

    Parameters
    ----------
    elements : Elements
    u : (n, 2) float64, metres

    Returns
    -------
    cauchy : (m, 4) float64, Pa
        Components xx, yy, zz, xy.
    hencky : (m, 3) float64
        Hencky strain, components xx, yy, xy.
    j : (m,) float64
        det F.
    """
    room = _room(len(elements.kind))
    set_element_states(elements, np.ascontiguousarray(u), *room)
    return room


def cut_stress(cut: CutElements, u: Floats) -> tuple[Floats, Floats, Floats]:
    """The same as :func:`element_stress` at each integration point of the cut elements, p rows."""
    room = _room(len(cut.weight))
    set_point_states(cut, np.ascontiguousarray(u), *room)
    return room


def von_mises(cauchy: Floats) -> Floats:
    """(m,) von Mises stress, Pa, of (m, 4) Cauchy stresses xx, yy, zz, xy."""
    xx, yy, zz, xy = cauchy.T
    return np.asarray(np.sqrt(0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * xy**2))
