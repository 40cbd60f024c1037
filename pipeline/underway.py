"""What this process runs of which batch, and the batches that it was asked to end."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.Lock()
_running: dict[str, set[str]] = {}
_ending: set[str] = set()


@contextmanager
def underway(batch: str, folder: str) -> Iterator[None]:
    """Note that a case of a batch runs in a folder."""
    with _lock:
        _running.setdefault(batch, set()).add(folder)
    try:
        yield
    finally:
        with _lock:
            _running[batch].discard(folder)


def end_batch(batch: str) -> list[str]:
    """Ask the cases of a batch that run in this process to end, and those that come to leave at once.

    Returns the folders of those that run. The driver of a batch calls it in every worker.
    """
    with _lock:
        _ending.add(batch)
        return sorted(_running.get(batch, ()))


def is_ending(batch: str) -> bool:
    """Whether the cases of a batch are to end; a run asks a few times a second."""
    return batch in _ending
