"""Bodies that may meet on their way with no contact to stop them, or that start faster than their own waves."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.bodies import CutBody
from phantomnode.pipeline.schema import Case

Floats = NDArray[np.float64]


FASTEST = 25e3
"""Of waves in a solid, m/s: 18 km/s in diamond."""

TOLD = 4
"""Pairs that a warning names."""


def unpaired(case: Case, cut: dict[str, CutBody]) -> list[str]:
    """A warning of bodies whose boxes cross as they fly on at their first velocities, and that share no contact."""
    joined = {
        frozenset((_body(case, contact.slave), _body(case, contact.master)))
        for contact in case.contact.values()
    }
    ways = {name: _way(case, name, body) for name, body in cut.items()}
    pairs = [
        f"{one} and {other}"
        for one, other in combinations(ways, 2)
        if frozenset((one, other)) not in joined and _cross(ways[one], ways[other])
    ]
    if not pairs:
        return []
    more = f", and {len(pairs) - TOLD} more pairs" if len(pairs) > TOLD else ""
    named = f"{', '.join(pairs[:TOLD])}{more}"
    return [f"bodies {named} may meet and share no contact: they would pass through each other"]


def too_fast(case: Case) -> list[str]:
    """A warning of each material in which a body moves, or is met, faster than its waves: mostly E in other units."""
    fastest: dict[str, tuple[float, str]] = {}
    for name, body in case.body.items():
        speed, met = float(np.hypot(*body.initial_velocity)), _met_at(case, name)
        what = f"starts at {speed:g} m/s" if speed >= met else f"is met at {met:g} m/s"
        told = max(speed, met), f"body {name} {what}"
        fastest[body.material] = max(fastest.get(body.material, told), told, key=lambda one: one[0])
    found = []
    for name, (speed, what) in fastest.items():
        material = case.material[name]
        modulus = material.E * (1.0 - material.nu) / ((1.0 + material.nu) * (1.0 - 2.0 * material.nu))
        wave = float(np.sqrt(modulus / material.rho))
        if wave > FASTEST:
            found.append(
                f"waves in {name} run at {wave:.3g} m/s, faster than in any solid: are E = {material.E:g} Pa and "
                f"rho = {material.rho:g} kg/m^3 right"
            )
        if speed > wave:
            found.append(
                f"{what}, faster than the waves in {name}, {wave:.3g} m/s: are E = {material.E:g} Pa and "
                f"rho = {material.rho:g} kg/m^3 right"
            )
    return found


def _met_at(case: Case, body: str) -> float:
    """The largest speed, m/s, at which bodies that have a contact with this one move against it at first."""
    pairs = ({_body(case, contact.slave), _body(case, contact.master)} for contact in case.contact.values())
    others = set().union(*(pair for pair in pairs if body in pair)) & case.body.keys()
    own = np.array(case.body[body].initial_velocity)
    return max((float(np.hypot(*(own - case.body[name].initial_velocity))) for name in others), default=0.0)


def _body(case: Case, surface: str) -> str:
    """The body, or the obstacle, that a surface belongs to."""
    owner = surface.partition(".")[0]
    return case.interface[owner].body if owner in case.interface else owner


def _way(case: Case, name: str, body: CutBody) -> Floats:
    """(2, 2) The box that holds a body from the start to the end of its free flight, m."""
    boxes = np.array([region.box for region in body.regions])
    start = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    end = start + np.array(case.body[name].initial_velocity) * case.time.end
    return np.array([np.minimum(start[0], end[0]), np.maximum(start[1], end[1])])


def _cross(one: Floats, other: Floats) -> bool:
    return bool(np.all(one[0] < other[1]) and np.all(other[0] < one[1]))
