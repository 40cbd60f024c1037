"""Writes the checkpoints of a run: when one is due, what it holds, that all it refers to is on the disk."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from phantomnode.pipeline.checkpoint import Identity, Tree, frame_tree, write_checkpoint
from phantomnode.pipeline.durations import Every, Schedule
from phantomnode.pipeline.fields import Fields
from phantomnode.pipeline.profile import ProfileWriter
from phantomnode.pipeline.start import Start
from phantomnode.pipeline.stopping import Stopping

if TYPE_CHECKING:
    from phantomnode.pipeline.background import Background
    from phantomnode.solver.explicit import Frame

LOG = logging.getLogger(__name__)


class Keeper:
    """Writes checkpoints.

    The loop goes on meanwhile: what changes with it is copied at once, and the rest is written behind the frames
    that are underway, in the thread that writes these.

    Parameters
    ----------
    folder : Path
        Of the results.
    identity : Identity
    every : Every
    start : Start
        The observers, and where the run began.
    background : Background
        The thread in which the fields and profiles are written.
    stopping : Stopping
        Is told how long a checkpoint takes.
    began : float, s
        Reading of ``time.perf_counter`` at the start of the run.
    """

    def __init__(
        self,
        folder: Path,
        identity: Identity,
        every: Every,
        start: Start,
        background: Background,
        stopping: Stopping,
        began: float,
    ) -> None:
        self._folder, self._identity, self._start = folder, identity, start
        self._background, self._stopping, self._began = background, stopping, began
        at = start.frame
        self._written = at.step if at is not None else -1
        step, simulated = (at.step, at.time) if at is not None else (0, 0.0)
        self._schedule = Schedule(every, step, simulated, time.perf_counter())

    def look(self, frame: Frame, stepping: float) -> None:
        """Write a checkpoint if one is due; ``stepping`` is the wall time of the steps so far, s."""
        if self._schedule.due(frame.step, frame.time, time.perf_counter()):
            self.write(frame, stepping)
            self._schedule.written(frame.step, frame.time, time.perf_counter())

    def write(self, frame: Frame, stepping: float) -> None:
        """Write a checkpoint from which the run goes on behind this frame."""
        if frame.step == self._written:
            return
        self._written = frame.step
        start, past = self._start, self._start.past
        tree = {
            "identity": list(self._identity),
            "frame": frame_tree(frame, resumable=True),
            "tally": start.tally.saved(),
            "history": start.history.saved(),
            "wall": past.wall + time.perf_counter() - self._began,
            "steps": past.steps + stepping,
            "resumed_at": list(past.resumed_at),
        }
        self._background.do(lambda: self._save(frame.step, tree))

    def _save(self, step: int, tree: Tree) -> None:
        began = time.perf_counter()
        files = {"fields": self._start.fields, **_named(self._start.profiles)}
        for file in (self._start.history, *files.values()):
            file.reach_disk()
        tree["files"] = {name: file.saved() for name, file in files.items()}
        write_checkpoint(self._folder, step, tree)
        LOG.info("checkpoint at step %d, in %.2f s", step, time.perf_counter() - began)
        self._stopping.slowest = max(self._stopping.slowest, time.perf_counter() - began)


def _named(profiles: Mapping[str, ProfileWriter]) -> dict[str, Fields | ProfileWriter]:
    return {f"profile.{name}": profile for name, profile in profiles.items()}
