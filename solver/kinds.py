"""Elements of equal constants share a kind: the rows of a Cartesian grid that no curve moves have one for all.

Elements of a row follow each other: from one to the next all four nodes are one further. What makes their constants
differ is the rounding of the positions alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.solver.model import GRADIENT, Elements

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SHORTEST_ROW = 4
"""Fewer elements in a row are cheaper as scattered ones."""

ROUNDING = 16.0 * np.finfo(np.float64).eps
"""Constants that differ by no more than this part times x/h differ by the rounding of the positions x only."""

CHUNK = 1 << 16
"""Elements looked at together: what is needed in between stays small."""


def shared_kinds(elements: Elements, x: Floats) -> Elements:
    """The elements, of as few kinds as there are: first those of the rows, then one for each scattered element.

    Parameters
    ----------
    elements : Elements
    x : (n, 2) float64, metres
        Reference positions of the nodes.
    """
    rounding = ROUNDING * float(np.max(np.abs(x), initial=0.0))
    first, length = _rows(elements, rounding)
    if len(first) == 0:
        return elements
    first_constants = elements.constants[:, elements.kind[first]]
    coarse = np.max(_rounding_of(first_constants, rounding), axis=1, initial=0.0, keepdims=True)
    whole = np.round(first_constants / np.where(coarse > 0.0, coarse, 1.0))
    _, one_of, number = np.unique(whole, axis=1, return_index=True, return_inverse=True)
    in_row = np.zeros(len(elements.kind) + 1, dtype=np.int8)
    in_row[first] += 1
    in_row[first + length] -= 1
    single = np.cumsum(in_row[:-1], dtype=np.int8) == 0
    kind = np.empty(len(single), dtype=np.uint32)
    kind[~single] = np.repeat(number.reshape(-1), length)
    kind[single] = np.arange(len(one_of), len(one_of) + np.count_nonzero(single))
    constants = np.concatenate(
        [first_constants[:, one_of], elements.constants[:, elements.kind[single]]], axis=1
    )
    return elements._replace(kind=kind, constants=constants)


def onward(elements: Elements, rows: slice) -> Bools:
    """(k - 1,) Whether all nodes of an element are one further than those of the one before, of k in turn."""
    nodes = elements.nodes[rows]
    after, before = nodes[1:], nodes[:-1]
    follows = (after[:, 0] == before[:, 1]) & (after[:, 3] == before[:, 2])
    for corner in range(4):
        follows &= after[:, corner] == before[:, corner] + np.uint32(1)
    return np.asarray(follows)


def _rounding_of(constants: Floats, rounding: Floats | float) -> Floats:
    """(10, k) What the rounding of the positions can make of constants (10, k)."""
    steep = np.max(np.abs(constants[GRADIENT]), axis=0, initial=0.0)
    size = np.stack([*[steep] * 4, *[1.0 / steep] * 2, *np.abs(constants[6:])])
    return np.asarray(rounding * steep * size)


def _rows(elements: Elements, rounding: float) -> tuple[Ints, Ints]:
    """First element and number of elements of each row."""
    m = len(elements.kind)
    breaks = np.ones(m, dtype=bool)
    for start in range(1, m, CHUNK):
        stop = min(start + CHUNK, m)
        constants = elements.constants[:, elements.kind[start - 1 : stop]]
        alike = np.abs(np.diff(constants, axis=1)) <= _rounding_of(constants, rounding)[:, 1:]
        breaks[start:stop] = ~(onward(elements, slice(start - 1, stop)) & np.all(alike, axis=0))
    first = np.flatnonzero(breaks)
    length = np.diff(np.append(first, m))
    first, length = first[length >= SHORTEST_ROW], length[length >= SHORTEST_ROW]
    return _equal(elements, first, length, rounding)


def _equal(elements: Elements, first: Ints, length: Ints, rounding: float) -> tuple[Ints, Ints]:
    """The rows all of whose elements are like their first one: small differences add up in a graded grid."""
    alike = np.ones(len(first), dtype=bool)
    begin = 0
    while begin < len(first):
        end = max(begin + 1, int(np.searchsorted(np.cumsum(length[begin:]), CHUNK)) + begin)
        members = np.concatenate(
            [np.arange(a, a + n) for a, n in zip(first[begin:end], length[begin:end], strict=True)]
        )
        constants = elements.constants[:, elements.kind[members]]
        bounds = np.cumsum(length[begin:end]) - length[begin:end]
        unlike = np.abs(constants - np.repeat(constants[:, bounds], length[begin:end], axis=1))
        unlike = unlike > _rounding_of(constants, rounding)
        alike[begin:end] = ~np.logical_or.reduceat(unlike.any(axis=0), bounds)
        begin = end
    return first[alike], length[alike]
