"""Fragments: areas, masses and time steps of random cuts, sharp corners, degenerate positions."""

from __future__ import annotations

import numpy as np
import pytest
from test_doubling import box, cut_mesh, disc, line, square_grid

from phantomnode.geometry.bilinear import gradients, to_local
from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.cut import cut
from phantomnode.geometry.doubling import CutMesh, double
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.noding import Lattice, node_segments
from phantomnode.geometry.relocate import relocate

DISTANCES = (0.0, np.spacing(1.0), 1e-16, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 1e-1)


def random_cuts(rng: np.random.Generator, cells: int) -> list[Curve]:
    """Lines and arcs that pass random nodes at the distances above; where two meet they cross."""
    curves = []
    for _ in range(2 * cells):
        node, angle = rng.integers(0, cells + 1, 2).astype(float), rng.uniform(0, np.pi)
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        offset = rng.choice(DISTANCES) * rng.choice([-1.0, 1.0])
        if rng.random() < 0.7:
            through = node + offset * across
            curves.append(line(tuple(through - 3 * cells * along), tuple(through + 3 * cells * along)))
        else:
            radius = rng.uniform(0.6, cells)
            curves.append(disc(*(node + (radius + offset) * across), radius))
    return curves


def critical_steps(mesh: CutMesh, corners: np.ndarray) -> np.ndarray:
    """(c,) Critical time step of each cut fragment on its own, in units of h / c_d (nu = 0.3, h = 1)."""
    cut_elements, index = np.unique(mesh.triangle_element, return_inverse=True)
    inside = np.einsum("pk,tka->tpa", np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0, mesh.triangles)
    owner = np.repeat(index, 3)
    quads = corners[np.repeat(mesh.triangle_element, 3)]
    g = gradients(quads, to_local(quads, inside.reshape(-1, 2)))
    b = np.zeros((len(g), 3, 8))
    b[:, 0, 0::2], b[:, 1, 1::2] = g[..., 0], g[..., 1]
    b[:, 2, 0::2], b[:, 2, 1::2] = g[..., 1], g[..., 0]
    lame, shear = 0.3 / 0.7, 0.2 / 0.7  # over lambda + 2 mu, for nu = 0.3
    elasticity = np.array([[1.0, lame, 0.0], [lame, 1.0, 0.0], [0.0, 0.0, shear]])
    d1, d2 = mesh.triangles[:, 1] - mesh.triangles[:, 0], mesh.triangles[:, 2] - mesh.triangles[:, 0]
    weight = np.repeat((d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 6.0, 3)
    weight /= mesh.area[cut_elements][owner]  # so that slivers do not underflow
    stiffness = np.zeros((len(cut_elements), 8, 8))
    np.add.at(stiffness, owner, weight[:, None, None] * np.einsum("pia,ij,pjb->pab", b, elasticity, b))
    return np.asarray(2.0 / np.sqrt(4.0 * np.linalg.eigvalsh(stiffness)[:, -1]))


def check_random_cuts(seed: int, wanted: int) -> None:
    rng, cells, done = np.random.default_rng(seed), 12, 0
    grid = square_grid(cells)
    regions = (box(0, 0, cells, cells),)
    while done < wanted:
        curves = random_cuts(rng, cells)
        mesh = cut_mesh(grid, regions, *curves)
        sums = np.bincount(mesh.cell, weights=mesh.area, minlength=cells**2)
        assert np.max(np.abs(sums - 1.0)) <= 1e-12  # the figure; areas are exact integers here
        assert np.all(mesh.area > 0.0)
        per_element = np.bincount(mesh.triangle_element, minlength=len(mesh.elements))
        assert np.all(per_element[mesh.cut] > 0)
        # formulation: a lone fragment's critical step stays above 0.555 h / c_d at any size.
        assert critical_steps(mesh, grid.xy[grid.quads[mesh.cell]]).min() >= 0.555
        done += len(np.unique(mesh.cell[mesh.cut]))


def test_random_cuts_keep_area_mass_and_time_step() -> None:
    check_random_cuts(seed=1, wanted=5_000)


@pytest.mark.slow
def test_100_000_random_cuts_keep_area_mass_and_time_step() -> None:
    check_random_cuts(seed=2, wanted=100_000)


def rotated(points: np.ndarray, angle: float, shift: np.ndarray) -> Region:
    c, s = np.cos(angle), np.sin(angle)
    p = points @ np.array([[c, s], [-s, c]]) + shift
    return Region(Curve(np.vstack([p, p[:1]]), np.zeros(len(p))))


POLYGONS = {
    "square": np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]),
    "L with a re-entrant corner": np.array([[-1, -1], [1, -1], [1, -0.2], [-0.2, -0.2], [-0.2, 1], [-1, 1]]),
    "seven corners": np.array([[0, -1], [0.9, -0.7], [1, 0.4], [0.3, 0.2], [0, 1], [-0.8, 0.6], [-1, -0.5]]),
}


@pytest.mark.parametrize("relocation", [0.0, 0.1], ids=["not relocated", "relocated"])
@pytest.mark.parametrize("name", POLYGONS)
def test_polygons_keep_their_area_at_50_random_offsets_and_angles(name: str, relocation: float) -> None:
    """Sharp corners stay: the area is off by the lattice only, 2^-22 h at each corner, 1e-8 of it at most."""
    cells = 30
    grid = square_grid(cells)
    rng = np.random.default_rng(7)
    for _ in range(50):
        region = rotated(10.0 * POLYGONS[name], rng.uniform(0, 2 * np.pi), 15.0 + rng.uniform(-0.5, 0.5, 2))
        moved = relocate(grid, region.loops, relocation).grid if relocation else grid
        mesh = double(moved, cut(moved, (region,), (), Lattice.of(grid)))
        assert mesh.area.sum() == pytest.approx(region.area, rel=1e-8)
        assert np.isclose(mesh.fraction[~mesh.cut], 1.0).all()


def test_area_of_a_disc_converges_with_h_squared() -> None:
    """Chords between grid crossings: the area misses O(h^2); the rate is fitted over four grids."""
    errors, sizes = [], np.array([10, 20, 40, 80])
    for cells in sizes:
        grid = square_grid(cells, 1.0 / cells)
        region = Region(disc(0.503, 0.497, 0.4))
        moved = relocate(grid, region.loops).grid
        mesh = double(moved, cut(moved, (region,), (), Lattice.of(grid)))
        errors.append(abs(mesh.area.sum() - region.area))
    rate = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate > 1.9


def test_boundary_segments_close_around_the_body() -> None:
    """Segments follow each other around every loop, with the material on their left."""
    region = Region(disc(2.5, 2.5, 2.1), (disc(2.5, 2.5, 0.9),))
    mesh = cut_mesh(square_grid(5), (region,))
    segments = mesh.segments
    assert np.array_equal(segments.ends[segments.following, 0], segments.ends[:, 1])
    assert sorted(segments.following) == list(range(len(segments.ends)))
    (x0, y0), (x1, y1) = segments.ends[:, 0].T, segments.ends[:, 1].T
    assert 0.5 * np.sum(x0 * y1 - x1 * y0) == pytest.approx(mesh.area.sum(), rel=1e-12)
    assert set(segments.curve) == {0, 1}


def test_the_two_sides_of_an_interface() -> None:
    """Material on the left of the curve is side +1; each side has segments of the same length."""
    mesh = cut_mesh(square_grid(5), (box(0, 0, 5, 5),), line((0, 2.3), (5, 2.6)))
    segments = mesh.segments
    length = np.hypot(*(segments.ends[:, 1] - segments.ends[:, 0]).T)
    above = mesh.xy[mesh.elements[segments.element]].mean(axis=1)[:, 1]
    assert length[segments.side == 1].sum() == pytest.approx(np.hypot(5, 0.3), rel=1e-6)
    assert length[segments.side == -1].sum() == pytest.approx(length[segments.side == 1].sum(), rel=1e-14)
    start, end = segments.ends[:, 0], segments.ends[:, 1]
    assert np.all((end - start)[segments.side == 1, 0] > 0)  # along the curve, left = above
    assert above[segments.side == 1].mean() > above[segments.side == -1].mean() - 1e-12


def test_grid_edges_on_the_outline_are_boundary_segments() -> None:
    mesh = cut_mesh(square_grid(4), (box(0, 0, 4, 4),))
    assert len(mesh.segments.ends) == 16 and not mesh.cut.any()
    assert np.bincount(mesh.segments.piece).tolist() == [4, 4, 4, 4]


def test_a_slit_in_one_fragment_carries_no_segments() -> None:
    mesh = cut_mesh(square_grid(3), (box(0, 0, 3, 3),), line((1.2, 1.5), (1.8, 1.5)))
    assert not np.any(mesh.segments.side)


def slanted(seed: int) -> tuple[np.random.Generator, np.ndarray, float, Curve]:
    """A square of side 4 at a random angle in the middle of 8 x 8 cells."""
    rng = np.random.default_rng(seed)
    centre, angle = rng.uniform(3.5, 4.5, 2), rng.uniform(0.0, 2.0 * np.pi)
    return rng, centre, angle, rotated(2.0 * POLYGONS["square"], angle, centre).outer


def relocated_cut(regions: tuple[Region, ...], *interfaces: Curve) -> CutMesh:
    grid = square_grid(8)
    moved = relocate(grid, [loop for region in regions for loop in region.loops] + list(interfaces)).grid
    return double(moved, cut(moved, regions, interfaces, Lattice.of(grid)))


@pytest.mark.parametrize("seed", range(40))
def test_an_interface_that_ends_exactly_on_slanted_outlines_separates(seed: int) -> None:
    rng, _, _, square = slanted(seed)
    ends = square.at(np.array([0, 2]), rng.uniform(0.1, 0.9, 2))
    assert relocated_cut((Region(square),), line(*map(tuple, ends))).component.max() == 1


@pytest.mark.parametrize("seed", range(20))
def test_interfaces_that_start_exactly_on_a_round_hole_separate(seed: int) -> None:
    """The chord of the hole's arc leaves the end of the interface in the material: the arc has a vertex there."""
    rng, centre, _, square = slanted(seed)
    hole = disc(*centre, rng.uniform(0.4, 1.3))
    starts = hole.at(np.array([0, 1]), rng.uniform(0.1, 0.9, 2))
    out = [centre + 5.0 * (start - centre) / np.hypot(*(start - centre)) for start in starts]
    cuts = [line(tuple(a), tuple(b)) for a, b in zip(starts, out, strict=True)]
    assert relocated_cut((Region(square, (hole,)),), *cuts).component.max() == 1


@pytest.mark.parametrize("seed", range(40))
def test_regions_that_share_a_part_of_a_slanted_side_do_not_cross(seed: int) -> None:
    rng, centre, angle, square = slanted(seed)
    other = np.array([[0.0, 2.0], [1.3, 2.0], [1.3, 3.0], [0.0, 3.0]]) + [rng.uniform(-1.9, 0.5), 0.0]
    mesh = relocated_cut((Region(square), rotated(other, angle, centre)))
    assert mesh.component.max() == 1
    assert mesh.area.sum() == pytest.approx(17.3, rel=1e-7)  # the lattice: 2^-22 h on a perimeter of 20 h


@pytest.mark.parametrize("radius", [3.54, 3.6, 4.0, 1e3])
def test_a_curve_outside_the_grid_cuts_nothing(radius: float) -> None:
    """A circle around the block (half diagonal 3.536): its chords must not sever the corners."""
    mesh = cut_mesh(square_grid(5), (box(0, 0, 5, 5),), disc(2.5, 2.5, radius))
    assert (len(mesh.elements), len(mesh.xy)) == (25, 36)


def test_a_hole_beyond_the_chord_of_the_outline_is_refused_with_advice() -> None:
    """Chords of 1 h on a radius of 2.5 h sag by 0.05 h: more than the 0.002 h between hole and outline."""
    region = Region(disc(4.0, 4.0, 2.5), (disc(4.0 + 2.198 * np.cos(0.2), 4.0 + 2.198 * np.sin(0.2), 0.3),))
    with pytest.raises(GeometryError, match="make the cells smaller"):
        cut_mesh(square_grid(8), (region,))


def test_nodes_of_no_cell_attract_nothing() -> None:
    grid = square_grid(5)
    lone = BackgroundGrid(np.vstack([grid.xy, [[2.3, 2.4]]]), grid.quads)
    regions, cuts = (box(0, 0, 5, 5),), line((0, 2.4), (5, 2.45))
    assert len(cut_mesh(lone, regions, cuts).segments.ends) == len(
        cut_mesh(grid, regions, cuts).segments.ends
    )


@pytest.mark.parametrize(
    ("region", "fragment"),
    [
        (box(1, 1, 6, 4), "reaches beyond its background grid"),
        (box(-3, -3, 9, 9), "reaches beyond its background grid"),
        (box(7, 7, 9, 9), "no cell of the background grid lies in the body"),
    ],
)
def test_a_body_outside_its_grid_is_refused(region: Region, fragment: str) -> None:
    with pytest.raises(GeometryError, match=fragment):
        cut_mesh(square_grid(5), (region,))


def test_cells_on_both_sides_twice_are_refused() -> None:
    grid = square_grid(2)
    doubled = BackgroundGrid(grid.xy, np.vstack([grid.quads, grid.quads[:1]]))
    with pytest.raises(GeometryError, match="two cells on the same side"):
        cut_mesh(doubled, (box(0, 0, 2, 2),))


@pytest.mark.parametrize(
    ("segments", "pieces"),
    [
        ([[(0, 0), (8, 8)], [(0, 8), (8, 0)]], 4),  # a crossing at a lattice point
        ([[(0, 0), (9, 9)], [(0, 8), (8, 0)]], 4),
        ([[(0, 0), (7, 7)], [(0, 7), (7, 0)]], 4),  # a crossing between lattice points
        ([[(0, 0), (8, 0)], [(4, 0), (4, 5)]], 3),  # an end on a segment
        ([[(0, 0), (8, 0)], [(2, 0), (12, 0)]], 4),  # collinear, overlapping
        ([[(0, 0), (8, 0)], [(8, 0), (0, 0)]], 2),  # the same segment, both ways
        ([[(0, 0), (100, 1)], [(50, 0), (50, -9)]], 3),  # a vertex half a unit off
        ([[(0, 0), (0, 0)], [(1, 1), (2, 2)]], 1),  # no length
        ([[(0, 0), (99, 0)], [(50, 1), (50, 9)]], 3),  # an end off a line by rounding
        (
            [
                [(25315704, 20973132), (24942076, 25103285)],
                [(25865038, 20972913), (24995158, 24516502)],
                [(25091506, 23451456), (24942076, 25103285)],
            ],
            6,
        ),  # an end beside two nearly coinciding segments
    ],
)
def test_noding_of_degenerate_positions(segments: list, pieces: int) -> None:
    given = np.array(segments)
    noded = node_segments(given[:, 0], given[:, 1])
    assert len(noded.ends) == pieces
    again = node_segments(noded.vertices[noded.ends[:, 0]], noded.vertices[noded.ends[:, 1]])
    assert len(again.ends) == pieces  # nothing is left to split


@pytest.mark.parametrize("seed", range(5))
def test_fragments_of_crooked_cells_fill_them(seed: int) -> None:
    """On slanted edges too the fragments of a cell sum to its area, to 1e-12 of it: rounding, no lattice."""
    rng, cells = np.random.default_rng(seed), 12
    grid = square_grid(cells)
    inner = np.all((grid.xy > 0) & (grid.xy < cells), axis=1)
    shaken = BackgroundGrid(grid.xy + 0.2 * rng.uniform(-1, 1, grid.xy.shape) * inner[:, None], grid.quads)
    mesh = cut_mesh(shaken, (box(0, 0, cells, cells),), *random_cuts(rng, cells))
    corners = Lattice.of(shaken).position(Lattice.of(shaken).snap(shaken.xy))[grid.quads]
    d1, d2 = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    areas = 0.5 * (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])
    sums = np.bincount(mesh.cell, weights=mesh.area, minlength=cells**2)
    assert np.max(np.abs(sums - areas)) <= 1e-12
    assert np.all(mesh.area > 0.0)


def test_places_in_small_cells_far_from_the_origin_keep_their_digits() -> None:
    """Cells of 2^-14 m at 1024 m: all sums are exact in doubles, so that nothing but Newton's steps may err."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    rng = np.random.default_rng(0)
    local = np.round(rng.uniform(-1.0, 1.0, (50, 2)) * 2**8) / 2**8
    corners = 1024.0 + 2.0**-14 * np.repeat(square[None], 50, axis=0)
    np.testing.assert_allclose(to_local(corners, 1024.0 + 2.0**-14 * local), local, rtol=0, atol=1e-15)
