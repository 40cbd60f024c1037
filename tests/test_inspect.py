"""``phantomnode inspect`` and ``phantomnode new --from``, and the picture of a case that is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest

from phantomnode.geometry.readers import read_geometry
from phantomnode.pipeline import cad_picture, cli, cli_files, console
from phantomnode.pipeline.bodies import cut_body
from phantomnode.pipeline.case import load_case
from phantomnode.pipeline.closing import meeting_time
from phantomnode.pipeline.drawings import Drawings
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.gaps import initial_gaps
from phantomnode.pipeline.prepare import prepare


def drawing(path: Path, draw: Callable[[Any], None], units: int = 4) -> Path:
    document = ezdxf.new("R2010", units=units)
    draw(document.modelspace())
    document.saveas(path)
    return path


def two_parts(space: Any) -> None:
    plate, bolt = {"layer": "Plate 1"}, {"layer": "bolt"}
    space.add_lwpolyline([(0, 0), (80, 0), (80, 30), (0, 30)], close=True, dxfattribs=plate)
    space.add_circle((20, 15), 5, dxfattribs=plate)
    space.add_circle((110, 15), 10, dxfattribs=bolt)
    space.add_line((40, -5), (40, 35), dxfattribs={"layer": "axis"})
    space.add_text("M8", dxfattribs={"layer": "notes"})


def crossing(space: Any) -> None:
    space.add_lwpolyline([(0, 0), (20, 0), (20, 20), (0, 20)], close=True, dxfattribs={"layer": "part"})
    space.add_lwpolyline([(10, 10), (30, 10), (30, 30), (10, 30)], close=True, dxfattribs={"layer": "clamp"})


def inspected(capsys: pytest.CaptureFixture[str], *arguments: Any, **options: Any) -> str:
    assert cli_files.inspect(*arguments, **options) == console.DONE
    return " ".join(capsys.readouterr().out.split())


def is_png(path: Path) -> bool:
    return path.read_bytes().startswith(b"\x89PNG")


def test_inspect_prints_and_draws_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    said = inspected(capsys, drawing(tmp_path / "two.dxf", two_parts))
    for part in (
        "unit mm, size 120 x 40 mm (0.12 x 0.04 m)",
        "2 regions with 1 hole, 1 other curve",
        "Plate 1 1 CIRCLE, 1 LWPOLYLINE",
        "1 Plate 1 2321.4602 80 x 30 (0, 0) 10.1 1 4 2 boundary, outer, inner, bottom, right, top, left, Plate 1",
        "2 bolt 314.15927 20 x 20 (100, 5) 20 0 0 2 boundary, outer, bolt",
        "1 axis 40 (40, -5) (40, 35)",
        "note left out: 1 TEXT",
        "picture results/inspect/two.dxf.png",
    ):
        assert part in said, part
    assert is_png(tmp_path / "results" / "inspect" / "two.dxf.png")


def test_inspect_needs_no_unit_and_tells_every_mend_and_every_problem(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")

    def draw(space: Any) -> None:
        crossing(space)
        for k in range(5):
            for a, b in (((0, 0), (1, 0)), ((1, 1e-4), (1, 1)), ((1, 1), (0, 0))):
                space.add_line((a[0], a[1] + 50 + 3 * k), (b[0], b[1] + 50 + 3 * k))

    file = drawing(tmp_path / "d.dxf", draw, units=0)
    said = inspected(capsys, file, out=tmp_path / "p.png")
    assert "no unit is said" in said and "area, units^2" in said and "is that so?" not in said
    assert "mended 5 gaps between ends of curves were closed" in said
    assert said.count("0.0001 units wide at (1, ") == 5 and "0.0001 units apart were joined" in said
    assert "problem 1 two outlines cross or share a stretch at (10, 20) units: LWPOLYLINE" in said
    assert "5 regions" in inspected(capsys, file, out=tmp_path / "p.png", unit="mm", layer=("0",))
    assert is_png(tmp_path / "p.png")


def test_inspect_of_a_file_that_cannot_be_read_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.dxf").write_text("hello")
    assert cli_files.inspect(tmp_path / "x.dxf") == console.INPUT_AT_FAULT
    assert "no known kind" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("units", "size", "label"), [(6, 0.168, "m"), (4, 5000.0, "mm"), (0, 0.168, "units of the file")]
)
def test_the_axes_of_the_picture_have_the_numbers_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, units: int, size: float, label: str
) -> None:
    """A small drawing in metres, a large one in millimetres, one without a unit."""
    kept = []
    monkeypatch.setattr(cad_picture, "save", lambda figure, path: kept.append(figure))
    corners = [(0, 0), (size, 0), (size, size)]
    file = drawing(tmp_path / "a.dxf", lambda space: space.add_lwpolyline(corners, close=True), units)
    assert cli_files.inspect(file, out=tmp_path / "a.png") == console.DONE
    kept[0].draw_without_rendering()
    axes = kept[0].axes[0]
    assert axes.get_xlabel() == f"x, {label}"
    labels = [float(text.get_text().replace("\N{MINUS SIGN}", "-")) for text in axes.get_xticklabels()]
    assert labels == pytest.approx(list(axes.get_xticks()), rel=1e-3, abs=1e-9)


def test_a_case_for_a_drawing_has_its_names_and_can_be_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = drawing(tmp_path / "two.dxf", two_parts)
    assert cli_files.new("mine", from_=file) == console.DONE
    text = (tmp_path / "mine" / "case.toml").read_text()
    assert (
        "# plate_1: 0.08 x 0.03 m; parts: boundary, outer, inner, bottom, right, top, left, Plate 1" in text
    )
    assert (
        "cell = 0.0025 }  # m; 4 through the thinnest wall, 0.01 m\n" in text
    )  # beside the hole of the plate
    assert "cell = 0.0025 }  # m; 8 through the thinnest wall, 0.02 m\n" in text and "ms of fall, and" in text
    case = load_case("mine", ())
    assert list(case.body) == ["plate_1", "bolt"] and list(case.contact) == [
        "plate_1_on_floor",
        "bolt_on_floor",
    ]
    for name, area in (("plate_1", 2400 - 25 * np.pi), ("bolt", 100 * np.pi)):
        mesh = cut_body(case, name, Drawings(case)).mesh
        # Arcs are cut by straight lines within a cell of a quarter of the radius: h^2/(6 R^2) of the circle is lost.
        assert mesh.area.sum() == pytest.approx(1e-6 * area, rel=1.1e-2)
    assert cli_files.new("mine", from_=file) == console.INPUT_AT_FAULT  # is left as it is


def test_regions_far_above_each_other_are_remarked_and_all_of_them_land(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end is rounded up: every pair meets before it, however long the fall of the highest region is."""
    monkeypatch.chdir(tmp_path)

    def column(space: Any) -> None:
        for height in (0, 30, 171):
            space.add_lwpolyline([(0, height), (20, height), (20, height + 20), (0, height + 20)], close=True)

    assert cli_files.new("high", from_=drawing(tmp_path / "c.dxf", column)) == console.DONE
    assert "The regions lie far above each other" in (tmp_path / "high" / "case.toml").read_text()
    prepared = prepare(load_case("high", ()))
    gaps = initial_gaps(prepared)
    meets = [meeting_time(prepared, number, gap) for number, gap in enumerate(gaps) if gap is not None]
    assert len(meets) == 3 and 0.017 < max(meets) < prepared.case.time.end
    assert cli_files.new("side", from_=drawing(tmp_path / "t.dxf", two_parts)) == console.DONE
    assert "far above" not in (tmp_path / "side" / "case.toml").read_text()


def test_a_case_takes_layers_and_unit_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = drawing(tmp_path / "d.dxf", crossing, units=0)
    assert cli_files.new("a", from_=file, unit="mm") == console.INPUT_AT_FAULT  # outlines cross
    assert cli_files.new("a", from_=file, layer=("part",)) == console.INPUT_AT_FAULT  # no unit
    assert cli_files.new("a", from_=file, unit="mm", layer=("part",)) == console.DONE
    geometry = load_case("a", ()).body["part"].geometry
    assert (geometry.unit, geometry.layers, geometry.region) == ("mm", ("part",), None)


def test_a_case_needs_an_outline(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = drawing(tmp_path / "l.dxf", lambda space: space.add_line((0, 0), (3, 4)))
    assert cli_files.new(str(tmp_path / "n"), from_=file) == console.INPUT_AT_FAULT
    where = "the longest ends at (0, 0) and (3, 4) mm, 5 mm apart: join the ends in the drawing"
    assert where in capsys.readouterr().err and not (tmp_path / "n").exists()
    assert f"problem there is no closed outline, and a body needs one; 1 open curves were found; {where}" in (
        inspected(capsys, file)
    )


CASE = """
time = { end = 1e-4 }
material.steel = { E = 210e9, nu = 0.3, rho = 7800.0 }
[body.part]
geometry = { file = "d.dxf" }
grid = { kind = "cartesian", cell = 0.002 }
material = "steel"
"""


@pytest.mark.parametrize(
    ("draw", "said"),
    [
        (crossing, r"body.part.geometry: two outlines cross or share a stretch at (10, 20) mm: LWPOLYLINE"),
        (lambda space: space.add_arc((0, 0), 5, 0, 90), "there is no closed outline"),
    ],
)
def test_check_draws_where_an_outline_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], draw: Callable[[Any], None], said: str
) -> None:
    drawing(tmp_path / "d.dxf", draw)
    (tmp_path / "case.toml").write_text(CASE)
    assert cli.check(str(tmp_path), out=tmp_path / "out") == console.INPUT_AT_FAULT
    message = capsys.readouterr().err
    assert said in message.replace(f"{tmp_path / 'd.dxf'}: ", "") and "drawn in" in message
    assert is_png(tmp_path / "out" / "problem.png")


def test_check_draws_where_bodies_overlap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A disc, 1 mm deep in a floor; between the middles of its segments a little less."""
    drawing(tmp_path / "d.dxf", lambda space: space.add_circle((0, 9), 10))
    obstacle = (
        "[rigid.floor]\ngeometry = { polyline = { points = [[-0.02, 0.0], [0.02, 0.0]] } }\nside = 'right'\n"
    )
    contact = "[contact.c]\nslave = 'part.outer'\nmaster = 'floor'\n"
    (tmp_path / "case.toml").write_text(CASE + obstacle + contact)
    assert cli.check(str(tmp_path), out=tmp_path / "out") == console.INPUT_AT_FAULT
    message = capsys.readouterr().err
    assert "part.outer and floor overlap at the start by 0.0009" in message and "problem.png" in message
    assert is_png(tmp_path / "out" / "problem.png")


def test_check_draws_where_a_variant_overlaps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawing(tmp_path / "d.dxf", lambda space: space.add_circle((0, 11), 10))
    obstacle = (
        "[rigid.floor]\ngeometry = { polyline = { points = [[-0.02, 0.0], [0.02, 0.0]] } }\nside = 'right'\n"
    )
    contact = "[contact.c]\nslave = 'part.outer'\nmaster = 'floor'\n"
    deep = "[variant.deep.body.part.geometry]\nmove = [0.0, -0.002]\n"
    (tmp_path / "case.toml").write_text(CASE + obstacle + contact + deep)
    assert cli.check(str(tmp_path), out=tmp_path / "out") == console.INPUT_AT_FAULT
    message = capsys.readouterr().err
    assert "variant.deep: contact.c: part.outer and floor overlap" in message and "problem.png" in message
    assert is_png(tmp_path / "out" / "problem.png")


@pytest.mark.parametrize(
    ("region", "area"), [("2", 100 * np.pi), ('"bolt"', 100 * np.pi), ("1", 2400 - 25 * np.pi)]
)
def test_a_region_is_taken_by_number_or_by_the_layer_of_its_outline(
    tmp_path: Path, region: str, area: float
) -> None:
    drawing(tmp_path / "d.dxf", two_parts)
    (tmp_path / "case.toml").write_text(CASE)
    case = load_case(str(tmp_path), (f"body.part.geometry.region={region}",))
    assert sum(r.area for r in cut_body(case, "part", Drawings(case)).regions) == pytest.approx(
        1e-6 * area, rel=1e-12
    )


@pytest.mark.parametrize(
    ("region", "said"), [("3", "there is no region 3; there are 2"), ('"nut"', "Plate 1, bolt")]
)
def test_a_region_that_is_not_there_is_answered_with_those_that_are(
    tmp_path: Path, region: str, said: str
) -> None:
    drawing(tmp_path / "d.dxf", two_parts)
    (tmp_path / "case.toml").write_text(CASE)
    with pytest.raises(ValueError, match=said):
        prepare(load_case(str(tmp_path), (f"body.part.geometry.region={region}",)))


def test_reading_is_given_up_after_the_time_that_was_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A hundredth of a second is less than a process needs to start."""
    monkeypatch.chdir(tmp_path)
    file = drawing(tmp_path / "d.dxf", two_parts)
    assert cli_files.inspect(file, time_limit=0.01) == console.INPUT_AT_FAULT
    assert "took more than 0.01 s" in capsys.readouterr().err
    for wrong in ("inf", "0", "nan"):
        with pytest.raises(SystemExit) as left:
            cli.app(["inspect", str(file), "--time-limit", wrong])
        assert left.value.code == console.INPUT_AT_FAULT and "Traceback" not in capsys.readouterr().err
    assert cli_files.new("n", from_=file, time_limit=60.0) == console.DONE
    case = load_case("n", ())
    assert {body.geometry.time_limit for body in case.body.values()} == {60.0}
    with pytest.raises(
        CaseError, match=r"body\.plate_1\.geometry: .*d\.dxf: reading it took more than 0\.01 s"
    ):
        prepare(load_case("n", ("body.plate_1.geometry.time_limit=0.01",)))


def test_the_regions_of_a_drawing_keep_their_numbers(tmp_path: Path) -> None:
    file = drawing(tmp_path / "d.dxf", two_parts)
    names = [[region.outer.name for region in read_geometry(file).regions] for _ in range(2)]
    assert names == [["Plate 1", "bolt"]] * 2
