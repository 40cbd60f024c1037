"""The runs that a figure shows: those of a case with its variants, or cases of a batch, and what they are called."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from phantomnode.pipeline.case import read_toml
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.figure_checks import fits
from phantomnode.pipeline.figure_tables import Figure
from phantomnode.pipeline.names import word
from phantomnode.pipeline.one_case import DONE
from phantomnode.pipeline.results import Results, open_results
from phantomnode.pipeline.run_files import VARIANTS
from phantomnode.pipeline.sweep import COPY, Sweep

RUN = "run"
"""The axis along which a case and its variants stand."""


class Source(NamedTuple):
    """A run: its place on each axis, by name, and its folder."""

    values: dict[str, Any]
    folder: Path


class Shown(NamedTuple):
    """A run in a figure: what it is called ("" where it is the only one), and its results."""

    label: str
    results: Results


def figures_in(folder: Path) -> tuple[dict[str, Figure], list[Source], str]:
    """The figures that a run or a batch asks for, the runs that are there, and the title.

    Raises
    ------
    CaseError
        Where the folder holds neither.
    """
    if (folder / COPY).is_file():
        sweep = Sweep.model_validate(read_toml(folder / COPY))
        return sweep.figure, _of_batch(folder, sweep), sweep.title
    if (folder / "results.csv").is_file():
        return {}, [], ""  # a batch of before there were figures
    if not (folder / "case.toml").is_file():
        raise CaseError(f"{folder}: holds no results of a run or a batch (no case.toml, no {COPY})")
    table = read_toml(folder / "case.toml")
    figures = {name: Figure.model_validate(figure) for name, figure in table.get("figure", {}).items()}
    variants = sorted(file.parent for file in folder.glob(f"{VARIANTS}/*/summary.json"))
    runs = {table["name"]: folder, **{path.name: path for path in variants}}
    sources = [Source({RUN: name}, path) for name, path in runs.items() if _is_done(path)]
    return figures, sources, table.get("title", "")


def chosen(figure: Figure, sources: Sequence[Source]) -> list[Shown]:
    """The runs of a figure with their labels, in their order; none where none of them is done."""
    found = [source for source in sources if fits(figure.where, source.values)]
    axes = _telling(found)
    labels = [", ".join(_called(axis, source.values[axis]) for axis in axes) for source in found]
    return [Shown(label, open_results(source.folder)) for label, source in zip(labels, found, strict=True)]


def _of_batch(folder: Path, sweep: Sweep) -> list[Source]:
    """The cases of a batch that are done, from results.csv."""
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["status"] == DONE]
    return [Source({axis: _value(row[axis]) for axis in sweep.axis}, folder / row["folder"]) for row in rows]


def _is_done(run: Path) -> bool:
    """Whether a run has come to its end."""
    return bool(open_results(run).summary.get("status") == DONE)


def _value(text: str) -> Any:
    """A value as results.csv holds it: JSON, or text as it is."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def _telling(sources: Sequence[Source]) -> list[str]:
    """The axes that tell some runs apart; those that go together with others are left out."""
    axes: list[str] = []
    distinct = 1
    for axis in sources[0].values if sources else ():
        found = len({tuple(word(source.values[name]) for name in (*axes, axis)) for source in sources})
        if found > distinct:
            axes.append(axis)
            distinct = found
    return axes


def _called(axis: str, value: Any) -> str:
    """A value in a label."""
    text = value if isinstance(value, str) else word(value)
    return text if axis == RUN else f"{axis} {text}"
