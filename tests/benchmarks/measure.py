"""Times by the CPU clock and by the wall clock, medians of several, and the figures made of them."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
"""The checkout: child processes run the product that it holds."""


class Seconds(NamedTuple):
    """What something took: cpu of all threads, wall, s."""

    cpu: float
    wall: float


@dataclass(frozen=True)
class Figure:
    """One line of the table.

    name; cpu, wall: the value by either clock (None where a clock has no part in it); unit; note: what else
    there is to say; spread: (largest - smallest)/median of the CPU times it is made of.
    """

    name: str
    cpu: float | None
    wall: float | None
    unit: str
    note: str = ""
    spread: float | None = None


@dataclass(frozen=True)
class Plan:
    """How much to do: repeats of each measurement, and the part of the full size, 1 but in the tests."""

    repeats: int = 5
    scale: float = 1.0

    def sized(self, count: float, least: int = 1) -> int:
        """That part of a full count."""
        return max(least, round(count * self.scale))

    @property
    def processes(self) -> int:
        """Repeats of whole processes, which take long: at most 3."""
        return min(self.repeats, 3)


def clocked(action: Callable[[], Any]) -> Seconds:
    """What one call takes."""
    wall, cpu = time.perf_counter(), time.process_time()
    action()
    return Seconds(time.process_time() - cpu, time.perf_counter() - wall)


def medians(runs: Sequence[Seconds]) -> Seconds:
    """Median of either clock."""
    return Seconds(*(statistics.median(column) for column in zip(*runs, strict=True)))


def spread(runs: Sequence[Seconds]) -> float:
    """(largest - smallest)/median of the CPU times."""
    times = [run.cpu for run in runs]
    return (max(times) - min(times)) / statistics.median(times)


def repeated(action: Callable[[], Any], repeats: int) -> list[Seconds]:
    """What each of several calls takes; one call before them compiles and warms the caches."""
    action()
    return [clocked(action) for _ in range(repeats)]


def alternating(actions: Sequence[Callable[[], Any]], repeats: int) -> list[list[Seconds]]:
    """The same for several actions in turns, so that whatever slows the machine slows them all."""
    for action in actions:
        action()
    rounds = [[clocked(action) for action in actions] for _ in range(repeats)]
    return [list(column) for column in zip(*rounds, strict=True)]


def rate(name: str, work: float, unit: str, runs: Sequence[Seconds], note: str = "") -> Figure:
    """Work per second."""
    seconds = medians(runs)
    return Figure(name, work / seconds.cpu, work / seconds.wall, unit, note, spread(runs))


def duration(name: str, runs: Sequence[Seconds], note: str = "") -> Figure:
    """Seconds."""
    seconds = medians(runs)
    return Figure(name, seconds.cpu, seconds.wall, "s", note, spread(runs))


class Process(NamedTuple):
    """A child process that has ended: what it took, what it printed."""

    seconds: Seconds
    output: str


def python(*arguments: str, program: str = sys.executable) -> Process:
    """Run Python on the checkout.

    Raises
    ------
    subprocess.CalledProcessError
        Where it fails, with what it wrote.
    """
    paths = [str(ROOT / ".typing"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    command = [program, *arguments]
    began = time.perf_counter()
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=ROOT
    )
    with child:
        assert child.stdout is not None
        output = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - began
    if child.returncode:
        raise subprocess.CalledProcessError(child.returncode, command, output)
    return Process(Seconds(usage.ru_utime + usage.ru_stime, wall), output)
