"""Bad input: each fault has its own message, exit code 2, and nothing is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import ezdxf
import pytest

from phantomnode.pipeline import cli, console

CASE = """
time = { end = 1e-3 }
material.soft = { E = 1e9, nu = 0.3, rho = 1000.0 }

[body.part]
geometry = { polygon = { points = [[0.0, 0.3], [0.4, 0.3], [0.4, 0.6], [0.0, 0.6]] } }
grid = { kind = "cartesian", cell = 0.05 }
material = "soft"

[body.floor]
geometry = { rectangle = { low = [-0.5, 0.0], high = [1.0, 0.25] } }
grid = { kind = "cartesian", cell = 0.05, aligned = true }
material = "soft"

[contact.landing]
slave = "part.outer"
master = "floor.top"

[boundary.base]
on = "floor.bottom"
displacement = { x = 0.0, y = 0.0 }
"""


def text(name: str, content: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(content)


def drawing(*lines: tuple, unit: int = 6, height: float = 0.0) -> Callable[[Path], None]:
    """A DXF of straight lines between points, in metres."""

    def write(folder: Path) -> None:
        document = ezdxf.new(units=unit)
        for a, b in lines:
            document.modelspace().add_line((*a, 0.0), (*b, height))
        document.saveas(folder / "part.dxf")

    return write


def chain(*points: tuple[float, float]) -> list[tuple]:
    return list(zip(points, [*points[1:], points[0]], strict=True))


FROM_DXF = 'body.part.geometry={file="part.dxf"}'
BOW_TIE = chain((0, 0.3), (0.4, 0.6), (0.4, 0.3), (0, 0.6))
SQUARE = chain((0, 0.3), (0.4, 0.3), (0.4, 0.6), (0, 0.6))


def nothing(folder: Path) -> None:
    """No file beside the case."""


# name: (files beside the case, overrides, what the message says)
FAULTS: dict[str, tuple[Callable[[Path], None], list[str], str]] = {
    "missing file": (nothing, [FROM_DXF], "there is no such file"),
    "folder for a file": (lambda f: (f / "part.dxf").mkdir(), [FROM_DXF], "part.dxf"),
    "empty file": (text("part.dxf", ""), [FROM_DXF], "empty"),
    "unknown content": (text("part.dxf", "hello, this is prose\n"), [FROM_DXF], "part.dxf"),
    "damaged file": (text("part.dxf", "  0\nSECTION\n  2\nHEADER\n  9\n"), [FROM_DXF], "part.dxf"),
    "open contour": (drawing(*SQUARE[:3]), [FROM_DXF], "closed outline"),
    "self-crossing contour": (drawing(*BOW_TIE), [FROM_DXF], "cross"),
    "no unit": (drawing(*SQUARE, unit=0), [FROM_DXF], "unit"),
    "unknown unit": (drawing(*SQUARE), ['body.part.geometry={file="part.dxf", unit="furlong"}'], "furlong"),
    "3D drawing": (drawing(*SQUARE, height=0.2), [FROM_DXF], "3D"),
    "3D part": (
        text("part.geo", 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\n'),
        ['body.part.geometry={file="part.geo", unit="m"}'],
        "3D",
    ),
    "script that runs a command": (
        text("part.geo", 'SystemCall "touch fired";\nPoint(1) = {0, 0, 0};\n'),
        ['body.part.geometry={file="part.geo", unit="m"}'],
        "SystemCall",
    ),
    "unknown region": (drawing(*SQUARE), ['body.part.geometry={file="part.dxf", region="lid"}'], "lid"),
    "unknown key": (nothing, ["body.part.materiel='soft'"], "did you mean 'material'"),
    "unknown table": (nothing, ["contacts.a.slave='x'"], "contact"),
    "wrong type": (nothing, ["time.end='soon'"], "time.end"),
    "negative density": (nothing, ["material.soft.rho=-1.0"], "material.soft.rho"),
    "nu = 0.5": (nothing, ["material.soft.nu=0.5"], "incompressible"),
    "negative modulus": (nothing, ["material.soft.E=-1.0"], "material.soft.E"),
    "negative end": (nothing, ["time.end=-1.0"], "time.end"),
    "unknown material": (nothing, ["body.part.material='steel'"], "steel"),
    "unknown grid": (nothing, ["body.part.grid='coarse'"], "coarse"),
    "no cells in the body": (
        nothing,
        ["body.part.grid={kind='cartesian', cell=0.05, box=[[5.0, 5.0], [6.0, 6.0]]}"],
        "no cell",
    ),
    "body beyond its grid": (
        nothing,
        ["body.part.grid={kind='cartesian', cell=0.05, box=[[0.1, 0.2], [1.0, 1.0]]}"],
        "reaches beyond its background grid",
    ),
    "too many cells": (nothing, ["body.part.grid.cell=1e-7"], "cells"),
    "overlapping bodies at the start": (
        nothing,
        ["body.part.geometry.move=[0.0, -0.1]"],
        "overlap at the start",
    ),
    "unstable step": (nothing, ["time.step=1e-3"], "unstable"),
    "contact with an unknown body": (nothing, ["contact.landing.master='flor.top'"], "flor"),
    "contact with an unknown part": (
        nothing,
        ["contact.landing.master='floor.topp'"],
        'did you mean "floor.top"',
    ),
    "boundary through cells": (
        nothing,
        ["body.part.grid.cell=0.07", "boundary.base.on='part.bottom'", "boundary.base.weak=false"],
        "inside of cells",
    ),
    "box without nodes": (
        nothing,
        ["boundary.base.on={body='floor', box=[[7.0, 7.0], [8.0, 8.0]]}"],
        "no node of floor lies in the box",
    ),
    "nodes held twice": (
        nothing,
        ["boundary.again={on='floor.bottom', velocity={y=0.0}}"],
        "already moved",
    ),
    "side without a straight line": (
        nothing,
        ["body.part.geometry.rotate=5.0", "contact.landing.slave='part.bottom'"],
        "no straight line",
    ),
    "side of a boundary without a straight line": (
        nothing,
        ["body.part.geometry.rotate=5.0", "boundary.hold={on='part.bottom', displacement={y=0.0}}"],
        'the nodes there are { body = "part", box = [[',
    ),
    "surface held twice": (
        nothing,
        [
            "body.part.grid.cell=0.07",
            "boundary.a={on='part.bottom', displacement={y=0.0}}",
            "boundary.b={on='part.outer', velocity={y=0.0}}",
        ],
        "already held in y by boundary.a",
    ),
    "two kinds of boundary": (nothing, ["boundary.base.pressure=1.0"], "exactly one of displacement"),
    "load on a box": (
        nothing,
        ["boundary.p={on={body='part', box=[[0.0, 0.0], [1.0, 1.0]]}, pressure=1e5}"],
        "acts on a surface",
    ),
    "traction that follows": (
        nothing,
        ["boundary.p={on='part.outer', traction={x=1.0}, follower=true}"],
        "follower belongs to a pressure",
    ),
    "springs for a load": (
        nothing,
        ["boundary.p={on='part.outer', pressure=1.0, weak=true}"],
        "weak belongs to a displacement",
    ),
    "penalty of a strong support": (
        nothing,
        ["boundary.base.penalty={value=1e12}"],
        "add weak = true",
    ),
    "penalty without springs": (
        nothing,
        ["boundary.base.penalty='auto'", "boundary.base.weak=false"],
        "leave out weak = false",
    ),
    "penalty of no kind": (nothing, ["boundary.base.penalty={value=-1.0}"], "penalty.value = -1.0"),
    "pressure that is not finite": (
        nothing,
        ["boundary.p={on='part.outer', pressure='1/t'}"],
        "boundary.p.pressure",
    ),
    "traction without a direction": (
        nothing,
        ["boundary.p={on='part.outer', traction={}}"],
        "x or y or both",
    ),
    "gravity that is not finite": (nothing, ["gravity=[0.0, 'log(t)']"], "gravity.1"),
    "gravity of one number": (nothing, ["gravity=9.81"], "gravity = 9.81"),
    "expression with an unknown name": (nothing, ["boundary.base.displacement={y='2*tt'}"], "tt"),
    "expression that is not finite": (nothing, ["boundary.base.displacement={y='log(t)'}"], "finite"),
    "displacement that jumps": (nothing, ["boundary.base.displacement={y=0.1}"], "t = 0"),
    "interface outside the body": (
        nothing,
        [
            "interface.slit={body='part', geometry={polyline={points=[[5.0, 5.0], [6.0, 6.0]]}}}",
            "contact.landing.slave='slit.plus'",
        ],
        "nothing is left",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_fault(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, overrides, said = FAULTS[name]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE)
    files(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert cli.run("case.toml", set_=tuple(overrides)) == console.INPUT_AT_FAULT
    message = capsys.readouterr().err
    assert said in " ".join(message.split()), message
    assert "Traceback" not in message
    assert sorted(tmp_path.rglob("*")) == before  # no results folder, nothing fired


def test_the_case_itself_is_sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The faults above are the only ones: without them the case runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE)
    assert cli.run("case.toml", set_=("time.end=1e-4",)) == console.DONE


def test_every_fault_has_a_message_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    messages = set()
    for files, overrides, _ in FAULTS.values():
        folder = tmp_path / f"case{len(messages)}"
        folder.mkdir()
        (folder / "case.toml").write_text(CASE)
        files(folder)
        cli.run(str(folder), set_=tuple(overrides))
        messages.add(capsys.readouterr().err.replace(str(folder), ""))
    assert len(messages) == len(FAULTS)
