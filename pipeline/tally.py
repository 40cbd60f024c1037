"""What a run adds up to: extremes over its samples, contact phases, momentum."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.checkpoint import Tree, frame_of, frame_tree
from phantomnode.pipeline.contacts import Pair
from phantomnode.pipeline.corners import deepest_corner, master_corners
from phantomnode.pipeline.history import boundary_force, centre
from phantomnode.pipeline.observer import Ending
from phantomnode.pipeline.prepare import Body, Floats, Prepared

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame

REST = 1e-9
"""A change of momentum below this times m |v|_max is none: rounding over 1e5 steps leaves about 1e-11."""

EXTREMES = (
    "largest_energy", "hourglass_max", "internal_max", "alpha_energy_max", "speed_max", "smallest_j", "stable_step",
)  # fmt: skip
"""Attributes of the tally that are single numbers."""

NO_FORCE = 1e-9
"""Of the largest force of a pair: below it surfaces that only touch press each other by rounding."""


class Phase(NamedTuple):
    """A time in which a pair was in contact: the first and the last sample with a force, s."""

    start: float
    end: float


class Momentum(NamedTuple):
    """Linear momentum of a body, kg m/s per metre: (2,) each.

    impulse: of its contact pairs, loads, weak supports, gravity and mass damping, over the run; error: |change -
    impulse| over the larger of the two, in the directions without a prescribed motion; None where both directions
    have one. There the change is what nodes with a prescribed motion were given besides. reaction: the impulse of all
    that holds or moves the body, of these nodes (change - impulse) and of weak supports.
    """

    start: Floats
    end: Floats
    impulse: Floats
    error: float | None
    reaction: Floats


def _slave_corners(prepared: Prepared, pair: Pair) -> list[slice]:
    """The corners of the slave of a pair among all points: those of its master are looked for by their places."""
    contact = prepared.model.contact
    return [slice(*contact.slave_first[k : k + 2]) for k in pair.corners if contact.sign[k] > 0.0]


class Tally:
    """Looks at every frame of a run and keeps what the summary needs."""

    def __init__(self, prepared: Prepared) -> None:
        self._prepared = prepared
        self.first: Frame | None = None
        self.last: Frame | None = None
        self.largest_energy = 0.0
        self._unbalanced = 0.0
        self.hourglass_max = 0.0
        self.internal_max = 0.0
        self.alpha_energy_max = 0.0
        self.speed_max = 0.0
        self.smallest_j = np.inf
        self.stable_step = np.inf
        self.peak_reaction = np.zeros(len(prepared.boundaries))
        self.penetration = np.zeros(len(prepared.pairs))
        self.corner_depth = np.zeros(len(prepared.pairs))
        self._corners = [master_corners(prepared, k) for k in range(len(prepared.pairs))]
        self._points = [[pair.points, *_slave_corners(prepared, pair)] for pair in prepared.pairs]
        self._times: list[float] = []
        self._forces: list[Floats] = []

    def due(self, step: int) -> bool:
        """Every frame."""
        return True

    def frame(self, frame: Frame) -> None:
        """Add one frame."""
        if self.first is None:
            self.first = frame
        self.last = frame
        self.largest_energy = max(self.largest_energy, frame.largest_energy)
        self._unbalanced = max(self._unbalanced, frame.energy_error * frame.largest_energy)
        self.hourglass_max = max(self.hourglass_max, frame.energies.hourglass)
        self.internal_max = max(self.internal_max, frame.energies.internal)
        self.alpha_energy_max = max(self.alpha_energy_max, alpha_energy(self._prepared, frame.u))
        self.speed_max = max(self.speed_max, float(np.max(np.hypot(*frame.v.T), initial=0.0)))
        self.smallest_j = min(self.smallest_j, frame.smallest_j)
        self.stable_step = min(self.stable_step, self._prepared.stable_step(frame.u))
        for k, boundary in enumerate(self._prepared.boundaries):
            size = float(np.hypot(*boundary_force(boundary, frame)))
            self.peak_reaction[k] = max(self.peak_reaction[k], size)
        for k, lists in enumerate(self._points):
            deepest = max(np.max(frame.gap[points], initial=0.0) for points in lists)
            corner = deepest_corner(self._corners[k], self._prepared.model.x, frame.u)
            self.corner_depth[k] = max(self.corner_depth[k], corner)
            self.penetration[k] = max(self.penetration[k], deepest, corner)
        self._times.append(frame.time)
        self._forces.append(np.hypot(*frame.pair_force.T))

    def saved(self) -> Tree:
        """All that was kept so far; what is given does not change any more."""
        kept = {name: getattr(self, name) for name in (*EXTREMES, "_unbalanced")}
        return {
            **kept,
            "peak_reaction": self.peak_reaction.copy(),
            "penetration": self.penetration.copy(),
            "corner_depth": self.corner_depth.copy(),
            "times": list(self._times),
            "forces": np.array(self._forces).reshape(len(self._times), -1),
            "first": {} if self.first is None else frame_tree(self.first, resumable=False),
            "last": {} if self.last is None else frame_tree(self.last, resumable=False),
        }

    def restore(self, saved: Tree) -> None:
        """Go on from what :meth:`saved` gave."""
        for name in (*EXTREMES, "_unbalanced", "peak_reaction", "penetration", "corner_depth"):
            setattr(self, name, saved[name])
        self._times = list(saved["times"])
        self._forces = list(saved["forces"])
        self.first = frame_of(saved["first"]) if saved["first"] else None
        self.last = frame_of(saved["last"]) if saved["last"] else None

    def finish(self, ending: Ending) -> None:
        """Add the last good frame of a run that was stopped between samples."""
        if ending.frame is not None and (self.last is None or ending.frame.step > self.last.step):
            self.frame(ending.frame)

    @property
    def energy_error_max(self) -> float:
        """The largest energy that was lost or gained, over the largest energy of the whole run.

        A frame's own error is over the largest energy so far, which is next to nothing when a load sets in.
        """
        return self._unbalanced / self.largest_energy if self.largest_energy > 0.0 else 0.0

    def phases(self, pair: int) -> list[Phase]:
        """The contact phases of a pair, in order.

        Breaks that are over before a wave has crossed the slave's body (:func:`crossing_time`) are chatter of
        one phase: the body as a whole has not let go yet.
        """
        phases: list[Phase] = []
        shortest = crossing_time(self._prepared, pair_bodies(self._prepared, pair)[0])
        for touch in self.touches(pair):
            if phases and touch.start - phases[-1].end < shortest:
                touch = Phase(phases.pop().start, touch.end)
            phases.append(touch)
        return phases

    def still_closing(self, pair: int) -> bool:
        """Whether slave and master still move towards each other at the end, against the impulse they have had.

        By the velocities of their centres; of an obstacle, by the mean of its nodes. False where nothing touched.
        """
        if self.last is None or not np.any(self.last.pair_impulse[pair]):
            return False
        apart = np.zeros(2)
        slave, master = pair_bodies(self._prepared, pair)
        contact, k = self._prepared.model.contact, self._prepared.pairs[pair].passes[0]
        obstacle = np.unique(contact.master_nodes[contact.master_first[k] : contact.master_first[k + 1]])
        for sign, body in ((1.0, slave), (-1.0, master)):
            moves = self.velocity(body)[1] if body is not None else self.last.v[obstacle].mean(axis=0)
            apart += sign * moves
        return float(apart @ self.last.pair_impulse[pair]) < -REST * self.speed_max * float(
            np.hypot(*self.last.pair_impulse[pair])
        )

    def bearing(self, pair: int) -> bool:
        """Whether a pair bears a force in the last sample."""
        touches = self.touches(pair)
        return bool(touches) and touches[-1].end == self._times[-1]

    def touches(self, pair: int) -> list[Phase]:
        """Every time in which a pair bore a force, in order, as far as the samples show."""
        if not self._times:
            return []
        force = np.array([sample[pair] for sample in self._forces])
        touching = force > NO_FORCE * force.max()
        turns = np.diff(np.concatenate([[False], touching, [False]]).astype(np.int8))
        starts, ends = np.flatnonzero(turns == 1), np.flatnonzero(turns == -1) - 1
        return [Phase(self._times[a], self._times[b]) for a, b in zip(starts, ends, strict=True)]

    def momentum(self, body: Body) -> Momentum:
        """The momentum balance of a body over the run; needs at least one frame."""
        assert self.first is not None and self.last is not None
        model = self._prepared.model
        mass = model.mass[body.nodes]
        start, end = mass @ self.first.v[body.nodes], mass @ self.last.v[body.nodes]
        impulse = np.zeros(2)
        if len(model.load):
            impulse = model.load[body.nodes].sum(axis=0) * (self.last.time - self.first.time)
        for k in range(len(self._prepared.pairs)):
            slave, master = pair_bodies(self._prepared, k)
            during = self.last.pair_impulse[k] - self.first.pair_impulse[k]
            impulse = impulse + during * (int(slave is body) - int(master is body))
        if model.damping.mass > 0.0:
            moved = mass @ (self.last.u[body.nodes] - self.first.u[body.nodes])
            impulse = impulse - model.damping.mass * moved
        loads, supports = self._load_impulses(body), self._support_impulses(body)
        impulse = impulse + np.sum(loads + supports, axis=0)
        free = np.all(model.channel[body.nodes] < 0, axis=0)
        reaction = np.where(free, 0.0, end - start - impulse) + np.sum(supports, axis=0)
        error = None
        if np.any(free):
            change, given = (end - start)[free], impulse[free]
            largest = float(np.max(np.hypot(*np.array(loads + supports).T)))
            size = max(float(np.hypot.reduce(change)), float(np.hypot.reduce(given)))
            rest = REST * (float(mass.sum()) * self.speed_max + largest)
            error = float(np.hypot.reduce(change - given)) / size if size > rest else 0.0
        return Momentum(start, end, impulse, error, reaction)

    def _load_impulses(self, body: Body) -> list[Floats]:
        """Impulses of the loads of a body over the run, (2,) each; the first is zero."""
        assert self.first is not None and self.last is not None
        loads, here = self._prepared.model.loads, (body.nodes.start, body.nodes.stop - 1)
        impulses = [np.zeros(2)]
        for node, row in ((loads.node, loads.row), (loads.point_nodes[:, 0], loads.point_row)):
            for r in np.unique(row[(node >= here[0]) & (node <= here[1])]):
                impulses.append(self.last.load_impulse[r] - self.first.load_impulse[r])
        return impulses

    def _support_impulses(self, body: Body) -> list[Floats]:
        """Impulses of the weak supports of a body over the run, (2,) each; the first is zero."""
        assert self.first is not None and self.last is not None
        supports, impulses = self._prepared.model.supports, [np.zeros(2)]
        here = (body.nodes.start, body.nodes.stop - 1)
        held = (supports.nodes[:, 0] >= here[0]) & (supports.nodes[:, 0] <= here[1])
        for axis in range(2):
            channels = np.unique(supports.channel[held, axis])
            for c in channels[channels >= 0]:
                during = self.last.support_impulse[c] - self.first.support_impulse[c]
                impulses.append(during * np.eye(2)[axis])
        return impulses

    def velocity(self, body: Body) -> tuple[Floats, Floats]:
        """Velocity of the centre of mass at the start and at the end, m/s, (2,) each."""
        assert self.first is not None and self.last is not None
        mass = self._prepared.model.mass[body.nodes]
        return centre(mass, self.first.v[body.nodes]), centre(mass, self.last.v[body.nodes])


def alpha_energy(prepared: Prepared, u: Floats) -> float:
    """Internal energy, J/m, that exists by the factor alpha of small cut elements (Eq. 30) only."""
    from phantomnode.solver.cut_elements import cut_energy

    cut, small = prepared.model.cut_elements, small_elements(prepared)
    if len(small) == 0:
        return 0.0
    points = [np.arange(*cut.first[e : e + 2]) for e in small]
    part = cut._replace(
        nodes=cut.nodes[small],
        first=np.cumsum([0, *(len(p) for p in points)]),
        gradient=cut.gradient[np.concatenate(points)],
        weight=cut.weight[np.concatenate(points)],
        lame=cut.lame[small],
        shear=cut.shear[small],
        mass=cut.mass[small],
    )
    return (1.0 - 1.0 / prepared.case.integration.alpha) * float(cut_energy(part, u))


def small_elements(prepared: Prepared) -> NDArray[np.intp]:
    """Numbers, among the cut elements of the model, of those to which alpha applies."""
    table = prepared.case.integration
    if table.alpha == 1.0:
        return np.zeros(0, dtype=np.intp)
    fraction = np.concatenate([body.mesh.cut_fraction for body in prepared.bodies])
    return np.flatnonzero(fraction < table.alpha_below)


def pair_bodies(prepared: Prepared, pair: int) -> tuple[Body, Body | None]:
    """The bodies that carry the slave and the master side of a contact pair; None is a rigid obstacle."""
    contact, first = prepared.model.contact, prepared.pairs[pair].passes[0]
    slave = body_of_node(prepared, int(contact.slave_nodes[contact.slave_first[first], 0]))
    master = body_of_node(prepared, int(contact.master_nodes[contact.master_first[first], 0]))
    assert slave is not None  # obstacles have no slave points
    return slave, master


def crossing_time(prepared: Prepared, body: Body) -> float:
    """Time that a wave, c_d^2 = (lambda + 2 mu)/rho, takes along the longer side of a body, s."""
    model = prepared.model
    uncut, cut = model.elements, model.cut_elements
    moduli = (
        (uncut.lame + 2.0 * uncut.shear)[body.elements],
        (cut.lame + 2.0 * cut.shear)[body.cut_elements],
    )
    modulus = np.max(np.concatenate(moduli))
    boxes = np.array([region.box for region in body.regions])
    return float(np.max(np.ptp(boxes, axis=(0, 1))) / np.sqrt(modulus / body.rho))


def body_of_node(prepared: Prepared, node: int) -> Body | None:
    """The body to which a node of the model belongs; None for a node of a rigid obstacle."""
    owners = (body for body in prepared.bodies if body.nodes.start <= node < body.nodes.stop)
    return next(owners, None)
