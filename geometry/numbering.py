"""Numbers for the nodes and cells of a mesh file that depend on the mesh alone, not on the numbers in the file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEVELS = 2.0**20
"""Heights in a mesh that are told apart when its nodes are numbered; differences by rounding are not."""


def renumbered(xy: Floats, quads: Ints) -> tuple[Floats, Ints]:
    """The same mesh, numbered row by row from below, each row from the left.

    Sums over nodes and elements are rounded in the order of the numbers. So the same mesh gives the same results to
    the bit, whatever the order of the nodes, cells and corners in its file was. Neighbours get near numbers, and
    cells between straight lines stand in rows as those of a Cartesian grid do.

    Parameters
    ----------
    xy : (n, 2) float64, metres
    quads : (m, 4) int64
        Nodes of each cell in turn, from any corner on.

    Returns
    -------
    xy : (n, 2) float64, metres
    quads : (m, 4) int64
        Each from its lowest node on, counter-clockwise, by ascending nodes. Each is there once: gmsh 2.2 writes a
        cell for every physical group that it belongs to.

    Raises
    ------
    GeometryError
        Where two nodes are at one place: nothing but their numbers would tell them apart.
    """
    y = xy[:, 1]
    level = np.rint((y - y.min()) * (LEVELS / max(float(np.ptp(y)), np.finfo(np.float64).tiny)))
    order = np.lexsort([y, xy[:, 0], level])
    sorted_xy = xy[order]
    _refuse_twins(sorted_xy)
    number = np.empty(len(xy), dtype=np.int64)
    number[order] = np.arange(len(xy))
    turned = _from_lowest(number[quads])
    a, b, c, d = np.moveaxis(sorted_xy[turned], 1, 0)
    clockwise = (c - a)[:, 0] * (d - b)[:, 1] < (c - a)[:, 1] * (d - b)[:, 0]
    turned[clockwise] = turned[clockwise][:, [0, 3, 2, 1]]
    turned = turned[np.lexsort(turned.T[::-1])]
    again = np.zeros(len(turned), dtype=bool)
    again[1:] = np.all(turned[1:] == turned[:-1], axis=1)
    return sorted_xy, turned[~again]


def _refuse_twins(xy: Floats) -> None:
    """Refuse (n, 2) sorted nodes of which two are at one place."""
    twins = np.flatnonzero(np.all(xy[1:] == xy[:-1], axis=1))
    if len(twins):
        x, y = xy[twins[0]]
        raise GeometryError(
            f"{len(twins)} nodes lie where another one does, the first at ({x:g}, {y:g}) m: parts of the "
            "mesh are not joined; remove duplicate nodes (gmsh: Coherence Mesh)"
        )


def _from_lowest(quads: Ints) -> Ints:
    """(m, 4) The same cells, each from its lowest node on."""
    corner = np.argmin(quads, axis=1)[:, None] + np.arange(4)
    return np.take_along_axis(quads, corner % 4, axis=1)
