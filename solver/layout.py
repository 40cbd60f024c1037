"""The lists of a model as the time loop reads them: uniform rows apart, by columns, in strips for the threads.

Uncut elements of a Cartesian grid stand in rows: from one to the next all four nodes are one further, and the
constants stay. A row needs neither connectivity nor constants of each element. All others are scattered elements
with lists of their own.

The elements, in the order of the model, are divided into strips so that no two even strips share a node, nor two odd
ones: strips of rows share nodes with their neighbours, and on a grid that closes on itself the last one does with the
first. First the even strips are added to the nodal forces, in any order or at once, then the odd ones: the sums, and
so all results, do not depend on the number of threads. The number of strips depends on the model alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.solver.model import CutElements, Elements, Model
from phantomnode.solver.search import Search, prepare_search

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Nodes = NDArray[np.uint32]
"""Numbers without a sign: a kernel need not look for negative indices."""

SHORTEST_ROW = 4
"""Fewer elements in a row are cheaper as scattered ones."""

ROUNDING = 16.0 * np.finfo(np.float64).eps
"""Constants that differ by no more than this part times x/h differ by the rounding of the positions x only."""

CHUNK = 1 << 18
"""Elements looked at together: what is needed in between stays small."""

STRIPS, STRIP_ELEMENTS = 64, 2048
"""Most strips, and the least mean number of elements in one."""

TRIED = 4
"""Numbers of strips that are tried one after the other before half as many are."""


class Rows(NamedTuple):
    """Rows of equal elements.

    low (r,), high (r,) first node of the lower and of the upper side, length (r,) elements; kind (r,) row of
    ``constants`` (kinds, 9), see :mod:`phantomnode.solver.block`; strip (strips + 1,) first row of each strip.
    """

    low: Ints
    high: Ints
    length: Ints
    kind: Ints
    constants: Floats
    strip: Ints


class Scattered(NamedTuple):
    """Elements that are in no row: nodes (g, 4); constants (9, g); strip (strips + 1,) first one of each strip."""

    nodes: Nodes
    constants: Floats
    strip: Ints


class Points(NamedTuple):
    """Integration points by columns.

    nodes (c, 4); first (c + 1,) first point of each element; gradient (8, p) of the four nodes in turn, x before y,
    1/m; lame (p,), shear (p,): lambda and mu times the weight, N.
    """

    nodes: Nodes
    first: Ints
    gradient: Floats
    lame: Floats
    shear: Floats


class Held(NamedTuple):
    """Prescribed degrees of freedom: node (h,), axis (h,), channel (h,)."""

    node: Ints
    axis: Ints
    channel: Ints


class Layout(NamedTuple):
    """What the time loop needs besides the model.

    rows, scattered: the uncut elements, none where they are integrated in full; full, cut: the points of the others;
    inverse_mass (n,), m/kg, 0 without mass; load (n, 2) constant nodal force, N/m, empty where there is none; held;
    search: the nodes of the contact pairs; threads: how many take part, None for the loop's own alone.
    """

    rows: Rows
    scattered: Scattered
    full: Points
    cut: Points
    inverse_mass: Floats
    load: Floats
    held: Held
    search: Search
    threads: int | None


def prepare_layout(model: Model, threads: int = 1) -> Layout:
    """The lists of a model as the time loop reads them, for at most so many threads."""
    whole = len(model.full.weight) > 0
    rows, scattered = uncut_lists(_none_of(model.elements) if whole else model.elements, model.x)
    mass, held = model.mass, np.argwhere(model.channel >= 0)
    load = model.load if np.any(model.load) else np.zeros((0, 2))
    most = min(threads, len(rows.strip) // 2)
    return Layout(
        rows=rows,
        scattered=scattered,
        full=point_lists(model.full),
        cut=point_lists(model.cut_elements),
        inverse_mass=np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0.0),
        load=np.asfortranarray(load),
        held=Held(
            np.ascontiguousarray(held[:, 0]),
            np.ascontiguousarray(held[:, 1]),
            model.channel[held[:, 0], held[:, 1]],
        ),
        search=prepare_search(model.contact),
        threads=most if most > 1 else None,
    )


def _none_of(elements: Elements) -> Elements:
    return Elements._make(field[:0] for field in elements)


def element_constants(elements: Elements) -> Floats:
    """(9, m) What an element needs beside its nodes, see :mod:`phantomnode.solver.block`."""
    e = elements
    # gamma = h - s . grad N sums with h and -h over the nodes of a diagonal to 2 - 2 s . grad N_1, and so on.
    first, second = e.gradient[:, 0], e.gradient[:, 1]
    along = 1.0 - e.gamma[:, 0], -1.0 - e.gamma[:, 1]
    determinant = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    sx = (along[0] * second[:, 1] - along[1] * first[:, 1]) / determinant
    sy = (along[1] * first[:, 0] - along[0] * second[:, 0]) / determinant
    return np.stack([*first.T, *second.T, sx, sy, e.volume * e.lame, e.volume * e.shear, e.hourglass])


def uncut_lists(elements: Elements, x: Floats) -> tuple[Rows, Scattered]:
    """Rows and scattered elements, and their strips.

    Parameters
    ----------
    elements : Elements
    x : (n, 2) float64, metres
        Reference positions of the nodes.
    """
    first, length = _rows(elements, x)
    in_row = np.zeros(len(elements.volume) + 1, dtype=np.int8)
    in_row[first] += 1
    in_row[first + length] -= 1
    single = np.flatnonzero(np.cumsum(in_row, dtype=np.int8)[:-1] == 0)
    bounds = _strips(elements.nodes, np.sort(np.concatenate([first, single])))
    constants, rounding = _with_rounding(elements, first, x)
    coarse = np.max(rounding, axis=1, initial=0.0, keepdims=True)
    whole = np.round(constants / np.where(coarse > 0.0, coarse, 1.0))
    _, kinds, kind = np.unique(whole, axis=1, return_index=True, return_inverse=True)
    rows = Rows(
        low=elements.nodes[first, 0],
        high=elements.nodes[first, 3],
        length=length,
        kind=kind.reshape(-1).astype(np.int64),
        constants=np.ascontiguousarray(constants[:, kinds].T),
        strip=np.searchsorted(first, bounds).astype(np.int64),
    )
    scattered = Scattered(
        nodes=elements.nodes[single].astype(np.uint32),
        constants=element_constants(Elements._make(field[single] for field in elements)),
        strip=np.searchsorted(single, bounds).astype(np.int64),
    )
    return rows, scattered


def scattered_lists(elements: Elements) -> tuple[Rows, Scattered]:
    """All elements as scattered ones, in one strip, and no rows."""
    none, whole = np.zeros(0, dtype=np.int64), np.array([0, len(elements.volume)])
    rows = Rows(none, none, none, none, np.zeros((0, 9)), np.zeros(2, dtype=np.int64))
    return rows, Scattered(elements.nodes.astype(np.uint32), element_constants(elements), whole)


def _with_rounding(elements: Elements, which: Ints | slice, x: Floats) -> tuple[Floats, Floats]:
    """(9, k) Constants of some elements, and what the rounding of the positions can make of them."""
    constants = element_constants(Elements._make(field[which] for field in elements))
    steep = np.max(np.abs(constants[:4]), axis=0, initial=0.0)
    size = np.stack([*[steep] * 4, *[1.0 / steep] * 2, *np.abs(constants[6:])])
    return constants, np.asarray(ROUNDING * np.max(np.abs(x), initial=0.0) * steep * size)


def _rows(elements: Elements, x: Floats) -> tuple[Ints, Ints]:
    """First element and number of elements of each row."""
    m = len(elements.volume)
    breaks = np.ones(m, dtype=bool)
    for start in range(1, m, CHUNK):
        stop = min(start + CHUNK, m)
        nodes = elements.nodes[start - 1 : stop]
        constants, rounding = _with_rounding(elements, slice(start - 1, stop), x)
        onward = np.all(np.diff(nodes, axis=0) == 1, axis=1)
        onward &= (nodes[1:, 0] == nodes[:-1, 1]) & (nodes[1:, 3] == nodes[:-1, 2])
        onward &= np.all(np.abs(np.diff(constants, axis=1)) <= rounding[:, 1:], axis=0)
        breaks[start:stop] = ~onward
    first = np.flatnonzero(breaks)
    length = np.diff(np.append(first, m))
    first, length = first[length >= SHORTEST_ROW], length[length >= SHORTEST_ROW]
    return _equal(elements, first, length, x)


def _equal(elements: Elements, first: Ints, length: Ints, x: Floats) -> tuple[Ints, Ints]:
    """The rows all of whose elements are like their first one: small differences add up in a graded grid."""
    alike = np.ones(len(first), dtype=bool)
    begin = 0
    while begin < len(first):
        end = max(begin + 1, int(np.searchsorted(np.cumsum(length[begin:]), CHUNK)) + begin)
        members = np.concatenate(
            [np.arange(a, a + n) for a, n in zip(first[begin:end], length[begin:end], strict=True)]
        )
        constants, rounding = _with_rounding(elements, members, x)
        bounds = np.cumsum(length[begin:end]) - length[begin:end]
        unlike = np.abs(constants - np.repeat(constants[:, bounds], length[begin:end], axis=1)) > rounding
        alike[begin:end] = ~np.logical_or.reduceat(unlike.any(axis=0), bounds)
        begin = end
    return first[alike], length[alike]


def _strips(nodes: Ints, units: Ints) -> Ints:
    """(strips + 1,) First element of each strip; ``units`` are the elements at which one may begin."""
    m = len(nodes)
    strips = max(1, min(STRIPS, m // STRIP_ELEMENTS))
    while True:
        # A grid that closes on itself needs an even number of strips, and there may be other bodies behind it.
        for count in range(strips, max(strips - TRIED, strips // 2, 0), -1):
            wanted = np.searchsorted(units, m * np.arange(1, count) // count)
            bounds = np.unique(np.concatenate([[0], units[wanted[wanted < len(units)]], [m]])).astype(
                np.int64
            )
            if count == 1 or _apart(nodes, bounds):
                return bounds
        strips //= 2


def _apart(nodes: Ints, bounds: Ints) -> bool:
    """Whether no node belongs to two even strips, or to two odd ones."""
    for parity in (0, 1):
        taken = np.zeros(int(nodes.max()) + 1, dtype=np.bool_)
        for strip in range(parity, len(bounds) - 1, 2):
            here = nodes[bounds[strip] : bounds[strip + 1]].ravel()
            if np.any(taken[here]):
                return False
            taken[here] = True
    return True


def point_lists(points: CutElements) -> Points:
    """Integration points by columns."""
    owner = np.repeat(np.arange(len(points.lame)), np.diff(points.first))
    return Points(
        nodes=points.nodes.astype(np.uint32),
        first=points.first,
        gradient=np.ascontiguousarray(points.gradient.reshape(-1, 8).T),
        lame=points.weight * points.lame[owner],
        shear=points.weight * points.shear[owner],
    )
