"""What is drawn: every body clipped to its material, deformed with it, and no phantom part.

An uncut element is drawn as its quadrilateral, a cut one as the triangles of its fragment. A point inside
or on the edge of an element moves with the bilinear interpolation of that element's nodes, real and phantom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.pipeline.prepare import Body, Prepared

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ON_THE_EDGE = 2e-6
"""Shape functions below this are zero: the point lies on the opposite edge. The lattice of the cut leaves up to
5e-7 where the edge is slanted; in a picture that is nothing."""


@dataclass(frozen=True)
class ClippedBodies:
    """All bodies of a case, clipped: what stays the same from frame to frame.

    Cells are the uncut elements in the order of ``model.elements``, then the triangles of the cut elements in
    the order of ``model.cut_elements``.

    Attributes
    ----------
    on_nodes : (c,) int32
        The node of the model on which each of the first points stands.
    nodes : (r, 4) int64
        Nodes of the model that carry each of the points between them, which follow.
    weights : (r, 4) float64
        Their shape functions at the point; they sum to 1.
    quads : (q, 4) int32
        Points of each uncut element, counter-clockwise.
    triangles : (t, 3) int32
        Points of each triangle of the cut elements, counter-clockwise.
    """

    on_nodes: NDArray[np.int32]
    nodes: Ints
    weights: Floats
    quads: NDArray[np.int32]
    triangles: NDArray[np.int32]

    @classmethod
    def of(cls, prepared: Prepared) -> ClippedBodies:
        """Clip the bodies of a prepared case."""
        quads = prepared.model.elements.nodes
        nodes, weights, place = _triangle_corners(prepared.bodies)
        single = np.count_nonzero(weights, axis=1) == 1
        own = nodes[np.arange(len(nodes)), np.argmax(weights, axis=1)]  # the node on which a corner stands

        used = np.zeros(len(prepared.model.x), dtype=bool)
        used[quads], used[own[single]] = True, True
        on_nodes = np.flatnonzero(used).astype(np.int32)
        point_of_node = np.cumsum(used, dtype=np.int32) - np.int32(1)
        between, point = _merge(nodes[~single], weights[~single], place[~single])
        corner = np.empty(len(nodes), dtype=np.int32)
        corner[single] = point_of_node[own[single]]
        corner[~single] = len(on_nodes) + point
        return cls(
            on_nodes=on_nodes,
            nodes=nodes[~single][between],
            weights=weights[~single][between],
            quads=point_of_node[quads].reshape(-1, 4),
            triangles=corner.reshape(-1, 3),
        )

    @property
    def points(self) -> int:
        """Number of points."""
        return len(self.on_nodes) + len(self.nodes)

    def interpolate(self, nodal: Floats) -> Floats:
        """(p, k) Values at the points from (n, k) values at the nodes of the model."""
        return np.column_stack([self.interpolated(column) for column in nodal.T])

    def interpolated(self, nodal: Floats) -> Floats:
        """(p,) The same of one component (n,)."""
        return np.concatenate([nodal[self.on_nodes], np.sum(self.weights * nodal[self.nodes], axis=1)])

    def per_cell(self, uncut: Floats, points: Floats) -> Floats:
        """(q + t, ...) One value a cell from uncut elements, (q, ...), and integration points, (3 t, ...)."""
        return np.concatenate([uncut, self.means(points)])

    def means(self, points: NDArray[np.floating[Any]]) -> Floats:
        """(t, ...) One value a triangle from (3 t, ...) values at its integration points.

        With one point a triangle there are t rows of points. A triangle takes the mean of its points, which
        carry equal weights.
        """
        each = max(len(points) // max(len(self.triangles), 1), 1)
        return np.asarray(points.reshape(len(self.triangles), each, *points.shape[1:]).mean(axis=1))


def _triangle_corners(bodies: tuple[Body, ...]) -> tuple[Ints, Floats, Floats]:
    """Corners of all triangles: (3 t, 4) nodes of the model, (3 t, 4) shape functions, (3 t, 2) places, m."""
    nodes, weights, places = [], [], []
    for body in bodies:
        mesh = body.mesh
        parent = np.repeat(mesh.nodes(mesh.triangle_element), 3, axis=0)
        corners = mesh.xy[parent]
        shapes = shape(to_local(corners, mesh.triangles.reshape(-1, 2)))
        shapes[np.abs(shapes) < ON_THE_EDGE] = 0.0
        nodes.append(body.nodes.start + parent)
        weights.append(shapes / shapes.sum(axis=1, keepdims=True))
        places.append(mesh.triangles.reshape(-1, 2))
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(places)


def _merge(nodes: Ints, weights: Floats, places: Floats) -> tuple[Ints, Ints]:
    """Corners that are one point: on the same place and carried by the same nodes.

    Returns the (r,) corners that represent each point and the (k,) point of each corner. Places come from one
    lattice, so the same vertex is the same to the bit. Two sides of a crack stand on the same place but on
    different nodes, so they stay apart.
    """
    if len(nodes) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    carriers = np.sort(np.where(weights == 0.0, -1, nodes), axis=1)
    key = np.hstack([carriers.astype(np.float64), places])
    _, first, point = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return first, point.reshape(-1)


class Labels(NamedTuple):
    """Of every cell drawn, (q + t,): body and side, the numbers of the body and of its connected part; fraction,
    material area over cell area of the element.
    """

    body: Ints
    side: Ints
    fraction: Floats


def cell_labels(bodies: tuple[Body, ...]) -> Labels:
    """Body, connected part and material fraction of every cell drawn."""
    rows = [(k, body.mesh, np.flatnonzero(~body.mesh.cut)) for k, body in enumerate(bodies)]
    rows += [(k, body.mesh, body.mesh.triangle_element) for k, body in enumerate(bodies)]
    return Labels(
        body=np.concatenate([np.full(len(elements), k) for k, _, elements in rows]),
        side=np.concatenate([mesh.component[elements].astype(np.int64) for _, mesh, elements in rows]),
        fraction=np.concatenate([mesh.fraction[elements] for _, mesh, elements in rows]),
    )
