"""Progress over the cases of a batch: a bar on a terminal, a line a case elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from phantomnode.pipeline.one_case import DONE, UNFINISHED, Outcome
from phantomnode.pipeline.outputs import wall_time

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as RichProgress


class Progress(Protocol):
    """Something that is told of each case that ends."""

    def ended(self, name: str, outcome: Outcome) -> None:
        """A case has ended."""


@contextmanager
def progress_of(cases: int, console: Console | None) -> Iterator[Progress]:
    """The progress that suits the console, for so many cases; none without one."""
    if console is None:
        yield Silence()
    elif console.is_terminal and not console.is_dumb_terminal:
        with _bar(console) as bar:
            yield Bar(bar, cases)
    else:
        yield Lines(cases, console)


class Silence:
    """Nothing is shown."""

    def ended(self, name: str, outcome: Outcome) -> None:
        """A case has ended."""


class Lines:
    """A line for each case, for logs and pipes."""

    def __init__(self, cases: int, console: Console) -> None:
        self._cases, self._console, self._ended = cases, console, 0

    def ended(self, name: str, outcome: Outcome) -> None:
        """Print it."""
        self._ended += 1
        count = f"{self._ended:{len(str(self._cases))}} of {self._cases}"
        self._console.print(
            f"{count}  {describe(name, outcome)}", markup=False, highlight=False, soft_wrap=True
        )


class Bar:
    """A bar over all cases, with what failed above it."""

    def __init__(self, bar: RichProgress, cases: int) -> None:
        self._bar, self._task, self._failed = bar, bar.add_task("cases", total=cases, failed=""), 0

    def ended(self, name: str, outcome: Outcome) -> None:
        """Move the bar."""
        if outcome.status != DONE:
            self._failed += outcome.status not in UNFINISHED
            self._bar.console.print(describe(name, outcome), markup=False, highlight=False, soft_wrap=True)
        failed = f"[red]{self._failed} failed[/]" if self._failed else ""
        self._bar.update(self._task, advance=1, failed=failed)


def describe(name: str, outcome: Outcome) -> str:
    """How a case ended, in a line."""
    wall = wall_time(outcome.figures)
    took = f" in {wall:.3g} s" if wall is not None else ""
    return f"{name}: {outcome.status}{took}" + (f": {outcome.reason}" if outcome.reason else "")


def _bar(console: Console) -> RichProgress:
    """Cases done, the time so far and what is left of it."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining

    columns = BarColumn(bar_width=30), MofNCompleteColumn(), TextColumn("cases"), TimeElapsedColumn()
    return Progress(
        *columns, Remaining(), TextColumn("{task.fields[failed]}"), console=console, transient=True
    )
