"""Damping: mass-proportional, bulk viscosity in compression, hourglass viscosity; all dissipation is booked.

Mass damping acts with the mean velocity of a step, -alpha_M m (v(n-1/2) + v(n+1/2))/2: central, so of second
order and without effect on the stable step. Viscous forces act with the velocity half a step back, which
keeps them explicit and shortens the stable step (timestep.py).

Bulk viscosity, after von Neumann and Richtmyer, in Lagrangian form: where J falls, at the rate r = -dJ/dt > 0, an
element resists with the pressure q = rho L r (b1 c_d + b2^2 L r), with reference density rho and length
L = sqrt(area of the cell). A velocity jump V over one cell gives q = rho V (b1 c_d + b2^2 V).

Sources: J. von Neumann, R. D. Richtmyer, A method for the numerical calculation of hydrodynamic shocks, J.
Appl. Phys. 21 (1950) 232-237; Flanagan and Belytschko (see q4.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.model import (
    GRADIENT,
    V_LAME,
    V_SHEAR,
    BulkViscosity,
    CutElements,
    Damping,
    Elements,
    Model,
    State,
)
from phantomnode.solver.q4 import displacement_gradient, hourglass_mode

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def is_viscous(damping: Damping) -> bool:
    """Whether there is any viscous force."""
    return len(damping.hourglass) > 0 or len(damping.bulk.weight) > 0


def hourglass_viscosity(elements: Elements, fraction: float) -> Floats:
    """(m,) Viscosity of the hourglass modes, N s/m, from (unscaled) elements.

    Parameters
    ----------
    elements : Elements
    fraction : float
        Of the critical damping of a mode of the frequency that the hourglass stiffness kappa = 1 would give it,
        w^2 = 2 c_d^2 |grad N|^2; on a square c = fraction rho c_d h/4.
    """
    c, kind, mass = elements.constants, elements.kind, elements.mass
    square = 2.0 * np.einsum("ik,ik->k", c[GRADIENT], c[GRADIENT])  # of all four nodes
    frequency2 = 2.0 * (c[V_LAME] + 2.0 * c[V_SHEAR]) * square  # times the mass
    return np.asarray(fraction * np.sqrt(frequency2[kind] * mass) / 8.0)


def bulk_points(points: CutElements, length: Floats, linear: float, quadratic: float) -> BulkViscosity:
    """Bulk viscosity at given integration points.

    Parameters
    ----------
    points : CutElements
        With their mass before any scaling.
    length : (c,) float64, metres
        L of each element.
    linear, quadratic : float
        b1 and b2; 0.06 and 1.2 are usual.
    """
    weight = np.add.reduceat(points.weight, points.first[:-1]) if len(points.lame) else np.zeros(0)
    rho = points.mass / weight
    wave_speed = np.sqrt((points.lame + 2.0 * points.shear) / rho)
    return BulkViscosity(
        nodes=points.nodes,
        first=points.first,
        gradient=points.gradient,
        weight=points.weight,
        linear=linear * rho * wave_speed * length,
        quadratic=quadratic**2 * rho * length**2,
        length=length,
    )


@kernel
def add_bulk_viscosity(bulk: BulkViscosity, u: Floats, v: Floats, force: Floats) -> None:
    """Add the forces of the bulk viscosity to (n, 2) force, N/m, from (n, 2) displacement and velocity."""
    for e in range(len(bulk.linear)):
        nodes = bulk.nodes[e]
        for p in range(bulk.first[e], bulk.first[e + 1]):
            h11, h12, h21, h22 = displacement_gradient(nodes, bulk.gradient[p], u)
            g11, g12, g21, g22 = displacement_gradient(nodes, bulk.gradient[p], v)
            # The cofactor J F^-T has the entries F22, -F21, -F12, F11; its product with dF/dt is dJ/dt.
            f11, f22 = 1.0 + h11, 1.0 + h22
            rate = h21 * g12 + h12 * g21 - f22 * g11 - f11 * g22
            if rate > 0.0:
                pressure = bulk.weight[p] * rate * (bulk.linear[e] + bulk.quadratic[e] * rate)
                for i in range(4):
                    gx, gy = bulk.gradient[p, i, 0], bulk.gradient[p, i, 1]
                    force[nodes[i], 0] += pressure * (f22 * gx - h21 * gy)
                    force[nodes[i], 1] += pressure * (f11 * gy - h12 * gx)


@kernel
def add_hourglass_viscosity(elements: Elements, viscosity: Floats, v: Floats, force: Floats) -> None:
    """Add the forces -c gamma (gamma . v) to (n, 2) force, N/m, from (m,) viscosities and (n, 2) velocity."""
    constants = elements.constants
    for e in range(len(viscosity)):
        qx, qy = hourglass_mode(elements, e, v)
        k, n = elements.kind[e], elements.nodes[e]
        # gamma_I = h_I - s . grad N_I, with opposite gradients across a diagonal.
        along1 = constants[4, k] * constants[0, k] + constants[5, k] * constants[1, k]
        along2 = constants[4, k] * constants[2, k] + constants[5, k] * constants[3, k]
        for i, share in ((0, 1.0 - along1), (1, -1.0 - along2), (2, 1.0 + along1), (3, along2 - 1.0)):
            force[n[i], 0] -= viscosity[e] * share * qx
            force[n[i], 1] -= viscosity[e] * share * qy


@kernel
def add_viscous_forces(
    damping: Damping, elements: Elements, u: Floats, v: Floats, viscous: Floats, force: Floats
) -> None:
    """The viscous forces at the current displacement and the last velocity, kept and added to the force."""
    viscous[:] = 0.0
    add_bulk_viscosity(damping.bulk, u, v, viscous)
    add_hourglass_viscosity(elements, damping.hourglass, v, viscous)
    for i in range(len(viscous)):
        force[i, 0] += viscous[i, 0]
        force[i, 1] += viscous[i, 1]


@kernel
def damp(
    alpha: float,
    mass: Floats,
    channel: NDArray[np.int32],
    state: State,
    kick: float,
    dt: float,
    increment: Floats,
) -> None:
    """Add the mass damping of the coming kick to the forces; book the energy that damping takes.

    With the mean velocity w of the kick, the force is -alpha m w, so that a = (F/m - alpha v)/(1 + alpha
    kick/2) where the motion is free; where it is prescribed, w is known.
    """
    viscous, lost = len(state.viscous) > 0, 0.0
    for i in range(len(mass)):
        m = mass[i]
        for d in range(2):
            v, c = state.v[i, d], channel[i, d]
            if c < 0:
                mean = v + 0.5 * kick * (state.force[i, d] / m - alpha * v) / (1.0 + 0.5 * alpha * kick)
            else:
                mean = 0.5 * (v + increment[c] / dt)
            drag = -alpha * m * mean
            state.force[i, d] += drag
            lost -= drag * mean
            if viscous:
                lost -= state.viscous[i, d] * mean
    state.dissipated[0] += kick * lost


def velocity(model: Model, state: State, dt: float) -> Floats:
    """(n, 2) Velocity at the time of the displacement, v(n) = v(n-1/2) + dt/2 a(n), m/s.

    The acceleration of free nodes includes the mass damping by v(n) itself.
    """
    if state.clock[1] == 0.0:
        return state.v.copy()
    v = state.v + 0.5 * dt * state.a
    if model.damping.mass > 0.0:
        v = np.where(model.channel < 0, v / (1.0 + 0.5 * dt * model.damping.mass), v)
    return v


def damping_force(model: Model, v: Floats) -> Floats:
    """(n, 2) The mass damping -alpha_M m v, N/m."""
    return -model.damping.mass * model.mass[:, None] * v


def dissipated(model: Model, state: State, v: Floats, half: float) -> float:
    """Energy that damping has taken up to the time of the displacement, J/m.

    Parameters
    ----------
    model : Model
    state : State
    v : (n, 2) float64, m/s
        The velocity at that time.
    half : float, s
        The time since ``state.dissipated`` was booked: half a step, or 0 at the start.
    """
    force = damping_force(model, v)
    if len(state.viscous):
        force = force + state.viscous
    return float(state.dissipated[0]) - half * 0.5 * float(np.sum(force * (state.v + v)))
