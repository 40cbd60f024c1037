"""Coulomb friction of closed slave points: a penalty spring that sticks, and slips by return mapping.

A closed point at p with the depth g below its closest point c on the master hangs on a spring that is fixed at a
material point q of the master surface, its anchor. The energy of the stuck spring is

    psi = eps_t w (|p - q|^2 - g^2) / 2,

which is eps_t w times half the square of the tangential distance where q and c are on one straight segment,
never negative (c is the closest point), and continuous where c passes vertices. Its gradient with q fixed to the
material is a force -eps_t w (c - q) on the slave, which is tangential, +eps_t w (p - q) on the master at q, and
eps_t w (c - p) on the master at c: they sum to zero, and so do their moments, and they turn with the bodies.
(The form is ours; the law is the usual penalty regularisation, e.g. Wriggers, Computational Contact Mechanics,
2006, section 5.2 and 6.)

Where eps_t |c - q| exceeds mu eps g, the anchor is dragged along the surface towards c, over vertices too, until
it does not (return mapping); a point that opens lets its anchor go.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.contact import OPEN, depth_at, nearest_segment, reported
from phantomnode.solver.model import Contact, State
from phantomnode.solver.search import Candidates, position

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FARTHEST = 256
"""Segments over which an anchor is looked for on either side of the closest point; one that is farther has
jumped to another part of the surface and is let go."""


@kernel
def master_point(contact: Contact, s: int, t: float, x: Floats, u: Floats) -> tuple[float, float]:
    """Current position, m, of the point at the parameter t of master segment s."""
    ax, ay = position(contact.master_nodes[s], contact.start_shape[s], x, u)
    bx, by = position(contact.master_nodes[s], contact.end_shape[s], x, u)
    return ax + t * (bx - ax), ay + t * (by - ay)


@kernel
def way_to(contact: Contact, s: int, t: float, anchor: int, anchor_at: float) -> int:
    """Whether the anchor lies behind (+1, along the segments) or before (-1) the place t on segment s.

    0 where it is nowhere within ``FARTHEST`` segments.
    """
    if anchor == s:
        return 1 if anchor_at >= t else -1
    behind, before = s, s
    for _ in range(FARTHEST):
        if behind >= 0:
            behind = contact.following[behind]
            if behind == anchor:
                return 1
        if before >= 0:
            before = contact.previous[before]
            if before == anchor:
                return -1
    return 0


@kernel
def at_distance(
    cx: float, cy: float, radius: float, ax: float, ay: float, bx: float, by: float, low: float, high: float
) -> float:
    """Parameter on the segment a-b, on the way from ``low`` to ``high``, where the distance from c is radius.

    ``high`` where all of the way is nearer.
    """
    dx, dy, ex, ey = bx - ax, by - ay, ax - cx, ay - cy
    square, half = dx * dx + dy * dy, dx * ex + dy * ey
    rest = ex * ex + ey * ey - radius * radius
    root = half * half - square * rest
    if not (square > 0.0 and root >= 0.0):
        return high
    sign = 1.0 if high > low else -1.0
    t = (-half + sign * math.sqrt(root)) / square
    return t if (t - high) * sign < 0.0 else high


@kernel
def slide(
    contact: Contact, s: int, t: float, anchor: int, anchor_at: float, radius: float, x: Floats, u: Floats
) -> tuple[int, float]:
    """The anchor that is dragged along the surface until it is as near as ``radius`` to the place t on s.

    It keeps its place where it is that near already. The walk starts at the place and ends on the circle about
    it, so it goes over vertices and passes from segment to segment.
    """
    way = way_to(contact, s, t, anchor, anchor_at)
    if way == 0:
        return s, t
    cx, cy = master_point(contact, s, t, x, u)
    qx, qy = master_point(contact, anchor, anchor_at, x, u)
    if (qx - cx) ** 2 + (qy - cy) ** 2 <= radius * radius:
        return anchor, anchor_at
    low = t
    while True:
        high = anchor_at if s == anchor else 1.0 if way > 0 else 0.0
        ax, ay = position(contact.master_nodes[s], contact.start_shape[s], x, u)
        bx, by = position(contact.master_nodes[s], contact.end_shape[s], x, u)
        found = at_distance(cx, cy, radius, ax, ay, bx, by, low, high)
        if found != high or s == anchor:
            return s, found
        s = contact.following[s] if way > 0 else contact.previous[s]
        low = 0.0 if way > 0 else 1.0


@kernel
def add_on_master(
    contact: Contact, s: int, t: float, fx: float, fy: float, force: Floats, friction_force: Floats
) -> None:
    """Add a force at the parameter t of master segment s to its nodes."""
    for c in range(4):
        n = contact.master_nodes[s, c]
        share = (1.0 - t) * contact.start_shape[s, c] + t * contact.end_shape[s, c]
        force[n, 0] += share * fx
        force[n, 1] += share * fy
        friction_force[n, 0] += share * fx
        friction_force[n, 1] += share * fy


@kernel
def stick_or_slip(
    contact: Contact, candidates: Candidates, k: int, i: int, x: Floats, state: State
) -> tuple[float, float]:
    """Friction of the closed candidate i of pair k: its force on the slave point, N/m.

    The anchor moves where the point slips; forces go to ``state.force`` and ``state.friction_force``, the energy
    of the spring to ``state.stick``.
    """
    u, g = state.u, candidates.near[i]
    px, py = position(contact.slave_nodes[g], contact.slave_shape[g], x, u)
    first, last = candidates.first[i], candidates.first[i + 1]
    _, s, t = nearest_segment(candidates.ends, candidates.segments, first, last, px, py)
    depth, nx, ny, t = depth_at(contact, s, t, px, py, x, u)
    if state.anchor[g] < 0:  # it has just closed: nothing is stretched yet
        state.anchor[g], state.anchor_at[g] = s, t
    radius = contact.friction[k] * contact.penalty[k] / contact.tangential_penalty[k] * state.gap[g]
    anchor, at = slide(contact, s, t, state.anchor[g], state.anchor_at[g], radius, x, u)
    state.anchor[g], state.anchor_at[g] = anchor, at
    stiffness = contact.tangential_penalty[k] * contact.slave_weight[g]
    qx, qy = master_point(contact, anchor, at, x, u)
    cx, cy = px + depth * nx, py + depth * ny
    fx, fy = stiffness * (qx - cx), stiffness * (qy - cy)
    for c in range(4):
        n, share = contact.slave_nodes[g, c], contact.slave_shape[g, c]
        state.force[n, 0] += share * fx
        state.force[n, 1] += share * fy
        state.friction_force[n, 0] += share * fx
        state.friction_force[n, 1] += share * fy
    add_on_master(
        contact, anchor, at, stiffness * (px - qx), stiffness * (py - qy), state.force, state.friction_force
    )
    add_on_master(
        contact, s, t, stiffness * (cx - px), stiffness * (cy - py), state.force, state.friction_force
    )
    # (p - q)^2 - (p - c)^2 without the cancellation: (c - q) . (2 (p - c) + (c - q)).
    along = (cx - qx) * (2.0 * (px - cx) + cx - qx) + (cy - qy) * (2.0 * (py - cy) + cy - qy)
    state.stick[0] += 0.5 * stiffness * along
    return fx, fy


@kernel
def add_friction_forces(contact: Contact, candidates: Candidates, x: Floats, state: State) -> None:
    """Add the friction of all closed points, after :func:`phantomnode.solver.contact.add_contact_forces`.

    Parameters
    ----------
    contact : Contact
        With ``friction`` and ``tangential_penalty``.
    candidates : Candidates
    x : (n, 2) float64, metres
    state : State
        ``gap`` at the current displacement ``u`` is read; ``force``, ``pair_force``, ``friction_force``,
        ``tangential``, ``stick`` and the anchors are written.
    """
    for n in range(len(state.friction_force)):
        state.friction_force[n, 0], state.friction_force[n, 1] = 0.0, 0.0
    state.stick[0] = 0.0
    for k in range(len(contact.penalty)):
        if not contact.friction[k] > 0.0:
            continue
        pair, sign = reported(contact, k)
        for i in range(candidates.near_first[k], candidates.near_first[k + 1]):
            g = candidates.near[i]
            if state.gap[g] == OPEN:
                state.anchor[g] = -1
                state.tangential[g, 0], state.tangential[g, 1] = 0.0, 0.0
                continue
            fx, fy = stick_or_slip(contact, candidates, k, i, x, state)
            state.tangential[g, 0], state.tangential[g, 1] = fx, fy
            state.pair_force[pair, 0] += sign * fx
            state.pair_force[pair, 1] += sign * fy


@kernel
def let_go(candidates: Candidates, state: State) -> None:
    """Points without candidates are open: their anchors are let go."""
    i, count = 0, candidates.near_first[len(candidates.near_first) - 1]
    for g in range(len(state.anchor)):
        if i < count and candidates.near[i] == g:
            i += 1
            continue
        state.anchor[g] = -1
        state.tangential[g, 0], state.tangential[g, 1] = 0.0, 0.0


@kernel
def friction_power(friction_force: Floats, v: Floats) -> float:
    """Power of the friction forces on all nodes, W/m, at the (n, 2) velocities v."""
    power = 0.0
    for n in range(len(friction_force)):
        power += friction_force[n, 0] * v[n, 0] + friction_force[n, 1] * v[n, 1]
    return power
