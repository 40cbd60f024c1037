"""How a command begins and ends: its console, its exit code, faults of the input as messages."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from rich.console import Console

DONE, INPUT_AT_FAULT, STOPPED, SOME_FAILED, INTERRUPTED = 0, 2, 3, 4, 130
"""Exit codes: done; the input is at fault; stopped by a guard; some cases of a batch failed; interrupted."""


@Parameter(name="*")
@dataclass(frozen=True)
class Talk:
    """How much a command says."""

    quiet: Annotated[
        bool,
        Parameter(name=("--quiet", "-q"), negative=(), show_default=False, help="Say nothing but errors."),
    ] = False
    verbose: Annotated[
        bool,
        Parameter(
            name=("--verbose", "-v"),
            negative=(),
            show_default=False,
            help="Say what is done and how long it takes.",
        ),
    ] = False


TALK = Talk()
LOG_WIDTH = 120
"""Columns where the output is no terminal and COLUMNS does not say: tables need more than 80."""


class _Told(logging.Handler):
    """Prints what the program logs, with the seconds since it began; a progress bar stays below."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console, self._began = console, time.perf_counter()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        clock = f"{time.perf_counter() - self._began:7.2f} s  "
        for line in self.format(record).splitlines():
            self._console.print(
                clock + line.rstrip(), style="dim", soft_wrap=True, markup=False, highlight=False
            )


def guarded(command: Callable[[Console], int], talk: Talk = TALK) -> int:
    """Run a command; faults of the input end as a message and an exit code, not as a traceback."""
    from rich.console import Console

    from phantomnode.geometry.errors import GeometryError
    from phantomnode.pipeline.errors import CaseError

    _let_terminate()
    stderr = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        if talk.quiet and talk.verbose:
            raise CaseError("--quiet and --verbose: take one")
        console = Console(quiet=talk.quiet)
        if not console.is_terminal and "COLUMNS" not in os.environ:
            console = Console(quiet=talk.quiet, width=LOG_WIDTH)
        with _told(console, talk):
            return command(console)
    except (CaseError, GeometryError, OSError) as error:
        if os.environ.get("PHANTOMNODE_DEBUG"):
            raise
        messages = error.messages if isinstance(error, CaseError) else (str(error),)
        for message in messages:
            stderr.print("[bold red]error:[/]", end=" ")
            stderr.print(message, markup=False)
        return INPUT_AT_FAULT
    except KeyboardInterrupt:
        stderr.print("interrupted")
        return INTERRUPTED


@contextmanager
def _told(console: Console, talk: Talk) -> Iterator[None]:
    """With --verbose, what the program logs is printed."""
    if not talk.verbose:
        yield
        return
    logger, handler = logging.getLogger("phantomnode"), _Told(console)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)


def _let_terminate() -> None:
    """SIGTERM ends a command as Ctrl-C does; a run that is under way looks at both itself."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
