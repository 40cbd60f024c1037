"""Integration points on the boundary of cut bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.pipeline.bodies import CutBody

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
"""Two points a segment, exact for the cubic that a follower pressure on a bilinear trace is."""


class SurfacePoints(NamedTuple):
    """Two Gauss points on each of some boundary segments.

    nodes (q, 4) of the mesh; shape (q, 4); slope (q, 4): the sum of slope[I] x[I] is the line element, m; length
    (q,) reference length of each point, m; normal (q, 2) outward in the reference configuration.
    """

    nodes: Ints
    shape: Floats
    slope: Floats
    length: Floats
    normal: Floats


def surface_points(body: CutBody, chosen: Ints) -> SurfacePoints:
    """The integration points of some boundary segments of a body.

    Shape functions are taken as quadratic along a segment, through their values at its ends and its middle:
    exact in rectangular cells, and everywhere linear fields and the resultants of segments are.
    """
    mesh = body.mesh
    ends, local = mesh.segments.ends[chosen], mesh.segments.local[chosen]
    nodes = mesh.nodes(mesh.segments.element[chosen])
    start, end = shape(local[:, 0]), shape(local[:, 1])
    middle = shape(to_local(mesh.xy[nodes], ends.mean(axis=1)))
    s = GAUSS[:, None]
    values = [
        start[:, None] * (1 - s) * (1 - 2 * s),
        middle[:, None] * 4 * s * (1 - s),
        end[:, None] * s * (2 * s - 1),
    ]
    slopes = [start[:, None] * (4 * s - 3), middle[:, None] * (4 - 8 * s), end[:, None] * (4 * s - 1)]
    side = ends[:, 1] - ends[:, 0]
    length = np.hypot(*side.T)
    normal = np.column_stack([side[:, 1], -side[:, 0]]) / length[:, None]
    return SurfacePoints(
        nodes=np.repeat(nodes, 2, axis=0),
        shape=np.sum(values, axis=0).reshape(-1, 4),
        slope=0.5 * np.sum(slopes, axis=0).reshape(-1, 4),
        length=np.repeat(0.5 * length, 2),
        normal=np.repeat(normal, 2, axis=0),
    )
