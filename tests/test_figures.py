"""Figures of runs and batches: which cases, which data, and what is refused before anything runs."""

from __future__ import annotations

import csv
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from phantomnode.pipeline.batch import run_batch
from phantomnode.pipeline.case import case_from_table, load_case
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.figure_pictures import arc_length
from phantomnode.pipeline.figure_sources import Source, chosen
from phantomnode.pipeline.figure_tables import Figure
from phantomnode.pipeline.figures import draw_figures
from phantomnode.pipeline.provenance import case_hash
from phantomnode.pipeline.report import write_report
from phantomnode.pipeline.results import Surface, open_results
from phantomnode.pipeline.run import run_all
from phantomnode.pipeline.sweep import COPY, load_study

SHORT = {"time.end": 4e-4, "output.fields.count": 4, "output.history.count": 20}
"""The block of 4.1 for long enough that its halves press on each other."""
PUSH = {"boundary.push.displacement.y": "-2*t"}
FIGURES = {
    "stress": {"kind": "field", "quantity": "stress_yy", "times": [4e-4], "where": {"penalty": [100, 1000]}},
    "pressure": {"kind": "pressure", "times": [4e-4]},
    "force": {"kind": "history", "columns": ["contact.halves.fy", "total"], "where": {"penalty": 100}},
}
SWEEP: dict[str, Any] = {
    "base": "block_contact",
    "set": {**SHORT, **PUSH},
    "axis": {"penalty": {"key": "contact.halves.penalty.times_E", "values": [100, 1000]}},
    "figure": FIGURES,
}


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as table:
        return list(csv.DictReader(table))


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    (folder / "sweep.toml").write_text(tomli_w.dumps(SWEEP))
    assert run_batch(folder / "sweep.toml", folder / "out", workers=1).status == "done"
    return folder / "out"


def test_a_batch_draws_its_figures_and_report_draws_them_again(batch: Path, tmp_path: Path) -> None:
    names = [f"figure.{name}.png" for name in FIGURES]
    assert {*names} <= {file.name for file in batch.iterdir()}
    page, *pictures = write_report([batch], tmp_path / "again")
    assert [file.name for file in pictures] == names and "Figure: pressure" in page.read_text()
    for name in (*names, "figure.pressure.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (batch / name).read_bytes()


def test_the_drawn_pressure_is_the_contact_force(batch: Path) -> None:
    """Pressure per current length times that length, summed; float32 in the files leaves 1e-5."""
    rows = rows_of(batch / "figure.pressure.csv")
    assert {row["case"] for row in rows} == {"penalty 100", "penalty 1000"}
    for penalty in (100, 1000):
        pressure = [float(row["pressure"]) for row in rows if row["case"] == f"penalty {penalty}"]
        results = open_results(batch / f"penalty={penalty}")
        ends = results.contact("end").ends
        length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
        force = results.history["contact.halves.fy"][-1]
        assert force > 1e6 and np.dot(pressure, length) == pytest.approx(force, rel=1e-5)


def test_the_drawn_history_is_the_file_and_the_total_its_sum(batch: Path) -> None:
    rows, history = rows_of(batch / "figure.force.csv"), open_results(batch / "penalty=100").history
    assert [float(row["contact.halves.fy"]) for row in rows] == history["contact.halves.fy"].tolist()
    total = np.array([float(row["total"]) for row in rows])
    assert np.abs(total - total[0]).max() < 1e-3 * history["external_work"].max()


def test_the_drawn_field_has_every_cell_of_both_cases(batch: Path) -> None:
    rows = rows_of(batch / "figure.stress.csv")
    cells = len(open_results(batch / "penalty=100").frame("end").values("stress_yy"))
    assert len(rows) == 2 * cells and {row["time"] for row in rows} == {"0.0004"}


def test_the_copy_of_a_sweep_loads_from_its_batch(batch: Path) -> None:
    study = load_study(batch / COPY)
    assert [point.name for point in study.points] == ["penalty=100", "penalty=1000"]


def test_a_case_that_is_not_done_is_left_out(batch: Path, tmp_path: Path) -> None:
    for name in (COPY, "results.csv"):
        text = (batch / name).read_text()
        (tmp_path / name).write_text(re.sub(r"(?m)^(penalty=100,penalty=100,)done", r"\1failed", text))
    (tmp_path / "penalty=1000").symlink_to(batch / "penalty=1000")
    drawn = [file.name for file in draw_figures(tmp_path)]
    assert drawn == ["figure.stress.png", "figure.pressure.png"]  # the force is that of the failed case
    assert {row["case"] for row in rows_of(tmp_path / "figure.pressure.csv")} == {""}


def test_a_run_draws_the_figures_of_its_case_with_the_variants(tmp_path: Path) -> None:
    few = [f"{key}={value!r}" for key, value in {**SHORT, **PUSH}.items()]
    table = load_case("block_contact", few).model_dump(mode="json", exclude_none=True)
    table |= {"figure": {"pressure": {"kind": "pressure", "times": [4e-4]}}}
    table |= {"variant": {"stiff": {"contact": {"halves": {"penalty": {"times_E": 1000}}}}}}
    run_all(case_from_table(table), tmp_path / "out")
    assert {row["case"] for row in rows_of(tmp_path / "out" / "figure.pressure.csv")} == {
        "block_contact",
        "stiff",
    }


def test_labels_tell_cases_apart_and_say_no_more(batch: Path) -> None:
    """Of axes that go together the first one is enough; what all cases share is left out."""
    places = [{"mesh": m, "cell": c, "speed": s} for s in (1, 2) for m, c in (("a", 0.1), ("b", 0.2))]
    sources = [Source(place, batch / "penalty=100") for place in places]
    figure = Figure.model_validate({"kind": "history", "columns": ["kinetic"]})
    assert [run.label for run in chosen(figure, sources)][1:3] == ["mesh b, speed 1", "mesh a, speed 2"]
    figure = figure.model_copy(update={"where": {"speed": 2.0}})
    assert [run.label for run in chosen(figure, sources)] == ["mesh a", "mesh b"]


@pytest.mark.parametrize(
    ("figure", "message"),
    [
        ({"kind": "field", "times": [4e-4]}, "figure.f: quantity must be given"),
        ({"kind": "field", "quantity": "stress_z", "times": [4e-4]}, "did you mean 'stress_zz'"),
        ({"kind": "pressure", "times": [4e-4], "pair": "halfs"}, "did you mean 'halves'"),
        ({"kind": "pressure", "times": [1.5e-4]}, "there will be no frame"),
        ({"kind": "pressure", "times": [4e-4], "columns": ["kinetic"]}, "columns is not for kind"),
        ({"kind": "history", "columns": ["kinetick"]}, "did you mean 'kinetic'"),
        ({"kind": "history", "columns": ["kinetic"], "curves": "times"}, 'curves = "times" is not for'),
        ({"kind": "history", "columns": ["kinetic"], "where": {"penalti": 100}}, "did you mean 'penalty'"),
        (
            {"kind": "history", "columns": ["kinetic"], "where": {"penalty": 5}},
            "no case has 5; there are 100, 1000",
        ),
    ],
)
def test_wrong_figures_are_refused_before_anything_runs(figure: dict, message: str, tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(tomli_w.dumps({**SWEEP, "figure": {"f": figure}}))
    with pytest.raises(CaseError, match=re.escape(message)):
        load_study(tmp_path)


def test_a_figure_changes_no_result_and_no_hash() -> None:
    case = load_case("block_contact")
    table = tomllib.loads(tomli_w.dumps(case.model_dump(mode="json", exclude_none=True)))
    other = case_from_table(table | {"figure": {"e": {"kind": "history", "columns": ["kinetic"]}}})
    assert case_hash(other) == case_hash(case)


def circle(count: int, start: float, clockwise: bool = False) -> Surface:
    """A circle of radius 1, m, as a slave surface of straight segments."""
    angle = start + np.linspace(0.0, 2.0 * np.pi, count + 1)[:: -1 if clockwise else 1]
    corner = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.stack([corner[:-1], corner[1:]], axis=1)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    until = np.cumsum(length)
    order, chain = np.arange(count), np.zeros(count, dtype=np.int64)
    return Surface(order, until - 0.5 * length, chain, True, ends, corner[0], float(until[-1]))


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("start", [0.0, 1.0, 4.0])
def test_arc_length_is_the_same_wherever_a_mesh_begins(start: float, clockwise: bool) -> None:
    """From the lowest place of the circle, growing to the right; chords of 1/200 of it miss (pi/200)^2/6 of it."""
    surface = circle(200, start, clockwise)
    arc, middle = arc_length(surface, (0.0, -1.0)), surface.ends.mean(axis=1)
    exact = np.arctan2(middle[:, 0], -middle[:, 1])
    apart = np.abs(np.mod(arc - exact + np.pi, 2.0 * np.pi) - np.pi)
    assert apart.max() < 1e-3


@pytest.mark.parametrize("turned", [False, True])
def test_arc_length_of_an_open_surface_begins_at_its_left_end(turned: bool) -> None:
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 1.0]])[:: -1 if turned else 1]
    ends = np.stack([corner[:-1], corner[1:]], axis=1)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    until = np.cumsum(length)
    surface = Surface(
        np.arange(2), until - 0.5 * length, np.zeros(2, np.int64), False, ends, corner[0], until[-1]
    )
    expected = np.array([0.5, 1.0 + 0.5 * np.sqrt(5.0)])
    assert arc_length(surface, None) == pytest.approx(expected[:: -1 if turned else 1])
    assert arc_length(surface, (1.0, 0.0)) == pytest.approx(expected[:: -1 if turned else 1] - 1.0)
