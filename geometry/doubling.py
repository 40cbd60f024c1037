"""Fragments into elements with real and phantom nodes: the one merging rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class BoundarySegments:
    """Straight pieces of the boundary and of interfaces, one for each side that carries material.

    The material of ``element`` lies on the left of every segment, so the outward normal is on its right.

    Attributes
    ----------
    ends : (s, 2, 2) float64, metres
        Start and end of each segment in the reference configuration.
    element : (s,) int64
        The parent element of each segment.
    local : (s, 2, 2) float64
        Local coordinates (xi, eta) of the ends in the parent element.
    curve : (s,) int64
        Which curve of the body it lies on: first the loops of the regions in order, then the interfaces.
    piece : (s,) int64
        Which piece of that curve.
    side : (s,) int8
        0 on the outline; on an interface +1 where the material lies on the left of the curve, -1 on the right.
    following : (s,) int64
        The segment that begins where this one ends, along the same boundary; -1 where there is none.
    """

    ends: Floats
    element: Ints
    local: Floats
    curve: Ints
    piece: Ints
    side: NDArray[np.int8]
    following: Ints


@dataclass(frozen=True)
class CutMesh:
    """The elements of one body, with real and phantom nodes.

    Attributes
    ----------
    xy : (n, 2) float64, metres
        Position of each node; copies of one grid node stand on the same place.
    grid_node : (n,) int64
        The grid node of which each node is a copy.
    real : (n,) bool
        Whether the node stands in the material of one of its elements; the others are phantom nodes.
    elements : (m, 4) int64
        Nodes of each element, counter-clockwise.
    cell : (m,) int64
        The grid cell of each element.
    area : (m,) float64, m^2
        Area of the material part of each element.
    fraction : (m,) float64
        The same over the area of its cell.
    cut : (m,) bool
        Whether the material is a part of the cell only.
    component : (m,) int64
        Number of the connected part of the body that the element belongs to.
    triangles : (t, 3, 2) float64, metres
        The material part of the cut elements as counter-clockwise triangles.
    triangle_element : (t,) int64
        The element of each triangle; ascending.
    segments : BoundarySegments
    """

    xy: Floats
    grid_node: Ints
    real: Bools
    elements: Ints
    cell: Ints
    area: Floats
    fraction: Floats
    cut: Bools
    component: Ints
    triangles: Floats
    triangle_element: Ints
    segments: BoundarySegments
