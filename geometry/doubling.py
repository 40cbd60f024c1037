"""Fragments into elements with real and phantom nodes: the one merging rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.arrangement import components
from phantomnode.geometry.bilinear import to_local
from phantomnode.geometry.cut import Fragments
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid, Numbers, chunks
from phantomnode.geometry.triangles import triangles_of_faces

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
    grid_node : (n,) int32
        The grid node of which each node is a copy.
    real : (n,) bool
        Whether the node stands in the material of one of its elements; the others are phantom nodes.
    elements : (m, 4) int32
        Nodes of each element, counter-clockwise.
    cell : (m,) int32
        The grid cell of each element.
    area : (m,) float64, m^2
        Area of the material part of each element.
    cut_fraction : (c,) float64
        The same over the area of its cell, of the cut elements.
    cut : (m,) bool
        Whether the material is a part of the cell only.
    component : (m,) int32
        Number of the connected part of the body that the element belongs to.
    triangles : (t, 3, 2) float64, metres
        The material part of the cut elements as counter-clockwise triangles.
    triangle_element : (t,) int64
        The element of each triangle; ascending.
    segments : BoundarySegments
    """

    xy: Floats
    grid_node: Numbers
    real: Bools
    elements: Numbers
    cell: Numbers
    area: Floats
    cut_fraction: Floats
    cut: Bools
    component: Numbers
    triangles: Floats
    triangle_element: Ints
    segments: BoundarySegments
    notes: tuple[str, ...] = ()

    @property
    def fraction(self) -> Floats:
        """(m,) Area of the material part of each element over the area of its cell."""
        fraction = np.ones(len(self.cut))
        fraction[self.cut] = self.cut_fraction
        return fraction

    def nodes(self, elements: Ints | Bools) -> Ints:
        """(k, 4) int64 Nodes of some elements."""
        return self.elements[elements].astype(np.int64)


def double(grid: BackgroundGrid, fragments: Fragments) -> CutMesh:
    """Turn fragments into elements with four nodes each, shared by the one merging rule.

    Two fragments of cells beside each other that share a piece of positive length of the common edge without
    a barrier have both end nodes of that edge in common: bilinear traces are affine along an edge, so being
    equal on any piece of it is being equal at both ends. Every other corner is a node of its own (paper,
    Fig. 6; Hansbo and Hansbo 2004; Song et al. 2006).

    Parameters
    ----------
    grid : BackgroundGrid
        The relocated grid that was cut.
    fragments : Fragments

    Raises
    ------
    GeometryError
        Where no cell lies in the body.
    """
    count = len(fragments.cell)
    if count == 0:
        raise GeometryError("no cell of the background grid lies in the body: make its cells smaller")
    near = np.flatnonzero(_in_part(fragments))
    cells = np.searchsorted(fragments.part.cells, fragments.cell[near])
    pairs = _shared_edges(fragments)
    elements, grid_node = _numbered(grid, fragments, near, cells, pairs)
    lattice = fragments.lattice
    xy = np.empty((len(grid_node), 2))
    for rows in chunks(len(xy)):
        xy[rows] = lattice.position(lattice.snap(grid.position(grid_node[rows])))
    triangles, triangle_element = _triangles(fragments)
    cell_area = np.empty(count)
    for rows in chunks(count):
        a, b, c, d = np.moveaxis(xy[elements[rows]], 1, 0)
        cell_area[rows] = 0.5 * _cross(c - a, d - b)
    cut_area = np.bincount(triangle_element, _areas(triangles), minlength=count)
    area = np.where(fragments.whole, cell_area, cut_area)
    return CutMesh(
        xy=xy,
        grid_node=grid_node,
        real=_real(fragments, elements, len(grid_node)),
        elements=elements,
        cell=fragments.cell,
        area=area,
        cut_fraction=area[~fragments.whole] / cell_area[~fragments.whole],
        cut=~fragments.whole,
        component=_components(fragments, near, pairs),
        triangles=triangles,
        triangle_element=triangle_element,
        segments=_boundary_segments(fragments, xy, elements),
        notes=_resolution_notes(fragments, elements),
    )


class _SharedEdges(NamedTuple):
    """Pieces of grid edges without a barrier: (k,) the edge, the elements on its left and right."""

    edge: Ints
    left: Ints
    right: Ints


def _shared_edges(fragments: Fragments) -> _SharedEdges:
    """Where elements of the part of the grid near barriers share a piece of an edge."""
    edges = fragments.edges
    # Pieces of edges in the band, then whole edges between cells outside it.
    piece = np.flatnonzero((fragments.grid_edge >= 0) & ~fragments.barrier)
    forward = fragments.edge_forward[piece]
    on_left, on_right = fragments.beside(True)[piece], fragments.beside(False)[piece]
    far = np.flatnonzero(np.all(edges.cell >= 0, axis=1) & np.all(fragments.of_cell[edges.cell] >= 0, axis=1))
    edge = np.concatenate([fragments.grid_edge[piece], far])
    left = np.concatenate([np.where(forward, on_left, on_right), fragments.of_cell[edges.cell[far, 0]]])
    right = np.concatenate([np.where(forward, on_right, on_left), fragments.of_cell[edges.cell[far, 1]]])
    both = (left >= 0) & (right >= 0)
    return _SharedEdges(edge[both], left[both], right[both])


def _in_part(fragments: Fragments) -> Bools:
    """(m,) Whether the cell of an element belongs to the part of the grid near barriers."""
    near = fragments.region < 0
    near[fragments.of_cell[fragments.of_cell >= 0]] = True
    return near


def _merged_corners(
    fragments: Fragments, near: Ints, corners: Numbers, shared: _SharedEdges
) -> tuple[Ints, Ints]:
    """Pairs of corner slots (4 * element + corner, elements counted among the near ones) that are one node.

    ``corners`` (k, 4) are the nodes of these elements in the part. A node that is not near a curve, where cells
    outside the part may stand, has only whole cells around it: all corners there are one node.
    """
    left, right = np.searchsorted(near, shared.left), np.searchsorted(near, shared.right)
    start, back = fragments.edges.corner[shared.edge].T
    slots = np.flatnonzero(~fragments.part.near[corners.reshape(-1)])
    slots = slots[np.argsort(corners.reshape(-1)[slots], kind="stable")]
    same = np.flatnonzero(np.diff(corners.reshape(-1)[slots]) == 0)
    first = np.concatenate([4 * left + start, 4 * left + (start + 1) % 4, slots[same]])
    second = np.concatenate([4 * right + (back + 1) % 4, 4 * right + back, slots[same + 1]])
    return first, second


def _numbered(
    grid: BackgroundGrid, fragments: Fragments, near: Ints, cells: Ints, shared: _SharedEdges
) -> tuple[Numbers, Numbers]:
    """(m, 4) Nodes of all elements, and (n,) the grid node of each.

    ``near`` are the elements in the part, ``cells`` their cells there. Nodes stand in the order of the grid
    nodes, then of the elements: the same numbers whatever scipy does.
    """
    corners = fragments.part.grid.quads[cells]
    first, second = _merged_corners(fragments, near, corners, shared)
    slots = corners.size
    _, copy = components(slots, first, second)
    representative = np.full(slots, slots)
    np.minimum.at(representative, copy, np.arange(slots))
    representative = representative[copy]
    roots = np.flatnonzero(representative == np.arange(slots))
    grid_of_root = fragments.part.nodes[corners.reshape(-1)[roots]]

    elements = np.empty((len(fragments.cell), 4), dtype=np.int32)
    copies = np.zeros(grid.node_count, dtype=np.int32)
    for rows in chunks(len(elements)):
        elements[rows] = grid.corners(fragments.cell[rows])
        copies[elements[rows]] = 1
    copies[fragments.part.nodes] = 0
    np.add.at(copies, grid_of_root, np.int32(1))
    used = np.flatnonzero(copies)
    grid_node = np.repeat(used.astype(np.int32), copies[used])
    number = np.cumsum(copies, dtype=np.int32)
    number -= copies
    for rows in chunks(len(elements)):
        elements[rows] = number[elements[rows]]

    order = np.lexsort([roots, grid_of_root])
    grid_of_root = grid_of_root[order]
    rank = np.arange(len(roots)) - np.searchsorted(grid_of_root, grid_of_root)
    number_of_root = np.empty(slots, dtype=np.int64)
    number_of_root[roots[order]] = number[grid_of_root] + rank
    elements[near] = number_of_root[representative].reshape(-1, 4)
    return elements, grid_node


def _components(fragments: Fragments, near: Ints, shared: _SharedEdges) -> Ints:
    """(m,) The connected part of the body that each element belongs to, numbered by their first elements."""
    regions = int(fragments.region.max(initial=-1)) + 1
    plain = np.flatnonzero(fragments.region[near] >= 0)
    first = np.concatenate([np.searchsorted(near, shared.left), plain])
    second = np.concatenate([np.searchsorted(near, shared.right), len(near) + fragments.region[near[plain]]])
    count, group = components(len(near) + regions, first, second)
    group = group.astype(np.int32)
    component = group[len(near) :][fragments.region] if regions else np.zeros(len(fragments.cell), np.int32)
    component[near] = group[: len(near)]
    lowest = np.full(count, len(component))
    lowest[component[::-1]] = np.arange(len(component))[::-1]  # what is written last stays
    rank = np.empty(count, dtype=np.int32)
    rank[np.argsort(lowest, kind="stable")] = np.arange(count)
    return np.asarray(rank[component])


def _real(fragments: Fragments, elements: Numbers, nodes: int) -> Bools:
    """(nodes,) Whether a node stands in (or on the rim of) the material of one of its elements."""
    real = np.zeros(nodes, dtype=bool)
    for rows in chunks(len(elements)):
        real[elements[rows][fragments.whole[rows]]] = True
    half = np.flatnonzero(fragments.of_face[fragments.arrangement.face] >= 0)
    element = fragments.of_face[fragments.arrangement.face[half]]
    cell = np.searchsorted(fragments.part.cells, fragments.cell[element])
    corner = fragments.nodes[fragments.part.grid.quads[cell]]  # (k, 4, 2)
    vertex = fragments.arrangement.vertices[fragments.arrangement.origin[half]]
    real[elements[element][np.all(corner == vertex[:, None], axis=2)]] = True
    return real


def _triangles(fragments: Fragments) -> tuple[Floats, Ints]:
    """Counter-clockwise triangles of the cut fragments, ordered by element."""
    arrangement = fragments.arrangement
    faces = np.flatnonzero(fragments.of_face >= 0)
    vertices, face = triangles_of_faces(arrangement, faces[~fragments.whole[fragments.of_face[faces]]])
    owner = fragments.of_face[face]
    order = np.argsort(owner, kind="stable")
    vertices, owner = vertices[order], owner[order]
    triangles = fragments.positions[vertices]
    # A sliver about as thin as the lattice may turn over when its corners are put on the grid edge: it stays
    # as the lattice has it.
    sliver = np.isin(owner, owner[_areas(triangles) <= 0.0])
    triangles[sliver] = fragments.lattice.position(arrangement.vertices)[vertices[sliver]]
    return triangles, owner


def _areas(triangles: Floats) -> Floats:
    """(t,) Signed areas of (t, 3, 2) triangles."""
    return 0.5 * _cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _cross(a: Floats, b: Floats) -> Floats:
    """(k,) z-component of the cross product of (k, 2) vectors."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _boundary_segments(fragments: Fragments, xy: Floats, elements: Numbers) -> BoundarySegments:
    """One segment for each side of a barrier that carries material, unless it is a slit in one fragment."""
    arrangement = fragments.arrangement
    left, right = fragments.beside(True), fragments.beside(False)
    inside = np.stack([left, right], axis=1).reshape(-1)  # by half-edge
    other = np.stack([right, left], axis=1).reshape(-1)
    emitted = np.repeat(fragments.barrier, 2) & (inside >= 0) & (inside != other)
    half = np.flatnonzero(emitted)
    segment = half // 2
    along_curve = fragments.curve_forward[segment] == (half % 2 == 0)
    on_interface = fragments.curve[segment] >= fragments.loops
    start, end = arrangement.origin[half], arrangement.origin[half ^ 1]
    ends = fragments.positions[np.stack([start, end], axis=1)]
    element = inside[half]
    local = to_local(np.repeat(xy[elements[element]], 2, axis=0), ends.reshape(-1, 2)).reshape(-1, 2, 2)
    return BoundarySegments(
        ends=ends,
        element=element,
        local=local,
        curve=fragments.curve[segment],
        piece=fragments.piece[segment],
        side=np.where(on_interface, np.where(along_curve, 1, -1), 0).astype(np.int8),
        following=_following(fragments, emitted, half),
    )


def _following(fragments: Fragments, emitted: Bools, half: Ints) -> Ints:
    """(s,) The boundary segment that goes on where each one ends: turn clockwise through the material."""
    successor = fragments.arrangement.next
    number = np.full(len(emitted), -1)
    number[half] = np.arange(len(half))
    candidate = successor[half]
    for _ in range(64):
        waiting = ~emitted[candidate]
        if not np.any(waiting):
            return np.asarray(number[candidate])
        candidate[waiting] = successor[candidate[waiting] ^ 1]
    return np.where(emitted[candidate], number[candidate], -1)


def _resolution_notes(fragments: Fragments, elements: Numbers) -> tuple[str, ...]:
    """Warn of what the grid is too coarse for: ligaments and cracks within one cell."""
    notes = []
    same_cell = np.flatnonzero(fragments.cell[1:] == fragments.cell[:-1])
    shared = np.sum(elements[same_cell] == elements[same_cell + 1], axis=1)
    stiff = same_cell[shared >= 3]
    if len(stiff):
        notes.append(
            f"{len(stiff)} cells hold two fragments that share three corners or more: a crack or ligament "
            "within one cell is closed or too stiff; use smaller cells there"
        )
    return tuple(notes)
