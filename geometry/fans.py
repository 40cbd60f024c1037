"""Fragments as fans of triangles about a centroid, for integration with one point a triangle.

One point a triangle leaves no zero-energy mode where the triangles stand around a point inside: their middles
lie around it and never on one line, and three points off a line see every mode of the bilinear cell. A fan
from a vertex, or any other division, can leave such modes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SEEN = 1e-9
"""Least part of the fragment that every triangle of a fan has; with less, an edge is not seen from the centroid."""


def centroid_fans(triangles: Floats, element: Ints) -> tuple[Floats, Ints]:
    """Divide every fragment anew: a fan about its centroid where that sees the whole outline.

    Where it does not (a fragment that is far from convex, or has a hole), each of its triangles becomes a fan of
    three about its own centroid, which is as sound and has more points.

    Parameters
    ----------
    triangles : (t, 3, 2) float64, metres
        Counter-clockwise triangles that fill the fragments.
    element : (t,) int64
        The fragment of each triangle, ascending.

    Returns
    -------
    triangles, element : (r, 3, 2) float64, metres, and (r,) int64
        Likewise; the areas and centroids of the fragments stay.
    """
    if len(triangles) == 0:
        return triangles, element
    fragments, owner = np.unique(element, return_inverse=True)
    area = _areas(triangles)
    total = np.bincount(owner, area)
    moment = area[:, None] * triangles.mean(axis=1)
    centroid = np.column_stack([np.bincount(owner, moment[:, k]) for k in (0, 1)]) / total[:, None]

    edges, edge_owner = _outline(triangles, owner)
    fan = np.concatenate([centroid[edge_owner][:, None], edges], axis=1)
    part = _areas(fan)
    smallest = np.full(len(fragments), np.inf)
    np.minimum.at(smallest, edge_owner, part)
    filled = np.abs(np.bincount(edge_owner, part, len(fragments)) - total) <= SEEN * total
    seen = (smallest > SEEN * total) & filled

    middle = triangles.mean(axis=1)
    thirds = np.stack([np.stack([middle, triangles[:, k], triangles[:, k - 2]], 1) for k in range(3)], 1)
    keep, split = seen[edge_owner], ~seen[owner]
    result = np.concatenate([fan[keep], thirds[split].reshape(-1, 3, 2)])
    numbers = np.concatenate([edge_owner[keep], np.repeat(owner[split], 3)])
    order = np.argsort(numbers, kind="stable")
    return result[order], fragments[numbers[order]]


def _areas(triangles: Floats) -> Floats:
    """(t,) Signed areas of (t, 3, 2) triangles."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def _outline(triangles: Floats, owner: Ints) -> tuple[Floats, Ints]:
    """Edges (k, 2, 2) that only one triangle of a fragment has, and the fragment of each."""
    edges = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    owners = np.repeat(owner, 3)
    swap = (edges[:, 0, 0] > edges[:, 1, 0]) | (
        (edges[:, 0, 0] == edges[:, 1, 0]) & (edges[:, 0, 1] > edges[:, 1, 1])
    )
    ends = np.where(swap[:, None, None], edges[:, ::-1], edges).reshape(-1, 4)
    _, kind, count = np.unique(
        np.column_stack([owners, ends]), axis=0, return_inverse=True, return_counts=True
    )
    single = count[kind.reshape(-1)] == 1
    return edges[single], owners[single]
