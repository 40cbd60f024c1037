"""What asks a run or a batch to end before its end: signals, the time that a queue allows, whoever ordered it."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, NamedTuple

from phantomnode.pipeline.durations import limit_option

FINISHING = 5.0
"""Wall time that is kept for the last files of a run, s, beside that for its checkpoint."""
KINDS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Ctrl-C, the end that a system or a queue asks for, a terminal that closes; Windows has not all of them."""


class WallLimit(NamedTuple):
    """Seconds of wall time that are allowed, and the reading of ``time.perf_counter`` from which they count."""

    seconds: float
    began: float


def wall_limit_from(limit: str | WallLimit | None, began: float) -> WallLimit | None:
    """A wall limit as the user wrote it, from a reading of ``time.perf_counter`` on.

    Raises
    ------
    CaseError
        Where it is no time.
    """
    if isinstance(limit, str):
        return WallLimit(limit_option(limit), began)
    return limit


class Stopping:
    """Signals and a wall limit end a run soon, with its files complete; a second signal at once.

    Where this process was started to outlive its terminal (nohup), it does. Python takes signals in the main
    thread only; in another one there are the wall limit and ``ordered`` only.

    Parameters
    ----------
    limit : WallLimit or None
    ordered : callable
        Whether somebody else asks the run to end, such as the batch that it is a case of.
    kept : float, s
        Wall time to keep for the last files.

    Attributes
    ----------
    slowest : float
        The longest that a checkpoint took so far, s.
    """

    def __init__(
        self,
        limit: WallLimit | None = None,
        ordered: Callable[[], bool] = lambda: False,
        kept: float = FINISHING,
    ) -> None:
        self.slowest = 0.0
        self._ordered, self._kept = ordered, kept
        self._signal = 0
        self._limit, self._moved = limit, False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Stopping:
        if threading.current_thread() is threading.main_thread():
            numbers = [getattr(signal, kind) for kind in KINDS if hasattr(signal, kind)]
            if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
                numbers.remove(signal.SIGHUP)
            self._before = {number: signal.signal(number, self._ask) for number in numbers}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def moved(self) -> None:
        """The run got further; before that no wall limit ends it, so that resumed runs come to an end."""
        self._moved = True

    def asked(self) -> bool:
        """Whether the run is to end."""
        return self._signal > 0 or self._ordered() or self._out_of_time()

    def reason(self) -> str:
        """Why it was to end."""
        if self._signal == 0 and self._limit is not None and self._out_of_time():
            return f"the wall limit of {self._limit.seconds:g} s is near"
        if self._signal == 0 and self._ordered():
            return "the batch that it belongs to ends"
        name = f" ({signal.Signals(self._signal).name})" if self._signal else ""
        return f"a signal{name} asked for the end"

    def _out_of_time(self) -> bool:
        if self._limit is None or not self._moved:
            return False
        seconds, began = self._limit
        kept = min(0.5 * seconds, self._kept + 3.0 * self.slowest)
        return time.perf_counter() > began + seconds - kept

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self._signal:
            raise KeyboardInterrupt
        self._signal = number
