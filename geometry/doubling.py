"""Fragments into elements with real and phantom nodes: the one merging rule."""

from __future__ import annotations

from dataclasses import dataclass

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.arrangement import components
from phantomnode.geometry.bilinear import to_local
from phantomnode.geometry.cut import Fragments
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.noding import cross

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
    notes: tuple[str, ...] = ()


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
    quads = grid.quads[fragments.cell]
    first, second, element_pairs = _merged_corners(fragments)
    elements, grid_node = _numbered(quads, first, second)
    xy = fragments.lattice.position(fragments.nodes)
    triangles, triangle_element = _triangles(fragments)
    diagonals = xy[quads[:, 2:]] - xy[quads[:, :2]]
    cell_area = 0.5 * _cross(diagonals[:, 0], diagonals[:, 1])
    cut_area = np.bincount(triangle_element, _areas(triangles), minlength=count)
    area = np.where(fragments.whole, cell_area, cut_area)
    return CutMesh(
        xy=xy[grid_node],
        grid_node=grid_node,
        real=_real(fragments, quads, elements, len(grid_node)),
        elements=elements,
        cell=fragments.cell,
        area=area,
        fraction=np.where(fragments.whole, 1.0, area / cell_area),
        cut=~fragments.whole,
        component=components(count, element_pairs[:, 0], element_pairs[:, 1])[1],
        triangles=triangles,
        triangle_element=triangle_element,
        segments=_boundary_segments(fragments, xy[quads]),
        notes=_resolution_notes(fragments, elements),
    )


def _numbered(quads: Ints, first: Ints, second: Ints) -> tuple[Ints, Ints]:
    """Nodes from corner slots of which the given pairs are one: (m, 4) elements, (n,) the grid node of each.

    Nodes stand in the order of the grid nodes, then of the elements: the same numbers whatever scipy does.
    """
    slots = quads.size
    _, copy = components(slots, first, second)
    representative = np.full(slots, slots)
    np.minimum.at(representative, copy, np.arange(slots))
    representative = representative[copy]
    roots = np.flatnonzero(representative == np.arange(slots))
    grid_of_root = quads.reshape(-1)[roots]
    order = np.lexsort([roots, grid_of_root])
    number = np.empty(slots, dtype=np.int64)
    number[roots[order]] = np.arange(len(roots))
    return number[representative].reshape(-1, 4), grid_of_root[order]


def _merged_corners(fragments: Fragments) -> tuple[Ints, Ints, Ints]:
    """Pairs of corner slots (4 * element + corner) that are one node, and the pairs of elements joined."""
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
    edge, left, right = edge[both], left[both], right[both]
    start, back = edges.corner[edge, 0], edges.corner[edge, 1]
    first = np.concatenate([4 * left + start, 4 * left + (start + 1) % 4])
    second = np.concatenate([4 * right + (back + 1) % 4, 4 * right + back])
    return first, second, np.column_stack([left, right])


def _real(fragments: Fragments, quads: Ints, elements: Ints, nodes: int) -> Bools:
    """(nodes,) Whether a node stands in (or on the rim of) the material of one of its elements."""
    real = np.zeros(nodes, dtype=bool)
    real[elements[fragments.whole]] = True
    points = {tuple(p): k for k, p in enumerate(fragments.nodes[np.unique(quads)].tolist())}
    of_vertex = np.array([points.get(tuple(p), -1) for p in fragments.arrangement.vertices.tolist()])
    grid_node = np.unique(quads)
    half = np.flatnonzero(fragments.of_face[fragments.arrangement.face] >= 0)
    vertex = of_vertex[fragments.arrangement.origin[half]]
    element, node = fragments.of_face[fragments.arrangement.face[half[vertex >= 0]]], vertex[vertex >= 0]
    match = quads[element] == grid_node[node][:, None]
    real[elements[element][match]] = True
    return real


def _triangles(fragments: Fragments) -> tuple[Floats, Ints]:
    """Counter-clockwise triangles of the cut fragments, ordered by element."""
    arrangement = fragments.arrangement
    corners: list[Ints] = [np.zeros((0, 3), dtype=np.int64)]
    element: list[Ints] = [np.zeros(0, dtype=np.int64)]
    faces = np.flatnonzero(fragments.of_face >= 0)
    for face in faces[~fragments.whole[fragments.of_face[faces]]]:
        walk = arrangement.origin[arrangement.cycles[face]]
        parts = _triangulated(walk, arrangement.vertices, int(arrangement.doubled_areas[face]))
        corners.append(parts)
        element.append(np.full(len(parts), fragments.of_face[face]))
    vertices, owner = np.concatenate(corners), np.concatenate(element)
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


def _triangulated(walk: Ints, vertices: Ints, doubled_area: int) -> Ints:
    """(t, 3) Vertices of triangles of a polygon given by its walk, exact in area; none of no area."""
    walk = _without_spikes(walk)
    ring = vertices[walk]
    local = ring - ring[0]
    turn = cross(np.roll(local, -1, axis=0) - local, np.roll(local, -2, axis=0) - np.roll(local, -1, axis=0))
    if np.all(turn >= 0):
        index = np.array([[0, k, k + 1] for k in range(1, len(ring) - 1)])
    else:
        flat = mapbox_earcut.triangulate_float64(local.astype(np.float64), np.array([len(ring)]))
        index = np.asarray(flat, dtype=np.int64).reshape(-1, 3)
    a, b, c = ring[index.T]
    twice = cross(b - a, c - a)
    index[twice < 0] = index[twice < 0][:, ::-1]
    if int(np.abs(twice).sum()) != doubled_area:
        raise GeometryError("a fragment could not be divided into triangles: report this geometry as a bug")
    return np.asarray(walk[index[twice != 0]])


def _without_spikes(walk: Ints) -> Ints:
    """A walk without its forays along slits and bridges (a, b, a becomes a)."""
    points = walk.tolist()
    k = 0
    while len(points) > 2 and k < len(points):
        if points[k - 2] == points[k]:
            # points[k-2], points[k-1], points[k]: drop the tip and one of the two equal ends.
            for index in sorted(((k - 1) % len(points), k), reverse=True):
                points.pop(index)
            k = 0
        else:
            k += 1
    return np.array(points, dtype=np.int64)


def _boundary_segments(fragments: Fragments, corners: Floats) -> BoundarySegments:
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
    local = to_local(np.repeat(corners[element], 2, axis=0), ends.reshape(-1, 2)).reshape(-1, 2, 2)
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


def _resolution_notes(fragments: Fragments, elements: Ints) -> tuple[str, ...]:
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
