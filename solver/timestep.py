"""The stable time step of elements, cut cells and contact together."""

from __future__ import annotations

from typing import NamedTuple


class StepEstimate(NamedTuple):
    """A safe time step, dt = 2 / sqrt(element_frequency^2 + contact_frequency^2).

    dt, s; element_frequency, rad/s, of the stiffest element alone; contact_frequency, rad/s, of the penalty
    springs with every slave point closed; element: its number (uncut elements first, then cut ones).
    """

    dt: float
    element_frequency: float
    contact_frequency: float
    element: int
