"""Cut elements: full integration over the triangles of the fragment.

The gradients of the bilinear shape functions of the whole cell are taken at each point.

Three points a triangle leave no zero-energy mode beside the rigid ones, so no hourglass term is needed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.block import BLOCK, ROOM, J, gather, stress_block, stress_of
from phantomnode.solver.hencky import energy_density
from phantomnode.solver.model import CutElements
from phantomnode.solver.q4 import displacement_gradient

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def fragment_elements(
    nodes: Ints,
    first: Ints,
    gradient: Floats,
    weight: Floats,
    lame: ArrayLike,
    shear: ArrayLike,
    rho: ArrayLike,
) -> CutElements:
    """Cut elements from their integration points; the mass is rho times the sum of the weights.

    Parameters
    ----------
    nodes : (c, 4) int64
    first : (c + 1,) int64
        First integration point of each element.
    gradient : (p, 4, 2) float64, 1/m
    weight : (p,) float64, m^2
    lame, shear : float or (c,) float64, Pa
    rho : float or (c,) float64, kg/m^3

    Raises
    ------
    ValueError
        Where an element has no points, or no positive weight.
    """
    c = len(nodes)
    first = np.ascontiguousarray(first, dtype=np.int64)
    weight = np.ascontiguousarray(weight, dtype=np.float64)
    area = np.bincount(np.repeat(np.arange(c), np.diff(first)), weights=weight, minlength=c)
    if not np.all(area > 0.0):
        raise ValueError(f"cut element {int(np.argmin(area))} has no integration point of positive weight")

    def each(value: ArrayLike) -> Floats:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (c,)).copy()

    return CutElements(
        nodes=np.ascontiguousarray(nodes, dtype=np.int64).reshape(c, 4),
        first=first,
        gradient=np.ascontiguousarray(gradient, dtype=np.float64).reshape(-1, 4, 2),
        weight=weight,
        lame=each(lame),
        shear=each(shear),
        mass=each(rho) * area,
    )


@kernel
def owner(first: Ints, point: int, before: int) -> int:
    """The element of an integration point, at or after the element ``before``."""
    while point >= first[before + 1]:
        before += 1
    return before


@kernel
def add_cut_forces(cut: CutElements, u: Floats, force: Floats) -> float:
    """Add the internal forces of the cut elements to (n, 2) force, N/m; return the smallest J or NaN."""
    smallest, lost = math.inf, False
    block, total = np.zeros(ROOM), len(cut.weight)
    reading, writing = 0, 0  # elements that own the points
    for start in range(0, total, BLOCK):
        count = min(BLOCK, total - start)
        for k in range(count):
            p = start + k
            reading = owner(cut.first, p, reading)
            lame, shear = cut.weight[p] * cut.lame[reading], cut.weight[p] * cut.shear[reading]
            gather(block, k, cut.nodes[reading], cut.gradient[p], lame, shear, u)
        stress_block(block, count)
        for k in range(count):
            p, j = start + k, block[J + k]
            writing = owner(cut.first, p, writing)
            p11, p12, p21, p22 = stress_of(block, k)
            smallest, lost = min(smallest, j), lost or not j < math.inf
            for i in range(4):
                n, gx, gy = cut.nodes[writing, i], cut.gradient[p, i, 0], cut.gradient[p, i, 1]
                force[n, 0] -= p11 * gx + p12 * gy
                force[n, 1] -= p21 * gx + p22 * gy
    return math.nan if lost else smallest


@kernel
def cut_energy(cut: CutElements, u: Floats) -> float:
    """Internal energy of the cut elements, J/m."""
    internal = 0.0
    for e in range(len(cut.lame)):
        for p in range(cut.first[e], cut.first[e + 1]):
            h11, h12, h21, h22 = displacement_gradient(cut.nodes[e], cut.gradient[p], u)
            internal += cut.weight[p] * energy_density(h11, h12, h21, h22, cut.lame[e], cut.shear[e])
    return internal
