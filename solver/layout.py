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

from phantomnode.solver.kinds import CHUNK, SHORTEST_ROW, onward
from phantomnode.solver.model import CutElements, Elements, Model, Nodes
from phantomnode.solver.search import Search, prepare_search

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STRIPS, STRIP_ELEMENTS = 64, 2048
"""Most strips, and the least mean number of elements in one."""

TRIED = 4
"""Numbers of strips that are tried one after the other before half as many are."""


class Rows(NamedTuple):
    """Rows of equal elements.

    low (r,), high (r,) first node of the lower and of the upper side, length (r,) elements; kind (r,) row of
    ``constants`` (kinds, 10), see :mod:`phantomnode.solver.model`; strip (strips + 1,) first row of each strip.
    """

    low: Ints
    high: Ints
    length: Ints
    kind: Ints
    constants: Floats
    strip: Ints


class Scattered(NamedTuple):
    """Elements that are in no row.

    nodes (g, 4); constants (10, k) of kinds of elements, of which ``first`` is that of the first element here, and
    those of the others follow; strip (strips + 1,) first element of each strip.
    """

    nodes: Nodes
    constants: Floats
    first: int
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
    rows, scattered = uncut_lists(model.elements.some(slice(0)) if whole else model.elements)
    mass, held = model.mass, np.argwhere(model.channel >= 0)
    most = min(threads, len(rows.strip) // 2)
    return Layout(
        rows=rows,
        scattered=scattered,
        full=point_lists(model.full),
        cut=point_lists(model.cut_elements),
        inverse_mass=np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0.0),
        load=model.load,
        held=Held(
            np.ascontiguousarray(held[:, 0]),
            np.ascontiguousarray(held[:, 1]),
            model.channel[held[:, 0], held[:, 1]].astype(np.int64),
        ),
        search=prepare_search(model.contact),
        threads=most if most > 1 else None,
    )


def uncut_lists(elements: Elements) -> tuple[Rows, Scattered]:
    """Rows and scattered elements, and their strips."""
    first, length = _rows(elements)
    in_row = np.zeros(len(elements.kind) + 1, dtype=np.int8)
    in_row[first] += 1
    in_row[first + length] -= 1
    single = np.flatnonzero(np.cumsum(in_row, dtype=np.int8)[:-1] == 0)
    bounds = _strips(elements.nodes, np.sort(np.concatenate([first, single])))
    kinds, kind = np.unique(elements.kind[first], return_inverse=True)
    rows = Rows(
        low=elements.nodes[first, 0].astype(np.int64),
        high=elements.nodes[first, 3].astype(np.int64),
        length=length,
        kind=kind.reshape(-1).astype(np.int64),
        constants=np.ascontiguousarray(elements.constants[:, kinds].T),
        strip=np.searchsorted(first, bounds).astype(np.int64),
    )
    return rows, _scattered(elements, single, np.searchsorted(single, bounds).astype(np.int64))


def scattered_lists(elements: Elements) -> tuple[Rows, Scattered]:
    """All elements as scattered ones, in one strip, and no rows."""
    none, every = np.zeros(0, dtype=np.int64), np.arange(len(elements.kind))
    rows = Rows(none, none, none, none, np.zeros((0, len(elements.constants))), np.zeros(2, dtype=np.int64))
    return rows, _scattered(elements, every, np.array([0, len(every)]))


def _scattered(elements: Elements, single: Ints, strip: Ints) -> Scattered:
    """The scattered elements; nodes and constants are views of the model's where they stand together there."""
    kind = elements.kind[single]
    first = int(kind[0]) if len(kind) else 0
    if np.array_equal(kind, np.arange(first, first + len(kind))):
        constants = elements.constants
    else:
        constants, first = elements.constants[:, kind], 0
    together = len(single) > 0 and single[-1] - single[0] + 1 == len(single)
    which = slice(single[0], single[-1] + 1) if together else single
    return Scattered(elements.nodes[which], constants, first, strip)


def _rows(elements: Elements) -> tuple[Ints, Ints]:
    """First element and number of elements of each row of one kind."""
    m = len(elements.kind)
    breaks = np.ones(m, dtype=bool)
    for start in range(1, m, CHUNK):
        stop = min(start + CHUNK, m)
        kind = elements.kind[start - 1 : stop]
        breaks[start:stop] = ~(onward(elements, slice(start - 1, stop)) & (kind[1:] == kind[:-1]))
    first = np.flatnonzero(breaks)
    length = np.diff(np.append(first, m))
    return first[length >= SHORTEST_ROW], length[length >= SHORTEST_ROW]


def _strips(nodes: Nodes, units: Ints) -> Ints:
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


def _apart(nodes: Nodes, bounds: Ints) -> bool:
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
        nodes=points.nodes,
        first=points.first,
        gradient=np.ascontiguousarray(points.gradient.reshape(-1, 8).T),
        lame=points.weight * points.lame[owner],
        shear=points.weight * points.shear[owner],
    )
