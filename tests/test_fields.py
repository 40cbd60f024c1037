from __future__ import annotations

import dataclasses
import io
import mmap
import os
import threading
import xml.etree.ElementTree as ET

import meshio
import numpy as np
import pytest

from phantomnode.pipeline import vtu
from phantomnode.pipeline.clip import ClippedBodies, cell_labels
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.fields import Fields, contact_lines, encoding_of_points
from phantomnode.pipeline.observer import Ending
from phantomnode.pipeline.outlines import open_edges
from phantomnode.pipeline.schema import FieldFrames
from phantomnode.pipeline.vtu import VTK_QUAD, VTK_TRIANGLE, Encoding, Series, cells, vectors, vtu_pieces
from phantomnode.pipeline.vtu_reader import read_vtu

FLOAT32 = 2e-7
"""Two roundings to float32 (6e-8 each) of numbers of order one."""


def polygon_areas(points):
    """(m,) Areas of (m, k, 2) polygons."""
    x, y = points[..., 0], points[..., 1]
    return 0.5 * np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)


def test_clipped_area_is_that_of_the_material(handmade):
    clipped = ClippedBodies.of(handmade)
    points = clipped.interpolate(handmade.model.x)
    areas = np.concatenate([polygon_areas(points[cell]) for cell in (clipped.quads, clipped.triangles)])
    assert np.all(areas > 0.0)
    # Block 1 - 0.25^2 / 2, floor 3 x 1; sums of a few exact numbers: rounding only.
    assert np.bincount(cell_labels(handmade.bodies).body, areas) == pytest.approx([0.96875, 3.0], rel=1e-14)
    np.testing.assert_array_equal(cell_labels(handmade.bodies).fraction, [1, 1, 1, 1, 0.875, 0.875, 0.875])


def test_no_point_stands_on_the_phantom_node(handmade):
    clipped = ClippedBodies.of(handmade)
    points = clipped.interpolate(handmade.model.x)
    assert np.all(points[points[:, 0] <= 1.0].sum(axis=1) <= 1.75 + 1e-12)  # the cut, x + y = 1.75
    assert [1.0, 1.0] not in points.tolist()


def test_phantom_node_moves_the_cut_edge(handmade):
    """The cut's points follow the bilinear interpolation of the parent, phantom node included."""
    clipped = ClippedBodies.of(handmade)
    u = np.zeros((13, 2))
    u[8] = (1.0, 0.0)
    points, moved = clipped.interpolate(handmade.model.x), clipped.interpolate(u)[:, 0]
    on_cut = np.isclose(points.sum(axis=1), 1.75)
    # (1, 0.75) and (0.75, 1) lie half way along the edges to the phantom node: N = 1/2.
    np.testing.assert_allclose(moved[on_cut], [0.5, 0.5], rtol=1e-14)
    np.testing.assert_allclose(moved[~on_cut], 0.0, atol=1e-15)


def test_neighbours_share_points_and_the_outline_is_closed(handmade):
    clipped = ClippedBodies.of(handmade)
    # 8 real nodes, 2 points on the cut, 4 nodes of the floor.
    assert clipped.points == 14
    outline = open_edges([clipped.quads, clipped.triangles], clipped.interpolate(handmade.model.x))
    # Block: 9 edges (two each of bottom and left, right .5 + .25, cut, top .25 + .5); floor: 4.
    assert len(outline) == 8 + 1 + 4
    assert np.all(np.bincount(outline.ravel())[np.unique(outline)] == 2)


def test_sides_of_a_crack_stay_apart(handmade):
    """Two elements on the same place with nodes of their own share no point."""
    import dataclasses

    first, floor = handmade.bodies
    double = dataclasses.replace(
        first, name="copy", nodes=slice(13, 22), elements=slice(4, 7), cut_elements=slice(1, 2)
    )
    nodes = np.vstack([handmade.model.elements.nodes, 13 + first.mesh.elements[:3]])
    model = handmade.model._replace(
        x=np.vstack([handmade.model.x, first.mesh.xy]), elements=handmade.model.elements._replace(nodes=nodes)
    )
    clipped = ClippedBodies.of(dataclasses.replace(handmade, bodies=(first, floor, double), model=model))
    assert clipped.points == 14 + 10


@pytest.fixture
def written(handmade, frame_of, tmp_path):
    """Two frames: the start, and a homogeneous deformation with two of the four points in contact."""
    stretch = np.array([[0.2, 0.1], [0.0, -0.1]])
    u = handmade.model.x @ stretch.T
    gap, normal = np.full(4, -1e300), np.zeros((4, 2))
    gap[:2], normal[:2] = (1e-3, 3e-3), (0.0, 1.0)
    last = frame_of(50, u=u, v=2.0 * u, gap=gap, normal=normal)
    fields = Fields(handmade, tmp_path, frozenset({0, 50}))
    fields.frame(frame_of(0))
    fields.frame(last)
    fields.finish(Ending("done", "", "", last))
    return tmp_path, u, np.eye(2) + stretch


def test_frame_holds_what_the_contract_names(written, handmade):
    folder, _, deformation = written
    mesh = meshio.read(folder / "fields" / "fields_00001.vtu")
    assert set(mesh.point_data) == {"displacement", "velocity"}
    assert set(mesh.cell_data) == {"stress", "von_mises", "hencky_strain", "J", "body", "side", "fraction"}
    assert [(block.type, len(block.data)) for block in mesh.cells] == [("quad", 4), ("triangle", 3)]
    assert mesh.cell_data["stress"][0].shape == (4, 6)
    displacement = mesh.point_data["displacement"]
    assert displacement.shape == (14, 3)
    reference = mesh.points - displacement
    np.testing.assert_allclose(mesh.points[:, :2], reference[:, :2] @ deformation.T, atol=2 * FLOAT32)
    np.testing.assert_allclose(mesh.point_data["velocity"], 2.0 * displacement, rtol=FLOAT32)
    np.testing.assert_array_equal(np.concatenate(mesh.cell_data["body"]), [0, 0, 0, 1, 0, 0, 0])


def test_the_highest_stress_has_its_time_and_place(handmade, frame_of, tmp_path):
    """Only a node of the floor moves: its cell has the stress, the block none; later ones are smaller."""
    floor, local = handmade.bodies[1], np.zeros_like(handmade.model.x)
    local[floor.nodes.start] = (0.0, 0.01)
    fields = Fields(handmade, tmp_path, frozenset({0, 1, 2}))
    for step, part in ((0, 0.0), (1, 1.0), (2, 0.5)):
        fields.frame(frame_of(step, u=part * local))
    block, highest = fields.highest
    assert block == (0.0, 0.0, pytest.approx(0.0))
    assert highest.stress > 0.0 and highest.time == handmade.dt
    np.testing.assert_allclose(
        highest.place, floor.mesh.xy[floor.mesh.elements[0]].mean(axis=0), atol=FLOAT32
    )
    again = Fields(handmade, tmp_path, frozenset({0, 1, 2}), fields.saved())
    assert [one.stress for one in again.highest] == [0.0, highest.stress]
    np.testing.assert_array_equal(again.highest[1].place, highest.place)


def test_homogeneous_deformation_gives_the_closed_form(written, handmade):
    """Hencky's law, J sigma = lambda ln J I + 2 mu ln V, with ln V from an eigendecomposition."""
    folder, _, deformation = written
    lame, shear = handmade.model.elements.lame[0], handmade.model.elements.shear[0]
    squares, axes = np.linalg.eigh(deformation @ deformation.T)
    strain, j = axes @ np.diag(0.5 * np.log(squares)) @ axes.T, np.linalg.det(deformation)
    volumetric = lame * np.log(j)
    xx, yy, zz, xy = (
        value / j
        for value in (
            volumetric + 2.0 * shear * strain[0, 0],
            volumetric + 2.0 * shear * strain[1, 1],
            volumetric,
            2.0 * shear * strain[0, 1],
        )
    )
    mises = np.sqrt(0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * xy**2)
    mesh = meshio.read(folder / "fields" / "fields_00001.vtu")
    data = {key: np.concatenate(value) for key, value in mesh.cell_data.items()}
    size = np.abs([xx, yy, zz, xy]).max()
    np.testing.assert_allclose(data["stress"], [[xx, yy, zz, xy, 0.0, 0.0]] * 7, atol=FLOAT32 * size)
    np.testing.assert_allclose(data["von_mises"], mises, rtol=FLOAT32)
    np.testing.assert_allclose(
        data["hencky_strain"], [[strain[0, 0], strain[1, 1], 0.0, strain[0, 1], 0.0, 0.0]] * 7, atol=FLOAT32
    )
    np.testing.assert_allclose(data["J"], j, rtol=FLOAT32)


def test_series_lists_every_frame_with_its_time(written, handmade):
    folder, *_ = written
    for name in ("fields", "contact"):
        entries = ET.parse(folder / f"{name}.pvd").getroot().findall("./Collection/DataSet")
        assert [float(e.get("timestep")) for e in entries] == [0.0, 50 * handmade.dt]
        assert all((folder / e.get("file")).is_file() for e in entries)


def test_pyvista_reads_the_series(written):
    pyvista = pytest.importorskip("pyvista")
    folder, *_ = written
    reader = pyvista.get_reader(folder / "fields.pvd")
    reader.set_active_time_point(1)
    grid = reader.read()[0]
    assert grid.n_cells == 7 and grid.n_points == 14
    assert grid.field_data["TimeValue"][0] == 0.005


def test_contact_lines(written):
    folder, *_ = written
    mesh = meshio.read(folder / "contact" / "contact_00001.vtu")
    assert [(block.type, len(block.data)) for block in mesh.cells] == [("line", 2)]
    data = {key: value[0] for key, value in mesh.cell_data.items()}
    # eps mean(g) = 1e9 * 2e-3 on the reference length, over the stretch 1.2 of the bottom edge.
    np.testing.assert_allclose(data["pressure"], [2e6 / 1.2, 0.0], rtol=FLOAT32)
    np.testing.assert_allclose(data["gap"], [-2e-3, np.nan], rtol=FLOAT32)
    np.testing.assert_array_equal(data["normal"], [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(data["pair"], [0, 0])


def test_pressure_times_current_length_is_the_force(handmade, frame_of):
    rng = np.random.default_rng(7)
    gap = rng.uniform(0.0, 1e-2, 4)
    lines = contact_lines(handmade, 0, frame_of(u=0.1 * rng.standard_normal((13, 2)), gap=gap))
    length = np.hypot(*(lines.ends[:, 1] - lines.ends[:, 0]).T)
    contact = handmade.model.contact
    force = contact.penalty[0] * np.sum(gap * contact.slave_weight)
    assert np.sum(lines.pressure * length) == pytest.approx(force, rel=1e-14)


def test_peak_is_the_frame_with_the_largest_internal_energy(handmade, frame_of, tmp_path):
    fields = Fields(handmade, tmp_path, frozenset({0, 1, 2}))
    for step, internal in enumerate((0.0, 5.0, 3.0)):
        energies = frame_of().energies._replace(internal=internal)
        fields.frame(frame_of(step, energies=energies))
    assert fields.peak is not None and fields.peak.step == 1


def test_series_is_whole_after_every_frame(tmp_path):
    series = Series(tmp_path / "a & b.pvd")
    grid = cells((VTK_QUAD, np.array([[0, 1, 2, 3]])), (VTK_TRIANGLE, np.array([[0, 1, 2]])))
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    for k in range(3):
        series.add(0.1 * k, vtu_pieces(vectors(square), grid, {}, {"value": np.arange(2.0)}, 0.1 * k))
        assert len(series.saved()["times"]) == k + 1  # once it is written
        entries = ET.parse(io.BytesIO((tmp_path / "a & b.pvd").read_bytes())).getroot().iter("DataSet")
        assert len([meshio.read(tmp_path / e.get("file")) for e in entries]) == k + 1


def test_frames_reach_the_disk_at_the_end_and_once_a_second_before(tmp_path, monkeypatch):
    synced, now = [], [0.0]
    monkeypatch.setattr(vtu, "monotonic", lambda: now[0])
    monkeypatch.setattr(vtu, "reach_disk", lambda path: synced.append(path.name))
    series = Series(tmp_path / "a.pvd")
    series.reach_disk()  # nothing yet
    for now[0] in (0.4, 0.8, 1.2, 1.6):
        series.add(now[0], [b"content"])
        series.saved()
    assert synced == ["a_00000.vtu", "a_00001.vtu", "a_00002.vtu", "a.pvd"]
    series.reach_disk()
    assert synced[4:] == ["a_00003.vtu", "a.pvd"]


def test_a_frame_that_cannot_be_written_is_told_by_what_comes_next(tmp_path):
    series = Series(tmp_path / "a.pvd")
    series.add(0.0, [b"content"])
    series.reach_disk()
    (tmp_path / "a").rename(tmp_path / "gone")
    for ask in (lambda: series.add(2.0, [b"content"]), series.saved, series.digests, series.reach_disk):
        series.add(1.0, [b"content"])
        series.close()  # says nothing
        with pytest.raises(FileNotFoundError, match="a_00001.vtu"):
            ask()
    assert series.saved()["times"] == [0.0] and "a_00001" not in (tmp_path / "a.pvd").read_text()


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("compression", ["zlib", "lz4", "none"])
def test_arrays_are_read_back(tmp_path, precision, compression):
    """Zeros, NaN, noise and whole numbers, by VTK, and by meshio where it knows what packs them."""
    rng, encoding = np.random.default_rng(3), Encoding(precision, compression)
    for count in (3, 20_000):
        points, value = rng.standard_normal((count, 2)), rng.standard_normal((count, 3))
        value[:, 2], value[0, 0] = 0.0, np.nan
        grid = cells((VTK_TRIANGLE, np.arange(3).reshape(1, 3)), encoding=encoding)
        data = {"value": value, "number": np.arange(count), "zero": np.zeros(count)}
        content = b"".join(vtu_pieces(vectors(points), grid, data, {"side": np.array([7])}, 0.5, encoding))
        (tmp_path / "a.vtu").write_bytes(content)
        read = pytest.importorskip("pyvista").read(tmp_path / "a.vtu")
        np.testing.assert_array_equal(read.points[:, :2], points.astype(precision))
        assert read["value"].dtype == read["zero"].dtype == np.dtype(precision)
        np.testing.assert_array_equal(read["value"], value.astype(precision))
        np.testing.assert_array_equal(read["number"], np.arange(count))
        np.testing.assert_array_equal(read["side"], [7])
        assert read.field_data["TimeValue"][0] == 0.5
        own = read_vtu(tmp_path / "a.vtu")
        for name in data:
            np.testing.assert_array_equal(own.point_data[name], read[name])
        np.testing.assert_array_equal(own.points, read.points)
        assert own.cells(VTK_TRIANGLE).tolist() == [[0, 1, 2]] and own.cell_data["side"] == [7]
        if compression != "lz4":
            mesh = meshio.read(tmp_path / "a.vtu")
            np.testing.assert_array_equal(mesh.points[:, :2], points.astype(precision))
            np.testing.assert_array_equal(mesh.point_data["value"], value.astype(precision))
            np.testing.assert_array_equal(mesh.point_data["number"], np.arange(count))


@pytest.mark.skipif(os.name != "posix", reason="identifiers of threads are addresses on POSIX only")
def test_equal_arrays_are_packed_into_equal_bytes_wherever_the_stack_lies():
    """ISA-L alone, without what data_array does about it, gives others on one stack in some hundred."""
    ones, packed, stacks, random = np.ones(32, np.float32), set(), set(), np.random.default_rng(1)

    def pack():
        if (stack := threading.get_ident() >> 16) not in stacks:
            stacks.add(stack)
            packed.add(vtu.data_array("ones", ones).pieces)

    before = threading.stack_size()
    try:
        for _ in range(1500):
            threading.stack_size(int(random.integers(16, 600)) << 16)
            gap = mmap.mmap(-1, int(random.integers(1, 2000)) << 16)  # shifts where the next stack lies
            thread = threading.Thread(target=pack)
            thread.start()
            thread.join()
            if random.random() < 0.5:
                gap.close()
    finally:
        threading.stack_size(before)
    assert len(packed) == 1 and len(stacks) > 100


@pytest.mark.parametrize("compression", ["zlib", "lz4", "none"])
def test_damaged_files_are_named(tmp_path, compression):
    encoding, file = Encoding(compression=compression), tmp_path / "a.vtu"
    grid = cells((VTK_TRIANGLE, np.arange(3).reshape(1, 3)), encoding=encoding)
    content = b"".join(vtu_pieces(np.eye(3), grid, {}, {}, encoding=encoding))
    for wrong in (content[:200], content[: content.index(b"_") + 30], b"", content.replace(b"raw", b"hex")):
        file.write_bytes(wrong)
        with pytest.raises(CaseError, match=r"a\.vtu: cannot be read"):
            read_vtu(file)


def test_points_far_from_the_origin_are_kept_in_double_precision(handmade):
    """1e-4 of the cell, 0.5 m, is what float32 rounds by at 839 m."""
    for place, precision in ((800.0, "float32"), (1700.0, "float64")):
        far = dataclasses.replace(handmade, model=handmade.model._replace(x=handmade.model.x + place))
        assert encoding_of_points(far) == Encoding(precision, "zlib")


def test_lz4_is_refused_where_it_is_not_installed(monkeypatch):
    monkeypatch.setattr("phantomnode.pipeline.schema.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install .phantomnode\[lz4\]"):
        FieldFrames(count=3, compression="lz4")
    assert FieldFrames(count=3).compression == "zlib"
