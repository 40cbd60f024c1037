"""Which faces and cells of an arrangement lie in the material; decided by topology.

An outline has the material on its left, and whatever is joined without crossing an outline is alike. Only a
part of the grid that no outline touches is asked for the sign of phi, at the centre of one of its cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from phantomnode.geometry.arrangement import Arrangement, components
from phantomnode.geometry.curves import Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid, chunks
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.near import Part
from phantomnode.geometry.noding import Lattice
from phantomnode.geometry.tags import CellEdges, Tags

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class PlainCells:
    """The cells outside the band: whatever hangs together there is all inside or all outside.

    Attributes
    ----------
    count : int
        Number of connected sets of such cells, here called regions.
    region : (m,) int32
        The region of each cell of the whole grid; -1 in the band.
    rim : (m,) bool
        Whether a cell has an edge beyond which there is no cell.
    """

    count: int
    region: NDArray[np.int32]
    rim: Bools

    @classmethod
    def of(cls, grid: BackgroundGrid, part: Part, band: Bools, edges: CellEdges) -> PlainCells:
        """Take the band, (c,) of the part, out of the grid."""
        plain = np.ones(grid.cell_count, dtype=bool)
        plain[part.cells[band]] = False
        if grid.shape is not None:
            count, region = connected_in_rows(plain.reshape(grid.shape[::-1]), grid.closed)
            return cls(count, region, _outer(grid.shape, grid.closed))
        pairs = edges.cell[np.all((edges.cell >= 0) & ~band[edges.cell], axis=1)]
        count, group = components(grid.cell_count, pairs[:, 0], pairs[:, 1])
        rim = np.zeros(grid.cell_count, dtype=bool)
        rim[edges.cell[np.any(edges.cell < 0, axis=1)].max(axis=1)] = True
        return cls(count, np.where(plain, group, -1).astype(np.int32), rim)

    @cached_property
    def first(self) -> Ints:
        """(count,) The lowest cell of each region; -1 of one without a cell."""
        first = np.full(self.count + 1, -1)
        for rows in reversed(list(chunks(len(self.region)))):
            first[self.region[rows][::-1]] = np.arange(rows.start, rows.stop)[
                ::-1
            ]  # what is written last stays
        return first[:-1]


def connected_in_rows(chosen: Bools, closed: bool) -> tuple[int, NDArray[np.int32]]:
    """Sets of chosen places of a table that hang together along rows and columns: their number, and one for each.

    Parameters
    ----------
    chosen : (rows, columns) bool
    closed : bool
        Whether the last row joins the first.

    Returns
    -------
    count : int
    label : (rows * columns,) int32
        -1 where nothing is chosen.
    """
    labels, count = label(chosen, output=np.int32)
    labels = labels.reshape(-1)
    labels -= 1
    if closed:
        first, last = labels[: chosen.shape[1]], labels[-chosen.shape[1] :]
        both = (first >= 0) & (last >= 0)
        count, group = components(count, first[both], last[both])
        labels = np.append(group, -1).astype(np.int32)[labels]
    return count, labels


def _outer(shape: tuple[int, int], closed: bool) -> Bools:
    """(m,) The outer cells of a structured grid."""
    outer = np.zeros(shape[::-1], dtype=bool)
    outer[:, [0, -1]] = True
    outer[[] if closed else [0, -1]] = True
    return outer.reshape(-1)


def cell_of_faces(arrangement: Arrangement, tags: Tags, edges: CellEdges, band: Bools) -> Ints:
    """(f,) The band cell around each face; -1 for what lies outside the band.

    A grid edge knows the cells on its sides; every other segment has the same cell on both.
    """
    left, right = arrangement.face[0::2], arrangement.face[1::2]
    on_edge = tags.grid_edge >= 0
    faces = len(arrangement.cycles)
    count, group = components(faces, left[~on_edge], right[~on_edge])
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


def inside_of(
    arrangement: Arrangement,
    tags: Tags,
    edges: CellEdges,
    face_cell: Ints,
    plain: PlainCells,
    part: Part,
    grid: BackgroundGrid,
    regions: tuple[Region, ...],
    lattice: Lattice,
) -> tuple[Bools, Bools]:
    """Which faces, and which cells of the whole grid outside the band, lie in the material.

    An outline has the material on its left; whatever is joined across segments that are no outline is alike.
    """
    faces = len(arrangement.cycles)
    left, right = arrangement.face[0::2].copy(), arrangement.face[1::2].copy()
    # Beyond the rim of the band a region of plain cells is one thing: number them after the faces.
    on_edge = np.flatnonzero(tags.grid_edge >= 0)
    side = np.where(tags.edge_forward, 0, 1)[on_edge]
    of_cell = plain.region[part.cells]
    for face, which in ((left, side), (right, 1 - side)):
        cell = edges.cell[tags.grid_edge[on_edge], which]
        rim = (cell >= 0) & (of_cell[cell] >= 0)
        face[on_edge[rim]] = faces + of_cell[cell[rim]]
    cell_of_thing = np.concatenate([np.where(face_cell >= 0, part.cells[face_cell], -1), plain.first])
    material = cell_of_thing >= 0
    joined = ~(tags.material_left | tags.material_right) & material[left] & material[right]
    count, group = components(len(material), left[joined], right[joined])
    state = np.zeros(count, dtype=np.int8)  # 1 inside, -1 outside, 0 not known yet
    for thing, inner in (
        (left[tags.material_left], 1),
        (right[tags.material_right], 1),
        (left[tags.material_right & ~tags.material_left], -1),
        (right[tags.material_left & ~tags.material_right], -1),
    ):
        thing = thing[material[thing]]
        wrong = np.flatnonzero(state[group[thing]] == -inner)
        if len(wrong):
            cell = cell_of_thing[thing[wrong[0]]]
            raise GeometryError(_crossing_message(arrangement, lattice, thing[wrong[0]], cell, grid))
        state[group[thing]] = inner
    # Parts of the grid that no outline touches: the sign of phi at a cell's centre decides.
    unknown = np.flatnonzero((state[group] == 0) & material)
    if len(unknown):
        _, one = np.unique(group[unknown], return_index=True)
        chosen = unknown[one]
        centres = grid.position(grid.corners(cell_of_thing[chosen])).mean(axis=1)
        sign = np.sign(LevelSet.of_regions(regions).distance(centres))
        state[group[chosen]] = sign.astype(np.int8)
    inside = (state[group] == 1) & material
    return inside[:faces], np.append(inside[faces:], False)[plain.region]  # -1, in the band: the last


def _crossing_message(
    arrangement: Arrangement, lattice: Lattice, thing: int, cell: int, grid: BackgroundGrid
) -> str:
    """Say where two outlines contradict each other."""
    if thing < len(arrangement.cycles):
        vertex = arrangement.vertices[arrangement.origin[arrangement.cycles[thing][0]]]
        x, y = lattice.position(vertex[None])[0]
    else:
        x, y = grid.position(grid.corners(np.array([cell]))[0]).mean(axis=0)
    return (
        f"outlines cross each other or themselves near ({x:.6g}, {y:.6g}) m, as drawn or as chords from one cell "
        "edge to the next: mend the drawing there, or make the cells smaller"
    )


def check_cover(
    arrangement: Arrangement,
    tags: Tags,
    edges: CellEdges,
    inside_face: Bools,
    inside_plain: Bools,
    plain: PlainCells,
    grid: BackgroundGrid,
    lattice: Lattice,
) -> None:
    """Refuse a body that reaches beyond the grid: material at a grid boundary that carries no outline."""
    outline = tags.material_left | tags.material_right
    on_rim = (tags.grid_edge >= 0) & np.any(edges.cell[tags.grid_edge] < 0, axis=1) & ~outline
    inner = inside_face[arrangement.face[0::2]] | inside_face[arrangement.face[1::2]]
    bad = np.flatnonzero(on_rim & inner)
    lone = np.flatnonzero(plain.rim & inside_plain)[:1]
    at = lattice.position(arrangement.vertices[arrangement.ends[bad, 0]])
    at = np.vstack([at, grid.position(grid.corners(lone)).mean(axis=1)])
    if len(at):
        x, y = at[0]
        raise GeometryError(
            f"the body reaches beyond its background grid near ({x:.6g}, {y:.6g}) m: make the grid larger, "
            "or let it follow the outline exactly (aligned = true for a rectangle)"
        )
