"""The only structures that kernels see: NamedTuples of arrays (and the numbers that go with them).

Numbers are float64, C-contiguous; nodes of elements are uint32, other indices int64. SI units, plane strain, per
metre of thickness.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


Nodes = NDArray[np.uint32]
"""Numbers without a sign: a kernel need not look for negative indices."""

GRADIENT, SKEW = slice(0, 4), slice(4, 6)
V_LAME, V_SHEAR, HOURGLASS, VOLUME = 6, 7, 8, 9
"""Rows of the constants of a kind of elements."""


class Elements(NamedTuple):
    """Uncut elements: one integration point and Flanagan-Belytschko hourglass control.

    What elements are made of is kept once for each kind of them, so that a structured grid costs no more than its
    nodes. Gradients of nodes across a diagonal are opposite, grad N_3 = -grad N_1 and grad N_4 = -grad N_2, and the
    hourglass vector is gamma_I = h_I - s . grad N_I with h = (1, -1, 1, -1) and s = sum h_I x_I.

    nodes (m, 4); kind (m,) uint32, column of the constants; constants (10, k) of each kind: grad N_1 and grad N_2 at
    the centre, x before y, 1/m; s, m; V lambda and V mu, N; the hourglass stiffness c of the force
    c gamma (gamma . u), N/m; the volume V, m^2 (per metre of thickness); mass (m,), kg/m, of which a quarter stands
    on each node.

    The properties are arrays of all elements, made when they are asked for.
    """

    nodes: Nodes
    kind: Nodes
    constants: Floats
    mass: Floats

    def some(self, which: Ints | slice) -> Elements:
        """Some of the elements, in that order, with the constants of all kinds."""
        return Elements(self.nodes[which], self.kind[which], self.constants, self.mass[which])

    @property
    def gradient(self) -> Floats:
        """(m, 4, 2) Gradients of N_I at the centre, 1/m."""
        half = self.constants[GRADIENT, self.kind].T.reshape(-1, 2, 2)
        return np.concatenate([half, -half], axis=1)

    @property
    def gamma(self) -> Floats:
        """(m, 4) Hourglass vectors."""
        g, s = self.constants[GRADIENT, self.kind].reshape(2, 2, -1), self.constants[SKEW, self.kind]
        first, second = np.einsum("iak,ak->ik", g, s)
        return np.column_stack([1.0 - first, -1.0 - second, 1.0 + first, second - 1.0])

    @property
    def volume(self) -> Floats:
        """(m,) Volumes, m^2 (per metre of thickness)."""
        return np.asarray(self.constants[VOLUME, self.kind])

    @property
    def hourglass(self) -> Floats:
        """(m,) Hourglass stiffness, N/m."""
        return np.asarray(self.constants[HOURGLASS, self.kind])

    @property
    def lame(self) -> Floats:
        """(m,) lambda, Pa."""
        return np.asarray(self.constants[V_LAME, self.kind] / self.volume)

    @property
    def shear(self) -> Floats:
        """(m,) mu, Pa."""
        return np.asarray(self.constants[V_SHEAR, self.kind] / self.volume)


def of_each_kind(elements: Elements) -> Elements:
    """An element of each kind, on no nodes and without mass."""
    kinds = elements.constants.shape[1]
    return Elements(
        np.zeros((kinds, 4), np.uint32),
        np.arange(kinds, dtype=np.uint32),
        elements.constants,
        np.zeros(kinds),
    )


class CutElements(NamedTuple):
    """Cut elements: integration points on the triangles of the fragment.

    nodes (c, 4); first (c + 1,) first point of each element in the lists of points; gradient (p, 4, 2) of N_I
    at each point, 1/m; weight (p,), m^2; lame (c,), shear (c,), Pa; mass (c,), kg/m.
    """

    nodes: Nodes
    first: Ints
    gradient: Floats
    weight: Floats
    lame: Floats
    shear: Floats
    mass: Floats


NONE = np.zeros(0)
NOBODY = np.zeros(0, dtype=np.int64)
NOWHERE = np.zeros((0, 2))
"""What is left empty where a feature is not in use, so that it costs nothing."""


class BulkViscosity(NamedTuple):
    """Points at which a rate of compression is resisted: those of all elements, or none.

    nodes (e, 4); first (e + 1,) first point of each element; gradient (p, 4, 2), 1/m; weight (p,), m^2;
    linear (e,), Pa s, and quadratic (e,), Pa s^2: the pressure is linear r + quadratic r^2 at the rate
    r = -dJ/dt > 0; length (e,), m, of the jump of velocity that a rate stands for.
    """

    nodes: Nodes
    first: Ints
    gradient: Floats
    weight: Floats
    linear: Floats
    quadratic: Floats
    length: Floats


class Damping(NamedTuple):
    """What takes energy out beside friction.

    mass: alpha_M of the force -alpha_M m v, 1/s; hourglass (m,) viscosity of each uncut element, N s/m, with
    force c gamma (gamma . v); empty where there is none; bulk: points of the bulk viscosity.
    """

    mass: float
    hourglass: Floats
    bulk: BulkViscosity


NO_POINTS = CutElements(
    np.zeros((0, 4), dtype=np.uint32), np.zeros(1, dtype=np.int64), np.zeros((0, 4, 2)), *(np.zeros(0),) * 4
)
"""A list without an element."""

NO_BULK_VISCOSITY = BulkViscosity(
    np.zeros((0, 4), dtype=np.uint32), np.zeros(1, dtype=np.int64), np.zeros((0, 4, 2)), *(np.zeros(0),) * 4
)

NO_DAMPING = Damping(0.0, np.zeros(0), NO_BULK_VISCOSITY)


class Contact(NamedTuple):
    """Slave points and master segments of all contact pairs.

    A slave point is sum_I slave_shape[I] x[slave_nodes[I]]; likewise the start and end of a master segment.
    The master's material is on the left of its segments (outward normal on the right). Segments of one pair
    are numbered in a row: pair k has masters master_first[k] .. master_first[k + 1] and slave points
    slave_first[k] .. slave_first[k + 1].

    slave_nodes (g, 4), slave_shape (g, 4), slave_weight (g,) reference length of each point, m (over slave_jump);
    slave_first (k + 1,); master_nodes (s, 4), start_shape (s, 4), end_shape (s, 4); previous (s,), following (s,)
    neighbours along the master surface, -1 at a free end; master_first (k + 1,); penalty (k,), Pa/m; reach
    (k,), m: how deep a point can lie inside and still be found (about one cell); offset (g,), m: the depth of each
    slave point that counts as no penetration (an overlap at the start).

    What follows is empty where no pair makes use of it. friction (k,) Coulomb's coefficient, and
    tangential_penalty (k,), Pa/m, of the stick; pair (k,): where a pair is tested in several passes, each of them is
    a pair k here, one behind the other, and pair[k] is the number under which all are reported, with the sign (k,)
    of their forces: -1 where the points of a pass belong to the pair's master; crowd (k,), m: of a pass whose points
    stand alone (sharp corners), the most weight that can stand on one node of its masters, 0 where points line the
    surface; exclusion (k,),
    m: in self contact a point does not see the segments within this distance from it along its own curve, and
    less of them up to twice as far (0 elsewhere), with slave_place (g, 2) number of the curve and distance along
    it, m, and master_place (s, 4) number of the curve, distance along it at the middle of the segment, half the
    segment's length, and length of the curve, m (infinite where it is open), all in the reference configuration;
    slave_jump (g,): beside the tip of a crack, where its faces have nodes in common, they part by this part of a
    jump of the other nodes, and the weight of a point is as much larger than its length.
    """

    slave_nodes: Ints
    slave_shape: Floats
    slave_weight: Floats
    slave_first: Ints
    master_nodes: Ints
    start_shape: Floats
    end_shape: Floats
    previous: Ints
    following: Ints
    master_first: Ints
    penalty: Floats
    reach: Floats
    offset: Floats
    friction: Floats = NONE
    tangential_penalty: Floats = NONE
    pair: Ints = NOBODY
    sign: Floats = NONE
    crowd: Floats = NONE
    exclusion: Floats = NONE
    slave_place: Floats = NOWHERE
    master_place: Floats = np.zeros((0, 4))
    slave_jump: Floats = NONE


class Loads(NamedTuple):
    """Forces that are given functions of time: dead ones by degree of freedom, follower pressures by point.

    A load row is one function of time; its value times what stands here is the force.

    node (d,), axis (d,), row (d,), coefficient (d,): a dead force of coefficient times value on one degree of
    freedom; the coefficient is the integral of N_I over the reference boundary (traction, Eq. 14), that times
    a component of the normal (dead pressure), or the nodal mass (gravity). point_nodes (q, 4), point_shape
    (q, 4), point_slope (q, 4), point_row (q,): integration points of follower pressures; the sum of
    slope[I] x[node I] is the current line element, m, with the material on its left. rows: number of load rows.
    """

    node: Ints
    axis: Ints
    row: Ints
    coefficient: Floats
    point_nodes: Ints
    point_shape: Floats
    point_slope: Floats
    point_row: Ints
    rows: int


class Supports(NamedTuple):
    """Surface points held by springs at prescribed positions (weak Dirichlet conditions by penalty).

    nodes (p, 4), shape (p, 4): the point is sum_I shape[I] u[nodes I]; stiffness (p,) penalty times reference
    length, N/m (per metre of thickness); channel (p, 2) row of the prescribed motion of each direction, -1 where
    it is free.
    """

    nodes: Ints
    shape: Floats
    stiffness: Floats
    channel: Ints


def no_loads() -> Loads:
    """No load at all."""
    none, nodes, shape = np.zeros(0, np.int64), np.zeros((0, 4), np.int64), np.zeros((0, 4))
    return Loads(none, none, none, np.zeros(0), nodes, shape, shape, none, 0)


def no_supports() -> Supports:
    """No weak support at all."""
    return Supports(np.zeros((0, 4), np.int64), np.zeros((0, 4)), np.zeros(0), np.zeros((0, 2), np.int64))


class Model(NamedTuple):
    """Everything that stays the same during a run.

    x (n, 2) reference positions, m; mass (n,) lumped, kg/m (0 for the nodes of rigid obstacles, which are
    held in both directions); load (n, 2) constant nodal force (gravity), N/m, by columns (order "F"), empty where
    there is none; channel (n, 2) int32, row of the prescribed motion that holds each degree of freedom, -1 where it
    is free;
    channels: number of prescribed motions, those of supports included; elements, cut_elements, contact: the lists
    above; full: the uncut elements once more with their points of full integration, where that is asked for: it
    stands for the one point and the hourglass control of ``elements`` then; damping, loads, supports.
    """

    x: Floats
    mass: Floats
    load: Floats
    channel: NDArray[np.int32]
    channels: int
    elements: Elements
    cut_elements: CutElements
    contact: Contact
    full: CutElements = NO_POINTS
    damping: Damping = NO_DAMPING
    loads: Loads = no_loads()
    supports: Supports = no_supports()


class State(NamedTuple):
    """Everything that changes; written in place by the kernels.

    The fields of the nodes u, v, a and force are stored by columns (order "F"), for the sake of vector code.

    u (n, 2) displacement at the current time, m; v (n, 2) velocity half a step back, m/s (at the start: the
    initial velocity); a (n, 2) acceleration at the current time (of prescribed degrees of freedom: the last
    known one, half a step back), m/s^2; force (n, 2) internal + hourglass + contact + load + support forces on
    the nodes at the current time, N/m; reaction (channels,) force that each prescribed motion exerted at the
    previous step, N/m; external (1,) work of reactions, supports and loads that change with time, up to half a
    step back, J/m; pair_force (k, 2) force on the slave of each pair, N/m; pair_impulse (k, 2) its time integral
    up to half a step back, N s/m; pair_peak (k,) its largest norm so far, N/m; gap (g,) penetration (positive) or
    -1e300 where open, m; normal (g, 2) direction of the force on the slave; clock (2,): time, s, and number of
    steps done; smallest_j (1,) smallest J = det F met in the last step.

    Friction, all empty where no pair has any: anchor (g,) master segment on which the spring of a stuck point
    is fixed, -1 where the point is open; anchor_at (g,) parameter on that segment, beyond 0..1 where the point has
    passed a free end; tangential (g, 2)
    friction force on each slave point, N/m; friction_force (n, 2) the part of ``force`` that is friction, N/m.
    stick (1,) energy of the springs, J/m; slip (1,) work of the friction forces up to half a step back, J/m.

    Damping: viscous (n, 2) the part of ``force`` by bulk and hourglass viscosity, N/m, empty where there is none;
    dissipated (1,) energy lost to all damping up to half a step back, J/m.

    Loads and weak supports: value (rows,) current value of each load row, Pa or m/s^2; applied (rows, 2) its
    current resultant, N/m; point_force (q, 2) current force of each follower point, N/m; load_impulse (rows, 2)
    time integral of the resultants up to half a step back, N s/m; held (channels,) current prescribed
    displacement, m; rate (channels,) its rate over the last step, m/s; support (channels,) current force of the
    springs of each channel on the body, N/m; support_impulse (channels,) its time integral up to half a step
    back, N s/m.
    """

    u: Floats
    v: Floats
    a: Floats
    force: Floats
    reaction: Floats
    external: Floats
    pair_force: Floats
    pair_impulse: Floats
    pair_peak: Floats
    gap: Floats
    normal: Floats
    clock: Floats
    smallest_j: Floats
    anchor: Ints
    anchor_at: Floats
    tangential: Floats
    friction_force: Floats
    stick: Floats
    slip: Floats
    viscous: Floats
    dissipated: Floats
    value: Floats = NONE
    applied: Floats = NOWHERE
    point_force: Floats = NOWHERE
    load_impulse: Floats = NOWHERE
    held: Floats = NONE
    rate: Floats = NONE
    support: Floats = NONE
    support_impulse: Floats = NONE


class Energies(NamedTuple):
    """Energies at one time, J per metre of thickness.

    contact holds the energy of all penalty springs: normal, tangential, and of weak supports; friction and damping
    are what slip and damping have dissipated since the start.
    """

    kinetic: float
    internal: float
    hourglass: float
    contact: float
    external_work: float
    friction: float = 0.0
    damping: float = 0.0
