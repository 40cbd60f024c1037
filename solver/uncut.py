"""Forces of the uncut elements: uniform rows and scattered elements, strip by strip, on one thread or several.

All go through the same arithmetic (block.py); they differ in how displacements come in and forces go out.
"""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.block import (
    A1X,
    A1Y,
    A2X,
    A2Y,
    BLOCK,
    CONSTANTS,
    CX,
    CY,
    D1X,
    D1Y,
    D2X,
    D2Y,
    G1X,
    HX,
    HY,
    ROOM,
    element_block,
    row_block,
)
from phantomnode.solver.layout import Rows, Scattered, scattered_lists
from phantomnode.solver.model import Elements
from phantomnode.solver.q4 import smallest_element_jacobian

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def add_element_forces(elements: Elements, u: Floats, force: Floats) -> float:
    """Add the internal and hourglass forces of uncut elements, as scattered ones, to the nodal forces.

    Parameters
    ----------
    elements : Elements
    u : (n, 2) float64, metres
    force : (n, 2) float64, N/m
        Added to, in the order of the elements.

    Returns
    -------
    float
        The smallest J met; NaN where one is not finite.
    """
    add_uncut_forces(*scattered_lists(elements), u, force, None)
    return smallest_element_jacobian(elements, u)


@kernel
def add_uncut_forces(rows: Rows, scattered: Scattered, u: Floats, force: Floats, threads: int | None) -> int:
    """Add the internal and hourglass forces of the uncut elements.

    Parameters
    ----------
    rows : Rows
    scattered : Scattered
    u : (n, 2) float64, metres
    force : (n, 2) float64, N/m
        Added to: by the even strips, then by the odd ones, in each by the rows, then by the scattered elements.
    threads : int or None
        None for the caller's alone, or as many as numba is told; the choice is made when this is compiled.

    Returns
    -------
    int
        How many elements are unsound: J not positive or not finite.
    """
    strips, total = len(rows.strip) - 1, 0
    if threads is None:
        for parity in range(2):
            for s in range(parity, strips, 2):
                total += add_strip(rows, scattered, s, u, force)
    else:
        unsound = np.zeros(strips, dtype=np.int64)
        for parity in range(2):
            add_by_threads(rows, scattered, parity, u, force, unsound)
        for s in range(strips):
            total += unsound[s]
    return total


@kernel(parallel=True)
def add_by_threads(
    rows: Rows, scattered: Scattered, parity: int, u: Floats, force: Floats, unsound: Ints
) -> None:
    """Add the forces of every other strip by several threads: strips of one parity share no nodes."""
    for k in prange((len(unsound) - parity + 1) // 2):
        s = 2 * k + parity
        unsound[s] = add_strip(rows, scattered, s, u, force)


@kernel
def add_strip(rows: Rows, scattered: Scattered, strip: int, u: Floats, force: Floats) -> int:
    """Add the forces of the elements of one strip; how many are unsound."""
    block, unsound = np.zeros(ROOM), 0
    ux, uy, fx, fy = u[:, 0], u[:, 1], force[:, 0], force[:, 1]
    a1x, a2x, cx = block[A1X : A1X + BLOCK], block[A2X : A2X + BLOCK], block[CX : CX + BLOCK]
    a1y, a2y, cy = block[A1Y : A1Y + BLOCK], block[A2Y : A2Y + BLOCK], block[CY : CY + BLOCK]
    for r in range(rows.strip[strip], rows.strip[strip + 1]):
        constants = rows.constants[rows.kind[r]]
        for start in range(0, rows.length[r], BLOCK):
            count = min(BLOCK, rows.length[r] - start)
            i, j = rows.low[r] + start, rows.high[r] + start
            k, m = i + count + 1, j + count + 1
            unsound += row_block(block, constants, ux[i:k], uy[i:k], ux[j:m], uy[j:m])
            add_row(a1x, a2x, cx, fx[i:k], fx[j:m])
            add_row(a1y, a2y, cy, fy[i:k], fy[j:m])
    first, last = scattered.strip[strip], scattered.strip[strip + 1]
    for start in range(first, last, BLOCK):
        count = min(BLOCK, last - start)
        gather(block, scattered, start, count, u)
        unsound += element_block(block, count)
        scatter(block, scattered, start, count, force)
    return unsound


@kernel
def add_row(a1: Floats, a2: Floats, c: Floats, low: Floats, high: Floats) -> None:
    """Add one component of the forces of a row to the nodes of its lower and its upper side, (count + 1,)."""
    last = len(low) - 1
    low[0] -= a1[0] + c[0]
    high[0] += a2[0] + c[0]
    for k in range(1, last):
        low[k] += (c[k - 1] - a2[k - 1]) - (a1[k] + c[k])
    for k in range(1, last):
        high[k] += (a1[k - 1] - c[k - 1]) + (a2[k] + c[k])
    low[last] += c[last - 1] - a2[last - 1]
    high[last] += a1[last - 1] - c[last - 1]


@kernel
def gather(block: Floats, scattered: Scattered, start: int, count: int, u: Floats) -> None:
    """Differences and constants of the elements from ``start`` on."""
    ux, uy = u[:, 0], u[:, 1]
    nodes, first = scattered.nodes[start : start + count], scattered.first + start
    for k in range(count):
        n1, n2, n3, n4 = nodes[k, 0], nodes[k, 1], nodes[k, 2], nodes[k, 3]
        u1, u2, u3, u4 = ux[n1], ux[n2], ux[n3], ux[n4]
        block[D1X + k], block[D2X + k], block[HX + k] = u1 - u3, u2 - u4, (u1 - u2) + (u3 - u4)
        u1, u2, u3, u4 = uy[n1], uy[n2], uy[n3], uy[n4]
        block[D1Y + k], block[D2Y + k], block[HY + k] = u1 - u3, u2 - u4, (u1 - u2) + (u3 - u4)
    for c in range(CONSTANTS):
        row, given = block[G1X + c * BLOCK :], scattered.constants[c, first : first + count]
        for k in range(count):
            row[k] = given[k]


@kernel
def scatter(block: Floats, scattered: Scattered, start: int, count: int, force: Floats) -> None:
    """Add the forces of the elements from ``start`` on to their nodes."""
    fx, fy = force[:, 0], force[:, 1]
    nodes = scattered.nodes[start : start + count]
    for k in range(count):
        n1, n2, n3, n4 = nodes[k, 0], nodes[k, 1], nodes[k, 2], nodes[k, 3]
        a1, a2, c = block[A1X + k], block[A2X + k], block[CX + k]
        fx[n1] -= a1 + c
        fx[n2] += c - a2
        fx[n3] += a1 - c
        fx[n4] += a2 + c
        a1, a2, c = block[A1Y + k], block[A2Y + k], block[CY + k]
        fy[n1] -= a1 + c
        fy[n2] += c - a2
        fy[n3] += a1 - c
        fy[n4] += a2 + c
