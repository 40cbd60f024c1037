"""Progress of a run: a live bar on a terminal, a line every tenth elsewhere."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from phantomnode.pipeline.observer import Ending
from phantomnode.pipeline.prepare import Prepared

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame


class LiveBar:
    """A bar with time, energies, energy error, contact force, steps a second and remaining time."""

    def __init__(self, prepared: Prepared, steps: int, console: Console, first: int = 0) -> None:
        self._end, self._began, self._first = prepared.case.time.end, time.perf_counter(), first
        self._bar = Progress(
            TextColumn("{task.fields[clock]}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.fields[state]}"),
            TimeRemainingColumn(),
            console=console,
            refresh_per_second=4,
            transient=True,
        )
        self._task = self._bar.add_task("", total=steps, clock="starting", state="loading the kernels")
        self._bar.start()

    def due(self, step: int) -> bool:
        """Every frame; rich draws at most four times a second."""
        return True

    def frame(self, frame: Frame) -> None:
        """Show the state."""
        rate = (frame.step - self._first) / (time.perf_counter() - self._began)
        clock = f"{frame.time * 1e3:.3f} of {self._end * 1e3:g} ms"
        state = f"{describe(frame)}  {rate:.0f} steps/s"
        self._bar.update(self._task, completed=frame.step, clock=clock, state=state)

    def finish(self, ending: Ending) -> None:
        """Take the bar away."""
        self.close()

    def close(self) -> None:
        """Give the terminal back, also after an error; closing twice is fine."""
        self._bar.stop()


class PlainLines:
    """A line at every tenth of the run, for logs and pipes."""

    def __init__(self, steps: int, console: Console) -> None:
        self._steps, self._console, self._next = max(steps, 1), console, 0.0

    def due(self, step: int) -> bool:
        """Whether another tenth is done."""
        return step >= self._next * self._steps

    def frame(self, frame: Frame) -> None:
        """Print the state."""
        part = frame.step / self._steps
        self._next = np.floor(10.0 * part + 1.0) / 10.0
        self._console.print(
            f"{part:4.0%}  t {frame.time * 1e3:.4g} ms  {describe(frame)}", highlight=False, soft_wrap=True
        )

    def finish(self, ending: Ending) -> None:
        """Nothing to put away."""

    def close(self) -> None:
        """Nothing to give back."""


def watcher(
    prepared: Prepared, steps: int, console: Console, resumed: Frame | None = None
) -> LiveBar | PlainLines:
    """The progress observer that suits the console."""
    first = resumed.step if resumed is not None else 0
    live = console.is_terminal and not console.is_dumb_terminal
    return LiveBar(prepared, steps, console, first) if live else PlainLines(steps, console)


def describe(frame: Frame) -> str:
    """Energies, energy error and contact force of a frame in one short line."""
    force = float(np.max(np.hypot(*frame.pair_force.T), initial=0.0))
    return (
        f"kin {frame.energies.kinetic:.3g} int {frame.energies.internal:.3g} J/m  "
        f"err {frame.energy_error:.1e}  F {force:.3g} N/m"
    )
