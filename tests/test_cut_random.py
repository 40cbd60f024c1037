"""Random cuts against exact polygon operations, and the null space of the stiffness they assemble to."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from test_doubling import box, disc, line, square_grid

from phantomnode.geometry.bilinear import gradients, to_local
from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.cut import Fragments, cut
from phantomnode.geometry.doubling import CutMesh, double
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.noding import UNITS_PER_CELL, Lattice

SIZE = 5


def random_set(rng: np.random.Generator) -> tuple[tuple[Region, ...], list[Curve]]:
    """A block with holes, cut by lines, cracks and circles; many through nodes and along grid lines."""

    def point() -> np.ndarray:
        p = rng.uniform(0.0, SIZE, 2)
        kind = rng.integers(4)
        if kind == 0:
            p = np.round(p)  # a node
        elif kind == 1:
            p[rng.integers(2)] = rng.integers(0, SIZE + 1)  # on a grid line
        return p

    holes = []
    if rng.random() < 0.5:
        holes.append(disc(*rng.uniform(1.5, 3.5, 2), rng.uniform(0.2, 1.2)))
    curves: list[Curve] = []
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(3)
        a, b = point(), point()
        if np.array_equal(a, b):
            continue
        if kind == 0:  # a line right across
            d = (b - a) / np.hypot(*(b - a))
            curves.append(line(tuple(a - 10 * d), tuple(b + 10 * d)))
        elif kind == 1:  # a crack
            curves.append(line(tuple(a), tuple(b)))
        else:
            curves.append(disc(*a, rng.uniform(0.3, 2.0)))
    return (Region(box(0, 0, SIZE, SIZE).outer, tuple(holes)),), curves


def moved(
    regions: tuple[Region, ...], curves: list[Curve], shift: np.ndarray
) -> tuple[tuple[Region, ...], list[Curve]]:
    """Interfaces and holes moved a little; the block stays on the grid."""

    def move(curve: Curve) -> Curve:
        points = curve.points + shift
        if curve.closed:
            points[-1] = points[0]
        return Curve(points, curve.bulges)

    return tuple(Region(r.outer, tuple(map(move, r.holes))) for r in regions), list(map(move, curves))


def polygons_of(fragments: Fragments, chosen: np.ndarray) -> list[shapely.Polygon]:
    """The polygons that the chosen noded segments enclose, in units of a cell."""
    xy = fragments.arrangement.vertices / float(UNITS_PER_CELL)
    lines = shapely.linestrings(xy[fragments.arrangement.ends[chosen]])
    return list(shapely.get_parts(shapely.polygonize(lines)))


def body_of(fragments: Fragments) -> shapely.Geometry:
    """The block without its hole, as a polygon (the hole is the smaller polygon of the two)."""
    outline = fragments.barrier & (fragments.curve < fragments.loops)
    return max(polygons_of(fragments, outline), key=lambda p: p.area)


def connected_parts(fragments: Fragments) -> int:
    """Connected components of the body minus its barriers."""
    body = body_of(fragments)
    return sum(body.contains(p.representative_point()) for p in polygons_of(fragments, fragments.barrier))


def open_patch_components(fragments: Fragments, grid: BackgroundGrid) -> np.ndarray:
    """(n,) Connected components of each node's open patch of cells minus barriers, by polygon operations.

    Works on the noded segments alone: neither faces nor fragments nor the merging rule are used.
    """
    body = body_of(fragments)
    nodes = fragments.nodes / float(UNITS_PER_CELL)
    xy = fragments.arrangement.vertices / float(UNITS_PER_CELL)
    segments = shapely.linestrings(xy[fragments.arrangement.ends])
    edge_ends, edge_cells = fragments.edges.ends, fragments.edges.cell
    noded = np.zeros(len(edge_ends), dtype=bool)
    noded[fragments.grid_edge[fragments.grid_edge >= 0]] = True
    counts = np.zeros(len(nodes), dtype=int)
    for node in range(len(nodes)):
        cells = np.flatnonzero(np.any(grid.quads == node, axis=1))
        own = np.isin(edge_cells, cells)
        rim = own.sum(axis=1) == 1
        rim |= own.any(axis=1) & ~np.any(edge_ends == node, axis=1)
        whole_edges = shapely.linestrings(nodes[edge_ends[rim & ~noded]])
        patch = shapely.union_all(shapely.polygons(nodes[grid.quads[cells]]))
        around = shapely.buffer(patch, 1e-5)  # noding may bend the rim by a lattice unit
        walls = (fragments.grid_edge >= 0) & rim[fragments.grid_edge]
        lines = segments[walls | (fragments.barrier & shapely.contains(around, segments))]
        faces = shapely.get_parts(shapely.polygonize([*whole_edges, *lines]))
        points = [face.representative_point() for face in faces]
        counts[node] = sum(body.contains(point) and patch.contains(point) for point in points)
    return counts


def zero_energy_modes(grid: BackgroundGrid, mesh: CutMesh) -> int:
    """Dimension of the null space of the assembled stiffness (lambda = mu = 1), scaled by the lumped mass."""
    gauss = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3.0)
    corners = grid.xy[grid.quads[mesh.cell]]
    whole = np.flatnonzero(~mesh.cut)
    element = np.concatenate([np.repeat(whole, 4), np.repeat(mesh.triangle_element, 3)])
    thirds = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0
    inside = np.einsum("pk,tka->tpa", thirds, mesh.triangles).reshape(-1, 2)
    local = np.vstack(
        [np.tile(gauss, (len(whole), 1)), to_local(np.repeat(corners[mesh.triangle_element], 3, 0), inside)]
    )
    d1, d2 = mesh.triangles[:, 1] - mesh.triangles[:, 0], mesh.triangles[:, 2] - mesh.triangles[:, 0]
    weight = np.concatenate(
        [np.repeat(mesh.area[whole] / 4, 4), np.repeat((d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 6, 3)]
    )
    g = gradients(corners[element], local)
    b = np.zeros((len(element), 3, 8))
    b[:, 0, 0::2], b[:, 1, 1::2] = g[..., 0], g[..., 1]
    b[:, 2, 0::2], b[:, 2, 1::2] = g[..., 1], g[..., 0]
    elasticity = np.array([[3.0, 1, 0], [1, 3, 0], [0, 0, 1]])
    k = np.einsum("p,pia,ij,pjb->pab", weight, b, elasticity, b)
    dof = np.stack([2 * mesh.elements, 2 * mesh.elements + 1], axis=-1).reshape(-1, 8)
    stiffness = np.zeros((2 * len(mesh.xy),) * 2)
    np.add.at(stiffness, (dof[element][:, :, None], dof[element][:, None, :]), k)
    mass = np.zeros(2 * len(mesh.xy))
    np.add.at(mass, dof, np.repeat(mesh.area[:, None] / 4, 8, axis=1))
    scale = 1 / np.sqrt(mass)
    values = np.linalg.eigvalsh(stiffness * scale[:, None] * scale)
    # Rounding leaves rigid motions at 1e-15 of the largest; the softest true modes lie above 1e-9.
    return int(np.count_nonzero(values < 1e-11 * values[-1]))


@pytest.mark.parametrize("block", range(10))
def test_node_copies_are_the_components_of_open_patches(block: int) -> None:
    """1,000 random sets, each also moved by an ulp and by half a snap step: copies of every grid node equal
    the components of its open patch, and zero-energy modes are three for each connected part."""
    grid = square_grid(SIZE)
    grid = BackgroundGrid(
        grid.xy, grid.quads
    )  # without a structure all of it is looked at as if near a curve
    lattice = Lattice.of(grid)
    for seed in range(100 * block, 100 * block + 100):
        rng = np.random.default_rng(seed)
        regions, curves = random_set(rng)
        for shift in (0.0, np.spacing(1.0), 0.5 / UNITS_PER_CELL):
            placed = moved(regions, curves, np.array([shift, -shift]))
            fragments = cut(grid, placed[0], tuple(placed[1]), lattice)
            mesh = double(grid, fragments)
            copies = np.bincount(mesh.grid_node, minlength=len(grid.xy))
            where = f"seed {seed}, moved by {shift}"
            assert np.array_equal(copies, open_patch_components(fragments, grid)), where
            assert zero_energy_modes(grid, mesh) == 3 * connected_parts(fragments), where
            assert mesh.component.max() + 1 == connected_parts(fragments), where
            assert np.isclose(mesh.area.sum(), body_of(fragments).area, rtol=1e-12, atol=0), where
