from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cad import by_gmsh

from phantomnode.geometry.curves import Region, arc_centre
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.planes import Plane, extruded_along
from phantomnode.geometry.readers import read_geometry
from phantomnode.pipeline import cli_files
from phantomnode.pipeline.bodies import cut_body
from phantomnode.pipeline.case import CaseError, case_from_table, load_case
from phantomnode.pipeline.drawings import Drawings

EXACT = 1e-12
"""Some roundings of 15 digits: lines and arcs stay lines and arcs."""

BRACKET = """
occ.addBox(0, 0, 0, 40, 20, 10, 1); occ.addCylinder(10, 10, 0, 0, 0, 10, 4, 2); occ.cut([(3, 1)], [(3, 2)])
occ.synchronize()
def at(*box): return [t for _, t in model.getEntitiesInBoundingBox(*box, 2)]
top, right = at(-1, -1, 9, 41, 21, 11), at(39, -1, -1, 41, 21, 11)
model.addPhysicalGroup(2, top, name='top'); model.addPhysicalGroup(2, right, name='right')
model.addPhysicalGroup(2, top + right, name='both'); model.addPhysicalGroup(3, [1], name='bracket')
"""
HOLED = 40 * 20 - np.pi * 4**2


def bracket(folder: Path, name: str = "b.xao", more: str = "") -> Path:
    return by_gmsh(folder, BRACKET + more, name)[0]


def one(path: Path, **choice: Any) -> tuple[Region, Sequence[str]]:
    geometry = read_geometry(path, "mm", **choice)
    (region,) = geometry.regions
    return region, geometry.notes


@pytest.mark.parametrize("suffix", ["step", "brep", "xao"])
def test_a_3d_part_says_what_can_be_taken_of_it(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(GeometryError) as refusal:
        read_geometry(bracket(tmp_path, f"b.{suffix}"), "mm")
    message = str(refusal.value)
    assert "3D part (solids: 1, faces: 7)" in message
    assert 'section = { axis = "z", at = 0.005 } (the middle of what is extruded along z)' in message
    assert ("'top' (z = 0.01 m, 0.04 x 0.02 m)" in message) == (suffix == "xao")
    assert message.count(" = ") == 6 + 4  # the six flat faces; face, section and its two keys


def test_a_section_of_an_extrusion_is_its_outline_with_exact_arcs(tmp_path: Path) -> None:
    region, notes = one(bracket(tmp_path), section=("z", 0.003))
    assert region.area == pytest.approx(HOLED * 1e-6, rel=EXACT, abs=0.0)
    (hole,) = region.holes
    centres = arc_centre(hole.points[:-1], hole.points[1:], hole.bulges)
    assert np.allclose(centres, 0.01, rtol=0.0, atol=EXACT * 0.04) and not notes
    assert region.name == "bracket" and set(region.outer.names) == {"", "right"}


@pytest.mark.parametrize(
    ("section", "box", "parts"),
    [
        (("y", 0.01), [[0.0, 0.0], [0.006, 0.01]], 2),  # through the bore, in (x, z)
        (("x", 0.03), [[0.0, 0.0], [0.02, 0.01]], 1),  # beside it, in (y, z)
        (("z", 0.0), [[0.0, 0.0], [0.04, 0.02]], 1),  # in the plane of the lower face
    ],
)
def test_sections_are_seen_from_the_right_the_front_and_above(
    tmp_path: Path, section: tuple[str, float], box: list[list[float]], parts: int
) -> None:
    regions = read_geometry(bracket(tmp_path), "mm", section=section).regions
    assert len(regions) == parts
    boxes = sorted(region.box.tolist() for region in regions)
    assert np.allclose(boxes[0], box, rtol=0.0, atol=EXACT)


def test_a_face_is_taken_by_its_name_or_number(tmp_path: Path) -> None:
    path = bracket(tmp_path)
    top, notes = one(path, face="top")
    assert top.area == pytest.approx(HOLED * 1e-6, rel=EXACT, abs=0.0) and len(top.holes) == 1 and not notes
    right, notes = one(path, face="right")
    assert np.allclose(right.box, [[0.0, 0.0], [0.02, 0.01]], rtol=0.0, atol=EXACT)
    assert notes == ("the outline lies in x = 0.04 m; its x and y are (y, z)",)
    with pytest.raises(GeometryError) as refusal:
        read_geometry(path, "mm")
    number = re.search(r"(\d+) 'top'", str(refusal.value))
    assert number and one(path, face=int(number[1]))[0].box.tolist() == top.box.tolist()


def test_a_face_of_a_3d_mesh_is_taken_by_its_name(tmp_path: Path) -> None:
    size = "mesh.setSize(model.getEntities(0), 5); mesh.generate(3)"
    path = bracket(tmp_path, "b.msh", size)
    region, _ = one(path, face="right")
    assert region.area == pytest.approx(200e-6, rel=EXACT, abs=0.0) and region.name == "right"
    with pytest.raises(GeometryError, match="3D mesh.*its faces are .*'right'"):
        read_geometry(path, "mm")


TILTED = """
occ.addDisk(0, 0, 0, 3, 3, 1); occ.addDisk(1, 0, 0, 1, 1, 2); occ.cut([(2, 1)], [(2, 2)])
occ.rotate([(2, 1)], 0, 0, 0, 1, 2, 0, 0.7); occ.translate([(2, 1)], 1, 2, 3); occ.synchronize()
"""


@pytest.mark.parametrize("suffix", ["step", "igs", "brep"])
def test_an_oblique_outline_is_read_in_its_own_coordinates(tmp_path: Path, suffix: str) -> None:
    region, notes = one(by_gmsh(tmp_path, TILTED, f"t.{suffix}")[0])
    # OCC writes oblique circles into IGES as splines of ten digits: these are flattened.
    accuracy = 1e-6 if suffix == "igs" else EXACT
    assert region.area == pytest.approx(8 * np.pi * 1e-6, rel=accuracy, abs=0.0)
    (note,) = notes
    assert "the plane with normal (" in note and "its x and y are distances along (" in note


def test_a_dome_on_a_plane_outline_is_3d(tmp_path: Path) -> None:
    dome = "occ.addSphere(0, 0, 0, 1, 1, 0); occ.synchronize(); occ.remove([(3, 1)])\n"
    dome += "flat = [(2, t) for _, t in model.getEntities(2) if model.getType(2, t) == 'Plane']\n"
    dome += "occ.remove(flat); occ.synchronize()"
    with pytest.raises(GeometryError, match="3D part .solids: 0, faces: 1"):
        read_geometry(by_gmsh(tmp_path, dome, "d.brep")[0], "mm")


def test_faces_that_enclose_a_part_are_cut_without_a_solid(tmp_path: Path) -> None:
    path = bracket(tmp_path, "b.brep", "occ.remove([(3, 1)]); occ.synchronize()")
    region, _ = one(path, section=("z", 0.003))
    assert region.area == pytest.approx(HOLED * 1e-6, rel=EXACT, abs=0.0) and len(region.holes) == 1


BUILT_IN = """Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Point(3) = {0, 1, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 1}; Curve Loop(1) = {1:3}; Plane Surface(1) = {1};
Extrude {0, 0, 1} { Surface{1}; }
"""


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"section": ("z", 1.0)}, r"the section misses the part, which reaches from -?[\d.e-]+ to 0.01 m"),
        ({"face": "left"}, "no face is 'left' among the 7 faces: take a flat face"),
        ({"face": 99}, "no face is 99"),
        ({"face": 7}, r"face 7 is not flat \(Cylinder\)"),
        ({"face": "both"}, "the faces named 'both' .* do not lie in one plane"),
    ],
)
def test_what_cannot_be_taken_is_said(tmp_path: Path, choice: dict[str, Any], message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        read_geometry(bracket(tmp_path), "mm", **choice)


def test_solids_of_the_built_in_kernel_have_faces_and_no_section(tmp_path: Path) -> None:
    path = tmp_path / "b.geo"
    path.write_text(BUILT_IN)
    assert one(path, face=1)[0].area == pytest.approx(0.5e-6, rel=EXACT, abs=0.0)
    with pytest.raises(GeometryError, match='SetFactory."OpenCASCADE".; at the head'):
        read_geometry(path, "mm", section=("z", 5e-4))


def case_of(**geometry: Any) -> dict[str, Any]:
    return {
        "time": {"end": 1e-6},
        "material": {"steel": {"E": 1e9, "nu": 0.3, "rho": 1e3}},
        "body": {"part": {"geometry": geometry, "grid": {"kind": "cartesian", "cell": 0.004}, "material": "steel"}},
    }  # fmt: skip


def test_a_case_takes_a_section_or_a_face(tmp_path: Path) -> None:
    bracket(tmp_path)
    for choice in ({"section": {"axis": "z", "at": 0.005}}, {"face": "top"}):
        case = case_from_table(case_of(file="b.xao", unit="mm", **choice), tmp_path)
        # The cut follows arcs by straight lines from edge to edge of the cells: off by s^2/(6 r^2) of the hole.
        assert cut_body(case, "part", Drawings(case)).mesh.area.sum() == pytest.approx(HOLED * 1e-6, rel=0.02)


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ({"file": "b.step", "face": 1, "section": {"axis": "z", "at": 0.0}}, "face and section are both given"),
        ({"circle": {"centre": [0, 0], "radius": 1.0}, "face": 1}, "face belongs to a file"),
        ({"file": "b.step", "face": 0}, "face = 0: must be at least 1"),
        ({"file": "b.step", "section": {"axis": "w", "at": 0.0}}, "section.axis"),
        ({"file": "b.step", "section": {"axis": "z"}}, "section.at"),
    ],
)  # fmt: skip
def test_bad_choices_are_refused_before_the_file_is_read(geometry: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        case_from_table(case_of(**geometry))


def test_planes_across_axes_keep_coordinates_to_the_bit() -> None:
    points = np.random.default_rng(7).uniform(-1e3, 1e3, (20, 3))
    for axis, kept in (("x", [1, 2]), ("y", [0, 2]), ("z", [0, 1])):
        flat = points.copy()
        flat[:, "xyz".index(axis)] = 0.1
        plane = Plane.through(flat)
        assert plane is not None and np.array_equal(plane.project(flat), points[:, kept])
        assert plane.words(1e-3) == f"{axis} = 0.0001 m"
    assert Plane.through(points) is None
    for wrong in (np.nan, np.inf, 1e13):
        with pytest.raises(GeometryError, match="beyond 1e.12 or no number"):
            Plane.through(np.vstack([points, [0.0, 0.0, wrong]]))


def test_an_oblique_plane_keeps_lengths_and_stands_upright() -> None:
    random = np.random.default_rng(8)
    for _ in range(20):
        frame = np.linalg.qr(random.normal(size=(3, 3)))[0]
        points = random.uniform(-1, 1, (30, 2)) @ frame[:2] + 5.0 * frame[2]
        plane = Plane.through(points)
        assert plane is not None and plane.frame[1, 2] > 0.0
        flat = plane.project(points)
        assert np.hypot(*(flat[1:] - flat[:-1]).T) == pytest.approx(
            np.linalg.norm(points[1:] - points[:-1], axis=1), rel=EXACT
        )
        assert abs(plane.offset) == pytest.approx(5.0, rel=EXACT, abs=0.0)


def test_only_an_extrusion_is_called_one() -> None:
    ring = np.array([[0, 0], [1, 0], [1, 1], [0, 0]], float)
    low, high = np.insert(ring, 1, 0.0, axis=1), np.insert(ring, 1, 2.0, axis=1)
    upright = [np.array([a, b]) for a, b in zip(low, high, strict=True)]
    assert extruded_along([low, high, *upright]) == "y"
    assert extruded_along([low, high + [0.1, 0, 0], *upright[:1]]) == "y"
    assert extruded_along([low, high, np.array([low[0], high[1]])]) is None
    assert extruded_along([low, 0.5 * (low + high), high, *upright]) is None


def test_inspect_and_new_take_a_section_or_a_face(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bracket(tmp_path)
    for flags in ({"section": "z=5e-3"}, {"face": "top"}):
        assert cli_files.inspect(path, unit="mm", out=tmp_path / "b.png", **flags) == 0
        assert "0.04 x 0.02 m" in capsys.readouterr().out
    choices = {"section": ({"section": "z=5e-3"}, 'section = { axis = "z", at = 0.005 }'),
               "face": ({"face": "top"}, 'face = "top"'), "number": ({"face": "6"}, "face = 6")}  # fmt: skip
    for name, (flags, written) in choices.items():
        assert cli_files.new(str(tmp_path / name), from_=path, unit="mm", **flags) == 0
        assert written in (tmp_path / name / "case.toml").read_text()
        assert load_case(tmp_path / name).body


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ({"section": "5"}, "--section 5: must be an axis and a place"),
        ({"section": "z=1..2"}, "--section z=1..2: must be an axis"),
        ({"section": "z=0", "face": "1"}, "--face and --section are both given"),
    ],
)
def test_bad_flags_are_refused(
    flags: dict[str, str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli_files.inspect(Path("b.step"), **flags) == 2
    assert message in " ".join(capsys.readouterr().err.split())
