from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
from cad import by_gmsh, read_here

from phantomnode.geometry.curves import Curve, Geometry, arc_centre
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.gmsh_reader import GMSH_LIBRARIES
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.readers import read_geometry, read_quads
from phantomnode.geometry.scripts import cleaned, objection

EXACT = 1e-12
"""Arcs are arcs: a few roundings of the file's decimals (15 digits) and of the conversion to metres."""

CHORD = 1e-6
"""The chord error of free-form curves over the diagonal."""


def drawing(path: Path, draw: Callable[[Any], None], units: int = 4) -> Path:
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = units
    draw(document.modelspace())
    document.saveas(path)
    return path


def check_circle(geometry: Geometry, centre: tuple[float, float], radius: float) -> None:
    (region,) = geometry.regions
    loop = region.outer
    assert np.all(loop.bulges != 0.0)
    assert region.area == pytest.approx(np.pi * radius**2, rel=EXACT)
    centres = arc_centre(loop.points[:-1], loop.points[1:], loop.bulges)
    assert np.allclose(centres, centre, rtol=0.0, atol=EXACT * 10 * np.hypot(*centre))
    assert np.hypot(*(loop.points[:-1] - centres).T) == pytest.approx(radius, rel=10 * EXACT)


CIRCLE = "occ.addCircle(500, 920, 0, 400); occ.addCurveLoop([1], 1); occ.addPlaneSurface([1], 1); occ.synchronize()"
BUILT_IN = """
for k, (x, y) in enumerate([(500, 920), (900, 920), (500, 1320), (100, 920), (500, 520)]):
    geo.addPoint(x, y, 0, 50, k + 1)
for k in range(4): geo.addCircleArc(2 + k, 1, 2 + (k + 1) % 4)
geo.addCurveLoop([1, 2, 3, 4], 1); geo.addPlaneSurface([1], 1); geo.synchronize()
"""
RING = """
occ.addDisk(0, 0, 0, 2, 2); occ.addDisk(0, 0, 0, 1, 1); occ.cut([(2, 1)], [(2, 2)]); occ.synchronize()
bore, rim = sorted((t for _, t in model.getEntities(1)), key=lambda t: model.getBoundingBox(1, t)[3])
model.addPhysicalGroup(1, [rim], name='rim'); model.addPhysicalGroup(1, [bore], name='bore')
model.addPhysicalGroup(2, [1], name='ring'); mesh.setSize(model.getEntities(0), 0.2)
"""


@pytest.mark.parametrize("name", ["c.step", "c.igs", "c.brep", "c.xao"])
def test_a_closed_occ_circle_with_its_single_point_is_two_exact_arcs(tmp_path: Path, name: str) -> None:
    (path,) = by_gmsh(tmp_path, CIRCLE, name)
    geometry = read_geometry(path, None if name in ("c.step", "c.igs") else "mm")
    assert len(geometry.regions[0].outer.bulges) == 2
    check_circle(geometry, (0.5, 0.92), 0.4)


def test_a_circle_of_four_built_in_arcs_is_exact(tmp_path: Path) -> None:
    (path,) = by_gmsh(tmp_path, BUILT_IN, "c.geo_unrolled")
    check_circle(read_geometry(path, "mm"), (0.5, 0.92), 0.4)


def test_a_dxf_circle_is_exact_and_its_unit_is_in_the_file(tmp_path: Path) -> None:
    path = drawing(tmp_path / "c.dxf", lambda space: space.add_circle((500, 920), 400))
    check_circle(read_geometry(path), (0.5, 0.92), 0.4)


SCRIPTED = """Point(1) = {500, 920, 0}; Point(2) = {900, 920, 0}; Point(3) = {500, 1320, 0}; Point(4) = {100, 920, 0};
Point(5) = {500, 520, 0};
Circle(1) = {2, 1, 3}; Circle(2) = {3, 1, 4}; Circle(3) = {4, 1, 5}; Circle(4) = {5, 1, 2};
Curve Loop(1) = {1:4}; Plane Surface(1) = {1};
"""
DRAWN = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 2000 2000"><circle cx="500" cy="1080" r="400"/></svg>'


@pytest.mark.parametrize(
    "name", ["c.dxf", "c.step", "c.geo", "occ.geo", "c.igs", "c.brep", "c.xao", "c.svg", "cut.step"]
)
def test_the_level_set_of_a_circle_is_exact_from_every_format(tmp_path: Path, name: str) -> None:
    path, section = tmp_path / name, None
    if name == "c.dxf":
        drawing(path, lambda space: space.add_circle((500, 920), 400))
    elif name in ("c.geo", "occ.geo", "c.svg"):
        occ = 'SetFactory("OpenCASCADE"); Disk(1) = {500, 920, 0, 400};'
        path.write_text({"c.geo": SCRIPTED, "occ.geo": occ, "c.svg": DRAWN}[name])
    elif name == "cut.step":
        section = ("z", 0.03)
        by_gmsh(tmp_path, "occ.addCylinder(500, 920, 0, 0, 0, 100, 400); occ.synchronize()", name)
    else:
        by_gmsh(tmp_path, CIRCLE, name)
    (region,) = read_geometry(path, "mm", section=section).regions
    places = np.random.default_rng(7).uniform(-1.0, 3.0, (2000, 2))
    found = LevelSet.of_regions([region]).distance(places)
    assert np.abs(found - (0.4 - np.hypot(*(places - [0.5, 0.92]).T))).max() < EXACT


def test_the_content_decides_and_not_the_name(tmp_path: Path) -> None:
    (path,) = by_gmsh(tmp_path, CIRCLE, "c.step")
    check_circle(read_geometry(path.rename(tmp_path / "c.geo")), (0.5, 0.92), 0.4)
    path = drawing(tmp_path / "c.dxf", lambda space: space.add_circle((500, 920), 400))
    check_circle(read_geometry(path.rename(tmp_path / "c.txt")), (0.5, 0.92), 0.4)


@pytest.mark.parametrize("unit", ["in", "m"])
def test_the_unit_argument_goes_before_that_of_the_file_with_a_note(tmp_path: Path, unit: str) -> None:
    (step,) = by_gmsh(tmp_path, CIRCLE, "c.step")
    dxf = drawing(tmp_path / "c.dxf", lambda space: space.add_circle((500, 920), 400))
    factor = {"in": 0.0254, "m": 1.0}[unit]
    for path in (step, dxf):
        geometry = read_geometry(path, unit)
        check_circle(geometry, (500 * factor, 920 * factor), 400 * factor)
        assert geometry.notes[-1] == f"the file says its unit is mm; read as {unit}, as asked"
        assert len(geometry.notes) == (2 if unit == "m" else 1)  # more than a kilometre: is that so?


def test_step_files_in_metres_and_inches_come_out_in_metres(tmp_path: Path) -> None:
    (path,) = by_gmsh(tmp_path, CIRCLE, "c.step")
    text = path.read_text()
    path.write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)"))
    check_circle(read_geometry(path), (500, 920), 400)
    si = "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"
    inch = "( CONVERSION_BASED_UNIT('INCH',#901) LENGTH_UNIT() NAMED_UNIT(#902) );\n"
    inch += "#901 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#903);\n"
    inch += f"#902 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);\n#903 = {si}"
    path.write_text(text.replace(si, inch))
    check_circle(read_geometry(path), (12.7, 23.368), 10.16)


@pytest.mark.parametrize("name", ["r.xao", "r2.msh", "r4.msh"])
def test_physical_groups_name_pieces_and_regions(tmp_path: Path, name: str) -> None:
    version = {"r2.msh": "2.2", "r4.msh": "4.1"}.get(name)
    meshing = f"mesh.generate(2); gmsh.option.setNumber('Mesh.MshFileVersion', {version})" if version else ""
    (path,) = by_gmsh(tmp_path, RING + meshing, name)
    (region,) = read_geometry(path, "m").regions
    assert region.name == "ring" and len(region.holes) == 1
    assert set(region.outer.names) == {"rim"} and set(region.holes[0].names) == {"bore"}
    exact = 3.0 * np.pi
    if version is None:
        assert region.area == pytest.approx(exact, rel=EXACT)
    else:  # inscribed polygons of sides s about 0.2: the area is off by s^2/(6 r^2), and the nodes are on the circles
        assert 0.0 < abs(region.area / exact - 1.0) < 0.2**2 / 6.0
        assert np.hypot(*region.outer.points.T) == pytest.approx(2.0, rel=EXACT)


def test_a_mesh_without_lines_counts_by_the_outer_edges_of_its_faces(tmp_path: Path) -> None:
    only_faces = RING.replace("model.addPhysicalGroup(1", "(lambda *a, **k: 0)(1") + "mesh.generate(2)"
    (path,) = by_gmsh(tmp_path, only_faces, "r.msh")
    (region,) = read_geometry(path, "m").regions
    assert region.name == "ring" and len(region.holes) == 1 and set(region.outer.names) == {""}


def test_a_mesh_of_lines_alone_counts_by_its_lines(tmp_path: Path) -> None:
    (path,) = by_gmsh(tmp_path, RING + "mesh.generate(1); model.removePhysicalGroups([(2, 1)])", "r.msh")
    (region,) = read_geometry(path, "m").regions
    assert len(region.holes) == 1 and set(region.outer.names) == {"rim"}


def test_faces_of_one_name_that_share_a_curve_are_one_region(tmp_path: Path) -> None:
    two = "occ.addRectangle(0,0,0,1,1); occ.addRectangle(1,0,0,1,1)\n"
    two += "occ.fragment([(2,1)],[(2,2)]); occ.synchronize()\n"
    (plain,) = by_gmsh(tmp_path, two, "a.xao")
    geometry = read_geometry(plain, "m")
    assert [region.area for region in geometry.regions] == pytest.approx([2.0], rel=EXACT)
    assert geometry.notes == ("1 unnamed curves between faces of one region were left out",)
    shared = "s = [t for _, t in model.getEntities(1) if len(model.getAdjacencies(1, t)[0]) == 2]\n"
    (named,) = by_gmsh(tmp_path, two + shared + "model.addPhysicalGroup(1, s, name='seam')", "b.xao")
    assert [curve.name for curve in read_geometry(named, "m").curves] == ["seam"]
    (apart,) = by_gmsh(
        tmp_path,
        two + "[model.addPhysicalGroup(2, [t], name='ab'[k]) for k, t in enumerate((1, 2))]",
        "c.xao",
    )
    regions = read_geometry(apart, "m").regions
    assert [region.name for region in regions] == ["a", "b"]
    assert [region.area for region in regions] == pytest.approx([1.0, 1.0], rel=EXACT)


def test_a_curve_embedded_in_a_face_is_a_free_curve(tmp_path: Path) -> None:
    crack = "occ.addRectangle(0,0,0,2,1); p = occ.addPoint(.5,.5,0), occ.addPoint(1.5,.5,0); c = occ.addLine(*p)\n"
    crack += "occ.fragment([(2,1)],[(1,c)]); occ.synchronize()"
    (path,) = by_gmsh(tmp_path, crack, "crack.brep")
    geometry = read_geometry(path, "m")
    assert len(geometry.regions) == 1 and len(geometry.curves) == 1
    assert sorted(geometry.curves[0].points.tolist()) == [[0.5, 0.5], [1.5, 0.5]]


def test_an_ellipse_keeps_the_chord_error_from_every_format(tmp_path: Path) -> None:
    (step, iges) = by_gmsh(
        tmp_path, "occ.addEllipse(0, 0, 0, 300, 100); occ.synchronize()", "e.step", "e.igs"
    )
    dxf = drawing(tmp_path / "e.dxf", lambda space: space.add_ellipse((0, 0), (300, 0), 1 / 3))
    for path in (step, iges, dxf):
        (region,) = read_geometry(path).regions
        points = region.outer.points
        diagonal = np.hypot(0.6, 0.2)
        assert np.hypot(points[:, 0] / 0.3, points[:, 1] / 0.1) == pytest.approx(1.0, rel=1e-9)
        middles = 0.5 * (points[1:] + points[:-1])
        inside = 0.1 * (1.0 - np.hypot(middles[:, 0] / 0.3, middles[:, 1] / 0.1))  # at most the distance
        assert 0.0 < inside.max() <= CHORD * diagonal


def test_every_kind_of_dxf_curve(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_lwpolyline([(0, 0, 0, 0, 1), (2, 0, 0, 0, 0)], close=True, dxfattribs={"layer": "half"})
        space.add_polyline2d([(10, 0, 0), (12, 0, 1), (12, 2, 0), (10, 2, 0)], format="xyb", close=True)
        for start, end in (((20, 0), (21, 0)), ((21, 0), (20, 1)), ((20, 1), (20, 0))):
            space.add_line(start, end)
        space.add_arc((30, 0), 1, 350, 170)
        space.add_spline([(40, 0), (41, 1), (42, 0), (43, 1)])

    geometry = read_geometry(drawing(tmp_path / "k.dxf", draw, units=6))
    areas = sorted(region.area for region in geometry.regions)
    assert areas == pytest.approx([0.5, np.pi / 2, 4 + np.pi / 2], rel=EXACT)
    (half,) = [region for region in geometry.regions if region.outer.name == "half"]
    assert half.outer.bulges.tolist().count(0.0) == 1
    arc, spline = sorted(geometry.curves, key=lambda curve: curve.points[0, 0])
    assert arc.angles.sum() == pytest.approx(np.pi, rel=EXACT) and arc.lengths.sum() == pytest.approx(
        np.pi, rel=EXACT
    )
    assert np.allclose(spline.points[[0, -1]], [[40, 0], [43, 1]], atol=EXACT * 43)


def test_dxf_arcs_drawn_from_below_are_mirrored(tmp_path: Path) -> None:
    below = {"extrusion": (0, 0, -1)}

    def draw(space: Any) -> None:
        space.add_arc((-5, 0), 1, 0, 90, dxfattribs=below)
        space.add_lwpolyline([(-8, 0, 0, 0, 1), (-10, 0, 0, 0, 0)], dxfattribs=below)

    arc, half = sorted(
        read_geometry(drawing(tmp_path / "b.dxf", draw, 6)).curves, key=lambda c: c.points[:, 0].min()
    )
    assert sorted(np.round(arc.points, 12).tolist()) == [[4.0, 0.0], [5.0, 1.0]]
    assert np.allclose(arc_centre(arc.points[0], arc.points[1], arc.bulges[0]), (5, 0), atol=10 * EXACT)
    # In its own system it turns left from (-8, 0) by way of (-9, 1) to (-10, 0).
    assert np.allclose(half.box, [[8, 0], [10, 1]], atol=20 * EXACT)


def test_dxf_blocks_are_expanded_with_their_layers(tmp_path: Path) -> None:
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 6
    block = document.blocks.new("HOLE")
    block.add_circle((0, 0), 1)
    block.add_circle((0, 0), 0.5, dxfattribs={"layer": "own"})
    space = document.modelspace()
    space.add_blockref("HOLE", (10, 0), dxfattribs={"layer": "bolts", "xscale": 2, "yscale": 2})
    space.add_blockref(
        "HOLE", (20, 0), dxfattribs={"row_count": 2, "column_count": 3, "row_spacing": 5, "column_spacing": 5}
    )
    document.saveas(tmp_path / "b.dxf")
    regions = read_geometry(tmp_path / "b.dxf").regions
    assert len(regions) == 7
    assert regions[0].area == pytest.approx(3.0 * np.pi, rel=EXACT)
    assert regions[0].outer.name == "bolts" and regions[0].holes[0].name == "own"


def test_dxf_other_entities_and_hidden_layers_are_noted(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_circle((0, 0), 1)
        space.add_text("hello")
        space.doc.layers.add("off").off()
        space.add_circle((0, 0), 3, dxfattribs={"layer": "off"})

    geometry = read_geometry(drawing(tmp_path / "n.dxf", draw))
    assert len(geometry.regions) == 1
    assert geometry.notes == (
        "layer 'off' is off: 1 CIRCLE on it do not count",
        "left out: 1 TEXT",
    )


def test_curves_at_one_height_are_plane(tmp_path: Path) -> None:
    path = drawing(tmp_path / "z.dxf", lambda space: space.add_circle((1, 2, 7), 1), 6)
    check_circle(read_geometry(path), (1, 2), 1)
    (brep,) = by_gmsh(tmp_path, "occ.addDisk(1, 2, 7, 1, 1); occ.synchronize()", "z.brep")
    check_circle(read_geometry(brep, "m"), (1, 2), 1)


SCRIPT = """// a square
a = 2; For k In {0:1}
  Point(2*k + 1) = {0, a*k, 0}; Point(2*k + 2) = {a, a*k, 0};
EndFor
Line(1) = {1, 2}; Line(2) = {2, 4}; Line(3) = {4, 3}; Line(4) = {3, 1};
Curve Loop(1) = {1:4}; Plane Surface(1) = {1}; Physical Surface("square") = {1}; Printf("done: %g", a);"""


def test_a_script_without_a_last_line_end_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "s.geo"
    path.write_text(SCRIPT)
    for trust in (False, True):
        (region,) = read_geometry(path, "cm", trust_scripts=trust).regions
        assert region.area == pytest.approx(4e-4, rel=EXACT) and region.name == "square"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ('SystemCall "touch hit";', "SystemCall"),
        ('System "touch hit";', "System"),
        ('If(0)\nSystem = 1;\nEndIf\nSystem "touch hit";', "System"),
        ('NonBlockingSystemCall "touch hit";', "NonBlockingSystemCall"),
        ('StringToName["SystemCall"] "touch hit";', "StringToName"),
        ('S2N["SystemCall"] "touch hit";', "S2N"),
        ('// x\rSystemCall "touch hit";', "SystemCall"),
        ('Sys/* */temCall "touch hit";', "Sys"),
        ('OnelabRun("a", "touch hit");', "OnelabRun"),
        ('Field[1] = ExternalProcess; Field[1].CommandLine = "touch hit";', "ExternalProcess"),
        ('Solver.Executable0 = "touch hit";', "Solver"),
        ('Print "hit";', "Print"),
        ('Save "hit.msh";', "Save"),
        ('Printf("a;b") > "hit";', "Printf"),
        ('Printf("x") >> "hit";', "Printf"),
        ('CreateDir "hit";', "CreateDir"),
        ('Include "/etc/passwd";', "Include"),
        ('Merge "other.step";', "Merge"),
        ('a() = ListFromFile("/etc/passwd");', "ListFromFile"),
        ('v() = ShapeFromFile("x.brep");', "ShapeFromFile"),
        ("Exit;", "Exit"),
        ("Abort;", "Abort"),
        ("Plugin(NewView).Run;", "Plugin"),
        ("Whatever 3;", "Whatever"),
        (f"a = \"{'x' * 1023}SystemCall 'touch hit';\";", "string of more than 1000"),
    ],
)
def test_scripts_that_run_read_or_write_are_refused(tmp_path: Path, line: str, named: str) -> None:
    path = tmp_path / "s.geo"
    path.write_text("Point(1) = {0, 0, 0};\n" + line + "\n")
    with pytest.raises(GeometryError, match=f"s.geo: line [2-5]: .*{named}.*--trust-scripts"):
        read_geometry(path, "m")
    assert not list(tmp_path.glob("hit*"))


def test_words_in_comments_and_strings_do_no_harm() -> None:
    text = 'Point(1) = {0, 0, 0, 1e-3}; // Include\n/* SystemCall "x"; \n*/ Physical Point("Merge") = {1};'
    assert objection(cleaned(text)) is None and cleaned(text).count("\n") == text.count("\n") + 1


def written(name: str, text: str | bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def cut_short(name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (path,) = by_gmsh(folder, RING + "mesh.generate(1)", name)
        path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
        return path

    return write


def drawn(draw: Callable[[Any], Any], units: int = 4) -> Callable[[Path], Path]:
    return lambda folder: drawing(folder / "d.dxf", draw, units)


def box(folder: Path) -> Path:
    return by_gmsh(folder, "occ.addBox(0, 0, 0, 1, 1, 1); occ.synchronize()", "box.step")[0]


def bow_tie(space: Any) -> None:
    space.add_lwpolyline([(0, 0), (2000, 2000), (2000, 0), (0, 2000)], close=True)


def nested(folder: Path) -> Path:
    document = ezdxf.new("R2010")
    document.blocks.new("B0").add_line((0, 0), (1, 0))
    for k in range(1, 12):
        inner = document.blocks.new(f"B{k}")
        for _ in range(10):
            inner.add_blockref(f"B{k - 1}", (0, 0))
    document.modelspace().add_blockref("B11", (0, 0))
    document.saveas(folder / "n.dxf")
    return folder / "n.dxf"


@pytest.mark.parametrize(
    ("make", "unit", "message"),
    [
        (lambda folder: folder / "none.dxf", "m", "none.dxf: no such file"),
        (lambda folder: folder, "m", "is a folder"),
        (written("e.step", ""), "m", "e.step: the file is empty"),
        (written("e.dxf", " \n"), "m", "empty"),
        (written("x.geo", "hello world"), "m", "no known kind"),
        (written("x.bin", bytes(range(256))), "m", "no known kind"),
        (written("v.pos", '// results\n// of a run\nView "u" {\n};'), "m", "post-processing view"),
        (written("x.stl", "solid a\nendsolid a"), "m", "STL"),
        (written("x.dwg", b"AC1032\0\0"), "m", "DWG"),
        (written("x.pdf", "%PDF-1.4"), "m", "PDF"),
        (written("x.zip", b"PK\x03\x04abc"), "m", "archive"),
        (written("s.geo", SCRIPT), None, "does not say in which unit"),
        (written("s.geo", SCRIPT), "mn", "unknown unit of length 'mn'; did you mean"),
        (written("s.geo", "Point(1) = {0, 0, 0};\n"), "m", "holds no curves"),
        (written("s.geo", "Point(1) = {0, 0, 0};\nLine(1) = {1, 7};\n"), "m", "gmsh cannot read it"),
        (
            written("m.msh", "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\nx\n$EndNodes\n$EndElements\n"),
            "m",
            "m.msh: ",
        ),
        (
            written("b.step", "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=X(;\nEND-ISO-10303-21;\n"),
            "mm",
            "b.step: ",
        ),
        (cut_short("t.step"), "m", "end of this STEP file is missing"),
        (cut_short("t.igs"), "m", "end of this IGES file is missing"),
        (cut_short("t.brep"), "m", "end of this BREP file is missing"),
        (cut_short("t.xao"), "m", "end of this XAO file is missing"),
        (cut_short("t.msh"), "m", "end of this gmsh mesh file is missing"),
        (box, None, "3D part"),
        (drawn(lambda s: s.add_line((0, 0, 0), (1, 0, 5))), None, "3D drawing"),
        (drawn(lambda s: s.add_3dface([(0, 0), (1, 0), (1, 1)])), None, "3D drawing"),
        (
            drawn(lambda s: s.add_arc((0, 0), 1, 0, 90, dxfattribs={"extrusion": (1, 0, 0)})),
            None,
            "3D drawing",
        ),
        (drawn(lambda s: s.add_text("x")), None, "holds no curves .it holds 1 TEXT"),
        (drawn(lambda s: None), None, "nothing at all"),
        (drawn(lambda s: s.add_circle((0, 0), 1), units=0), None, "does not say in which unit"),
        (drawn(lambda s: s.add_line((1, 1), (1, 1))), None, "holds no curves .it holds 1 LINE of no length"),
        (drawn(bow_tie), None, r"d.dxf: an outline crosses.* itself at \(1000, 1000\) mm: LWPOLYLINE"),
        (
            written("t.dxf", "0\nSECTION\n2\nENTITIES\n0\nLINE\n8\n0\n10\n0\n"),
            "m",
            "end of this DXF file is missing",
        ),
        (nested, "m", "entities with its blocks expanded"),
    ],
)
def test_bad_files_are_refused(
    tmp_path: Path, make: Callable[[Path], Path], unit: str | None, message: str
) -> None:
    with pytest.raises(GeometryError, match=message):
        read_geometry(make(tmp_path), unit)


def test_damaged_drawings_give_geometry_or_a_message_and_never_anything_else(tmp_path: Path) -> None:
    def draw(space: Any) -> None:
        space.add_lwpolyline([(20, 0, 0, 0, 1), (30, 0, 0, 0, 0), (30, 5, 0, 0, 0)], close=True)
        space.add_spline([(40, 0), (41, 1), (42, 0)])
        space.add_polyline2d([(90, 0), (92, 0), (92, 2)], close=True)
        space.doc.blocks.new("X").add_circle((0, 0), 1)
        space.add_blockref("X", (100, 0))

    lines = drawing(tmp_path / "d.dxf", draw).read_text().split("\n")
    start, random = lines.index("ENTITIES"), np.random.default_rng(8)
    outcomes: set[type] = set()
    for _ in range(150):
        damaged = list(lines)
        damaged[random.integers(start, len(lines) - 10)] = random.choice(
            ["0", "-1", "1e308", "nan", "", "abc", "999"]
        )
        (tmp_path / "d.dxf").write_text("\n".join(damaged))
        try:
            outcomes.add(type(read_here(tmp_path / "d.dxf")))
        except GeometryError:
            outcomes.add(GeometryError)
    assert outcomes == {Geometry, GeometryError}


def test_a_script_that_never_ends_is_stopped(tmp_path: Path) -> None:
    path = written("l.geo", "For k In {1:1e9}\n a = k;\nEndFor\n")(tmp_path)
    with pytest.raises(GeometryError, match="more than 2 s"):
        read_geometry(path, "m", time_limit=2.0)


def test_a_trusted_script_that_exits_is_told_from_a_result(tmp_path: Path) -> None:
    path = written("x.geo", SCRIPT + "\nExit;\n")(tmp_path)
    with pytest.raises(GeometryError, match="calls Exit"):
        read_geometry(path, "m", trust_scripts=True)


def test_missing_system_libraries_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gmsh.py").write_text("raise OSError('libGLU.so.1: cannot open shared object file')")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    path = written("s.geo", SCRIPT)(tmp_path)
    with pytest.raises(GeometryError, match="libGLU.so.1.*apt-get install libglu1-mesa"):
        read_geometry(path, "m")
    assert "libfontconfig1" in GMSH_LIBRARIES


def test_a_side_file_next_to_the_file_is_not_executed(tmp_path: Path) -> None:
    (path,) = by_gmsh(tmp_path, CIRCLE, "c.step")
    (tmp_path / "c.step.opt").write_text(f'SystemCall "touch {tmp_path}/hit";\n')
    check_circle(read_geometry(path), (0.5, 0.92), 0.4)
    assert not (tmp_path / "hit").exists()


QUADS = "occ.addRectangle(0,0,0,2,1); occ.synchronize(); mesh.setSize(model.getEntities(0), .25)\n"
QUADS += (
    "gmsh.option.setNumber('Mesh.RecombineAll', 1); gmsh.option.setNumber('Mesh.SubdivisionAlgorithm', 1)\n"
)


def test_a_quad_mesh_is_a_background_grid(tmp_path: Path) -> None:
    (path,) = by_gmsh(tmp_path, QUADS + "mesh.generate(2); mesh.reverse([(2, 1)])", "q.msh")
    grid = read_quads(path, "mm")
    assert grid.shape is None and np.all(grid.areas > 0.0)
    assert grid.areas.sum() == pytest.approx(2e-6, rel=EXACT)
    assert np.array_equal(np.unique(grid.quads), np.arange(len(grid.xy)))


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_cells_in_two_physical_groups_are_there_once(tmp_path: Path, version: float) -> None:
    groups = "for name in 'ab': model.addPhysicalGroup(2, [1], name=name)\n"
    groups += f"gmsh.option.setNumber('Mesh.MshFileVersion', {version})"
    (path,) = by_gmsh(tmp_path, QUADS + "mesh.generate(2)\n" + groups, "q.msh")
    assert read_quads(path, "m").areas.sum() == pytest.approx(2.0, rel=EXACT)
    (region,) = read_geometry(path, "m").regions
    assert region.area == pytest.approx(2.0, rel=EXACT)


def quads_file(body: str, name: str = "q.msh") -> Callable[[Path], Path]:
    return lambda folder: by_gmsh(folder, body, name)[0]


@pytest.mark.parametrize(
    ("make", "unit", "message"),
    [
        (quads_file(QUADS + "gmsh.option.setNumber('Mesh.RecombineAll', 0)\n"
                    "gmsh.option.setNumber('Mesh.SubdivisionAlgorithm', 0)\n"
                    "mesh.generate(2)"), "m", "Triangle 3 elements"),
        (quads_file(QUADS + "mesh.generate(2); mesh.setOrder(2)"), "m", "Quadrilateral 9 elements"),
        (quads_file(QUADS + "mesh.generate(1)"), "m", "no quadrilaterals"),
        (quads_file(QUADS + "mesh.generate(2)"), None, "does not say in which unit"),
        (quads_file(CIRCLE, "c.step"), "m", "this is a STEP file"),
        (quads_file("occ.addBox(0,0,0,1,1,1); occ.synchronize(); mesh.generate(3)"), "m", "3D"),
        (written("f.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n"
                 "1 0 0 0\n2 1 0 0\n3 .2 .2 0\n4 0 1 0\n$EndNodes\n"
                 "$Elements\n1\n1 3 2 1 1 1 2 3 4\n$EndElements\n"), "m", "1 cells are folded or flat"),
    ],
)  # fmt: skip
def test_bad_quad_meshes_are_refused(
    tmp_path: Path, make: Callable[[Path], Path], unit: str | None, message: str
) -> None:
    with pytest.raises(GeometryError, match=message):
        read_quads(make(tmp_path), unit)


def test_the_geometry_of_the_ring_impact_reads_as_the_paper_says() -> None:
    folder = Path(__file__).parents[1] / "cases" / "ring_impact"
    (ring,) = read_geometry(folder / "ring.dxf").regions
    assert ring.area == pytest.approx(np.pi * (0.4**2 - 0.3**2), rel=EXACT)
    assert np.allclose(ring.box, [[0.1, 0.52], [0.9, 1.32]], rtol=EXACT)
    assert (ring.outer.name, ring.holes[0].name) == ("outer", "inner")
    (obstacle,) = read_geometry(folder / "obstacle.step").regions
    assert obstacle.box.tolist() == [[0.0, 0.0], [1.0, 0.5]] and obstacle.area == 0.5
    assert isinstance(obstacle.outer, Curve) and not np.any(obstacle.outer.bulges)
