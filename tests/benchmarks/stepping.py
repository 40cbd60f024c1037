"""The product's compiled loop on a prepared case, from any of its states on."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import set_num_threads
from numpy.typing import NDArray

from phantomnode.pipeline.prepare import Prepared
from phantomnode.solver.explicit import copied
from phantomnode.solver.layout import Layout, prepare_layout
from phantomnode.solver.leapfrog import DONE, advance, initial_state
from phantomnode.solver.model import Model, State

Floats = NDArray[np.float64]


class Loop(NamedTuple):
    """What the loop reads and writes, and its time step, s."""

    model: Model
    layout: Layout
    state: State
    dt: float

    def go(self, increments: Floats) -> None:
        """Take a step for each row of (steps, channels) increments of the prescribed motions, m.

        A loop that stops early has not done the work that its time is divided by.
        """
        if self.layout.threads is not None:
            set_num_threads(self.layout.threads)
        if advance(self.model, self.layout, self.state, self.dt, increments) != DONE:
            raise RuntimeError("an element was inverted: the steps that were to be timed were not taken")

    def take(self, steps: int) -> None:
        """The same without prescribed motions."""
        self.go(np.zeros((steps, 0)))


def started(prepared: Prepared, velocity: Floats, threads: int = 1) -> Loop:
    """The loop at the start of a case without prescribed motions or loads, its forces evaluated."""
    layout = prepare_layout(prepared.model, threads)
    loop = Loop(prepared.model, layout, initial_state(prepared.model, velocity, layout), prepared.dt)
    loop.take(0)
    return loop


def from_state(model: Model, state: State, dt: float, increments: Floats) -> Callable[[], None]:
    """A function that takes the same steps again and again, from a state that stays as it is."""
    layout = prepare_layout(model)
    return lambda: Loop(model, layout, copied(state), dt).go(increments)
