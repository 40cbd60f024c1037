"""The central difference loop in leapfrog form (Eq. 18-20), compiled as a whole.

Free degrees of freedom: v(n+1/2) = v(n-1/2) + dt a(n), u(n+1) = u(n) + dt v(n+1/2); the first step starts
from the initial velocity with half a kick, v(1/2) = v(0) + dt/2 a(0). Prescribed ones move by their
increment, so that v(n+1/2) = increment/dt; the reaction is what their acceleration needs beyond the forces
on them. With R(n) from the central difference of the velocities, the work R(n) dt (v(n-1/2) + v(n+1/2))/2
makes the discrete balance of kinetic energy and work an identity, and the error of the whole balance is
O(dt^2). The work of friction, of damping (damping.py), of loads that change with time and of weak supports is
booked in the same way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.contact import OPEN, add_contact_forces, pairs_of
from phantomnode.solver.cut_elements import add_point_forces
from phantomnode.solver.damping import add_viscous_forces, damp, is_viscous
from phantomnode.solver.friction import add_friction_forces, friction_power, let_go
from phantomnode.solver.layout import Held, Layout
from phantomnode.solver.model import Contact, CutElements, Elements, Model, State
from phantomnode.solver.motion import move_nodes, reset
from phantomnode.solver.q4 import smallest_element_jacobian, smallest_jacobian
from phantomnode.solver.search import Candidates, Search, build_candidates, outdated
from phantomnode.solver.surface_loads import add_loads, add_support_forces, load_power
from phantomnode.solver.uncut import add_uncut_forces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DONE, INVERTED, NOT_FINITE = 0, 1, 2
"""What :func:`advance` returns: all steps done, or what stopped it (see the clock for when)."""


def initial_state(model: Model, velocity: Floats, layout: Layout, value: Floats | None = None) -> State:
    """The state at time 0: undeformed, with the forces and accelerations there.

    Parameters
    ----------
    model : Model
    velocity : (n, 2) float64, m/s
        Initial velocity of every node. The state takes the array itself where it is stored by columns.
    layout : Layout
        From :func:`phantomnode.solver.layout.prepare_layout`.
    value : (rows,) float64 or None
        Values of the load rows at time 0; zero unless given.

    Raises
    ------
    ValueError
        Where a node that is not held has no mass or a contact pair has no reach.
    """
    n, points, pairs = len(model.x), len(model.contact.slave_weight), pairs_of(model.contact)
    massless = ~(model.mass > 0.0) & np.any(model.channel < 0, axis=1)
    if np.any(massless):
        raise ValueError(f"node {int(np.argmax(massless))} has no mass; every node must belong to an element")
    if not np.all(model.contact.reach > 0.0):
        raise ValueError(
            f"contact pair {int(np.argmin(model.contact.reach))} has no reach; give about one cell"
        )
    rubbing = bool(np.any(model.contact.friction > 0.0))
    state = State(
        u=np.zeros((n, 2), order="F"),
        v=np.asfortranarray(velocity, dtype=np.float64),
        a=np.zeros((n, 2), order="F"),
        force=np.zeros((n, 2), order="F"),
        reaction=np.zeros(model.channels),
        external=np.zeros(1),
        pair_force=np.zeros((pairs, 2)),
        pair_impulse=np.zeros((pairs, 2)),
        pair_peak=np.zeros(pairs),
        gap=np.full(points, OPEN),
        normal=np.zeros((points, 2)),
        clock=np.zeros(2),
        smallest_j=np.ones(1),
        anchor=np.full(points if rubbing else 0, -1, dtype=np.int64),
        anchor_at=np.zeros(points if rubbing else 0),
        tangential=np.zeros((points if rubbing else 0, 2)),
        friction_force=np.zeros((n if rubbing else 0, 2)),
        stick=np.zeros(1),
        slip=np.zeros(1),
        viscous=np.zeros((n if is_viscous(model.damping) else 0, 2)),
        dissipated=np.zeros(1),
        value=np.zeros(model.loads.rows) if value is None else np.array(value, dtype=np.float64),
        applied=np.zeros((model.loads.rows, 2)),
        point_force=np.zeros((len(model.loads.point_row), 2)),
        load_impulse=np.zeros((model.loads.rows, 2)),
        held=np.zeros(model.channels),
        rate=np.zeros(model.channels),
        support=np.zeros(model.channels),
        support_impulse=np.zeros(model.channels),
    )
    advance(model, layout, state, 0.0, np.zeros((0, model.channels)))
    return state


@kernel
def evaluate_elements(model: Model, layout: Layout, state: State) -> int:
    """Add all forces but those of contact at the current displacement to the constant ones; whether all is sound."""
    unsound = add_uncut_forces(layout.rows, layout.scattered, state.u, state.force, layout.threads)
    unsound += add_point_forces(layout.full, state.u, state.force)
    unsound += add_point_forces(layout.cut, state.u, state.force)
    add_loads(model.loads, state.value, model.x, state.u, state.force, state.applied, state.point_force)
    add_support_forces(model.supports, state.held, state.u, state.force, state.support)
    if len(state.viscous) > 0:
        add_viscous_forces(model.damping, model.elements, state.u, state.v, state.viscous, state.force)
    if unsound == 0:
        return DONE
    state.smallest_j[0] = find_smallest_jacobian(model.elements, model.full, model.cut_elements, state.u)
    return INVERTED if state.smallest_j[0] <= 0.0 else NOT_FINITE


def evaluate_forces(model: Model, layout: Layout, state: State) -> int:
    """All forces but those of contact at the current displacement; whether all is sound."""
    reset(layout.load, state.force)
    return int(evaluate_elements(model, layout, state))


@kernel
def find_smallest_jacobian(elements: Elements, full: CutElements, cut: CutElements, u: Floats) -> float:
    """The smallest J of all points, NaN where one is not finite."""
    if len(full.weight) == 0:
        uncut_j = smallest_element_jacobian(elements, u)
    else:
        uncut_j = smallest_jacobian(full.nodes, full.first, full.gradient, u)
    cut_j = smallest_jacobian(cut.nodes, cut.first, cut.gradient, u)
    return cut_j if not uncut_j <= cut_j and uncut_j == uncut_j else uncut_j


@kernel
def find_candidates(contact: Contact, search: Search, x: Floats, state: State) -> Candidates:
    """Candidate lists at the current displacement; points outside them are open."""
    for g in range(len(state.gap)):
        state.gap[g] = OPEN
    candidates = build_candidates(contact, search, x, state.u)
    let_go(candidates, state)
    return candidates


@kernel
def evaluate_contact(contact: Contact, candidates: Candidates, x: Floats, state: State) -> None:
    """Add the contact forces at the current displacement."""
    add_contact_forces(
        contact, candidates, x, state.u, state.force, state.pair_force, state.gap, state.normal
    )
    if len(state.anchor) > 0:
        add_friction_forces(contact, candidates, x, state)
    for k in range(len(state.pair_peak)):
        size = math.sqrt(state.pair_force[k, 0] ** 2 + state.pair_force[k, 1] ** 2)
        state.pair_peak[k] = max(state.pair_peak[k], size)


@kernel
def move(model: Model, layout: Layout, state: State, kick: float, dt: float, increment: Floats) -> None:
    """Velocities over the interval ``kick``, reactions and their work, then displacements over the step.

    The forces are used up: what is left is the constant load.
    """
    slip = friction_power(state.friction_force, state.v)
    work = 0.5 * load_power(model.loads, state.value, state.point_force, state.v)
    before = values_at(layout.held, state.u)
    work += react(model.mass, layout.held, state.v, state.a, state.force, state.reaction, kick, dt, increment)
    move_nodes(layout.inverse_mass, layout.load, state.u, state.v, state.force, kick, dt, layout.threads)
    prescribe(layout.held, before, state.u, state.v, dt, increment)
    work += 0.5 * load_power(model.loads, state.value, state.point_force, state.v)
    for c in range(len(state.held)):
        rate = increment[c] / dt
        work += state.support[c] * 0.5 * (state.rate[c] + rate)
        state.support_impulse[c] += kick * state.support[c]
        state.held[c] += increment[c]
        state.rate[c] = rate
    state.external[0] += kick * work
    state.slip[0] += kick * 0.5 * (slip + friction_power(state.friction_force, state.v))
    for r in range(len(state.value)):
        state.load_impulse[r, 0] += kick * state.applied[r, 0]
        state.load_impulse[r, 1] += kick * state.applied[r, 1]
    for k in range(len(state.pair_peak)):
        state.pair_impulse[k, 0] += kick * state.pair_force[k, 0]
        state.pair_impulse[k, 1] += kick * state.pair_force[k, 1]


@kernel
def react(
    mass: Floats, held: Held, v: Floats, a: Floats, force: Floats, reaction: Floats,
    kick: float, dt: float, increment: Floats,
) -> float:  # fmt: skip
    """Accelerations and reactions of the prescribed degrees of freedom; the power of the reactions, W/m."""
    reaction[:] = 0.0
    power = 0.0
    for h in range(len(held.node)):
        i, d, c = held.node[h], held.axis[h], held.channel[h]
        before, after = v[i, d], increment[c] / dt
        a[i, d] = (after - before) / kick
        needed = mass[i] * a[i, d] - force[i, d]
        reaction[c] += needed
        power += needed * 0.5 * (before + after)
    return power


@kernel
def values_at(held: Held, u: Floats) -> Floats:
    """(h,) Displacements of the prescribed degrees of freedom, m."""
    values = np.empty(len(held.node))
    for h in range(len(values)):
        values[h] = u[held.node[h], held.axis[h]]
    return values


@kernel
def prescribe(held: Held, before: Floats, u: Floats, v: Floats, dt: float, increment: Floats) -> None:
    """Displacements and velocities of the prescribed degrees of freedom, from the (h,) displacements before."""
    for h in range(len(before)):
        i, d, c = held.node[h], held.axis[h], held.channel[h]
        u[i, d], v[i, d] = before[h] + increment[c], increment[c] / dt


@kernel
def find_accelerations(channel: NDArray[np.int32], inverse_mass: Floats, force: Floats, a: Floats) -> None:
    """Accelerations of the free degrees of freedom from the current forces, m/s^2."""
    for i in range(len(inverse_mass)):
        for d in range(2):
            if channel[i, d] < 0:
                a[i, d] = force[i, d] * inverse_mass[i]


@kernel(nogil=True)  # so that frames can be written meanwhile
def advance(model: Model, layout: Layout, state: State, dt: float, increments: Floats) -> int:
    """Run one step for each row of increments; with none, only evaluate the forces.

    Parameters
    ----------
    model : Model
    layout : Layout
        From :func:`phantomnode.solver.layout.prepare_layout`.
    state : State
        Written in place; after a stop it holds the displacement at which the step failed.
    dt : float, s
    increments : (steps, channels + rows) float64
        Displacement increment of each prescribed motion in each step, m; behind them the value of each load row
        at its end, Pa or m/s^2.

    Returns
    -------
    int
        ``DONE``, ``INVERTED`` (some J <= 0) or ``NOT_FINITE``.
    """
    candidates = find_candidates(model.contact, layout.search, model.x, state)
    if len(increments) == 0:
        reset(layout.load, state.force)
        status = evaluate_elements(model, layout, state)
        evaluate_contact(model.contact, candidates, model.x, state)
    damped = model.damping.mass > 0.0 or len(state.viscous) > 0
    for step in range(len(increments)):
        kick = 0.5 * dt if state.clock[1] == 0.0 else dt
        if damped:
            damp(model.damping.mass, model.mass, model.channel, state, kick, dt, increments[step])
        move(model, layout, state, kick, dt, increments[step])
        state.clock[1] += 1.0
        state.clock[0] = state.clock[1] * dt
        for r in range(len(state.value)):
            state.value[r] = increments[step, model.channels + r]
        status = evaluate_elements(model, layout, state)
        if status != DONE:
            return status
        if outdated(layout.search, candidates, state.u):
            candidates = find_candidates(model.contact, layout.search, model.x, state)
        evaluate_contact(model.contact, candidates, model.x, state)
    find_accelerations(model.channel, layout.inverse_mass, state.force, state.a)
    state.smallest_j[0] = find_smallest_jacobian(model.elements, model.full, model.cut_elements, state.u)
    return status
