"""Frames are shown in another thread: in order, each once, and what fails there fails the run."""

from __future__ import annotations

import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from numba import config

from phantomnode.pipeline.background import WAITING, Background
from phantomnode.pipeline.observer import Ending, Sampled
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import advance, initial_state


class Notes(Sampled):
    """Notes the steps that it takes, as fast as a gate lets it; fails at one of them."""

    def __init__(self, steps, fails_at=-1):
        super().__init__(frozenset(steps))
        self.gate = threading.Event()
        self.gate.set()
        self.taken, self.threads, self.fails_at = [], set(), fails_at

    def take(self, frame):
        self.gate.wait(10.0)
        if frame.step == self.fails_at:
            raise OSError(28, "No space left on device")
        self.taken.append(frame.step)
        self.threads.add(threading.current_thread())


def frame_at(step):
    return SimpleNamespace(step=step)


def show(background, steps):
    for step in steps:
        if background.due(step):
            background.frame(frame_at(step))


def done(step):
    return Ending("done", "", "", frame_at(step))


def test_every_observer_takes_its_own_frames_in_order_and_the_last_one():
    even, third = Notes(range(0, 40, 2)), Notes(range(0, 40, 3))
    background = Background([even, third])
    show(background, range(40))
    background.finish(done(39))
    assert even.taken == [*range(0, 40, 2), 39]
    assert third.taken == [*range(0, 40, 3)]
    assert threading.current_thread() not in even.threads | third.threads and len(even.threads) == 1


def test_the_run_goes_on_while_frames_are_underway_and_waits_for_no_more_than_these():
    slow = Notes(range(10))
    slow.gate.clear()
    background = Background([slow])
    show(background, range(WAITING))  # returns although nothing can be taken
    assert slow.taken == []
    opening = threading.Timer(0.05, slow.gate.set)
    opening.start()
    background.frame(frame_at(WAITING))  # has to wait for the first
    assert slow.taken[:1] == [0]
    background.finish(done(WAITING))
    assert slow.taken == list(range(WAITING + 1))


def test_an_error_is_raised_where_the_next_frame_is_due_and_nothing_is_written_after_it():
    full = Notes(range(10), fails_at=2)
    background = Background([full])
    with pytest.raises(OSError, match="No space left"):
        show(background, range(10))
    background.close()
    assert full.taken == [0, 1]


def test_an_error_in_the_last_frame_is_raised_at_the_end():
    full = Notes([5], fails_at=5)
    background = Background([full])
    show(background, range(6))
    with pytest.raises(OSError, match="No space left"):
        background.finish(done(5))
    background.close()
    background.close()


def test_what_is_underway_is_written_also_where_the_run_fails():
    notes = Notes(range(WAITING))
    notes.gate.clear()
    background = Background([notes])
    show(background, range(WAITING))
    notes.gate.set()
    background.close()
    assert notes.taken == list(range(WAITING))


def test_the_compiled_loop_runs_without_pythons_lock(handmade):
    """With hand-overs of the lock put off for good, another thread counts only where the loop lets it go."""
    if config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    model, layout = handmade.model, prepare_layout(handmade.model)
    state = initial_state(model, handmade.velocity, layout)
    increments = np.zeros((20_000, model.channels))
    advance(model, layout, state, 1e-9, increments[:1])  # compiled
    counted, stop, interval = [0], threading.Event(), sys.getswitchinterval()

    def count():
        while not stop.is_set():
            counted[0] += 1
            time.sleep(0.0)  # gives the lock back

    thread = threading.Thread(target=count)
    sys.setswitchinterval(100.0)
    try:
        thread.start()
        during = []
        for _ in range(10):
            before = counted[0]
            advance(model, layout, state, 1e-9, increments)
            during.append(counted[0] - before)
    finally:
        sys.setswitchinterval(interval)
        stop.set()
        thread.join()
    assert max(during) > 0
