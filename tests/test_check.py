"""``check``: what it says of a case, and what its picture shows."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from matplotlib.collections import PolyCollection

from phantomnode.geometry.curves import SIDES
from phantomnode.pipeline import check_picture
from phantomnode.pipeline.case import case_from_table, load_case
from phantomnode.pipeline.closing import meeting_time
from phantomnode.pipeline.drawing import moment
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.gaps import initial_gaps
from phantomnode.pipeline.preflight import _bytes, element_place, estimated_disk, step_place, text_report
from phantomnode.pipeline.prepare import Prepared, prepare
from phantomnode.pipeline.run import run


def two_blocks(gap: float, **contact: Any) -> dict[str, Any]:
    """A block above a slanted floor under its left corner, so far apart."""
    box = {"kind": "cartesian", "cell": 0.1}
    return {
        "time": {"end": 1e-3},
        "material": {"soft": {"E": 1e7, "nu": 0.3, "rho": 1000.0}},
        "body": {
            "block": {
                "geometry": {"rectangle": {"low": [0.0, gap], "high": [0.5, 0.5 + gap]}},
                "grid": box,
                "material": "soft",
            },
            "floor": {
                "geometry": {"polygon": {"points": [[-1, 0], [-1, -1], [1, -1], [1, -0.5], [0, 0]]}},
                "grid": box,
                "material": "soft",
            },
        },
        "contact": {"fall": {"slave": "block.bottom", "master": "floor.outer", **contact}},
        "boundary": {
            "base": {"on": "floor.bottom", "displacement": {"y": 0.0}},
            "push": {"on": "block.top", "pressure": 1e3},
        },
    }


@pytest.fixture(scope="module")
def apart() -> Prepared:
    return prepare(case_from_table(two_blocks(0.03)))


def test_the_gap_at_the_start_is_between_the_nearest_places(apart: Prepared) -> None:
    (gap,) = initial_gaps(apart)
    assert gap is not None
    # From the block's corner (0, 0.03) to the floor's, both nodes or relocated: rounding to the lattice.
    assert gap.distance == pytest.approx(0.03, rel=1e-6)
    np.testing.assert_allclose(gap.slave, [0.0, 0.03], atol=1e-7)
    np.testing.assert_allclose(gap.master, [0.0, 0.0], atol=1e-7)


def test_an_overlap_that_is_taken_as_zero_is_a_negative_gap() -> None:
    (gap,) = initial_gaps(prepare(case_from_table(two_blocks(-0.02, overlap="offset"))))
    # The deepest is the Gauss point next to the corner, square to the slope of 1 : 2 below it.
    x = 0.1 * (0.5 - 1.0 / np.sqrt(12.0))
    assert gap is not None and gap.distance == pytest.approx(-(0.02 - 0.5 * x) * 2.0 / np.sqrt(5.0), rel=1e-6)


def test_self_contact_has_no_gap() -> None:
    table = two_blocks(0.03)
    table["contact"] = {"own": {"slave": "block.outer", "master": "block.outer"}}
    assert initial_gaps(prepare(case_from_table(table))) == [None]


def test_the_report_names_gap_place_and_disk(apart: Prepared) -> None:
    text = text_report(apart)
    x, y = step_place(apart)
    for words in ("gap, m", "0.03", f"({x:.4g}, {y:.4g}) m", "disk", "for 6 frames and two checkpoints"):
        assert words in " ".join(text.split())


def test_the_disk_that_a_run_takes_is_foreseen(tmp_path: Path) -> None:
    """To a quarter: the docstring promises a fifth of the frames, and a small run is also its pictures."""
    few = ("body.block.grid.counts=[40,20]", "time.step='auto'", "time.end=0.01", "output.fields.count=40")
    case = load_case("wavy_block", few)
    run(case, tmp_path / "out")
    taken = sum(file.stat().st_size for file in (tmp_path / "out").rglob("*") if file.is_file())
    assert estimated_disk(prepare(case)) == pytest.approx(taken, rel=0.25)


def thin_plate(cell: float) -> str:
    """What ``check`` says of a plate of 0.1 m."""
    table = two_blocks(0.03)
    table["body"]["block"]["geometry"] = {"rectangle": {"low": [0.0, 0.03], "high": [1.5, 0.13]}}
    table["body"]["block"]["grid"] = {"kind": "cartesian", "cell": cell}
    return " ".join(text_report(prepare(case_from_table(table))).split())


def test_few_cells_through_a_wall_are_told_and_what_would_be_enough() -> None:
    warned = "body block: 1.2 cells go through its thinnest wall, 0.1 m; 4 bend right (cell = 0.025)"
    assert warned in thin_plate(0.08)
    finer = thin_plate(0.04)
    assert "warning body block" not in finer and "cells through it 2.5" in finer


@pytest.mark.parametrize(
    ("size", "text"),
    [(10.0, "0.01 kB"), (3.21e6, "3.2 MB"), (54.6e6, "55 MB"), (1.2e9, "1.2 GB"), (5e12, "5 TB")],
)
def test_sizes_are_readable(size: float, text: str) -> None:
    assert _bytes(size) == text


@pytest.mark.parametrize("fine", [0, check_picture.FINE])
def test_the_picture_names_what_it_shows(apart: Prepared, monkeypatch, fine: int) -> None:
    """Cells one by one, and (as of millions of cells) without: the same names, far fewer shapes."""
    kept = []
    monkeypatch.setattr(check_picture, "FINE", fine)
    monkeypatch.setattr(check_picture, "save", lambda figure, path: kept.append(figure))
    check_picture.draw_preview(apart, Path("preview.png"))
    (figure,) = kept
    figure.draw_without_rendering()
    everything, *close = figure.axes
    assert {text.get_text() for text in everything.texts} >= {"block", "floor", "a", "b"}
    (legend,) = figure.legends
    assert {text.get_text() for text in legend.get_texts()} == {
        "fall: master floor.outer (whole outline)",
        "fall: slave block.bottom, gap 30 mm",
        "fall: where the two are nearest",
        "base: y held (21 nodes)",
        "push: load (12 nodes)",
        "uncut cells, a colour a body",
        "cut cells",
        "real nodes (right)",
        "phantom nodes (right)",
    }
    least = min(float(body.mesh.fraction.min()) for body in apart.bodies)
    titles = [axes.get_title() for axes in close]
    assert titles == [
        f"a: smallest fragment, {least:.3g} of its cell",
        f"b: sets the step, {apart.estimate.dt:.3g} s",
    ]
    drawn = sum(
        len(shape.get_paths()) for shape in everything.collections if isinstance(shape, PolyCollection)
    )
    triangles = sum(len(body.mesh.triangles) for body in apart.bodies)
    uncut = sum(int((~body.mesh.cut).sum()) for body in apart.bodies)
    assert drawn == (triangles + uncut if fine else 0)


def test_what_sets_the_step_is_marked_on_its_material(apart: Prepared) -> None:
    """Not beside it, where a cut cell has none: the middle of its triangles, by brute force."""
    for body in apart.bodies:
        mesh = body.mesh
        for element in np.flatnonzero(mesh.cut):
            own = [shapely.Polygon(t) for t in mesh.triangles[mesh.triangle_element == element]]
            whole = shapely.union_all(own)
            np.testing.assert_allclose(element_place(mesh, int(element)), whole.centroid.coords[0], atol=1e-9)


@pytest.mark.parametrize(
    ("speed", "paired", "warned"), [(-10.0, False, True), (-10.0, True, False), (0.0, False, False)]
)
def test_bodies_that_may_meet_without_a_contact_are_told(speed: float, paired: bool, warned: bool) -> None:
    """One above the other, which falls; each box as wide as the other."""

    def body(low: float, velocity: float) -> dict[str, object]:
        square = {"rectangle": {"low": [0.0, low], "high": [1.0, low + 1.0]}}
        grid = {"kind": "cartesian", "cell": 0.25}
        return {"geometry": square, "grid": grid, "material": "soft", "initial_velocity": [0.0, velocity]}

    table = {
        "time": {"end": 0.2},
        "material": {"soft": {"E": 1e6, "nu": 0.3, "rho": 1e3}},
        "body": {"upper": body(1.5, speed), "lower": body(0.0, 0.0)},
    }
    if paired:
        table["contact"] = {"landing": {"slave": "upper.bottom", "master": "lower.top"}}
    told = any("upper and lower may meet" in warning for warning in prepare(case_from_table(table)).warnings)
    assert told == warned


@pytest.mark.parametrize(
    ("speeds", "meets"),
    [
        ((-5.0, 0.0), 0.02),
        ((-5.0, 5.0), 0.01),
        ((5.0, 0.0), np.inf),  # it has left
        ((0.0, 0.0), np.inf),
        ((-5.0, -5.0), np.inf),
    ],
)
def test_when_surfaces_meet_by_their_first_velocities(speeds: tuple[float, float], meets: float) -> None:
    """A gap of 0.1 m; the floor moves too, or flees."""
    table = two_blocks(0.1)
    table["boundary"] = {}
    for name, speed in zip(("block", "floor"), speeds, strict=True):
        table["body"][name]["initial_velocity"] = [0.0, speed]
    prepared = prepare(case_from_table(table))
    (gap,) = initial_gaps(prepared)
    assert gap is not None
    assert meeting_time(prepared, 0, gap) == pytest.approx(meets, rel=1e-6)
    late = (
        f"the two meet at {moment(meets)}, after the end of the run, 1 ms"
        if (0.0 <= meets < np.inf)
        else "after the end"
    )
    assert (late in " ".join(text_report(prepared).split())) == bool(0.0 <= meets < np.inf)


def test_a_body_faster_than_its_waves_is_doubtful() -> None:
    """E in GPa where Pa are asked for: c = sqrt(E (1 - nu)/((1 + nu)(1 - 2 nu) rho)) is 0.116 m/s for 10 Pa."""
    table = two_blocks(0.03)
    table["body"]["block"]["initial_velocity"] = [0.0, -5.0]
    assert not any("faster than the waves" in text for text in prepare(case_from_table(table)).warnings)
    table["material"]["soft"]["E"] = 10.0
    (told,) = [text for text in prepare(case_from_table(table)).warnings if "faster" in text]
    assert told.startswith(
        "body block starts at 5 m/s, faster than the waves in soft, 0.116 m/s: are E = 10 Pa"
    )
    table["material"]["hard"] = {"E": 1e9, "nu": 0.3, "rho": 1000.0}
    table["body"]["block"]["material"] = "hard"  # now the floor at rest is the soft one
    (told,) = [text for text in prepare(case_from_table(table)).warnings if "faster" in text]
    assert told.startswith("body floor is met at 5 m/s, faster than the waves in soft, 0.116 m/s")


def test_one_element_that_is_smallest_and_sets_the_step_is_shown_once(apart: Prepared, monkeypatch) -> None:
    least = min(apart.bodies, key=lambda body: float(body.mesh.fraction.min()))
    place = element_place(least.mesh, int(np.argmin(least.mesh.fraction)))
    assert len([*check_picture._spots(apart)]) == 2
    monkeypatch.setattr(check_picture, "step_place", lambda prepared: place)
    (spot,) = check_picture._spots(apart)
    assert "smallest fragment" in spot.title and "sets the step" in spot.title


@pytest.mark.parametrize("side", SIDES)
def test_the_box_that_is_suggested_for_a_side_holds_nodes_there(side: str) -> None:
    """A square that stands on its corner has no straight side; the message gives what to write instead."""
    table = two_blocks(0.03)
    diamond = [[0.0, 1.0], [1.0, 0.1], [2.0, 1.0], [1.0, 2.0]]
    table["body"]["block"]["geometry"] = {"polygon": {"points": diamond}}
    table["contact"]["fall"]["slave"] = "block.outer"
    table["boundary"] = {"hold": {"on": f"block.{side}", "displacement": {"y": 0.0}}}
    with pytest.raises(CaseError) as refused:
        prepare(case_from_table(table))
    (written,) = re.findall(r"the nodes there are (\{.*\})\)", str(refused.value))
    table["boundary"]["hold"]["on"] = tomllib.loads(f"on = {written}")["on"]
    (hold,) = prepare(case_from_table(table)).boundaries
    assert 3 <= len(hold.nodes) <= 20


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rho": 7.8}, "waves in a run at "),
        ({"cell": 1.2}, " elements: are the cell and the unit"),
    ],
)
def test_numbers_in_other_units_are_told(change: dict[str, float], said: str) -> None:
    """A density in g/cm^3; a cell in other units than the drawing."""
    table = two_blocks(0.1)
    (name,) = {table["body"]["block"]["material"]}
    table["material"][name] = {"E": 210e9, "nu": 0.3, "rho": change.get("rho", 7800.0)}
    if "cell" in change:
        table["body"]["block"]["grid"] = {"kind": "cartesian", "cell": change["cell"]}
    told = " ".join(prepare(case_from_table(table)).warnings)
    assert said.replace(" a ", f" {name} ") in told, told
