"""Mass scaling: mass is added to the elements whose own step is shorter than the wanted one, and to no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.solver.model import CutElements, Elements, Model
from phantomnode.solver.timestep import contact_by_element, element_rates

Floats = NDArray[np.float64]

CHUNK = 1 << 16
"""Elements whose mass is added at once."""


def lumped_mass(nodes: int, elements: Elements, cut_elements: CutElements) -> Floats:
    """(nodes,) A quarter of the mass of each element on each of its nodes, kg/m (paper, end of 2.2)."""
    mass = np.zeros(nodes)
    for group in (elements, cut_elements):
        for start in range(0, len(group.mass), CHUNK):
            part = slice(start, start + CHUNK)
            np.add.at(mass, group.nodes[part], 0.25 * group.mass[part, None])
    return mass


def scale_mass(model: Model, dt: float, speed: float = 0.0) -> Model:
    """The model with mass added so that the step ``dt`` (with no margin) is stable with contact closed.

    An element of stiffness w^2 and viscosity c (see timestep.py) keeps dt^2 (w^2 + w_c^2)/4 + dt c/2 <= 1; the
    first and the last term fall with its mass. Loads stay: gravity pulls at the true mass.

    Parameters
    ----------
    model : Model
    dt : float, s
    speed : float, m/s
        See :func:`phantomnode.solver.timestep.stable_step`.

    Raises
    ------
    ValueError
        Where the contact penalty alone asks for a smaller step.
    """
    contact = contact_by_element(model)
    left = 1.0 - 0.25 * dt**2 * contact
    if not np.all(left > 0.0):
        longest = 2.0 / np.sqrt(np.max(contact))
        raise ValueError(f"the contact penalties alone allow steps below {longest:.4g} s only")
    stiffness, viscosity = element_rates(model, speed)
    factor = np.maximum(1.0, (0.25 * dt**2 * stiffness + 0.5 * dt * viscosity) / left)
    uncut = len(model.elements.mass)
    elements = model.elements._replace(mass=model.elements.mass * factor[:uncut])
    cut = model.cut_elements._replace(mass=model.cut_elements.mass * factor[uncut:])
    full = model.full
    if len(full.weight):
        full = full._replace(mass=elements.mass)
    mass = lumped_mass(len(model.x), elements, cut)
    return model._replace(elements=elements, cut_elements=cut, full=full, mass=mass)
