from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import mutants
import numpy as np
import pytest
from cad import by_gmsh

from phantomnode.geometry import child, readers, wire
from phantomnode.geometry.curves import Contents, Curve, Geometry, Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.readers import read_geometry

SEED = 7
SQUARE = """Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Point(3) = {1, 1, 0}; Point(4) = {0, 1, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1}; Curve Loop(1) = {1:4}; Plane Surface(1) = {1};
"""
MESH = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
CANARIES = {
    "system.geo": 'SystemCall "touch HIT";',
    "renamed.step": 'SystemCall "touch HIT";',
    "include.geo": 'Include "FOLDER/other.geo";',
    "printf.geo": 'Printf("x") > "HIT";',
    "onelab.geo": 'OnelabRun("x", "touch HIT");',
    "merge.geo": 'Merge "FOLDER/other.geo";',
    "mesh.msh": MESH + ';\nSystemCall "touch HIT";\n$EndElements\n',
    "blank.msh": "\n" + MESH + ';\nSystemCall "touch HIT";\n$EndElements\n',
    "mark.msh": "\ufeff" + MESH + ';\nSystemCall "touch HIT";\n$EndElements\n',
    "shape.brep": 'DBRep_DrawableShape\n;SystemCall "touch HIT";\n//TShapes\n\n+1 0\n',
    "xao.xao": '/*<XAO*/\nSystemCall "touch HIT";\n//</XAO>\n',
}


def canary(folder: Path, name: str) -> tuple[Path, Path]:
    """A file that would write another one, and that other one."""
    hit = folder / "hit"
    (folder / "other.geo").write_text(f'SystemCall "touch {hit}";\n')
    command = CANARIES[name].replace("HIT", str(hit)).replace("FOLDER", str(folder))
    (folder / name).write_text(command + "\n" if command[0] in "\n$\ufeffD/" else SQUARE + command + "\n")
    return folder / name, hit


@pytest.mark.parametrize("name", CANARIES)
def test_canaries_never_fire(tmp_path: Path, name: str) -> None:
    path, hit = canary(tmp_path, name)
    with pytest.raises(GeometryError):
        read_geometry(path, "m")
    assert not hit.exists()


@pytest.mark.parametrize("name", ["system.geo", "renamed.step", "include.geo", "printf.geo", "merge.geo"])
def test_the_canaries_are_alive(tmp_path: Path, name: str) -> None:
    path, hit = canary(tmp_path, name)
    read_geometry(path, "m", trust_scripts=True)
    assert hit.exists()


def test_a_side_file_next_to_the_file_is_not_executed(tmp_path: Path) -> None:
    (path,) = by_gmsh(tmp_path, "occ.addDisk(0, 0, 0, 1, 1); occ.synchronize()", "c.step")
    (tmp_path / "c.step.opt").write_text(f'SystemCall "touch {tmp_path}/hit";\n')
    assert read_geometry(path).regions and not (tmp_path / "hit").exists()


def change_the_child(folder: Path, monkeypatch: pytest.MonkeyPatch, change: str) -> None:
    """Let every Python process that starts from here on begin with a change."""
    (folder / "sitecustomize.py").write_text(change)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))


@pytest.mark.skipif(os.name != "posix", reason="limits of processes are POSIX")
def test_what_slips_past_the_check_of_scripts_can_still_not_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, hit = canary(tmp_path, "printf.geo")
    change_the_child(
        tmp_path, monkeypatch, "import phantomnode.geometry.reading as r; r.objection = lambda text: None"
    )
    assert read_geometry(path, "m").regions
    assert not hit.exists() or hit.stat().st_size == 0


@pytest.mark.skipif(os.name != "posix", reason="limits of processes are POSIX")
def test_a_file_that_needs_too_much_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "m.geo"
    path.write_text(SQUARE + "l() = {0:1e8};\n")
    change_the_child(
        tmp_path, monkeypatch, "import phantomnode.geometry.limits as l; l.ADDRESS_SPACE = 1 << 30"
    )
    with pytest.raises(GeometryError, match="memory"):
        read_geometry(path, "m")


def test_a_mesh_that_begins_with_blanks_or_a_mark_is_read(tmp_path: Path) -> None:
    (path,) = by_gmsh(
        tmp_path, "occ.addRectangle(0, 0, 0, 1, 1); occ.synchronize(); mesh.generate(2)", "m.msh"
    )
    content = path.read_bytes()
    for before in (b"\n \n", b"\xef\xbb\xbf"):
        path.write_bytes(before + content)
        assert read_geometry(path, "m").regions[0].area == pytest.approx(1.0, rel=1e-12)


def test_a_name_of_another_encoding_is_told(tmp_path: Path) -> None:
    square = (
        "occ.addRectangle(0, 0, 0, 1, 1); occ.synchronize(); model.addPhysicalGroup(2, [1], name='Traeger')\n"
    )
    (path,) = by_gmsh(tmp_path, square + "mesh.generate(2)", "m.msh")
    path.write_bytes(path.read_bytes().replace(b"Traeger", "Träger".encode("latin-1")))
    with pytest.raises(GeometryError, match="a name or word in it is not UTF-8"):
        read_geometry(path, "m")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes in the file system are POSIX")
def test_pipes_and_huge_files_are_refused_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe.step")
    with pytest.raises(GeometryError, match="pipe.step: is no ordinary file"):
        read_geometry(tmp_path / "pipe.step", "m")
    with open(tmp_path / "huge.step", "wb") as file:
        file.truncate(readers.MOST_BYTES + 1)  # a hole: nothing is written
    with pytest.raises(GeometryError, match="has more than 1024 MB"):
        read_geometry(tmp_path / "huge.step", "m")


SLOW = {
    "comments.dxf": "999\n\n\n\n\n" * 400 + "x",  # many ways to split blank lines
    "ends.geo": "a = 1\n" * 200_000,  # no statement ends
    "comments.geo": "/*" * 200_000,  # no comment ends
    "braces.geo": SQUARE + "a~{" * 100_000,  # no list ends
    "global.igs": f"{'1H,,1H;' + ',' * 65:72s}S      1\n" + f"{',' * 72}G      1\n" * 20_000,
    "entities.step": "ISO-10303-21;\n" + "#1=" * 200_000 + "\nEND-ISO-10303-21;",
}


def test_other_text_is_told_from_a_script_at_once(tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_text(SLOW["ends.geo"])
    with pytest.raises(GeometryError, match="of no known kind"):
        read_geometry(tmp_path / "x.txt", "m")


@pytest.mark.parametrize("name", SLOW)
def test_content_that_patterns_are_slow_on_is_given_up_in_time(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(SLOW[name])
    start = time.monotonic()
    with pytest.raises(GeometryError):
        read_geometry(tmp_path / name, "m", time_limit=3.0)
    assert time.monotonic() - start < 3.0 + mutants.SLACK


def test_geometry_goes_through_json_to_the_bit() -> None:
    outer = Curve(np.array([[0.1, 0.0], [1.0 / 3.0, 0.0], [0.0, 1e-300], [0.1, 0.0]]), np.array([0.0, 0.3, -0.0]),
                  ("a", "", "b"), "loop")  # fmt: skip
    geometry = Geometry((Region(outer, (), "r"),), (outer,), ("note",), "mm", ())
    back = wire.decoded(child.json.loads(child.json.dumps(wire.encoded(geometry))))
    assert wire.encoded(back) == wire.encoded(geometry)
    assert np.array_equal(back.curves[0].points, outer.points) and back.curves[0].points.dtype == np.float64
    assert back.regions[0].name == "r" and back.notes == ("note",) and Contents.__name__ in wire._CLASSES


def test_mutants_end_as_every_file_must() -> None:
    found = mutants.outcomes(16, SEED)
    assert not [o for o in found if not mutants.good(o)]
    assert {o.what for o in found} >= {"regions", "refused"}


@pytest.mark.slow
def test_two_thousand_mutants_end_as_every_file_must() -> None:
    # As a program, in a process of its own: it reads in forks of itself.
    root = Path(__file__).parents[1]
    ended = subprocess.run(
        [sys.executable, "-m", "tests.mutants", "2000", str(SEED)], cwd=root, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
