"""Classic X-FEM with Heaviside enrichment (Eq. 7-8), for the comparison of section 2.2 of the paper.

On each side of the interface the enriched field u(x) = sum N_I d_I + sum N_I H a_I is bilinear, with the nodal
values d_I + H a_I of that side. Those are the values of the two copies that the phantom-node method gives to
every node of a cut cell: classic X-FEM is the same space, and the same internal forces, in another basis
(Areias and Belytschko, Comput. Methods Appl. Mech. Engrg. 195 (2006) 1275-1276). What differs is the mass: lumped
in the basis (d, a) it ties the two sides of the interface to each other, and waves leak. So nodal values are those
of the copies here, too, and only the mass matrix, by way of :class:`Inertia`, knows the basis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from phantomnode.solver.cut_elements import cut_energy
from phantomnode.solver.explicit import Frame, Motion, broken, copied, go_on, load_work, unbalanced
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import DONE, evaluate_forces, find_smallest_jacobian, initial_state
from phantomnode.solver.model import Energies, Model, State
from phantomnode.solver.q4 import element_energies

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SETTLED = 64
"""From this step on the energy error is held against the guard, as in the explicit run."""


class Basis(NamedTuple):
    """The enrichment: node copy k has the value d[standard[k]] + factor[k] a[enriched[k]].

    standard (n,) number of the standard degree of freedom; enriched (n,) number of the enriched one, -1 where
    there is none; factor (n,): H (Eq. 8), or H(x) - H(x_I) where it is shifted; standard_count,
    enriched_count: how many there are, n together.
    """

    standard: Ints
    enriched: Ints
    factor: Floats
    standard_count: int
    enriched_count: int


class Inertia(Protocol):
    """A mass matrix M over the node copies, with what is prescribed."""

    def momentum(self, v: Floats) -> Floats:
        """(n, 2) M v."""

    def acceleration(self, force: Floats, prescribed: Floats) -> Floats:
        """(n, 2) a such that M a = force on every free degree of freedom; the others are as prescribed."""


def heaviside_basis(
    grid_node: Ints | NDArray[np.int32], sign: Ints, real: NDArray[np.bool_], shifted: bool
) -> Basis:
    """The enrichment of a mesh whose nodes next to the interface have a copy on each side of it.

    Parameters
    ----------
    grid_node : (n,) integers
        The grid node of which each node is a copy.
    sign : (n,) int64
        +1 or -1: the side of the interface on which each copy's values count; only read where there are two.
    real : (n,) bool
        Whether the copy stands in the material: the side on which the node itself lies.
    shifted : bool
        Enrich with H(x) - H(x_I), which vanishes at the nodes, not with H.

    Raises
    ------
    ValueError
        Where a grid node has more than two copies, or two on the same side.
    """
    _, standard, copies = np.unique(grid_node, return_inverse=True, return_counts=True)
    twice = copies[standard] == 2
    pairs = np.lexsort([sign, standard])
    pairs = pairs[twice[pairs]].reshape(-1, 2)  # the minus side first
    if np.any(copies > 2) or np.any(sign[pairs] != [-1, 1]):
        raise ValueError("a node has not one copy on each side of one interface")
    enriched = np.full(len(grid_node), -1, dtype=np.int64)
    enriched[pairs] = np.arange(len(pairs))[:, None]
    factor = np.zeros(len(grid_node))
    factor[pairs] = [-1.0, 1.0]
    if shifted:
        # H is -1 at a node on the interface itself (Eq. 8), where both copies are real.
        node_side = np.where(real[pairs[:, 1]] & ~real[pairs[:, 0]], 1.0, -1.0)
        factor[pairs] -= node_side[:, None]
    return Basis(standard.astype(np.int64), enriched, factor, len(copies), len(pairs))


def frames(
    model: Model,
    inertia: Inertia,
    velocity: Floats,
    dt: float,
    steps_at: Ints | Sequence[int],
    motion: Motion,
    guard: float,
    resume: Frame | None = None,
    looks: bool = False,
    ended: Callable[[], bool] = go_on,
) -> Iterator[Frame]:
    """Run a model with a mass matrix of its own and yield its frames.

    Central differences as in :mod:`phantomnode.solver.leapfrog`, with a system of equations in every step:
    M a = f, in which the prescribed accelerations are known from the motion. The Python loop costs little
    beside the solution.

    Parameters
    ----------
    model : Model
        Without contact. Its nodes are the copies; its ``mass`` serves the output only.
    inertia : Inertia
    velocity, dt, steps_at, motion, guard, resume, looks, ended
        As for :func:`phantomnode.solver.explicit.frames`.

    Raises
    ------
    RunStopped
        When the energy error exceeds the guard, or an element is inverted or not finite.
    """
    due, held = np.asarray(steps_at, dtype=np.int64), model.channel >= 0
    start = np.array(velocity, dtype=np.float64)
    start[held] = (motion.increments(0, 1, dt)[0] / dt)[model.channel[held]]
    # Nodal masses tell momentum only here and may vanish (shifted enrichment): they move nothing.
    unit = model._replace(mass=np.ones(len(model.x)))
    layout = prepare_layout(model)
    state, last = (
        (initial_state(unit, start, layout), None) if resume is None else (copied(resume.state), resume)
    )
    done = -1 if resume is None else resume.step
    for step in range(max(done, 0), int(due[-1]) + 1):
        if last is not None and ended():
            return
        increment = motion.increments(step, 1, dt)[0]
        reaction = _accelerate(model, inertia, state, increment / dt, dt)
        if step > done and (step in due or step % SETTLED == 0):
            frame = _frame(model, inertia, state, reaction, dt, last)
            if frame.step >= SETTLED and not frame.energy_error <= guard:
                raise unbalanced(frame, guard, last or frame)
            last = frame
            if looks or step in due:
                yield frame
        if step < due[-1]:
            _move(model, state, reaction, increment, dt)
            if evaluate_forces(model, layout, state) != DONE:
                assert last is not None  # step 0 always makes a frame
                raise broken(model, state, last)


def _kick(state: State, dt: float) -> float:
    """Time between the last two velocities, s: from rest at t = 0 it is half a step."""
    return 0.5 * dt if state.clock[1] == 0.0 else dt


def _accelerate(model: Model, inertia: Inertia, state: State, speed: Floats, dt: float) -> Floats:
    """Accelerations at the current time; returns the (n, 2) reactions, N/m.

    ``speed`` (channels,) is the velocity of each prescribed motion over the coming step, m/s.
    """
    held = model.channel >= 0
    state.a[held] = (speed[model.channel[held]] - state.v[held]) / _kick(state, dt)
    state.a[:] = inertia.acceleration(state.force, state.a)
    return np.where(held, inertia.momentum(state.a) - state.force, 0.0)


def _move(model: Model, state: State, reaction: Floats, increment: Floats, dt: float) -> None:
    """One step of velocities and displacements, with the work of the reactions."""
    held, kick = model.channel >= 0, _kick(state, dt)
    before = state.v.copy()
    state.v[:] += kick * state.a
    state.v[held] = (increment / dt)[model.channel[held]]
    state.external[0] += kick * 0.5 * float(np.sum(reaction * (before + state.v)))
    state.u[:] += dt * state.v
    state.clock[1] += 1.0
    state.clock[0] = state.clock[1] * dt


def _frame(
    model: Model, inertia: Inertia, state: State, reaction: Floats, dt: float, before: Frame | None
) -> Frame:
    """The frame of a state whose acceleration is known."""
    half = 0.0 if state.clock[1] == 0.0 else 0.5 * dt
    v = state.v + half * state.a
    smallest_j = find_smallest_jacobian(model.elements, model.full, model.cut_elements, state.u)
    internal, hourglass = element_energies(model.elements, state.u)
    now = Energies(
        kinetic=0.5 * float(np.sum(v * inertia.momentum(v))),
        internal=internal + cut_energy(model.cut_elements, state.u),
        hourglass=hourglass,
        contact=0.0,
        external_work=float(state.external[0])
        + half * 0.5 * float(np.sum(reaction * (state.v + v)))
        + load_work(model, state.u),
    )
    stored = now.internal + now.hourglass
    total = now.kinetic + stored - now.external_work
    initial = before.initial_energy if before else total
    largest = max(now.kinetic, stored, abs(now.external_work), before.largest_energy if before else 0.0)
    held = model.channel >= 0
    channels = np.zeros(model.channels)
    np.add.at(channels, model.channel[held], reaction[held])
    copy = copied(state)
    return Frame(
        time=float(state.clock[0]),
        step=int(state.clock[1]),
        u=copy.u,
        v=v,
        energies=now,
        energy_error=abs(total - initial) / largest if largest > 0.0 else 0.0,
        reaction=channels,
        pair_force=copy.pair_force,
        pair_impulse=copy.pair_impulse,
        pair_peak=copy.pair_peak,
        gap=copy.gap,
        normal=copy.normal,
        smallest_j=smallest_j,
        state=copy,
        initial_energy=initial,
        largest_energy=largest,
    )
