"""The page that compares runs: the cases of a batch, a run with its variants, or runs side by side."""

from __future__ import annotations

import csv
import json
import tomllib
from collections import Counter
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
from phantomnode.pipeline.trust import doubtful, open_end

PAGE = "report.html"
GALLERY, THUMBNAIL = 12, 560
"""Cases whose picture is shown, and its width in pixels."""
SHOWN = (
    "contact_impulse.",
    "peak_contact_force.",
    "largest_penetration.",
    "highest_von_mises.",
    "energy_error_max",
    "smallest_J",
    "wall_s",
)
"""Outputs that the table shows, or their beginnings; the chart offers all."""


class Compared(NamedTuple):
    """One run of a comparison.

    name: of the case; folder: of its results; status and reason: how it ended; inputs: by the names of the axes;
    outputs: by their names, None where there is none; doubts: what wants a look, None where there are no checks; end:
    in words, that it ends before contact does.
    """

    name: str
    folder: Path
    status: str
    reason: str
    inputs: dict[str, Any]
    outputs: dict[str, float | None]
    doubts: tuple[str, ...] | None
    end: str = ""


class Asked(NamedTuple):
    """What a sweep says of its page.

    Its title; the outputs that it wants; units of axes; the keys that they set, in words; words for its plots.
    """

    title: str = ""
    outputs: tuple[str, ...] = ()
    units: Mapping[str, str] = MappingProxyType({})
    keys: Mapping[str, str] = MappingProxyType({})
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
        {name: unit_of_key(_keys(axis)[0]) for name, axis in axes.items()},
        {name: f" ({', '.join(_keys(axis))})" for name, axis in sweep.get("axis", {}).items()},
        {
            name: f"{in_words(plot['y'])} over {in_words(plot['x'])}"
            for name, plot in sweep.get("plot", {}).items()
        },
    )


def _keys(axis: dict[str, Any]) -> list[str]:
    """The keys of the case that an axis sets."""
    return [axis["key"]] if "key" in axis else list(axis["keys"])


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
            *_judged(_summary(batch / row["folder"])),
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
        runs.append(Compared(name, folder, status, reason, {"run": name}, outputs, *_judged(summary)))
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
    look = [case for case in cases if case.doubts]
    varied = [_varied(name, [case.inputs[name] for case in cases], asked) for name in axes if name != "run"]
    pictures = [*(picture_in(file, titled(file)) for file in drawn), *_plots(home, asked)]
    laid = overlay({case.name: case.folder for case in cases})
    return render(
        "cases.html",
        {"comparison": _comparison(cases, asked), "overlay": laid},
        title=asked.title,
        trusted=done == len(cases) and not look,
        headline=f"{done} of {len(cases)} cases are done.",
        lead=_lead(cases),
        axes=varied,
        comparison=done > 0,
        overlay_note=laid["note"] if laid else "",
        table=table_of(cases, home, asked),
        troubles=[
            {"name": case.name, "text": f"{case.status}: {case.reason}"} for case in cases if case.reason
        ],
        pictures=pictures,
        gallery=_gallery(cases),
    )


def _varied(axis: str, values: Sequence[Any], asked: Asked) -> str:
    """What an axis is set to, with its unit and key: "speed, m/s: -50, -100 (body.ring.initial_velocity.1)"."""
    return f"{named(axis, asked.units.get(axis, ''))}: {_listed(values)}{asked.keys.get(axis, '')}"


def _lead(cases: Sequence[Compared]) -> str:
    """How many cases want a look, and how many end before contact does."""
    look = sum(bool(case.doubts) for case in cases)
    kept = ["All kept their checks."] if all(case.status == DONE for case in cases) else []
    lead = [f"{_how_many(look, len(cases))} want a look."] if look else kept
    ends = Counter(case.end for case in cases if case.end)
    return " ".join([*lead, *(f"{_how_many(count, len(cases))}: {end}." for end, count in ends.items())])


def _link(folder: Path, home: Path) -> str:
    """From a page to the page of a case, or to its folder where it has none; "" where it is no folder below."""
    if folder == home or not folder.is_relative_to(home):
        return ""
    below = folder.relative_to(home).as_posix()
    return f"{below}/{PAGE}" if (folder / PAGE).is_file() else f"{below}/"


def _how_many(count: int, of: int) -> str:
    """The subject of a sentence: "All", "3 of them", "1 of them"."""
    return "All" if count == of else f"{count} of them"


def table_of(cases: Sequence[Compared], home: Path, asked: Asked = NOTHING_ASKED) -> Table:
    """The cases as rows: inputs, status, whether they can be trusted, outputs asked for and those that tell most."""
    axes = [name for name in cases[0].inputs if name != "run"]
    there = _outputs(cases)
    outputs = [name for name in asked.outputs if name in there]
    telling = sorted((name for name in there if name.startswith(SHOWN)), key=_telling)
    outputs += [name for name in telling if name not in outputs]
    rows = []
    for case in cases:
        name = Cell(case.name, "", _link(case.folder, home))
        row = [_cell(case.inputs[name]) for name in axes]
        row.append(Cell(case.status, "good" if case.status == DONE else "look"))
        row.append(_checks(case))
        row += [_cell(case.outputs.get(name)) for name in outputs]
        rows.append([*row, name] if axes else [name, *row])
    columns = [*(named(name, asked.units.get(name, "")) for name in axes), "status", "checks"]
    columns += map(with_unit, outputs)
    return Table([*columns, "case"] if axes else ["case", *columns], rows)


def _checks(case: Compared) -> Cell:
    """What wants a look in a run, and whether it ends before contact does."""
    if case.doubts is None:
        return Cell("")
    text = ", ".join(case.doubts) or "kept"
    return Cell(f"{text}; {case.end}" if case.end else text, "look" if case.doubts else "good")


def _comparison(cases: Sequence[Compared], asked: Asked) -> dict[str, Any]:
    """What the chart draws: axes and outputs, a value a case; first the outputs that were asked for."""

    def rank(name: str) -> tuple[bool, int]:
        return name not in asked.outputs, _telling(name)

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


def _telling(name: str) -> int:
    """The place of an output among those that are shown, behind them where it is none."""
    return next((k for k, begin in enumerate(SHOWN) if name.startswith(begin)), len(SHOWN))


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
        pictures.append(
            Picture(data_url(content.getvalue()), f"{name}: when most energy is stored, own colours")
        )
    return pictures


def _summary(folder: Path) -> dict[str, Any]:
    """summary.json of a run; empty where it has not ended."""
    try:
        content: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return content


def _judged(summary: dict[str, Any]) -> tuple[tuple[str, ...] | None, str]:
    """What wants a look in a run, None where it has no checks; and whether it ends before contact does."""
    return (doubtful(summary), open_end(summary)) if summary.get("checks") else (None, "")


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
