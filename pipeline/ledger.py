"""What became of the cases of a batch: results.csv, and the table that is shown."""

from __future__ import annotations

import csv
import io
import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.one_case import DONE, INTERRUPTED, RUNNING, UNFINISHED, WAITING, Outcome, known
from phantomnode.pipeline.outputs import CASE_COLUMNS, output_of, wall_time
from phantomnode.pipeline.sweep import Study
from phantomnode.pipeline.trust import doubtful, open_end

if TYPE_CHECKING:
    from rich.table import Table

STYLES = {DONE: "green", WAITING: "dim", RUNNING: "cyan", INTERRUPTED: "yellow"}
EVERY = 1.0
"""Least time between two writes of results.csv, s."""
MOST_ROWS = 200
"""Of the table that is shown; of more cases it shows those that are not done."""


class Ledger:
    """The outcomes of all cases, and the file that holds them.

    Parameters
    ----------
    study : Study
    folders : sequence of str
        The folder of each case, within that of the batch.
    outcomes : sequence of Outcome
        What is known before anything runs.
    """

    def __init__(self, study: Study, folders: Sequence[str], outcomes: Sequence[Outcome]) -> None:
        self.study, self.folders, self.outcomes = study, tuple(folders), list(outcomes)
        self._lines = [self._line(place) for place in range(len(self.outcomes))]
        self._written, self._changed = float("-inf"), True

    def enter(self, place: int, outcome: Outcome) -> None:
        """Note how a case ended, or that it runs."""
        self.outcomes[place] = outcome
        self._lines[place] = self._line(place)
        self._changed = True

    def unfinished(self) -> list[int]:
        """Places of the cases that have not ended."""
        return [place for place, outcome in enumerate(self.outcomes) if outcome.status in UNFINISHED]

    def look_again(self, folder: Path) -> None:
        """Read from their folders what has become of the cases that have not ended."""
        for place in self.unfinished():
            self.enter(place, known(folder / self.folders[place], self.study.points[place].hash))

    def count(self) -> Counter[str]:
        """How many cases there are of each status."""
        return Counter(outcome.status for outcome in self.outcomes)

    def write(self, folder: Path, *, now: bool = True) -> None:
        """Write results.csv in one step; without ``now``, where it changed and at most once a second."""
        if not now and (not self._changed or time.monotonic() < self._written + EVERY):
            return
        header = _csv([*CASE_COLUMNS, *self.study.sweep.axis, *self.study.outputs])
        write_atomically(folder / "results.csv", header + "".join(self._lines), durable=now)
        self._written, self._changed = time.monotonic(), False

    def table(self) -> Table:
        """The table of all cases: values, status, time, what came out."""
        from rich.table import Table

        table = Table(box=None, header_style="bold")
        for name in self.study.sweep.axis:
            table.add_column(name, justify="right")
        for name in ("status", "wall, s", *self.study.shown):
            broken = name.replace(".", ".\n")  # else it may break within a word
            table.add_column(broken, justify="left" if name == "status" else "right", overflow="fold")
        many = len(self.outcomes) > MOST_ROWS
        for point, outcome in zip(self.study.points, self.outcomes, strict=True):
            if many and outcome.status == DONE:
                continue
            style = STYLES.get(outcome.status, "red")
            outputs = (output_of(outcome.figures, name) for name in self.study.shown)
            shown = [_short(value) for value in (wall_time(outcome.figures), *outputs)]
            values = (_short(point.values[name]) for name in self.study.sweep.axis)
            table.add_row(*values, f"[{style}]{outcome.status}[/]{_doubt(outcome.figures)}", *shown)
        return table

    def _line(self, place: int) -> str:
        """A row of results.csv."""
        point, outcome = self.study.points[place], self.outcomes[place]
        inputs = [_text(point.values[name]) for name in self.study.sweep.axis]
        outputs = [_text(output_of(outcome.figures, name)) for name in self.study.outputs]
        folder, status, reason = self.folders[place], outcome.status, outcome.reason
        return _csv([point.name, folder, status, reason, point.hash, *inputs, *outputs])


def _doubt(figures: dict[str, Any]) -> str:
    """What stands behind the status of a case that wants a look, or that ends before contact does."""
    look, end = "look at it" if doubtful(figures) else "", open_end(figures)
    return "".join(f", {text}" for text in (look, end) if text)


def _csv(cells: Sequence[str]) -> str:
    """A line of a CSV file."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue()


def _text(value: Any) -> str:
    """A value for a program to read: all digits of a number, JSON of a list or table, nothing for None."""
    if value is None or isinstance(value, str):
        return value or ""
    return json.dumps(value)


def _short(value: Any) -> str:
    """A value for people to read."""
    from rich.markup import escape

    return f"{value:.5g}" if isinstance(value, float) else escape(_text(value))
