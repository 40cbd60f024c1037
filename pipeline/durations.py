"""Lengths of time as users write them: how often to write a checkpoint, how long a queue lets a run go on."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Literal, NamedTuple, TypeVar

from phantomnode.pipeline.errors import CaseError

Value = TypeVar("Value")

SIMULATED = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
WALL = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
EVERY = '"0.5 ms" (ns, us, ms, s: simulated time), "1000 steps", or wall time as "10 min" (min, h, d) or "30 s wall"'
LIMIT = '"90 min" (s, min, h, d) or "HH:MM:SS" or "D-HH:MM:SS"'

NUMBER = r"(\d+\.?\d*(?:e[-+]?\d+)?|\.\d+(?:e[-+]?\d+)?)"


class Every(NamedTuple):
    """An interval: of simulated time, s, of steps, or of wall time, s."""

    kind: Literal["simulated", "steps", "wall"]
    length: float


def parse_every(text: str) -> Every:
    """The interval that a text names.

    Raises
    ------
    ValueError
        Saying what can be written.
    """
    found = re.fullmatch(rf"{NUMBER}\s*([a-z]+)(\s+wall)?", text.strip().lower())
    if found:
        number, unit, wall = float(found[1]), found[2], bool(found[3])
        if unit in ("step", "steps") and not wall and number >= 1.0 and number == int(number):
            return Every("steps", number)
        if 0.0 < number < math.inf:
            if unit in SIMULATED and not wall:
                return Every("simulated", number * SIMULATED[unit])
            if unit in WALL:
                return Every("wall", number * WALL[unit])
    raise ValueError(f'"{text}" is no interval; write {EVERY}')


def parse_limit(text: str) -> float:
    """The wall time that a text names, s.

    Raises
    ------
    ValueError
        Saying what can be written.
    """
    clean, seconds = text.strip().lower(), 0.0
    if clock := re.fullmatch(r"(?:(\d+)-)?(\d+):(\d\d):(\d\d)", clean):
        days, hours, minutes, rest = (int(part or 0) for part in clock.groups())
        seconds = 86400.0 * days + 3600.0 * hours + 60.0 * minutes + rest
    elif (found := re.fullmatch(rf"{NUMBER}\s*([a-z]+)", clean)) and found[2] in WALL:
        seconds = float(found[1]) * WALL[found[2]]
    if not 0.0 < seconds < math.inf:
        raise ValueError(f'"{text}" is no wall time; write {LIMIT}')
    return seconds


def every_option(text: str) -> Every:
    """The value of --checkpoint-every.

    Raises
    ------
    CaseError
        Where it is no interval.
    """
    return _option("--checkpoint-every", parse_every, text)


def limit_option(text: str) -> float:
    """The value of --wall-limit, s.

    Raises
    ------
    CaseError
        Where it is no time.
    """
    return _option("--wall-limit", parse_limit, text)


def _option(name: str, parse: Callable[[str], Value], text: str) -> Value:
    """The value of an option; what is wrong with it is told with its name."""
    try:
        return parse(text)
    except ValueError as error:
        raise CaseError(f"{name}: {error}") from error


class Schedule:
    """When the next checkpoint is due.

    Parameters
    ----------
    every : Every
    step, time, wall : int, float, float
        Where the run begins: steps done, simulated time, s, clock, s.
    """

    def __init__(self, every: Every, step: int, time: float, wall: float) -> None:
        self._every, self._next = every, 0.0
        self._wall = wall
        self.written(step, time, wall)

    def due(self, step: int, time: float, wall: float) -> bool:
        """Whether one is due."""
        return self._place(step, time, wall) >= self._next

    def written(self, step: int, time: float, wall: float) -> None:
        """One was written: the next is due at the next whole interval, of wall time an interval from now."""
        length, place = self._every.length, self._place(step, time, wall)
        if self._every.kind == "wall":
            self._next = place + length
        else:
            self._next = (math.floor(place / length * (1.0 + 1e-12)) + 1.0) * length * (1.0 - 1e-12)

    def _place(self, step: int, time: float, wall: float) -> float:
        return {"simulated": time, "steps": float(step), "wall": wall - self._wall}[self._every.kind]
