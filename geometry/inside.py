"""Which faces and cells of an arrangement lie in the material; decided by topology.

An outline has the material on its left, and whatever is joined without crossing an outline is alike. Only a
part of the grid that no outline touches is asked for the sign of phi, at the centre of one of its cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.arrangement import Arrangement, components
from phantomnode.geometry.curves import Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.noding import Lattice
from phantomnode.geometry.tags import CellEdges, Tags

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


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
    count, group = components(faces + cells, first, second)
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


def check_cover(
    arrangement: Arrangement,
    tags: Tags,
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
