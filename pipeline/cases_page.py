"""The page that compares runs: the cases of a batch, a run with its variants, or runs side by side."""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.one_case import DONE
from phantomnode.pipeline.outputs import (
    CASE_COLUMNS,
    SCALARS,
    in_words,
    known_outputs,
    named,
    output_of,
    unit_of_key,
    with_unit,
)
from phantomnode.pipeline.page_charts import overlay
from phantomnode.pipeline.pages import Cell, Picture, Table, data_url, picture_in, render, titled
from phantomnode.pipeline.results import open_results
from phantomnode.pipeline.sweep import COPY

PAGE = "report.html"
GALLERY, THUMBNAIL = 12, 560
"""Cases whose picture is shown, and its width in pixels."""
SHOWN = (
    "contact_impulse.",
    "peak_contact_force.",
    "largest_penetration.",
    "energy_error_max",
    "smallest_J",
    "wall_s",
)
"""Outputs that the table shows, or their beginnings; the chart offers all."""


class Compared(NamedTuple):
    """One run of a comparison.

    name: of the case; folder: of its results; status and reason: how it ended; inputs: by the names of the axes;
    outputs: by their names, None where there is none; doubts: the checks that it did not keep, None where it has
    none at all.
    """

    name: str
    folder: Path
    status: str
    reason: str
    inputs: dict[str, Any]
    outputs: dict[str, float | None]
    doubts: tuple[str, ...] | None


class Asked(NamedTuple):
    """What a sweep says of its page: its title, the outputs that it wants, units of axes and words for its plots."""

    title: str = ""
    outputs: tuple[str, ...] = ()
    units: Mapping[str, str] = MappingProxyType({})
    plots: Mapping[str, str] = MappingProxyType({})


NOTHING_ASKED = Asked()
"""Of runs that no sweep made."""


def asked_of(batch: Path) -> Asked:
    """What the copy of its sweep says in the folder of a batch; its name is the title of one that has none."""
    try:
        sweep = tomllib.loads((batch / COPY).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return Asked(batch.resolve().name)
    axes = {name: axis for name, axis in sweep.get("axis", {}).items() if "names" not in axis}
    return Asked(
        sweep.get("title") or batch.resolve().name,
        tuple(sweep.get("outputs", ())),
        {name: unit_of_key(axis["key"] if "key" in axis else axis["keys"][0]) for name, axis in axes.items()},
        {
            name: f"{in_words(plot['y'])} over {in_words(plot['x'])}"
            for name, plot in sweep.get("plot", {}).items()
        },
    )


def compared_cases(batch: Path) -> list[Compared]:
    """The cases of a batch, from its results.csv and their summaries.

    Raises
    ------
    CaseError
        Where the table is not one of a batch.
    """
    with (batch / "results.csv").open(encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    if not rows or not set(CASE_COLUMNS) <= set(rows[0]):
        raise CaseError(f"{batch / 'results.csv'}: is no table of a batch")
    values = [name for name in rows[0] if name not in CASE_COLUMNS]
    outputs = [name for name in values if "." in name or name in SCALARS]
    axes = [name for name in values if name not in outputs]
    return [
        Compared(
            row["case"], batch / row["folder"], row["status"], row["reason"],
            {name: _value(row[name]) for name in axes},
            {name: _number(row[name]) for name in outputs},
            _doubts(_summary(batch / row["folder"])),
        )
        for row in rows
    ]  # fmt: skip


def compared_runs(folders: dict[str, Path]) -> list[Compared]:
    """Runs by their names, from their summaries; the outputs are those of all of them.

    Raises
    ------
    CaseError
        Where one has no results.
    """
    runs = []
    for name, folder in folders.items():
        results, summary = open_results(folder), _summary(folder)
        outputs = {one: output_of(summary, one) for one in known_outputs(results.case)}
        status, reason = summary.get("status", "not ended"), summary.get("reason", "")
        runs.append(Compared(name, folder, status, reason, {"run": name}, outputs, _doubts(summary)))
    return runs


def cases_page(asked: Asked, cases: Sequence[Compared], home: Path, drawn: Sequence[Path] = ()) -> str:
    """The page.

    Parameters
    ----------
    asked : Asked
        Its title, and what it is to show first.
    cases : sequence of Compared
    home : Path
        The folder of the page, from which its links lead to those of the cases.
    drawn : sequence of Path
        Figures and profiles that compare the cases.
    """
    axes = list(cases[0].inputs)
    done = sum(case.status == DONE for case in cases)
    doubtful = [case for case in cases if case.doubts]
    varied = [f"{name}: {_listed([case.inputs[name] for case in cases])}" for name in axes if name != "run"]
    lead = f"{len(doubtful)} of them kept not all of their checks." if doubtful else ""
    pictures = [
        *(picture_in(file, titled(file)) for file in drawn),
        *_plots(home, asked),
        *_gallery(cases),
    ]
    laid = overlay({case.name: case.folder for case in cases})
    return render(
        "cases.html",
        {"comparison": _comparison(cases, asked), "overlay": laid},
        title=asked.title,
        trusted=done == len(cases) and not doubtful,
        headline=f"{done} of {len(cases)} cases are done.",
        lead=lead or ("All kept their checks." if done == len(cases) else ""),
        axes=varied,
        comparison=done > 0,
        overlay_note=laid["note"] if laid else "",
        table=table_of(cases, home, asked),
        troubles=[
            {"name": case.name, "text": f"{case.status}: {case.reason}"} for case in cases if case.reason
        ],
        pictures=pictures,
    )


def table_of(cases: Sequence[Compared], home: Path, asked: Asked = NOTHING_ASKED) -> Table:
    """The cases as rows: inputs, status, whether they can be trusted, outputs asked for and those that tell most."""
    axes = [name for name in cases[0].inputs if name != "run"]
    there = _outputs(cases)
    outputs = [name for name in asked.outputs if name in there]
    outputs += [name for name in there if name.startswith(SHOWN) and name not in outputs]
    rows = []
    for case in cases:
        beside = case.folder != home and case.folder.is_relative_to(home) and (case.folder / PAGE).is_file()
        name = Cell(case.name, "", f"{case.folder.relative_to(home).as_posix()}/{PAGE}" if beside else "")
        row = [_cell(case.inputs[name]) for name in axes]
        row.append(Cell(case.status, "good" if case.status == DONE else "look"))
        row.append(_checks(case.doubts))
        row += [_cell(case.outputs.get(name)) for name in outputs]
        rows.append([*row, name] if axes else [name, *row])
    columns = [*(named(name, asked.units.get(name, "")) for name in axes), "status", "checks"]
    columns += map(with_unit, outputs)
    return Table([*columns, "case"] if axes else ["case", *columns], rows)


def _checks(doubts: tuple[str, ...] | None) -> Cell:
    """Which checks a run did not keep."""
    if doubts is None:
        return Cell("")
    return Cell(", ".join(doubts), "look") if doubts else Cell("kept", "good")


def _comparison(cases: Sequence[Compared], asked: Asked) -> dict[str, Any]:
    """What the chart draws: axes and outputs, a value a case; first the outputs that were asked for."""

    def rank(name: str) -> tuple[bool, bool]:
        return name not in asked.outputs, not name.startswith(SHOWN)

    return {
        "axes": [
            {
                "name": named(name, asked.units.get(name, "")),
                "values": [_plain(case.inputs[name]) for case in cases],
            }
            for name in cases[0].inputs
        ],
        "outputs": [
            {"name": with_unit(name), "values": [case.outputs.get(name) for case in cases]}
            for name in sorted(_outputs(cases), key=rank)
        ],
    }


def _outputs(cases: Sequence[Compared]) -> list[str]:
    """The names of all outputs that some case has."""
    names = dict.fromkeys(name for case in cases for name in case.outputs)
    return [name for name in names if any(case.outputs.get(name) is not None for case in cases)]


def _plots(home: Path, asked: Asked) -> list[Picture]:
    """The pictures that the sweep asked for."""
    files = {file.stem.removeprefix("plot."): file for file in sorted(home.glob("plot.*.png"))}
    return [picture_in(file, asked.plots.get(name, name)) for name, file in files.items()]


def _gallery(cases: Sequence[Compared]) -> list[Picture]:
    """The bodies of the first cases at their peaks, small."""
    from PIL import Image

    files = [(case.name, case.folder / "peak.png") for case in cases]
    pictures = []
    for name, file in [(name, file) for name, file in files if file.is_file()][:GALLERY]:
        with Image.open(file) as image:
            image.thumbnail((THUMBNAIL, 2 * THUMBNAIL))
            content = BytesIO()
            image.convert("RGB").quantize(192).save(content, format="png", optimize=True)
        pictures.append(Picture(data_url(content.getvalue()), name))
    return pictures


def _summary(folder: Path) -> dict[str, Any]:
    """summary.json of a run; empty where it has not ended."""
    try:
        content: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return content


def _doubts(summary: dict[str, Any]) -> tuple[str, ...] | None:
    """The checks that a run did not keep; None where it has none."""
    checks = summary.get("checks")
    return tuple(check["name"] for check in checks if not check["passed"]) if checks else None


def _value(text: str) -> Any:
    """A value of results.csv: a number or list as JSON, or a text."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _number(text: str) -> float | None:
    value = _value(text)
    return float(value) if isinstance(value, int | float) else None


def _plain(value: Any) -> float | str:
    """A place along an axis of the chart: a number, or a word."""
    return (
        value if isinstance(value, int | float | str) and not isinstance(value, bool) else json.dumps(value)
    )


def _cell(value: Any) -> Cell:
    if isinstance(value, int | float):
        return Cell(f"{value:.5g}", "number")
    return Cell("" if value is None else str(_plain(value)))


def _listed(values: Sequence[Any]) -> str:
    """The different values of an axis, not too many of them."""
    different = list(dict.fromkeys(_cell(value).text for value in values))
    if len(different) <= 12:
        return ", ".join(different)
    return f"{', '.join(different[:6])}, ..., {different[-1]} ({len(different)} values)"
