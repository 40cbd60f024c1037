"""The explicit run as a sequence of frames: the state at chosen steps, the energy balance, the guards.

Fields of a frame belong to one time: the velocity is v(n) = v(n-1/2) + dt/2 a(n), the reaction and the work
are completed to the same time with the last known acceleration of the prescribed nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numba import set_num_threads
from numpy.typing import NDArray

from phantomnode.solver.contact import contact_energy
from phantomnode.solver.cut_elements import cut_energy
from phantomnode.solver.damping import damping_force, dissipated, velocity
from phantomnode.solver.layout import Layout, prepare_layout
from phantomnode.solver.leapfrog import DONE, advance, initial_state
from phantomnode.solver.model import NONE, NOWHERE, Energies, Model, State
from phantomnode.solver.q4 import element_energies
from phantomnode.solver.stress import cut_stress, element_stress
from phantomnode.solver.surface_loads import load_power, support_energy

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SETTLED = 64
"""From this step on the energy error is held against the guard. A load that sets in at once excites the
fastest waves first; at the usual step they make a tenth of the little energy of the first steps oscillate."""

LOOK_STEPS, LOOK_WORK = (64, 4096), 200_000_000
"""Fewest and most steps between two looks at the guards, and the steps times elements between: some seconds."""

ASK_WORK = 8_000_000
"""Steps times elements between two questions whether to end: a fraction of a second."""


class Motion(Protocol):
    """The prescribed motions and loads; a model without load rows never asks for values."""

    def increments(self, first_step: int, steps: int, dt: float) -> Floats:
        """(steps, channels) Displacement increments, m, over the steps that begin at first_step*dt, ..."""

    def values(self, first_step: int, steps: int, dt: float) -> Floats:
        """(steps, rows) Values of the load rows, Pa or m/s^2, at first_step*dt, (first_step + 1)*dt, ..."""


class Frame(NamedTuple):
    """The state at one time.

    time, s; step; u (n, 2), m; v (n, 2), m/s; energies; energy_error: |kinetic + internal + hourglass +
    contact + friction + damping - external work - what there was at time 0| over the largest energy seen so
    far; reaction (channels,) force that each prescribed motion exerts, N/m; pair_force (k, 2) force on the
    slave of each pair, N/m; pair_impulse (k, 2) its time integral, N s/m; pair_peak (k,) its largest norm so
    far, N/m; gap (g,) penetration or -1e300 where open, m; normal (g, 2) direction of the force on the slave;
    tangential (g, 2) friction force on each slave point, N/m, empty without friction;
    smallest_j: smallest J = det F; state, initial_energy and largest_energy: what a run needs to be resumed
    from here; applied (rows, 2) resultant of each load row, N/m; load_impulse (rows, 2) and support_impulse
    (channels,): time integrals of the loads and of the springs of weak supports, N s/m.
    """

    time: float
    step: int
    u: Floats
    v: Floats
    energies: Energies
    energy_error: float
    reaction: Floats
    pair_force: Floats
    pair_impulse: Floats
    pair_peak: Floats
    gap: Floats
    normal: Floats
    smallest_j: float
    state: State
    initial_energy: float
    largest_energy: float
    tangential: Floats = NOWHERE
    applied: Floats = NOWHERE
    load_impulse: Floats = NOWHERE
    support_impulse: Floats = NONE


class RunStopped(RuntimeError):
    """A guard stopped the run.

    Attributes
    ----------
    reason, advice : str
        What went wrong, where and when; what to do.
    last_good : Frame
        The last frame before.
    """

    def __init__(self, reason: str, advice: str, last_good: Frame) -> None:
        super().__init__(f"{reason}; {advice}")
        self.reason = reason
        self.advice = advice
        self.last_good = last_good


def energies(model: Model, state: State, dt: float) -> Energies:
    """Energies at the time of the displacement, J/m; exact stored-energy functions.

    The kinetic energy is that of the velocity there; the work done so far is that of reactions and loads, and
    of the prescribed ends of weak supports.
    """
    v = velocity(model, state, dt)
    reaction = _nodal_reaction(model, state, v)
    half = 0.0 if state.clock[1] == 0.0 else 0.5 * dt
    last_half_step = half * 0.5 * float(np.sum(reaction * (state.v + v)))
    last_half_step += half * load_power(model.loads, state.value, state.point_force, 0.5 * (state.v + v))
    last_half_step += half * float(state.support @ state.rate)
    internal, hourglass = _uncut_energies(model, state.u)
    return Energies(
        kinetic=0.5 * float(np.sum(model.mass[:, None] * v**2)),
        internal=internal + cut_energy(model.cut_elements, state.u),
        hourglass=hourglass,
        contact=contact_energy(model.contact, state.gap)
        + float(state.stick[0])
        + support_energy(model.supports, state.held, state.u),
        external_work=float(state.external[0]) + last_half_step + load_work(model, state.u),
        friction=_rubbed(state, v, half),
        damping=dissipated(model, state, v, half),
    )


def load_work(model: Model, u: Floats) -> float:
    """Work of the constant loads, J/m."""
    return float(np.sum(model.load * u)) if len(model.load) else 0.0


def _rubbed(state: State, v: Floats, half: float) -> float:
    """What slip has turned into heat so far, J/m: what the friction forces took and the springs do not hold."""
    if len(state.friction_force) == 0:
        return 0.0
    last_half_step = half * 0.5 * float(np.sum(state.friction_force * (state.v + v)))
    return -(float(state.slip[0]) + last_half_step) - float(state.stick[0])


def _uncut_energies(model: Model, u: Floats) -> tuple[float, float]:
    """Internal and hourglass energy of the uncut elements, J/m."""
    if len(model.full.weight):
        return cut_energy(model.full, u), 0.0
    internal, hourglass = element_energies(model.elements, u)
    return internal, hourglass


def _nodal_reaction(model: Model, state: State, v: Floats) -> Floats:
    """(n, 2) What the prescribed motion exerts on each degree of freedom, N/m; zero on free ones."""
    forces = state.force + damping_force(model, v) if model.damping.mass > 0.0 else state.force
    return np.where(model.channel >= 0, model.mass[:, None] * state.a - forces, 0.0)


def _frame(model: Model, state: State, dt: float, before: Frame | None) -> Frame:
    """The frame of a state; ``before`` is the last one, from which the balance goes on."""
    now = energies(model, state, dt)
    stored = now.internal + now.hourglass + now.contact
    total = now.kinetic + stored + now.friction + now.damping - now.external_work
    initial = before.initial_energy if before else total
    largest = max(now.kinetic, stored, abs(now.external_work), before.largest_energy if before else 0.0)
    held, v = model.channel >= 0, velocity(model, state, dt)
    reaction = state.support.copy()
    np.add.at(reaction, model.channel[held], _nodal_reaction(model, state, v)[held])
    copy = copied(state)
    half = 0.0 if state.clock[1] == 0.0 else 0.5 * dt
    return Frame(
        time=float(state.clock[0]),
        step=int(state.clock[1]),
        u=copy.u,
        v=v,
        energies=now,
        energy_error=abs(total - initial) / largest if largest > 0.0 else 0.0,
        reaction=reaction,
        pair_force=copy.pair_force,
        pair_impulse=copy.pair_impulse + half * copy.pair_force,
        pair_peak=copy.pair_peak,
        gap=copy.gap,
        normal=copy.normal,
        smallest_j=float(state.smallest_j[0]),
        state=copy,
        initial_energy=initial,
        largest_energy=largest,
        tangential=copy.tangential,
        applied=copy.applied,
        load_impulse=copy.load_impulse + half * copy.applied,
        support_impulse=copy.support_impulse + half * copy.support,
    )


def copied(state: State) -> State:
    """A state of its own, in the order of memory that the kernels are compiled for."""
    return State(
        **{
            name: np.array(field, order="F" if name in ("u", "v", "a", "force") else "C")
            for name, field in state._asdict().items()
        }
    )


def go_on() -> bool:
    """Nobody asks the run to end."""
    return False


def say_nothing(threads: int) -> None:
    """Nobody asks how many threads take part."""


def look_steps(model: Model) -> int:
    """Most steps between two looks at the guards; it depends on nothing but the size of the model."""
    return int(np.clip(LOOK_WORK // _elements(model), *LOOK_STEPS))


def _elements(model: Model) -> int:
    return max(1, len(model.elements.kind) + len(model.cut_elements.lame))


def frames(
    model: Model,
    velocity: Floats,
    dt: float,
    steps_at: Ints | Sequence[int],
    motion: Motion,
    guard: float,
    resume: Frame | None = None,
    threads: int = 1,
    looks: bool = False,
    ended: Callable[[], bool] = go_on,
    told: Callable[[int], None] = say_nothing,
) -> Iterator[Frame]:
    """Run a model and yield its frames.

    Parameters
    ----------
    model : Model
    velocity : (n, 2) float64, m/s
        Initial velocity; prescribed degrees of freedom start with that of their motion instead, so that a
        motion that sets in at full speed needs no infinite force.
    dt : float, s
    steps_at : (f,) int64
        Numbers of the steps after which a frame is due, ascending; 0 is the initial state.
    motion : Motion
    guard : float
        The largest energy error that is let pass (from step ``SETTLED`` on).
    resume : Frame or None
        Go on from this frame (only its ``state``, ``initial_energy`` and ``largest_energy`` are used);
        steps up to it are not yielded again. The result is the same, to the bit, as without the
        interruption.
    threads : int
        How many may take part; small models keep to one. The result is the same, to the bit.
    looks : bool
        Yield also the frames between, at most :func:`look_steps` apart, at which the guards are looked at. A run
        can be resumed from them as from those that are due.
    ended : callable
        Asked a few times a second; where it says so, no more frame comes.
    told : callable
        Gets the number of threads that take part, before the first frame.

    Raises
    ------
    RunStopped
        When the energy error exceeds the guard, or an element is inverted or not finite.
    """
    due = np.asarray(steps_at, dtype=np.int64)
    layout = prepare_layout(model, threads)
    told(layout.threads or 1)
    if layout.threads is not None:
        set_num_threads(layout.threads)
    if resume is None:
        start = np.array(velocity, dtype=np.float64, order="F")
        del velocity
        held = model.channel >= 0
        start[held] = (motion.increments(0, 1, dt)[0] / dt)[model.channel[held]]
        state = initial_state(model, start, layout, motion.values(0, 1, dt)[0] if model.loads.rows else None)
        last = _frame(model, state, dt, None)
        if 0 in due:
            yield last
    else:
        state, last = copied(resume.state), resume
    longest = look_steps(model)
    for target in due[due > last.step].tolist():
        while last.step < target:
            step = min(last.step + longest, target)
            if not _reach(model, layout, state, dt, motion, step, last, ended):
                return
            frame = _frame(model, state, dt, last)
            if frame.step >= SETTLED and not frame.energy_error <= guard:
                raise unbalanced(frame, guard, last)
            last = frame
            if looks and step < target:
                yield last
        yield last


def _reach(
    model: Model,
    layout: Layout,
    state: State,
    dt: float,
    motion: Motion,
    step: int,
    last: Frame,
    ended: Callable[[], bool],
) -> bool:
    """Advance to a step, unless the run is to end before; how the steps are divided changes no bit."""
    stride, done = max(1, ASK_WORK // _elements(model)), last.step
    while done < step:
        if ended():
            return False
        steps = min(stride, step - done)
        if advance(model, layout, state, dt, _table(model, motion, done, steps, dt)) != DONE:
            raise broken(model, state, last)
        done += steps
    return True


def _table(model: Model, motion: Motion, done: int, steps: int, dt: float) -> Floats:
    """(steps, channels + rows) Increments of the prescribed motions, and the loads at the end of each step."""
    increments = motion.increments(done, steps, dt)
    if model.loads.rows:
        increments = np.hstack([increments, motion.values(done + 1, steps, dt)])
    return np.ascontiguousarray(increments, dtype=np.float64)


def broken(model: Model, state: State, last: Frame) -> RunStopped:
    """The elements are inverted or not finite: say which, where and when."""
    m = len(model.elements.kind)
    uncut = (
        (cut_stress(model.full, state.u).j, np.diff(model.full.first))
        if len(model.full.weight)
        else (element_stress(model.elements, state.u).j, np.ones(m, dtype=np.int64))
    )
    cut = cut_stress(model.cut_elements, state.u).j, np.diff(model.cut_elements.first)
    j, points = (np.concatenate(pair) for pair in zip(uncut, cut, strict=True))
    worst = int(np.argmin(np.where(np.isfinite(j), j, -np.inf)))
    element = int(np.repeat(np.arange(len(points)), points)[worst])
    nodes = np.concatenate([model.elements.nodes, model.cut_elements.nodes])[element]
    x, y = model.x[nodes].mean(axis=0)
    kind = "inverted" if np.isfinite(j[worst]) else "no longer finite"
    return RunStopped(
        f"element {element} (at x = {x:.6g}, y = {y:.6g} in the undeformed body) is {kind}, "
        f"J = {j[worst]:.3g}, at t = {state.clock[0]:.6g} s, step {int(state.clock[1])}",
        "take a smaller time step, a finer grid there or a smaller load; look at the last good state",
        last,
    )


def unbalanced(frame: Frame, guard: float, last: Frame) -> RunStopped:
    """The energy balance is lost."""
    return RunStopped(
        f"the energy error is {frame.energy_error:.3g} of the largest energy (allowed: {guard:.3g}) "
        f"at t = {frame.time:.6g} s, step {frame.step}",
        "take a smaller time step; where bodies overlap by much of a cell, a stiffer penalty; look at the last good "
        "state",
        last,
    )
