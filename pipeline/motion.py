"""Prescribed motions and loads, step by step, from functions of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

Kind = Literal["displacement", "velocity", "acceleration"]


@dataclass
class Channel:
    """One prescribed direction of one boundary.

    Attributes
    ----------
    kind : str
        What ``value`` gives: "displacement", m, "velocity", m/s, or "acceleration", m/s^2.
    value : callable
        (n,) values at (n,) times, s.
    initial_velocity : float, m/s
        Velocity at t = 0 from which an acceleration goes on.
    """

    kind: Kind
    value: Callable[[Floats], Floats]
    initial_velocity: float = 0.0
    _reached: tuple[int, float] = field(default=(0, 0.0), repr=False)

    def increments(self, first_step: int, steps: int, dt: float) -> Floats:
        """(steps,) Displacements over the steps that begin at times first_step * dt and on, m.

        Displacements are met exactly at every step; velocities are taken at mid-step; accelerations are
        summed as the central difference scheme does (half a kick at t = 0).
        """
        if self.kind == "displacement":
            return np.diff(self.value(_times(first_step, first_step + steps + 1, dt)))
        if self.kind == "velocity":
            return self.value(_times(first_step + 0.5, first_step + steps, dt)) * dt
        return self._from_acceleration(first_step, steps, dt)

    def _from_acceleration(self, first_step: int, steps: int, dt: float) -> Floats:
        """Sum from the start, one after the other, so that the bits do not depend on how a run is divided."""
        done, velocity = self._reached
        if done > first_step or done == 0:
            done, velocity = 0, self.initial_velocity
        kicks = self.value(_times(done, first_step + steps, dt)) * dt
        if done == 0:
            kicks[0] *= 0.5
        velocities = np.cumsum(np.concatenate([[velocity], kicks]))[1:]
        self._reached = (first_step + steps, float(velocities[-1]))
        return np.asarray(velocities[first_step - done :] * dt)


@dataclass(frozen=True)
class PrescribedMotion:
    """All channels of a case and the functions of its load rows, each in the order of their numbers."""

    channels: tuple[Channel, ...]
    loads: tuple[Callable[[Floats], Floats], ...] = ()

    def increments(self, first_step: int, steps: int, dt: float) -> Floats:
        """(steps, channels) Displacement increments, m."""
        columns = [channel.increments(first_step, steps, dt) for channel in self.channels]
        return np.column_stack(columns) if columns else np.zeros((steps, 0))

    def values(self, first_step: int, steps: int, dt: float) -> Floats:
        """(steps, rows) Values of the loads at the times of the steps first_step, first_step + 1, ..."""
        times = _times(first_step, first_step + steps, dt)
        return np.column_stack([load(times) for load in self.loads]) if self.loads else np.zeros((steps, 0))


def _times(first: float, last: float, dt: float) -> Floats:
    """(n,) Times of the steps first, first + 1, ... below last, s."""
    return np.asarray(np.arange(first, last) * dt, dtype=np.float64)
