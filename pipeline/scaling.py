"""Mass that is added to bodies so that a longer step is stable, and what is said about it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.motion import PrescribedMotion
from phantomnode.pipeline.schema import Case
from phantomnode.solver.mass_scaling import scale_mass
from phantomnode.solver.model import Model

if TYPE_CHECKING:
    from phantomnode.pipeline.prepare import Body

PROBES = 1000
"""Times at which the speed of prescribed motions is looked at."""

HEAVY = 0.05
"""Added mass, as a part of the true one, from which on it is warned about."""


def scaled(case: Case, model: Model, jump: float) -> Model:
    """The model with the mass that the wanted step takes."""
    if case.mass_scaling is None:
        return model
    try:
        return scale_mass(model, case.mass_scaling.step / case.time.safety, jump)
    except ValueError as error:
        raise CaseError(
            f"mass_scaling.step: {case.mass_scaling.step:g} s cannot be reached: {error}; "
            "take a smaller step or lower contact penalties"
        ) from error


def largest_jump(case: Case, motion: PrescribedMotion) -> float:
    """Largest difference of velocity that the case brings along, m/s: initial and prescribed ones, and rest."""
    if case.damping.bulk_viscosity.quadratic == 0.0:
        return 0.0
    initial = [body.initial_velocity for body in case.body.values()]
    rest = [(0.0, 0.0)] if motion.channels else []
    dt = case.time.end / PROBES
    prescribed = np.abs(motion.increments(0, PROBES, dt)).max(initial=0.0) / dt
    return float(np.hypot(*np.ptp(np.array(initial + rest), axis=0)) + prescribed)


def added_mass(body: Body, model: Model) -> float:
    """Mass of a body beyond rho times its area, kg/m: by alpha (Eq. 30) and by mass scaling."""
    scaled = (model.elements.mass[body.elements], model.cut_elements.mass[body.cut_elements])
    true = body.rho * body.mesh.area
    uncut, cut = true[~body.mesh.cut], true[body.mesh.cut]
    more = float(np.sum(scaled[0] - uncut) + np.sum(scaled[1] - cut))
    return more if more > 1e-9 * float(true.sum()) else 0.0  # areas are summed in two ways


def heavy_bodies(bodies: tuple[Body, ...], model: Model) -> list[str]:
    """Warnings of bodies that are much heavier than they should be."""
    parts = {body.name: added_mass(body, model) / float(model.mass[body.nodes].sum()) for body in bodies}
    return [
        f"body {name}: {part / (1.0 - part):.1%} mass is added (mass_scaling, alpha): its inertia is too large by "
        "as much; take a smaller mass_scaling.step where that matters"
        for name, part in parts.items()
        if part / (1.0 - part) > HEAVY
    ]
