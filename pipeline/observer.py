"""Observers see the state of a run at chosen times: history, fields, progress, the tally of the summary."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame


class Ending(NamedTuple):
    """How a run ended.

    status: "done", "stopped" (by a guard) or "interrupted" (by the user or the system); reason and advice:
    what happened and what to do, "" where it is done; frame: the last state that can be trusted, None where
    the run ended before its first.
    """

    status: str
    reason: str
    advice: str
    frame: Frame | None


class Observer(Protocol):
    """Something that looks at a run and never changes it."""

    def due(self, step: int) -> bool:
        """Whether it wants the frame of this step."""

    def frame(self, frame: Frame) -> None:
        """Look at the state at a step that was due."""

    def finish(self, ending: Ending) -> None:
        """Look at the last state, however the run ended; called exactly once."""


class Sampled(ABC):
    """Observers that take each due frame once, the last one of the run included."""

    def __init__(self, steps: frozenset[int]) -> None:
        self._steps = steps
        self._seen = -1

    def due(self, step: int) -> bool:
        """Whether the step is one of the samples."""
        return step in self._steps

    def frame(self, frame: Frame) -> None:
        """Take a frame, unless it was taken already."""
        if frame.step > self._seen:
            self._seen = frame.step
            self.take(frame)

    def finish(self, ending: Ending) -> None:
        """Take the last frame too: after a stop it is the one that shows why."""
        if ending.frame is not None:
            self.frame(ending.frame)

    @abstractmethod
    def take(self, frame: Frame) -> None:
        """What the observer does with a frame."""


def sample_steps(steps: int, count: int) -> frozenset[int]:
    """Steps of ``count`` samples at equal distances, as far as whole steps allow, and the start."""
    return frozenset(int(step) for step in np.round(np.linspace(0, steps, min(count, steps) + 1)))
