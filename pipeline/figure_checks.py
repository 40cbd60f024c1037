"""What is wrong with the figures of a case or of a sweep, told before anything runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.figure_tables import TOTAL, Figure
from phantomnode.pipeline.messages import listed, shown, suggestion
from phantomnode.pipeline.names import word
from phantomnode.pipeline.quantities import quantity

if TYPE_CHECKING:
    from phantomnode.pipeline.schema import Case

MISSED = 0.01
"""A frame further from the time that was asked for than this part of the run is another moment."""
WHOLE = (
    "time", "kinetic", "internal", "hourglass", "contact", "external_work", "energy_error", "friction", "damping",
    "smallest_j", "stable_step", TOTAL,
)  # fmt: skip
"""Columns that every run has, and the total."""


def case_faults(case: Case) -> Iterator[str]:
    """What is wrong with the figures of a case; each message starts with its key."""
    for name, figure in case.figure.items():
        if figure.where:
            yield f"figure.{name}.where: chooses cases of a sweep; a case is drawn with all its variants"
        yield from (f"figure.{name}.{fault}" for fault in _faults(figure, case))


def sweep_faults(
    figures: Mapping[str, Figure], cases: Sequence[Case], places: Sequence[Mapping[str, Any]]
) -> Iterator[str]:
    """What is wrong with the figures of a sweep; ``places`` are the values of the axes of each case."""
    for name, figure in figures.items():
        key = f"figure.{name}"
        if unknown := [axis for axis in figure.where if axis not in places[0]]:
            hint = suggestion(unknown[0], places[0])
            yield f"{key}.where: there is no axis {unknown[0]!r}{hint}; there are {listed(places[0])}"
            continue
        for axis, wanted in figure.where.items():
            values = dict.fromkeys(word(place[axis]) for place in places)
            if missing := [value for value in words(wanted) if value not in values]:
                yield f"{key}.where.{axis}: no case has {missing[0]}; there are {listed(values)}"
        found = [case for case, place in zip(cases, places, strict=True) if fits(figure.where, place)]
        yield from dict.fromkeys(f"{key}.{fault}" for case in found for fault in _faults(figure, case))


def fits(where: Mapping[str, Any], values: Mapping[str, Any]) -> bool:
    """Whether a case is among those that are asked for; 100 and 100.0 are the same value, and so is a name."""
    return all(word(values[axis]) in words(wanted) for axis, wanted in where.items())


def words(wanted: Any) -> list[str]:
    """The values that are asked for, one or each of a list, as they stand in names."""
    return [word(value) for value in wanted] if isinstance(wanted, list | tuple) else [word(wanted)]


def _faults(figure: Figure, case: Case) -> Iterator[str]:
    """What a case does not have."""
    if figure.quantity is not None:
        try:
            quantity(figure.quantity)
        except CaseError as error:
            yield f"quantity: {error}"
    if figure.kind == "pressure" and not case.contact:
        yield "kind: there is no contact pair whose pressure could be drawn"
    elif figure.pair is not None and figure.pair not in case.contact:
        hint = suggestion(figure.pair, case.contact)
        yield f"pair = {shown(figure.pair)}: there is no such contact pair{hint}; there are {listed(case.contact)}"
    known = [*WHOLE, *_named_columns(case)]
    for column in figure.columns:
        if column not in known:
            yield (
                f"columns: history.csv will have no column {column!r}{suggestion(column, known)}; there are "
                f"{listed(known)}"
            )
    yield from _missed(figure, case)


def _missed(figure: Figure, case: Case) -> Iterator[str]:
    """Times at which there will be no frame."""
    end, count = case.time.end, case.output.fields.count
    for time in figure.times:
        frame = min(round(time * count / end), count) * end / count
        if abs(frame - time) > MISSED * end:
            yield (
                f"times: at {time:g} s there will be no frame, the nearest is at {frame:g} s; choose "
                f"output.fields.count = {count} and time.end = {end:g} such that one falls on it"
            )


def _named_columns(case: Case) -> Iterator[str]:
    """The columns of pairs, boundaries and bodies."""
    values = ("fx", "fy", "ix", "iy")
    for pair, table in case.contact.items():
        yield from (f"contact.{pair}.{v}" for v in (*values, *(("tx", "ty") if table.friction else ())))
    for name in (*case.boundary, *case.rigid):
        yield from (f"reaction.{name}.{v}" for v in ("fx", "fy"))
    for body in case.body:
        yield from (f"body.{body}.{v}" for v in ("ux", "uy", "vx", "vy", "cx", "cy", "px", "py", "l"))
