"""What asks a run to end before its end: signals, and the time that a queue allows."""

from __future__ import annotations

import signal
import threading
import time
from types import FrameType, TracebackType
from typing import Any, NamedTuple

FINISHING = 5.0
"""Wall time that is kept for the last files of a run, s, beside that for its checkpoint."""


class WallLimit(NamedTuple):
    """Seconds of wall time that are allowed, and the reading of ``time.perf_counter`` from which they count."""

    seconds: float
    began: float


class Stopping:
    """Ctrl-C, SIGTERM and a wall limit end a run soon, with its files complete; a second signal at once.

    Python takes signals in the main thread only; in another one there is the wall limit only.

    Parameters
    ----------
    limit : WallLimit or None

    Attributes
    ----------
    slowest : float
        The longest that a checkpoint took so far, s.
    """

    def __init__(self, limit: WallLimit | None = None) -> None:
        self.slowest = 0.0
        self._signal = 0
        self._limit, self._moved = limit, False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Stopping:
        if threading.current_thread() is threading.main_thread():
            self._before = {
                number: signal.signal(number, self._ask) for number in (signal.SIGINT, signal.SIGTERM)
            }
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
        return self._signal > 0 or self._out_of_time()

    def reason(self) -> str:
        """Why it was to end."""
        if self._signal == 0 and self._limit is not None and self._out_of_time():
            return f"the wall limit of {self._limit.seconds:g} s is near"
        name = f" ({signal.Signals(self._signal).name})" if self._signal else ""
        return f"a signal{name} asked the run to end"

    def _out_of_time(self) -> bool:
        if self._limit is None or not self._moved:
            return False
        seconds, began = self._limit
        kept = min(0.5 * seconds, FINISHING + 3.0 * self.slowest)
        return time.perf_counter() > began + seconds - kept

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self._signal:
            raise KeyboardInterrupt
        self._signal = number
