"""When the surfaces of contact pairs meet, as they fly on at their first velocities."""

from __future__ import annotations

import numpy as np

from phantomnode.pipeline.gaps import Gap, master_surface, slave_surface
from phantomnode.pipeline.prepare import Floats, Prepared

ALIKE = 1e-9
"""Of a speed, or of a cell: what differs by less differs by rounding."""

LEVEL = 1e-12
"""A segment along which points fly is met at its ends alone: one whose ends are no farther across than this part."""


def meeting_time(prepared: Prepared, number: int, gap: Gap) -> float:
    """When the surfaces of a pair meet, s, each as it is, at its mean first velocity; infinite where they never do.

    A prescribed motion counts by its first step. Infinite, too, where they touch or overlap already and where
    both fly alike.
    """
    flight = closing_velocity(prepared, number)
    speed = float(np.hypot(*flight))
    if not (speed > 0.0 and apart(prepared, gap)):
        return float("inf")
    pair = prepared.pairs[number]
    turned = np.array([flight, [-flight[1], flight[0]]]).T / speed  # columns: along the flight, across it
    slave, master = slave_surface(prepared, pair) @ turned, master_surface(prepared, pair) @ turned
    return min(_way_to(slave.reshape(-1, 2), master), _way_to(-master.reshape(-1, 2), -slave)) / speed


def closing_velocity(prepared: Prepared, number: int) -> Floats:
    """(2,) Mean first velocity of the slave of a pair less that of its master, m/s."""
    velocity = prepared.velocity
    held = prepared.model.channel >= 0
    rates = prepared.motion.increments(0, 1, prepared.dt)[0] / prepared.dt
    velocity[held] = rates[prepared.model.channel[held]]
    contact, k = prepared.model.contact, prepared.pairs[number].passes[0]
    sides = (contact.slave_nodes, contact.slave_first), (contact.master_nodes, contact.master_first)
    slave, master = (
        velocity[np.unique(nodes[first[k] : first[k + 1]])].mean(axis=0) for nodes, first in sides
    )
    speed = max(float(np.hypot(*slave)), float(np.hypot(*master)))
    flight = np.asarray(slave - master)
    return flight if np.hypot(*flight) > ALIKE * speed else np.zeros(2)


def flies_on(prepared: Prepared) -> bool:
    """Whether nothing but contact changes the first velocities: no gravity, no load, no motion but a steady one."""
    case, quarters = prepared.case, np.linspace(0.0, prepared.case.time.end, 5)
    if any(part != 0.0 for part in case.gravity) or any(b.kind == "load" for b in prepared.boundaries):
        return False
    # The difference in time that is nothing in a steady motion.
    orders = {"displacement": 2, "velocity": 1, "acceleration": 0}
    for channel in prepared.motion.channels:
        values = channel.value(quarters)
        change = np.diff(values, orders[channel.kind])
        if np.abs(change).max() > ALIKE * np.abs(values).max():
            return False
    return True


def apart(prepared: Prepared, gap: Gap) -> bool:
    """Whether two surfaces are apart by more than rounding."""
    return gap.distance > ALIKE * min(body.grid.typical_size for body in prepared.bodies)


def _way_to(points: Floats, ends: Floats) -> float:
    """The shortest way, m, along the first axis from any of (p, 2) points to any of the segments (s, 2, 2) ahead."""
    points = points[np.argsort(points[:, 1])]
    lower, upper = ends[:, :, 1].min(axis=1), ends[:, :, 1].max(axis=1)
    first = np.searchsorted(points[:, 1], lower, side="left")
    last = np.searchsorted(points[:, 1], upper, side="right")
    across = ends[:, 1, 1] - ends[:, 0, 1]
    steep = np.abs(across) > LEVEL * np.ptp(points, axis=0).max()
    shortest = np.inf
    for s in np.flatnonzero(steep & (last > first)):
        seen = points[first[s] : last[s]]
        (ax, ay), (bx, _) = ends[s]
        way = ax + (bx - ax) * (seen[:, 1] - ay) / across[s] - seen[:, 0]
        shortest = min(shortest, float(np.min(way, where=way >= 0.0, initial=np.inf)))
    return shortest
