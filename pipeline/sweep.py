"""Sweep files: a base case, the axes along which it changes, and the cases that they make."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, ValidationError, model_validator

from phantomnode.pipeline.axes import Axis, Samples, axis_values
from phantomnode.pipeline.case import (
    SWEEP_FILE,
    bundled_cases,
    case_from_table,
    default_name,
    find_case,
    read_toml,
)
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.figure_checks import sweep_faults
from phantomnode.pipeline.figure_tables import Figure
from phantomnode.pipeline.messages import describe, listed, suggestion
from phantomnode.pipeline.names import unique_names
from phantomnode.pipeline.outputs import FIXED, known_outputs
from phantomnode.pipeline.overrides import set_key
from phantomnode.pipeline.provenance import family_hash
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.values import Name, Table

COPY = "batch.toml"
"""The sweep in the folder of its batch."""


class Plot(Table):
    """A picture of one output over one axis; a curve for each choice of the others."""

    x: str = Field(description="name of an axis")
    y: str = Field(description='name of an output, as in results.csv, such as "energy_error_max"')
    log: tuple[str, ...] = Field(default=(), description='logarithmic directions: ["x"], ["y"] or ["x", "y"]')

    @model_validator(mode="after")
    def _directions(self) -> Plot:
        if not {*self.log} <= {"x", "y"}:
            raise ValueError(f'log = {list(self.log)} must be ["x"], ["y"] or ["x", "y"]')
        return self


class Sweep(Table):
    """A base case and the axes along which it changes."""

    title: str = Field(default="", description="one line that says what is studied")
    base: str = Field(
        default="case.toml", description="a case file, relative to this one, or the name of a bundled case"
    )
    set: dict[str, Any] = Field(default={}, description='keys of every case, as in { "time.end" = 0.002 }')
    axis: dict[Name, Axis] = Field(min_length=1, description="one table for each axis")
    zip: tuple[tuple[Name, ...], ...] = Field(
        default=(), description='axes that go together, as in [["speed", "cell"]]; others are crossed'
    )
    samples: Samples | None = Field(
        default=None, description="{ count = 20, seed = 1 } of the axes with random values"
    )
    outputs: tuple[str, ...] = Field(
        default=(), description="what the table of all cases shows; energy error and peak forces unless given"
    )
    plot: dict[Name, Plot] = Field(default={}, description="pictures of an output over an axis")
    figure: dict[Name, Figure] = Field(default={}, description="pictures of several cases, with their data")

    @model_validator(mode="after")
    def _axes_fit(self) -> Sweep:
        _refuse_clashes(self.axis)
        _refuse_wrong_zips(self)
        random = [name for name, axis in self.axis.items() if axis.random]
        if random and self.samples is None:
            raise ValueError(
                f"axis {random[0]} is random: add samples = {{ count = 20, seed = 1 }} to the sweep"
            )
        if self.samples is not None and not random:
            raise ValueError("samples is given, but no axis is uniform, loguniform or normal")
        for name, plot in self.plot.items():
            if plot.x not in self.axis:
                hint = suggestion(plot.x, self.axis)
                raise ValueError(f"plot.{name}.x: no axis {plot.x!r}{hint}; there are {listed(self.axis)}")
        return self


@dataclass(frozen=True)
class Point:
    """One case of a sweep.

    Attributes
    ----------
    name : str
        Readable, made of the values, good as the name of a folder and unlike every other.
    values : dict
        The value of each axis, as TOML reads it, or its name where the axis gives names.
    case : Case
        Validated.
    hash : str
        Of the resolved case with its variants and geometry files.
    """

    name: str
    values: dict[str, Any]
    case: Case
    hash: str


@dataclass(frozen=True)
class Study:
    """A sweep with all its cases.

    Attributes
    ----------
    name : str
        Good as the name of a results folder.
    sweep : Sweep
    points : tuple of Point
    outputs : tuple of str
        Names of the outputs that these cases have, in the order of results.csv.
    shown : tuple of str
        Those that the table of all cases shows.
    file : Path
        Where the sweep was read from.
    """

    name: str
    sweep: Sweep
    points: tuple[Point, ...]
    outputs: tuple[str, ...]
    shown: tuple[str, ...]
    file: Path

    def copy(self) -> dict[str, Any]:
        """The sweep as a table that loads from anywhere."""
        table = self.sweep.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        beside = self.file.parent / Path(self.sweep.base).expanduser()
        return {**table, "base": str(beside.resolve()) if beside.exists() else self.sweep.base}


def load_study(source: str | Path) -> Study:
    """Read a sweep file and validate every case of it.

    Parameters
    ----------
    source : str or Path
        A sweep file, a folder that holds ``sweep.toml``, or the name of a bundled case that has one.

    Raises
    ------
    CaseError
        With everything that is wrong, each message naming the file and the key, or the case.
    """
    file = find_sweep(source)
    table = read_toml(file)
    try:
        sweep = _validated(table)
        points = _points(sweep, _base(sweep, file))
        outputs = tuple(dict.fromkeys(name for point in points for name in known_outputs(point.case)))
        shown = sweep.outputs or tuple(name for name in outputs if name.startswith("peak_contact_force"))[:3]
        _refuse_unknown_outputs(sweep, outputs)
        _refuse_wrong_figures(sweep, points)
    except CaseError as error:
        raise CaseError([f"{file}: {message}" for message in error.messages]) from error
    return Study(default_name(file), sweep, points, outputs, shown or outputs[:1], file)


def find_sweep(source: str | Path) -> Path:
    """The file of a sweep.

    Raises
    ------
    CaseError
        If there is no such file, folder or bundled sweep.
    """
    path = Path(source).expanduser()
    if path.is_file():
        return path
    if (path / SWEEP_FILE).is_file():
        return path / SWEEP_FILE
    bundled = {
        name: file.parent / SWEEP_FILE
        for name, file in bundled_cases().items()
        if "/" not in name and (file.parent / SWEEP_FILE).is_file()
    }
    if str(source) in bundled:
        return bundled[str(source)]
    raise CaseError(
        f"{source}: there is no such sweep file, no folder with {SWEEP_FILE}, and no bundled sweep"
        f"{suggestion(str(source), bundled)}; bundled sweeps are {listed(bundled)}"
    )


def _validated(table: Mapping[str, Any]) -> Sweep:
    """The sweep in a table."""
    try:
        return Sweep.model_validate(table)
    except ValidationError as error:
        raise CaseError(describe(error, table, Sweep)) from error


def _base(sweep: Sweep, file: Path) -> dict[str, Any]:
    """The base case as a table that loads from anywhere, with the keys that the sweep sets in every case."""
    beside = file.parent / Path(sweep.base).expanduser()
    bundled = bundled_cases()
    if not beside.exists() and sweep.base not in bundled:
        raise CaseError(
            f'base = "{sweep.base}": there is no {beside}, and no bundled case of that name'
            f"{suggestion(sweep.base, bundled)}; bundled cases are {listed(bundled)}"
        )
    found = find_case(beside if beside.exists() else sweep.base)
    table = read_toml(found)
    table["folder"] = str((found.parent / str(table.get("folder", "."))).resolve())
    table.setdefault("name", default_name(found))
    table.pop("figure", None)  # a batch draws its own
    for key, value in sweep.set.items():
        try:
            set_key(table, key, value)
        except CaseError as error:
            raise CaseError([f'set."{key}": {message}' for message in error.messages]) from error
    return table


def _points(sweep: Sweep, base: Mapping[str, Any]) -> tuple[Point, ...]:
    """Every case of a sweep, validated."""
    choices = list(_choices(sweep))
    shown = [{name: value.shown for name, value in choice.items()} for choice in choices]
    names = unique_names(shown)
    cases, faults = [], dict[str, list[str]]()
    for name, choice in zip(names, choices, strict=True):
        try:
            cases.append(_case(sweep, base, {axis: value.of_case for axis, value in choice.items()}))
        except CaseError as error:
            for message in error.messages:
                faults.setdefault(message, []).append(name)
    if faults:
        raise CaseError([_in_cases(message, found, len(names)) for message, found in faults.items()])
    hashes = [family_hash(case) for case in cases]
    _refuse_twins(names, hashes)
    return tuple(Point(*parts) for parts in zip(names, shown, cases, hashes, strict=True))


class _Value(NamedTuple):
    """A value of an axis: as the case takes it, and as it is called."""

    of_case: Any
    shown: Any


def _choices(sweep: Sweep) -> Iterator[dict[str, _Value]]:
    """The values of the axes, by name, of each case; the last group of axes varies fastest."""
    values = {name: _named_values(name, axis, sweep.samples) for name, axis in sweep.axis.items()}
    random = tuple(name for name, axis in sweep.axis.items() if axis.random)
    groups = [*sweep.zip, random] if random else [*sweep.zip]
    group_of = {name: group for group in groups for name in group}
    ordered = dict.fromkeys(group_of.get(name, (name,)) for name in sweep.axis)
    rows = [list(zip(*(values[name] for name in group), strict=True)) for group in ordered]
    for chosen in product(*rows):
        pairs = zip(ordered, chosen, strict=True)
        found = {name: value for group, row in pairs for name, value in zip(group, row, strict=True)}
        yield {name: found[name] for name in sweep.axis}


def _named_values(name: str, axis: Axis, samples: Samples | None) -> list[_Value]:
    """The values of an axis with what they are called."""
    values = axis_values(name, axis, samples)
    return [_Value(*pair) for pair in zip(values, axis.names or values, strict=True)]


def _case(sweep: Sweep, base: Mapping[str, Any], values: Mapping[str, Any]) -> Case:
    """The base case with the values of the axes in their places."""
    table = copy.deepcopy(dict(base))
    for name, value in values.items():
        for key in sweep.axis[name].paths:
            try:
                set_key(table, key, copy.deepcopy(value))
            except CaseError as error:
                raise CaseError([f"axis.{name}: {key}: {message}" for message in error.messages]) from error
    return case_from_table(table)


def _in_cases(message: str, names: list[str], total: int) -> str:
    """A message with the cases that it is about; nothing is added where it is about all of them."""
    if len(names) == total:
        return message
    return f"case {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1 else "") + f": {message}"


def _refuse_clashes(axes: Mapping[str, Axis]) -> None:
    """No two axes set the same key, and none has the name of another column of results.csv."""
    owner = dict[str, str]()
    for name, axis in axes.items():
        if name in FIXED:
            raise ValueError(f"axis.{name}: results.csv has a column of that name already; choose another")
        for key in axis.paths:
            if key in owner:
                raise ValueError(f"axis.{name}: {key} is set by axis {owner[key]} already")
            owner[key] = name


def _refuse_wrong_zips(sweep: Sweep) -> None:
    """Zipped axes exist, are in one group only, and are equally long."""
    seen = set[str]()
    for group in sweep.zip:
        for name in group:
            if name not in sweep.axis:
                hint = suggestion(name, sweep.axis)
                raise ValueError(f"zip: there is no axis {name!r}{hint}; there are {listed(sweep.axis)}")
            if name in seen:
                raise ValueError(f"zip: axis {name} stands twice")
            if sweep.axis[name].random:
                raise ValueError(f"zip: axis {name} is random; random axes go together by themselves")
            seen.add(name)
        lengths = {name: len(axis_values(name, sweep.axis[name], None)) for name in group}
        if len({*lengths.values()}) > 1:
            found = ", ".join(f"{name} has {length}" for name, length in lengths.items())
            raise ValueError(f"zip: axes that go together need equally many values: {found}")


def _refuse_twins(names: list[str], hashes: list[str]) -> None:
    """No two cases are the same."""
    first = dict[str, str]()
    for name, digest in zip(names, hashes, strict=True):
        if digest in first:
            raise CaseError(f"two cases are the same: {first[digest]}, {name}; take one of the values away")
        first[digest] = name


def _refuse_unknown_outputs(sweep: Sweep, outputs: tuple[str, ...]) -> None:
    """Every output that is asked for is there."""
    asked = {f"plot.{name}.y": plot.y for name, plot in sweep.plot.items()}
    asked |= {f"outputs.{number}": output for number, output in enumerate(sweep.outputs)}
    faults = [
        f'{key} = "{output}": there is no such output{suggestion(output, outputs)}; there are {listed(outputs)}'
        for key, output in asked.items()
        if output not in outputs
    ]
    if faults:
        raise CaseError(faults)


def _refuse_wrong_figures(sweep: Sweep, points: tuple[Point, ...]) -> None:
    """Every figure asks for what the cases have."""
    cases, places = [point.case for point in points], [point.values for point in points]
    if faults := list(sweep_faults(sweep.figure, cases, places)):
        raise CaseError(faults)
