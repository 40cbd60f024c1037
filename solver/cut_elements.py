"""Cut elements: full integration over the triangles of the fragment.

The gradients of the bilinear shape functions of the whole cell are taken at each point.

Three points a triangle leave no zero-energy mode beside the rigid ones, so no hourglass term is needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.block import BLOCK, POINT_LAME, POINT_SHEAR, ROOM, point_block
from phantomnode.solver.hencky import energy_density
from phantomnode.solver.layout import Points, point_lists
from phantomnode.solver.model import CutElements, Nodes
from phantomnode.solver.q4 import displacement_gradient, smallest_jacobian

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def fragment_elements(
    nodes: Ints | Nodes,
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
    nodes : (c, 4) integers
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
        nodes=np.ascontiguousarray(nodes, dtype=np.uint32).reshape(c, 4),
        first=first,
        gradient=np.ascontiguousarray(gradient, dtype=np.float64).reshape(-1, 4, 2),
        weight=weight,
        lame=each(lame),
        shear=each(shear),
        mass=each(rho) * area,
    )


def add_cut_forces(cut: CutElements, u: Floats, force: Floats) -> float:
    """Add the internal forces of the cut elements to (n, 2) force, N/m; return the smallest J or NaN."""
    add_point_forces(point_lists(cut), u, force)
    return smallest_jacobian(cut.nodes, cut.first, cut.gradient, u)


@kernel
def add_point_forces(points: Points, u: Floats, force: Floats) -> int:
    """Add the internal forces of integration points to (n, 2) force, N/m; how many are unsound (J <= 0)."""
    block, unsound, total = np.zeros(ROOM), 0, len(points.lame)
    element = 0  # the one that owns the first point of the block
    for start in range(0, total, BLOCK):
        count = min(BLOCK, total - start)
        gather_points(block, points, element, start, count, u)
        unsound += point_block(block, points.gradient, start, count)
        element = scatter_points(block, points, element, start, count, force)
    return unsound


@kernel
def gather_points(block: Floats, points: Points, element: int, start: int, count: int, u: Floats) -> None:
    """Displacements of the nodes of the points from ``start`` on, of which ``element`` owns the first."""
    done = 0
    while done < count:
        last = min(count, points.first[element + 1] - start)
        for i in range(4):
            n = points.nodes[element, i]
            ux, uy = u[n, 0], u[n, 1]
            row_x, row_y = block[2 * i * BLOCK :], block[(2 * i + 1) * BLOCK :]
            for k in range(done, last):
                row_x[k], row_y[k] = ux, uy
        done, element = last, element + 1
    for k in range(count):
        block[POINT_LAME + k], block[POINT_SHEAR + k] = points.lame[start + k], points.shear[start + k]


@kernel
def scatter_points(block: Floats, points: Points, element: int, start: int, count: int, force: Floats) -> int:
    """Add the forces of the points of the block to their nodes; the element that owns the next point."""
    done = 0
    while True:
        last = min(count, points.first[element + 1] - start)
        f1x, f1y, f2x, f2y, f3x, f3y, f4x, f4y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(done, last):
            f1x, f1y = f1x + block[k], f1y + block[BLOCK + k]
            f2x, f2y = f2x + block[2 * BLOCK + k], f2y + block[3 * BLOCK + k]
            f3x, f3y = f3x + block[4 * BLOCK + k], f3y + block[5 * BLOCK + k]
            f4x, f4y = f4x + block[6 * BLOCK + k], f4y + block[7 * BLOCK + k]
        add_at(force, points.nodes[element, 0], f1x, f1y)
        add_at(force, points.nodes[element, 1], f2x, f2y)
        add_at(force, points.nodes[element, 2], f3x, f3y)
        add_at(force, points.nodes[element, 3], f4x, f4y)
        element += points.first[element + 1] == start + last
        if last == count:
            return element
        done = last


@kernel(inline="always")
def add_at(force: Floats, node: int, fx: float, fy: float) -> None:
    """Add a force to that of a node."""
    force[node, 0] += fx
    force[node, 1] += fy


@kernel
def cut_energy(cut: CutElements, u: Floats) -> float:
    """Internal energy of the cut elements, J/m."""
    internal = 0.0
    for e in range(len(cut.lame)):
        for p in range(cut.first[e], cut.first[e + 1]):
            h11, h12, h21, h22 = displacement_gradient(cut.nodes[e], cut.gradient[p], u)
            internal += cut.weight[p] * energy_density(h11, h12, h21, h22, cut.lame[e], cut.shear[e])
    return internal
