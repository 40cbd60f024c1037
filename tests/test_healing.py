"""Drawings that need a hand: what is mended, what is told about it, and what is not mended."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest

from phantomnode.geometry.curves import Curve, Geometry
from phantomnode.geometry.errors import OutlineError
from phantomnode.geometry.loops import assemble
from phantomnode.geometry.readers import read_geometry
from phantomnode.geometry.shapes import circle, rectangle

EXACT = 1e-12


def line(*points: tuple[float, float], name: str = "") -> Curve:
    return Curve(np.array(points, dtype=float), np.zeros(len(points) - 1), (name,) * (len(points) - 1))


def arc(a: tuple[float, float], b: tuple[float, float], bulge: float) -> Curve:
    return Curve(np.array([a, b], dtype=float), np.array([bulge]))


def mended(*pieces: Curve) -> Geometry:
    return assemble(pieces, [f"entity {k}" for k in range(len(pieces))])


def kinds(geometry: Geometry) -> list[str]:
    return [finding.kind for finding in geometry.findings]


def test_a_gap_is_told_with_its_width_its_place_and_both_entities() -> None:
    geometry = mended(line((0, 0), (3, 0)), line((3, 0), (3, 4)), line((3, 4.0003), (0, 0)))
    (gap,) = geometry.findings
    assert gap.kind == "gap" and gap.size == pytest.approx(3e-4) and gap.at == pytest.approx((3, 4.00015))
    assert gap.entities == ("entity 1", "entity 2")
    assert gap.told("mm") == "0.3 mm wide at (3000, 4000.15) mm: entity 1 and entity 2"
    assert geometry.regions[0].area == pytest.approx(6.0, rel=1e-3)


def test_gaps_are_closed_where_three_ends_meet_as_well() -> None:
    outline = [
        line((0, 0), (2, 0)),
        line((2, 1e-5), (2, 1)),
        line((2, 1), (0, 1), (0, 0)),
        line((2, -1e-5), (3, -1)),
    ]
    geometry = mended(*outline)
    assert [region.area for region in geometry.regions] == pytest.approx([2.0], rel=1e-4)
    assert kinds(geometry) == ["gap", "gap"]


def test_the_distance_to_join_can_be_given() -> None:
    pieces = [line((0, 0), (3, 0), (3, 4)), line((3, 3.9), (0, 0.05), (0, 0.02))]
    assert not assemble(pieces).regions
    assert len(assemble(pieces, gap=0.15).regions) == 1


def test_lines_over_the_lines_of_a_chain_are_taken_once() -> None:
    chain = line((0, 0), (1, 0), (1, 1), (0, 1))
    geometry = mended(chain, line((1, 1), (1, 0)), line((0, 1), (0, 0)), line((0, 0), (0, 1)))
    assert [region.area for region in geometry.regions] == [1.0] and not geometry.curves
    assert [(f.kind, f.entities) for f in geometry.findings] == [
        ("twice", ("entity 1",)),
        ("twice", ("entity 3",)),
    ]


def test_an_outline_drawn_twice_by_different_entities_is_taken_once() -> None:
    sides = [line(a, b) for a, b in (((0, 0), (1, 0)), ((1, 0), (1, 1)), ((1, 1), (0, 1)), ((0, 1), (0, 0)))]
    geometry = mended(
        rectangle((0, 0), (1, 1)).outer, *sides, circle((5, 5), 1).outer, circle((5, 5), 1).outer
    )
    assert [region.area for region in geometry.regions] == pytest.approx([1.0, np.pi])
    assert kinds(geometry) == ["twice", "twice"] and not geometry.curves


def test_a_tail_at_a_corner_does_not_open_the_outline() -> None:
    geometry = mended(line((0, 0), (1, 0), (1, 1), (0, 0)), line((1, 1), (2, 2), name="tail"))
    assert [region.area for region in geometry.regions] == [0.5]
    assert [curve.name for curve in geometry.curves] == ["tail"]
    geometry = mended(line((0, 0), (1, 0)), line((1, 0), (1, 1)), line((1, 1), (0, 0)), line((1, 1), (2, 2)))
    assert [region.area for region in geometry.regions] == [0.5] and not geometry.findings


def test_lines_that_divide_an_outline_stay_curves_within_its_outer_boundary() -> None:
    """Three by three squares of single lines, each from crossing to crossing."""
    along = [line((x, y), (x + 1, y)) for x in range(3) for y in range(4)]
    up = [line((x, y), (x, y + 1)) for x in range(4) for y in range(3)]
    geometry = mended(*along, *up, circle((1.5, 1.5), 0.25).outer)
    (region,) = geometry.regions
    assert region.area == pytest.approx(9.0 - np.pi / 16.0, rel=EXACT) and len(region.holes) == 1
    assert sum(curve.lengths.sum() for curve in geometry.curves) == pytest.approx(12.0, rel=EXACT)
    assert kinds(geometry) == ["branch"]


def test_an_end_on_a_line_or_on_an_arc_closes_an_outline() -> None:
    base, arch = line((-3, 0), (3, 0), name="base"), arc((1, 0), (-1, 0), 1.0)
    chord = line((-np.sqrt(0.75), 0.5), (np.sqrt(0.75), 0.5))
    geometry = mended(base, arch, chord)
    (region,) = geometry.regions
    assert region.area == pytest.approx(np.pi / 2, rel=EXACT)
    assert region.outer.names.count("base") == 1
    assert sorted(round(float(c.lengths.sum()), 9) for c in geometry.curves) == [1.732050808, 2.0, 2.0]


def test_two_ends_on_one_piece_cut_it_in_three() -> None:
    """A line and an arc, each with a bridge between two points on it, given in either order."""
    for flip in (False, True):
        ends = [(1.0, 0.0), (4.0, 0.0)]
        bridge = line(*(ends[::-1] if flip else ends)[:1], (2.5, 1.0), *(ends[::-1] if flip else ends)[1:])
        geometry = mended(line((0, 0), (5, 0)), bridge)
        assert [region.area for region in geometry.regions] == pytest.approx([1.5], rel=EXACT)
        angles = np.radians([30.0, 120.0] if flip else [120.0, 30.0])
        a, b = (tuple(np.array([np.cos(t), np.sin(t)])) for t in angles)
        geometry = mended(arc((1, 0), (-1, 0), 1.0), line(a, b))
        segment = 0.5 * (np.pi / 2 - 1.0)
        assert [region.area for region in geometry.regions] == pytest.approx([segment], rel=EXACT)


def test_open_curves_that_enclose_nothing_stay_as_they_are() -> None:
    cross = [line((-1, 0), (1, 0)), line((0, 0), (0, 1)), line((5, 5), (6, 6))]
    geometry = mended(*cross)
    assert not geometry.regions and not geometry.findings
    assert [c.points.tolist() for c in geometry.curves] == [c.points.tolist() for c in cross]


def test_open_curves_that_cross_midway_make_no_outline() -> None:
    hash_sign = [line((0, 1), (3, 1)), line((0, 2), (3, 2)), line((1, 0), (1, 3)), line((2, 0), (2, 3))]
    assert not mended(*hash_sign).regions


def test_outlines_that_cross_leave_the_others_alone_but_not_their_own_holes() -> None:
    crossing = [rectangle((0, 0), (2, 2)).outer, rectangle((1, 1), (3, 3)).outer]
    hole, around, apart = (rectangle((a, a), (b, b)).outer for a, b in ((0.1, 0.5), (-1, 4), (10, 11)))
    geometry = mended(*crossing, hole, apart)
    assert [region.area for region in geometry.regions] == [1.0] and len(geometry.curves) == 3
    assert [(f.kind, f.entities) for f in geometry.wrong] == [("crossing", ("entity 0", "entity 1"))]
    assert not mended(*crossing, around).regions  # what is material in it cannot be told


def crossing_layers(space: Any) -> None:
    space.add_lwpolyline([(0, 0), (20, 0), (20, 20), (0, 20)], close=True, dxfattribs={"layer": "part"})
    space.add_lwpolyline([(10, 10), (30, 10), (30, 30), (10, 30)], close=True, dxfattribs={"layer": "clamp"})


def test_a_drawing_of_crossing_outlines_is_refused_with_the_place_and_drawn_by_layer(tmp_path: Path) -> None:
    document = ezdxf.new("R2010", units=4)
    crossing_layers(document.modelspace())
    document.saveas(tmp_path / "d.dxf")
    with pytest.raises(
        OutlineError, match=r"d.dxf: two outlines cross.* at \(10, 20\) mm: LWPOLYLINE .*'part'"
    ) as told:
        read_geometry(tmp_path / "d.dxf")
    assert len(told.value.geometry.curves) == 2
    (region,) = read_geometry(tmp_path / "d.dxf", layers=["part"]).regions
    assert region.area == pytest.approx(4e-4, rel=EXACT)


def test_what_was_mended_is_in_the_notes_in_the_unit_of_the_file(tmp_path: Path) -> None:
    document = ezdxf.new("R2010", units=4)
    space = document.modelspace()
    corners = [(0, 0), (30, 0), (30, 40.001), (30, 40), (0, 0)]
    for a, b in ((0, 1), (1, 2), (3, 4), (3, 4)):
        space.add_line(corners[a], corners[b], dxfattribs={"layer": "cut"})
    document.saveas(tmp_path / "d.dxf")
    twice, gap = read_geometry(tmp_path / "d.dxf").notes
    assert twice.startswith("1 curves drawn twice were taken once (at (30, 40) mm: LINE ")
    assert gap.startswith(
        "1 gaps between ends of curves were closed (0.001 mm wide at (30, 40.0005) mm: LINE "
    )
    assert gap.endswith(" on layer 'cut')")
