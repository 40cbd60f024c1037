"""Cells cut into fragments by the outlines of a body and by the interfaces and cracks inside it.

A fragment is a connected part of (cell within the body) minus all barriers. What is inside, which fragment
lies on either side of a piece of a cell edge, and whether that piece carries a barrier are all read from one
arrangement of noded segments; no coordinate is looked at again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.arrangement import Arrangement, components
from phantomnode.geometry.chains import Chains, barrier_chains, in_cells
from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.grid import BackgroundGrid, Numbers
from phantomnode.geometry.inside import PlainCells, cell_of_faces, check_cover, inside_of
from phantomnode.geometry.near import Part, near_part
from phantomnode.geometry.noding import Lattice, Pieces, cross, node_segments
from phantomnode.geometry.tags import CellEdges, Tags

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Fragments:
    """The fragments of all cells; a whole cell inside the body is a fragment too.

    Attributes
    ----------
    lattice : Lattice
    part : Part
        The part of the grid near barriers; what stands inside it is numbered as there.
    nodes : (n, 2) int64
        Lattice points of the (relocated) nodes of the part.
    edges : CellEdges
        Of the part.
    arrangement : Arrangement
        Of the cells that barriers pass through ("the band") with the barriers.
    cell : (m,) int32
        The cell of each fragment in the whole grid; ascending.
    whole : (m,) bool
        Whether the fragment is all of its cell.
    region : (m,) int32
        Which connected set of cells outside the band it belongs to; -1 in the band.
    of_face : (f,) int64
        The fragment of each face of the arrangement; -1 in the void and outside the band.
    of_cell : (c,) int64
        The fragment of each cell of the part that lies outside the band, inside the body; -1 otherwise.
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
    part: Part
    nodes: Ints
    edges: CellEdges
    arrangement: Arrangement
    cell: NDArray[np.int32]
    whole: Bools
    region: NDArray[np.int32]
    of_face: Ints
    of_cell: Ints
    grid_edge: Ints
    edge_forward: Bools
    barrier: Bools
    curve: Ints
    piece: Ints
    curve_forward: Bools
    loops: int

    @cached_property
    def positions(self) -> Floats:
        """(v, 2) Positions of the vertices, metres; those on a grid edge stand on its straight line.

        The lattice has them up to a unit beside it, where the shape functions of the two cells differ a little.
        """
        xy, nodes = self.lattice.position(self.arrangement.vertices), self.lattice.position(self.nodes)
        on_edge = np.flatnonzero(self.grid_edge >= 0)
        vertex, edge = self.arrangement.ends[on_edge].reshape(-1), np.repeat(self.grid_edge[on_edge], 2)
        start, along = nodes[self.edges.ends[edge, 0]], np.diff(nodes[self.edges.ends[edge]], axis=1)[:, 0]
        t = np.sum((xy[vertex] - start) * along, axis=1) / np.sum(along**2, axis=1)
        inner = (t > 0.0) & (t < 1.0)
        xy[vertex[inner]] = (start + t[:, None] * along)[inner]
        return xy

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
    curves = [*loops, *interfaces]
    part = near_part(grid, curves)
    quads = part.grid.quads
    chains = barrier_chains(curves, part.grid, lattice, len(loops))
    nodes, edges = lattice.snap(part.grid.xy), CellEdges.of(part.grid)
    chains, band = in_cells(chains, nodes[quads])
    pieces, source_edges = _noded(nodes, quads, edges, band, chains)
    arrangement = Arrangement.of(pieces)
    tags = Tags.of(arrangement, pieces, source_edges, chains, len(loops))
    face_cell = cell_of_faces(arrangement, tags, edges, band)
    plain = PlainCells.of(grid, part, band, edges)
    inside_face, inside_plain = inside_of(
        arrangement, tags, edges, face_cell, plain, part, grid, regions, lattice
    )
    check_cover(arrangement, tags, edges, inside_face, inside_plain, plain, grid, lattice)
    return _fragments(
        lattice,
        part,
        nodes,
        edges,
        arrangement,
        tags,
        face_cell,
        inside_face,
        inside_plain,
        plain,
        len(loops),
    )


def _noded(nodes: Ints, quads: Numbers, edges: CellEdges, band: Bools, chains: Chains) -> tuple[Pieces, Ints]:
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


def _bridges(pieces: Pieces, grid_edges: int, nodes: Ints, quads: Numbers, band: Bools) -> Ints:
    """(k, 2, 2) Ties from each island of barriers to a corner of the cell around it."""
    count, label = components(len(pieces.vertices), pieces.ends[:, 0], pieces.ends[:, 1])
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


def _fragments(
    lattice: Lattice,
    part: Part,
    nodes: Ints,
    edges: CellEdges,
    arrangement: Arrangement,
    tags: Tags,
    face_cell: Ints,
    inside_face: Bools,
    inside_plain: Bools,
    plain: PlainCells,
    loops: int,
) -> Fragments:
    """Unite the faces of each cell across whatever is no barrier, and number the fragments by cell."""
    left, right = arrangement.face[0::2], arrangement.face[1::2]
    barrier = tags.curve >= 0
    joined = (tags.grid_edge < 0) & ~barrier
    _, group = components(len(inside_face), left[joined], right[joined])
    faces = np.flatnonzero(inside_face)
    roots, fragment = np.unique(group[faces], return_inverse=True)
    cell_of_root = np.empty(len(roots), dtype=np.int64)
    cell_of_root[fragment] = face_cell[faces]
    area, whole_area = np.zeros(len(roots), dtype=np.int64), np.zeros(len(part.cells), dtype=np.int64)
    np.add.at(area, fragment, arrangement.doubled_areas[faces])
    # A cell's area is that of its faces: noding may have bent its edges by a lattice unit.
    in_band = face_cell >= 0
    np.add.at(whole_area, face_cell[in_band], arrangement.doubled_areas[in_band])
    order = np.argsort(cell_of_root, kind="stable")
    banded, cells = part.cells[cell_of_root[order]], np.flatnonzero(inside_plain)
    # Two ascending lists become one: each goes behind what the other has below it.
    number = np.empty(len(roots), dtype=np.int64)
    number[order] = place = np.arange(len(roots)) + np.searchsorted(cells, banded)
    m = len(roots) + len(cells)
    cell, whole, region = np.empty(m, np.int32), np.ones(m, dtype=bool), np.full(m, -1, np.int32)
    away = np.ones(m, dtype=bool)
    away[place] = False
    cell[place], cell[away] = banded, cells
    whole[number], region[away] = area == whole_area[cell_of_root], plain.region[cells]
    of_face = np.full(len(inside_face), -1)
    of_face[faces] = number[fragment]
    of_cell = np.where(inside_plain[part.cells], np.searchsorted(cell, part.cells), -1)
    return Fragments(
        lattice, part, nodes, edges, arrangement, cell, whole, region, of_face, of_cell,
        tags.grid_edge, tags.edge_forward, barrier, tags.curve, tags.piece, tags.curve_forward, loops,
    )  # fmt: skip
