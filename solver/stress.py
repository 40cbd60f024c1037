"""Stresses and strains of a displacement field, for the output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.hencky import cauchy, hencky_strain
from phantomnode.solver.model import CutElements, Elements
from phantomnode.solver.q4 import displacement_gradient

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@kernel(nogil=True)  # frames are written beside the run
def _point_stress(
    nodes: Ints, gradient: Floats, lame: Floats, shear: Floats, first: Ints, u: Floats
) -> tuple[Floats, Floats, Floats]:
    """Cauchy stress (p, 4), Hencky strain (p, 3), J (p,) at the points first[e] .. of each element."""
    stress, strain, jacobian = (
        np.empty((len(gradient), 4)),
        np.empty((len(gradient), 3)),
        np.empty(len(gradient)),
    )
    for e in range(len(nodes)):
        for p in range(first[e], first[e + 1]):
            h11, h12, h21, h22 = displacement_gradient(nodes[e], gradient[p], u)
            stress[p, 0], stress[p, 1], stress[p, 2], stress[p, 3] = cauchy(
                h11, h12, h21, h22, lame[e], shear[e]
            )
            strain[p, 0], strain[p, 1], strain[p, 2] = hencky_strain(h11, h12, h21, h22)
            jacobian[p] = (1.0 + h11) * (1.0 + h22) - h12 * h21
    return stress, strain, jacobian


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
    one_each = np.arange(len(elements.volume) + 1)
    e = elements
    stress, strain, j = _point_stress(e.nodes, e.gradient, e.lame, e.shear, one_each, np.ascontiguousarray(u))
    return stress, strain, j


def cut_stress(cut: CutElements, u: Floats) -> tuple[Floats, Floats, Floats]:
    """The same as :func:`element_stress` at each integration point of the cut elements, p rows."""
    u = np.ascontiguousarray(u)
    stress, strain, j = _point_stress(cut.nodes, cut.gradient, cut.lame, cut.shear, cut.first, u)
    return stress, strain, j


def von_mises(cauchy: Floats) -> Floats:
    """(m,) von Mises stress, Pa, of (m, 4) Cauchy stresses xx, yy, zz, xy."""
    xx, yy, zz, xy = cauchy.T
    return np.asarray(np.sqrt(0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * xy**2))
