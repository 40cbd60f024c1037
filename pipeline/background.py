"""Observers that write files look at frames in a thread of their own, so that the run need not wait for them.

A frame is a copy of the state, and the compiled loop runs without Python's lock: while it takes the next steps,
the thread computes and writes what the last frame shows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

from phantomnode.pipeline.observer import Ending, Observer

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame

WAITING = 2
"""Frames on their way at most: then the run waits, so that a slow disk does not fill the memory."""


class Background:
    """Shows frames to observers in another thread, in order; what fails there fails the run.

    An error is raised where the next frame is due, or at the end; the observers see no frame after it.

    Parameters
    ----------
    observers : sequence of Observer
        Their ``due`` must depend on nothing that changes.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = observers
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="output")
        self._underway: deque[Future[None]] = deque()
        self._failed = False

    def due(self, step: int) -> bool:
        """Whether any of the observers wants the frame of this step."""
        return any(observer.due(step) for observer in self._observers)

    def frame(self, frame: Frame) -> None:
        """Have the observers look at a frame that is due; wait where too many are underway."""
        self.do(lambda: self._show(frame))

    def do(self, task: Callable[[], None]) -> None:
        """Do something behind the frames that are underway; wait where too much is."""
        while self._underway and (len(self._underway) == WAITING or self._underway[0].done()):
            self._underway.popleft().result()
        self._underway.append(self._thread.submit(self._unless_failed, task))

    def finish(self, ending: Ending) -> None:
        """Have the observers look at the last state, and wait until all is done."""
        self._underway.append(self._thread.submit(self._unless_failed, lambda: self._end(ending)))
        while self._underway:
            self._underway.popleft().result()
        self.close()

    def close(self) -> None:
        """End the thread after what is underway, also after an error elsewhere; closing twice is fine."""
        self._thread.shutdown()

    def _unless_failed(self, task: Callable[[], None]) -> None:
        """In the thread: nothing is written after a frame that could not be."""
        if self._failed:
            return
        try:
            task()
        except BaseException:
            self._failed = True
            raise

    def _show(self, frame: Frame) -> None:
        for observer in self._observers:
            if observer.due(frame.step):
                observer.frame(frame)

    def _end(self, ending: Ending) -> None:
        for observer in self._observers:
            observer.finish(ending)
