"""The product's compiled loop on a prepared case, from any of its states on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.prepare import Prepared
from phantomnode.solver.explicit import copied
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import DONE, advance, initial_state
from phantomnode.solver.model import Model, State

Floats = NDArray[np.float64]


def started(prepared: Prepared, velocity: Floats) -> Callable[[int], None]:
    """A function that takes a number of steps, each time from where the last ones ended.

    The case has no load that changes with time and no prescribed motion.
    """
    model, layout = prepared.model, prepare_layout(prepared.model)
    state = initial_state(model, velocity, layout)

    def go(steps: int) -> None:
        expect_done(advance(model, layout, state, prepared.dt, np.zeros((steps, 0))))

    go(0)
    return go


def from_state(model: Model, state: State, dt: float, increments: Floats) -> Callable[[], None]:
    """A function that takes the same steps again and again, from a state that stays as it is.

    increments: (steps, channels), m, of the prescribed motions.
    """
    layout = prepare_layout(model)

    def go() -> None:
        expect_done(advance(model, layout, copied(state), dt, increments))

    return go


def expect_done(status: int) -> None:
    """A loop that stopped early has not done the work that its time is divided by."""
    if status != DONE:
        raise RuntimeError("an element was inverted: the steps that were to be timed were not taken")
