"""Cells cut into fragments by the outlines of a body and by the interfaces and cracks inside it.

A fragment is a connected part of (cell within the body) minus all barriers. What is inside, which fragment
lies on either side of a piece of a cell edge, and whether that piece carries a barrier are all read from one
arrangement of noded segments; no coordinate is looked at again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from phantomnode.geometry.arrangement import Arrangement
from phantomnode.geometry.chains import Chains, barrier_chains, in_cells
from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.noding import Lattice, Pieces, cross, node_segments

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class CellEdges:
    """The edges of a grid with the cells beside them.

    Attributes
    ----------
    ends : (e, 2) int64
        Nodes of each edge.
    cell : (e, 2) int64
        The cell on the left (in which the edge runs forward) and the one on the right; -1 outside the grid.
    corner : (e, 2) int64
        The corner of that cell at which the edge starts (left: at ends[0]; right: at ends[1]).
    """

    ends: Ints
    cell: Ints
    corner: Ints

    @classmethod
    def of(cls, grid: BackgroundGrid) -> CellEdges:
        """Find the edges of a grid; more than two cells at an edge, or cells that overlap, are refused."""
        directed = np.stack([grid.quads, np.roll(grid.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
        forward = directed[:, 0] < directed[:, 1]
        ends, edge = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
        edge = edge.reshape(-1)
        cell, corner = np.full((len(ends), 2), -1), np.full((len(ends), 2), -1)
        for side, mask in ((0, forward), (1, ~forward)):
            if len(np.unique(edge[mask])) != np.count_nonzero(mask):
                raise GeometryError("the background grid has an edge with two cells on the same side")
            number = np.flatnonzero(mask)
            cell[edge[mask], side], corner[edge[mask], side] = number // 4, number % 4
        return cls(ends, cell, corner)


@dataclass(frozen=True)
class Fragments:
    """The fragments of all cells; a whole cell inside the body is a fragment too.

    Attributes
    ----------
    lattice : Lattice
    nodes : (n, 2) int64
        Lattice points of the (relocated) grid nodes.
    edges : CellEdges
    arrangement : Arrangement
        Of the cells near barriers ("the band") with the barriers.
    cell : (m,) int64
        The cell of each fragment; ascending.
    doubled_area : (m,) int64
        Twice the area of each fragment in lattice units, exact.
    whole : (m,) bool
        Whether the fragment is all of its cell.
    of_face : (f,) int64
        The fragment of each face of the arrangement; -1 in the void and outside the band.
    of_cell : (cells,) int64
        The fragment of each cell that lies outside the band, inside the body; -1 otherwise.
    grid_edge : (s,) int64
        The grid edge of each segment of the arrangement, -1 inside cells.
    edge_forward : (s,) bool
        Whether the segment runs along its grid edge.
    barrier : (s,) bool
        Whether the segment carries a barrier.
    curve, piece : (s,) int64
        The curve (regions' loops first, then interfaces) and piece of each barrier; an outline goes before
        an interface; -1 where there is none.
    curve_forward : (s,) bool
        Whether the segment runs along that curve.
    loops : int
        Number of curves that are loops of regions.
    """

    lattice: Lattice
    nodes: Ints
    edges: CellEdges
    arrangement: Arrangement
    cell: Ints
    doubled_area: Ints
    whole: Bools
    of_face: Ints
    of_cell: Ints
    grid_edge: Ints
    edge_forward: Bools
    barrier: Bools
    curve: Ints
    piece: Ints
    curve_forward: Bools
    loops: int

    def beside(self, forward: bool) -> Ints:
        """(s,) The fragment on the left (``forward``) or right of each segment, -1 in the void.

        On a grid edge of the band's rim the fragment is the neighbouring whole cell.
        """
        inside = self.of_face[self.arrangement.face[0 if forward else 1 :: 2]]
        on_edge = self.grid_edge >= 0
        side = np.where(self.edge_forward, 0, 1) if forward else np.where(self.edge_forward, 1, 0)
        cell = self.edges.cell[self.grid_edge, side]
        rim = on_edge & (cell >= 0) & (inside < 0)
        return np.where(rim, self.of_cell[cell], inside)


def cut(
    grid: BackgroundGrid, regions: tuple[Region, ...], interfaces: tuple[Curve, ...], lattice: Lattice
) -> Fragments:
    """Cut the cells of a grid by the outlines of a body and the interfaces inside it.

    Parameters
    ----------
    grid : BackgroundGrid
        After relocation.
    regions : tuple of Region
        The body.
    interfaces : tuple of Curve
        Interfaces and cracks.
    lattice : Lattice
        Of the grid before relocation.

    Raises
    ------
    GeometryError
        Where outlines cross each other or the body reaches beyond the grid.
    """
    loops = [loop for region in regions for loop in region.loops]
    chains = barrier_chains([*loops, *interfaces], grid, lattice, len(loops))
    nodes, edges = lattice.snap(grid.xy), CellEdges.of(grid)
    chains, band = in_cells(chains, nodes[grid.quads])
    pieces, source_edges = _noded(nodes, grid.quads, edges, band, chains)
    arrangement = Arrangement.of(pieces)
    tags = _Tags.of(arrangement, pieces, source_edges, chains, len(loops))
    face_cell = _cell_of_faces(arrangement, tags, edges, band)
    inside_face, inside_cell = _inside(arrangement, tags, edges, band, face_cell, grid, regions, lattice)
    _check_cover(arrangement, tags, edges, inside_face, inside_cell, face_cell, nodes, lattice)
    return _fragments(
        lattice, nodes, grid.quads, edges, arrangement, tags, face_cell, inside_face, inside_cell, len(loops)
    )


def _noded(nodes: Ints, quads: Ints, edges: CellEdges, band: Bools, chains: Chains) -> tuple[Pieces, Ints]:
    """Node the edges of the band with the chains; the grid edges among the sources come first.

    A closed chain inside one cell touches no edge: a bridge, which is no barrier, ties it to a corner of its
    cell, so that every face has one closed walk around it.
    """
    used = np.flatnonzero(np.any((edges.cell >= 0) & band[edges.cell], axis=1))
    starts = np.vstack([nodes[edges.ends[used, 0]], chains.starts])
    ends = np.vstack([nodes[edges.ends[used, 1]], chains.ends])
    pieces = node_segments(starts, ends)
    bridges = _bridges(pieces, len(used), nodes, quads, band)
    if len(bridges):
        starts, ends = np.vstack([starts, bridges[:, 0]]), np.vstack([ends, bridges[:, 1]])
        pieces = node_segments(starts, ends)
    return pieces, used


def _bridges(pieces: Pieces, grid_edges: int, nodes: Ints, quads: Ints, band: Bools) -> Ints:
    """(k, 2, 2) Ties from each island of barriers to a corner of the cell around it."""
    count, label = _components(len(pieces.vertices), pieces.ends[:, 0], pieces.ends[:, 1])
    tied = np.zeros(count, dtype=bool)
    tied[label[pieces.ends[pieces.source < grid_edges, 0]]] = True
    islands = []
    cells = np.flatnonzero(band)
    corners = nodes[quads[cells]]
    sides = np.roll(corners, -1, axis=1) - corners
    for island in np.flatnonzero(~tied):
        vertex = pieces.vertices[np.flatnonzero(label == island)[0]]
        around = np.flatnonzero(np.all(cross(sides, vertex - corners) > 0, axis=1))
        if len(around):
            islands.append((vertex, corners[around[0], 0]))
    return np.array(islands, dtype=np.int64).reshape(-1, 2, 2)


def _components(count: int, first: Ints, second: Ints) -> tuple[int, Ints]:
    """Connected components of ``count`` things joined in pairs: their number, and the one of each thing."""
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    number, label = connected_components(graph, directed=False)
    return int(number), label.astype(np.int64)


@dataclass(frozen=True)
class _Tags:
    """What each segment of an arrangement carries; see :class:`Fragments`."""

    grid_edge: Ints
    edge_forward: Bools
    material_left: Bools
    material_right: Bools
    curve: Ints
    piece: Ints
    curve_forward: Bools

    @classmethod
    def of(
        cls, arrangement: Arrangement, pieces: Pieces, source_edges: Ints, chains: Chains, loops: int
    ) -> _Tags:
        count, segment, forward = len(arrangement.ends), arrangement.piece_segment, arrangement.piece_forward
        grid_edge, edge_forward = np.full(count, -1), np.zeros(count, dtype=bool)
        on_edge = pieces.source < len(source_edges)
        grid_edge[segment[on_edge]] = source_edges[pieces.source[on_edge]]
        edge_forward[segment[on_edge]] = forward[on_edge]
        # Sources after the edges are the chains; after these, bridges.
        barrier = ~on_edge & (pieces.source < len(source_edges) + len(chains.curve))
        chain = pieces.source[barrier] - len(source_edges)
        segment, forward = segment[barrier], forward[barrier]
        outline = chains.curve[chain] < loops
        left, right = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        left[segment[outline & forward]] = True
        right[segment[outline & ~forward]] = True
        # Written in descending order of the curve, so that an outline stays where it meets an interface.
        order = np.argsort(-chain, kind="stable")
        curve, piece, curve_forward = np.full(count, -1), np.full(count, -1), np.zeros(count, dtype=bool)
        curve[segment[order]] = chains.curve[chain[order]]
        piece[segment[order]] = chains.piece[chain[order]]
        curve_forward[segment[order]] = forward[order]
        return cls(grid_edge, edge_forward, left, right, curve, piece, curve_forward)


def _cell_of_faces(arrangement: Arrangement, tags: _Tags, edges: CellEdges, band: Bools) -> Ints:
    """(f,) The band cell around each face; -1 for what lies outside the band.

    A grid edge knows the cells on its sides; every other segment has the same cell on both.
    """
    left, right = arrangement.face[0::2], arrangement.face[1::2]
    on_edge = tags.grid_edge >= 0
    faces = len(arrangement.cycles)
    count, group = _components(faces, left[~on_edge], right[~on_edge])
    cell_of_group = np.full(count, -2)
    side = np.where(tags.edge_forward, 0, 1)[on_edge]
    for face, which in ((left[on_edge], side), (right[on_edge], 1 - side)):
        cell = edges.cell[tags.grid_edge[on_edge], which]
        cell = np.where((cell >= 0) & band[cell], cell, -1)
        seen = cell_of_group[group[face]]
        cell_of_group[group[face]] = cell
        if np.any((seen != -2) & (seen != cell)) or np.any(cell_of_group[group[face]] != cell):
            raise GeometryError(
                "a grid cell folds over itself: the background grid is too distorted to be cut"
            )
    return np.asarray(np.maximum(cell_of_group, -1)[group])


def _inside(
    arrangement: Arrangement,
    tags: _Tags,
    edges: CellEdges,
    band: Bools,
    face_cell: Ints,
    grid: BackgroundGrid,
    regions: tuple[Region, ...],
    lattice: Lattice,
) -> tuple[Bools, Bools]:
    """Which faces, and which cells outside the band, lie in the material.

    An outline has the material on its left; whatever is joined across segments that are no outline is alike.
    """
    faces, cells = len(arrangement.cycles), len(band)
    left, right = arrangement.face[0::2].copy(), arrangement.face[1::2].copy()
    # Outside the band, a cell stands for itself: number it after the faces.
    on_edge = np.flatnonzero(tags.grid_edge >= 0)
    side = np.where(tags.edge_forward, 0, 1)[on_edge]
    for face, which in ((left, side), (right, 1 - side)):
        cell = edges.cell[tags.grid_edge[on_edge], which]
        rim = (cell >= 0) & ~band[cell]
        face[on_edge[rim]] = faces + cell[rim]
    outline = tags.material_left | tags.material_right
    material = (face_cell >= 0)[np.minimum(left, faces - 1)] | (left >= faces)
    material &= (face_cell >= 0)[np.minimum(right, faces - 1)] | (right >= faces)
    plain = ~outline & material
    far = np.all((edges.cell >= 0) & ~band[edges.cell], axis=1)
    first = np.concatenate([left[plain], faces + edges.cell[far, 0]])
    second = np.concatenate([right[plain], faces + edges.cell[far, 1]])
    count, group = _components(faces + cells, first, second)
    state = np.zeros(count, dtype=np.int8)  # 1 inside, -1 outside, 0 not known yet
    for thing, inner in (
        (left[tags.material_left], 1),
        (right[tags.material_right], 1),
        (left[tags.material_right & ~tags.material_left], -1),
        (right[tags.material_left & ~tags.material_right], -1),
    ):
        known = state[group[thing]]
        exterior = (thing < faces) & (face_cell[np.minimum(thing, faces - 1)] < 0)
        wrong = np.flatnonzero((known == -inner) & ~exterior)
        if len(wrong):
            raise GeometryError(_crossing_message(arrangement, lattice, thing[wrong[0]], faces, grid))
        state[group[thing[~exterior]]] = inner
    # Parts of the grid that no outline touches: the sign of phi at a cell's centre decides.
    cell_of_thing = np.concatenate([face_cell, np.where(band, -1, np.arange(cells))])
    unknown = np.flatnonzero((state[group] == 0) & (cell_of_thing >= 0))
    if len(unknown):
        _, one = np.unique(group[unknown], return_index=True)
        chosen = unknown[one]
        centres = grid.xy[grid.quads[cell_of_thing[chosen]]].mean(axis=1)
        sign = np.sign(LevelSet.of_regions(regions).distance(centres))
        state[group[chosen]] = sign.astype(np.int8)
    inside = (state[group] == 1) & (cell_of_thing >= 0)
    return inside[:faces], inside[faces:]


def _crossing_message(
    arrangement: Arrangement, lattice: Lattice, thing: int, faces: int, grid: BackgroundGrid
) -> str:
    """Say where two outlines contradict each other."""
    if thing < faces:
        vertex = arrangement.vertices[arrangement.origin[arrangement.cycles[thing][0]]]
        x, y = lattice.position(vertex[None])[0]
    else:
        x, y = grid.xy[grid.quads[thing - faces]].mean(axis=0)
    return (
        f"outlines cross each other or themselves near ({x:.6g}, {y:.6g}) m, as drawn or as chords from one cell "
        "edge to the next: mend the drawing there, or make the cells smaller"
    )


def _check_cover(
    arrangement: Arrangement,
    tags: _Tags,
    edges: CellEdges,
    inside_face: Bools,
    inside_cell: Bools,
    face_cell: Ints,
    nodes: Ints,
    lattice: Lattice,
) -> None:
    """Refuse a body that reaches beyond the grid: material at a grid boundary that carries no outline."""
    outline = tags.material_left | tags.material_right
    on_rim = (tags.grid_edge >= 0) & np.any(edges.cell[tags.grid_edge] < 0, axis=1) & ~outline
    inner = inside_face[arrangement.face[0::2]] | inside_face[arrangement.face[1::2]]
    bad = np.flatnonzero(on_rim & inner)
    at = arrangement.vertices[arrangement.ends[bad, 0]]
    lone = np.flatnonzero(np.any(edges.cell < 0, axis=1) & inside_cell[edges.cell.max(axis=1)])
    at = np.vstack([at, nodes[edges.ends[lone, 0]]])
    if len(at):
        x, y = lattice.position(at[:1])[0]
        raise GeometryError(
            f"the body reaches beyond its background grid near ({x:.6g}, {y:.6g}) m: make the grid larger, "
            "or let it follow the outline exactly (aligned = true for a rectangle)"
        )


def _fragments(
    lattice: Lattice,
    nodes: Ints,
    quads: Ints,
    edges: CellEdges,
    arrangement: Arrangement,
    tags: _Tags,
    face_cell: Ints,
    inside_face: Bools,
    inside_cell: Bools,
    loops: int,
) -> Fragments:
    """Unite the faces of each cell across whatever is no barrier, and number the fragments by cell."""
    left, right = arrangement.face[0::2], arrangement.face[1::2]
    barrier = tags.curve >= 0
    joined = (tags.grid_edge < 0) & ~barrier
    _, group = _components(len(inside_face), left[joined], right[joined])
    faces = np.flatnonzero(inside_face)
    roots, fragment = np.unique(group[faces], return_inverse=True)
    cell_of_root = np.empty(len(roots), dtype=np.int64)
    cell_of_root[fragment] = face_cell[faces]
    area = np.zeros(len(roots), dtype=np.int64)
    np.add.at(area, fragment, arrangement.doubled_areas[faces])
    cells = np.flatnonzero(inside_cell)
    cell = np.concatenate([cell_of_root, cells])
    corner = nodes[quads]
    whole_area = cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    # In the band, a cell's area is that of its faces: noding may have bent its edges by a lattice unit.
    in_band = face_cell >= 0
    whole_area[np.unique(face_cell[in_band])] = 0
    np.add.at(whole_area, face_cell[in_band], arrangement.doubled_areas[in_band])
    area = np.concatenate([area, whole_area[cells]])
    order = np.lexsort([np.arange(len(cell)), cell])
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.arange(len(order))
    of_face, of_cell = np.full(len(inside_face), -1), np.full(len(quads), -1)
    of_face[faces] = number[fragment]
    of_cell[cells] = number[len(roots) :]
    cell, area = cell[order], area[order]
    return Fragments(
        lattice, nodes, edges, arrangement, cell, area, area == whole_area[cell], of_face, of_cell,
        tags.grid_edge, tags.edge_forward, barrier, tags.curve, tags.piece, tags.curve_forward, loops,
    )  # fmt: skip
