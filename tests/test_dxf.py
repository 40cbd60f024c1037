"""What real DXF drawings hold: every case is drawn here by ezdxf, or cut out of what it writes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
from cad import read_here as read_geometry

from phantomnode.geometry import dxf, dxf_load
from phantomnode.geometry.curves import Geometry
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.splines import spline

EXACT = 1e-12
"""Arcs are arcs: a few roundings of the file's decimals (15 digits) and of the conversion to metres."""

CHORD = 1e-6
"""The chord error of free-form curves over the diagonal."""


def read(
    folder: Path,
    draw: Callable[[Any], None],
    *,
    version: str = "R2010",
    fmt: str = "asc",
    units: int = 6,
    **how: Any,
) -> Geometry:
    document = ezdxf.new(version)
    if version != "R12":
        document.header["$INSUNITS"] = units
    draw(document.modelspace())
    document.saveas(folder / "d.dxf", fmt=fmt)
    return read_geometry(folder / "d.dxf", "m" if version == "R12" else None, **how)


def areas(geometry: Geometry) -> list[float]:
    return sorted(region.area for region in geometry.regions)


@pytest.mark.parametrize("version", ["R12", "R2000", "R2004", "R2007", "R2010", "R2013", "R2018"])
@pytest.mark.parametrize("fmt", ["asc", "bin"])
def test_every_version_is_read_ascii_and_binary_to_the_same_numbers(
    tmp_path: Path, version: str, fmt: str
) -> None:
    def draw(space: Any) -> None:
        space.add_circle((1 / 3, 2 / 3), 0.7)
        space.add_polyline2d(
            [(3, 0, 1), (5, 0, 0.5)], format="xyb", close=True, dxfattribs={"layer": "Übermaß"}
        )

    geometry = read(tmp_path, draw, version=version, fmt=fmt)
    assert geometry.regions[0].area == pytest.approx(np.pi * 0.49, rel=EXACT)
    assert geometry.regions[1].outer.name == "Übermaß"
    assert not geometry.notes


def test_the_level_set_of_a_dxf_circle_is_exact(tmp_path: Path) -> None:
    """Also of one in a block that is scaled by minus two and turned, and of one drawn as a bulged polyline."""

    def draw(space: Any) -> None:
        block = space.doc.blocks.new("C")
        block.add_circle((0.5, 0), 0.25)
        space.add_blockref("C", (0, 0), dxfattribs={"xscale": -2, "yscale": 2, "rotation": 90})
        space.add_lwpolyline([(2.5, 0, 1), (3.5, 0, 1)], format="xyb", close=True)

    geometry = read(tmp_path, draw)
    points = np.random.default_rng(3).uniform(-4.0, 4.0, (1000, 2))
    for region, centre in zip(geometry.regions, [(0.0, -1.0), (3.0, 0.0)], strict=True):
        distance = LevelSet.of_regions((region,)).distance(points)
        assert np.max(np.abs(distance - (0.5 - np.hypot(*(points - centre).T)))) < EXACT


def test_entities_without_subclass_markers_are_read_with_a_note(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_lwpolyline([(0, 0), (1, 0), (1, 1)], close=True, dxfattribs={"layer": "a", "color": 3})
        space.add_open_spline([(3, 0), (4, 2), (5, 0), (6, 1)], dxfattribs={"layer": "b"})

    whole = read(tmp_path, draw)
    text = (tmp_path / "d.dxf").read_text()
    for marker in ("AcDbPolyline", "AcDbSpline"):
        text = text.replace(f"100\n{marker}\n", "")
    (tmp_path / "d.dxf").write_text(text)
    bare = read_geometry(tmp_path / "d.dxf")
    assert bare.notes == (
        "the DXF file has 1 LWPOLYLINE without subclass markers",
        "the DXF file has 1 SPLINE without subclass markers",
    )
    assert bare.regions[0].outer.name == "a" and bare.curves[0].name == "b"
    assert np.array_equal(bare.curves[0].points, whole.curves[0].points)


def test_a_file_without_its_last_mark_is_read_and_one_cut_in_its_entities_is_refused(tmp_path: Path) -> None:
    read(tmp_path, lambda space: space.add_circle((0, 0), 1))
    text = (tmp_path / "d.dxf").read_text()
    (tmp_path / "d.dxf").write_text(text.replace("  0\nEOF\n", ""))
    assert "without the mark EOF" in read_geometry(tmp_path / "d.dxf").notes[0]
    (tmp_path / "d.dxf").write_text(text[: text.index("AcDbCircle")])
    with pytest.raises(GeometryError, match="end of this DXF file is missing"):
        read_geometry(tmp_path / "d.dxf")
    read(tmp_path, lambda space: space.add_circle((0, 0), 1), fmt="bin")
    content = (tmp_path / "d.dxf").read_bytes()
    (tmp_path / "d.dxf").write_bytes(content[: len(content) // 2])
    with pytest.raises(GeometryError, match="end of this DXF file is missing"):
        read_geometry(tmp_path / "d.dxf")


def test_what_the_recover_mode_mends_is_told(tmp_path: Path) -> None:
    read(tmp_path, lambda space: space.add_circle((0, 0), 1))
    text = (tmp_path / "d.dxf").read_text()
    assert " 40\n1.0\n" in text
    (tmp_path / "d.dxf").write_text(text.replace(" 40\n1.0\n", " 40\n1.0mm\n"))
    geometry = read_geometry(tmp_path / "d.dxf", "m")
    assert len(geometry.regions) == 1 and any("was recovered" in note for note in geometry.notes)


def test_a_file_of_too_many_bytes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dxf_load, "MOST_BYTES", 1000)
    with pytest.raises(GeometryError, match="more than 0 MB are not read: purge it"):
        read(tmp_path, lambda space: space.add_circle((0, 0), 1))


CLAMPED = np.array([0.0, 0, 0, 0, 1, 2, 2, 2, 2])
FRAME = np.array([[0.0, 0], [1, 2], [3, 2], [4, 0], [5, 1]])


@pytest.mark.parametrize("knots", [CLAMPED, CLAMPED[1:-1], np.zeros(0)])
def test_a_spline_with_all_inner_or_no_knots_is_the_same_curve(knots: np.ndarray) -> None:
    evaluate, breaks = spline(3, knots, FRAME)
    assert breaks.tolist() == [0.0, 1.0, 2.0]
    assert np.allclose(evaluate(breaks[[0, -1]]), FRAME[[0, -1]], rtol=0.0, atol=1e-15)
    assert np.allclose(evaluate(np.array([1.0])), [[2.75, 1.5]], rtol=0.0, atol=1e-15)  # by de Boor, by hand


def test_a_rational_spline_draws_a_circle() -> None:
    corner = np.sqrt(0.5)
    points = np.array([[1.0, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]])
    weights = np.array([1.0, corner] * 4 + [1.0])
    evaluate, breaks = spline(2, np.repeat(np.arange(5.0), [3, 2, 2, 2, 3]), points, weights)
    assert np.hypot(*evaluate(np.linspace(0, 4, 101)).T) == pytest.approx(1.0, rel=1e-15 * 10)
    assert breaks.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_periodic_spline_by_its_distinct_knots_closes_smoothly() -> None:
    square = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
    evaluate, breaks = spline(3, np.arange(5.0), square, periodic=True)
    ends = evaluate(breaks[[0, -1]])
    assert np.array_equal(np.round(ends[0], 14), np.round(ends[1], 14))
    turned = evaluate(np.array([0.3, 1.3, 2.3, 3.3]))  # a quarter of the knots further is a quarter turn
    assert np.allclose(turned[1:], turned[:-1] @ [[0, 1], [-1, 0]], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("degree", "knots", "weights", "message"),
    [
        (3, np.arange(5.0), None, "degree 3 with 5 control points has 9 knots, not 5"),
        (3, CLAMPED[::-1], None, "do not ascend"),
        (3, CLAMPED, np.zeros(5), "not positive"),
        (3, CLAMPED, np.ones(4), "4 weights for 5"),
        (3, np.zeros(9), None, "all the same"),
        (99, CLAMPED, None, "degree is 99"),
        (3, CLAMPED * np.nan, None, "not all finite"),
    ],
)
def test_splines_that_do_not_fit_together_are_refused(
    degree: int, knots: np.ndarray, weights: np.ndarray | None, message: str
) -> None:
    with pytest.raises(GeometryError, match=message):
        spline(degree, knots, FRAME, weights)


def test_a_broken_entity_is_named_by_handle_and_layer(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_circle((0, 0), 1)
        curve = space.add_open_spline([(3, 0), (4, 2), (5, 0), (6, 1)], dxfattribs={"layer": "wrong"})
        curve.dxf.degree = 2

    with pytest.raises(
        GeometryError, match=r"SPLINE [0-9A-F]+ on layer 'wrong' cannot be read .a spline of degree 2"
    ):
        read(tmp_path, draw)
    assert len(read_geometry(tmp_path / "d.dxf", without_layers=["wrong"]).regions) == 1


def test_boundaries_of_filled_areas_count_where_there_are_no_curves(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        paths = space.add_hatch().paths
        paths.add_polyline_path([(0, 0, 1), (2, 0, 1)], is_closed=True)
        edges = paths.add_edge_path()
        edges.add_line((4, 0), (6, 0))
        edges.add_arc((5, 0), 1, 180, 360, ccw=False)
        for below in (1, -1):
            hatch = space.add_hatch(dxfattribs={"extrusion": (0, 0, below)})
            hatch.paths.add_edge_path().add_ellipse((10, 0), (2, 0), 0.5)
        space.add_solid([(20, 0), (21, 0), (20, 1), (21, 1)])

    geometry = read(tmp_path, draw)
    assert areas(geometry) == pytest.approx([1.0, np.pi / 2, np.pi, 2 * np.pi, 2 * np.pi], rel=1e-4)
    assert sorted(round(r.box[0, 0], 3) for r in geometry.regions) == [-12.0, 0.0, 4.0, 8.0, 20.0]
    assert geometry.notes == ("there are no curves: the boundaries of filled areas are taken",)


def test_hatches_do_not_count_beside_curves(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_circle((0, 0), 1)
        space.add_hatch().paths.add_polyline_path([(0, 0), (2, 0), (0, 2)])

    geometry = read(tmp_path, draw)
    assert areas(geometry) == pytest.approx([np.pi], rel=EXACT) and geometry.notes == ("left out: 1 HATCH",)


def test_paper_space_counts_where_the_model_space_is_empty(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_text("title")
        space.doc.layout("Layout1").add_circle((0, 0), 1)

    geometry = read(tmp_path, draw)
    assert len(geometry.regions) == 1
    assert geometry.notes[0] == "the model space holds no curves: paper space 'Layout1' is taken"


def layered(space: Any) -> None:
    for k, layer in enumerate(("Cut-1", "Cut-2", "Notes", "Off", "Cold")):
        space.add_circle((0, 0), 1 + k, dxfattribs={"layer": layer})
    space.doc.layers.add("Off").off()
    space.doc.layers.add("Cold").freeze()


@pytest.mark.parametrize(
    ("how", "radii"),
    [
        ({}, [1, 2, 3]),
        ({"layers": ["cut-*"]}, [1, 2]),
        ({"layers": ["Off"]}, [4]),
        ({"without_layers": ["NOTES"]}, [1, 2]),
        ({"layers": ["cut-*"], "without_layers": ["cut-2"]}, [1]),
    ],
)
def test_layers_are_chosen_by_name_or_pattern(tmp_path: Path, how: dict[str, Any], radii: list[int]) -> None:
    geometry = read(tmp_path, layered, **how)
    loops = [loop for region in geometry.regions for loop in region.loops]
    assert sorted(np.ptp(loop.points[:, 0]) / 2 for loop in loops) == pytest.approx(radii)


def test_layers_off_and_frozen_are_said_and_a_wrong_name_is_answered_with_the_right_ones(
    tmp_path: Path,
) -> None:
    geometry = read(tmp_path, layered)
    assert "layer 'Cold' is frozen: 1 CIRCLE on it do not count" in geometry.notes
    states = {layer.name: layer.state for layer in geometry.contents}
    assert states == {"Cut-1": "", "Cut-2": "", "Notes": "", "Off": "off", "Cold": "frozen"}
    with pytest.raises(
        GeometryError, match="no layer is called 'cutt'; there are '0', 'Cold', 'Cut-1', 'Cut-2'"
    ):
        read(tmp_path, layered, layers=["cutt"])


def test_a_frozen_layer_hides_a_whole_block_and_one_that_is_off_only_what_is_on_it(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        layered(space)
        block = space.doc.blocks.new("B")
        block.add_circle((20, 0), 1, dxfattribs={"layer": "Notes"})
        block.add_circle((30, 0), 1)
        space.add_blockref("B", (0, 0), dxfattribs={"layer": "Off"})
        space.add_blockref("B", (100, 0), dxfattribs={"layer": "Cold"})
        space.add_circle((200, 0), 1, dxfattribs={"invisible": 1})

    boxes = [region.box[0, 0] for region in read(tmp_path, draw).regions]
    assert sorted(np.round(boxes, 9)) == [-3.0, -1.0, 19.0]


def test_blocks_are_scaled_turned_mirrored_and_repeated(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        block = space.doc.blocks.new("B", base_point=(1, 0))
        block.add_lwpolyline([(1, 0, 0), (3, 0, 1), (3, 1, 0), (1, 1, 0)], format="xyb", close=True)
        space.add_blockref("B", (10, 0), dxfattribs={"xscale": 3, "yscale": 3, "zscale": 0, "rotation": 90})
        space.add_blockref("B", (40, 0), dxfattribs={"xscale": 2, "yscale": -1})
        array = {"row_count": 2, "column_count": 2, "row_spacing": 5, "column_spacing": 5, "rotation": 30}
        space.add_blockref("B", (100, 0), dxfattribs=array)

    geometry = read(tmp_path, draw)
    one = 2.0 + np.pi / 8.0
    # Scaled unevenly, the arc is half an ellipse, which becomes a polygon: off by less than length times error.
    assert areas(geometry) == pytest.approx([one] * 4 + [2 * one, 9 * one], rel=1e-4)
    assert areas(geometry)[-1] == pytest.approx(9 * one, rel=EXACT)
    turned = next(region for region in geometry.regions if region.box[1, 0] < 20)
    assert np.allclose(turned.box, [[7.0, 0.0], [10.0, 7.5]], rtol=0.0, atol=1e-11)


def test_a_block_that_is_repeated_without_end_is_refused(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.doc.blocks.new("B").add_circle((0, 0), 1)
        array = {"row_count": 30000, "column_count": 30000, "row_spacing": 5, "column_spacing": 5}
        space.add_blockref("B", (0, 0), dxfattribs=array)

    with pytest.raises(GeometryError, match="INSERT [0-9A-F]+ on layer '0' repeats a block 900000000 times"):
        read(tmp_path, draw)


def test_the_missing_block_and_the_entity_out_of_the_plane_are_named(tmp_path: Path) -> None:
    with pytest.raises(GeometryError, match="shows the block 'GONE', which is missing"):
        read(tmp_path, lambda space: space.add_blockref("GONE", (0, 0)))

    def draw(space: Any) -> None:
        space.add_circle((0, 0), 1)
        space.add_line((0, 0, 0), (0, 0, 3), dxfattribs={"layer": "axis"})
        space.add_line((5, 0, 0), (5, 1, 3), dxfattribs={"layer": "axis"})

    with pytest.raises(
        GeometryError, match="3D drawing.*LINE [0-9A-F]+ on layer 'axis' reaches z = 3.*without_layers"
    ):
        read(tmp_path, draw)
    assert len(read_geometry(tmp_path / "d.dxf", without_layers=["axis"]).regions) == 1


def test_multilines_count_by_their_lines(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_mline([(0, 0), (4, 0), (4, 4), (0, 4)], close=True, dxfattribs={"layer": "wall"})

    geometry = read(tmp_path, draw)
    (region,) = geometry.regions
    assert len(region.holes) == 1 and region.outer.name == "wall"


def test_too_many_entities_are_refused_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dxf, "MOST_ENTITIES", 10)
    with pytest.raises(GeometryError, match="more than 10 entities"):
        read(tmp_path, lambda space: [space.add_line((0, k), (1, k)) for k in range(12)])


@pytest.mark.parametrize(("measurement", "said"), [(1, "perhaps mm"), (0, "perhaps in")])
def test_where_no_unit_is_given_the_drawing_is_asked_for_a_hint(
    tmp_path: Path, measurement: int, said: str
) -> None:
    def draw(space: Any) -> None:
        space.add_circle((0, 0), 1)
        space.doc.header["$MEASUREMENT"] = measurement

    with pytest.raises(GeometryError, match=said):
        read(tmp_path, draw, units=0)


def test_an_unlikely_size_is_asked_about(tmp_path: Path) -> None:
    (note,) = read(tmp_path, lambda space: space.add_circle((0, 0), 1500), units=6).notes
    assert note == (
        "the drawing is 4243 m across, read in m: is that so? It would be 4.243 m in mm or 107.8 m in in: give the "
        "unit then"
    )
    (note,) = read(tmp_path, lambda space: space.add_circle((0, 0), 1e-3), units=4).notes
    assert note.startswith("the drawing is 2.828e-06 m across, read in mm: is that so?")
