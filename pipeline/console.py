"""How a command begins and ends: its console, its exit code, faults of the input as messages."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

DONE, INPUT_AT_FAULT, STOPPED, SOME_FAILED, INTERRUPTED = 0, 2, 3, 4, 130
"""Exit codes: done; the input is at fault; stopped by a guard; some cases of a batch failed; interrupted."""


def guarded(command: Callable[[Console], int]) -> int:
    """Run a command; faults of the input end as a message and an exit code, not as a traceback."""
    from rich.console import Console

    from phantomnode.geometry.errors import GeometryError
    from phantomnode.pipeline.errors import CaseError

    _let_terminate()
    try:
        return command(Console())
    except (CaseError, GeometryError, OSError) as error:
        if os.environ.get("PHANTOMNODE_DEBUG"):
            raise
        messages = error.messages if isinstance(error, CaseError) else (str(error),)
        stderr = Console(stderr=True, highlight=False, soft_wrap=True)
        for message in messages:
            stderr.print("[bold red]error:[/]", end=" ")
            stderr.print(message, markup=False)
        return INPUT_AT_FAULT
    except KeyboardInterrupt:
        Console(stderr=True).print("interrupted")
        return INTERRUPTED


def _let_terminate() -> None:
    """SIGTERM ends a command as Ctrl-C does; a run that is under way looks at both itself."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
