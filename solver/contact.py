"""Penalty contact along the normal between slave points and the signed distance to the master surface, Eq. 22-28.

The penetration g of a slave point is its depth in the polyline of master segments: the distance of the
closest point, vertices included, positive inside the material, less the overlap it may start with. The
contact energy is the sum of eps w g^2/2 with w the reference length of the point, and the forces are its
exact gradient, so energy and momentum balance: along the normal of a segment in its interior, along the
radius at a vertex. The force on the
master goes to the nodes of the two ends of the segment with (1 - t) N_I(a) + t N_I(b); N_I at the projected
point (Eq. 28 read literally) would be the gradient of no energy once the element is deformed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.model import Contact
from phantomnode.solver.search import Candidates, closest, place_ends, position

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

OPEN = -1e300
"""The gap of a slave point that touches nothing."""


@kernel
def reported(contact: Contact, k: int) -> tuple[int, float]:
    """The number under which pass k is reported, and the sign of its forces: -1 where its points are the master's."""
    if len(contact.pair) == 0:
        return k, 1.0
    return contact.pair[k], contact.sign[k]


@kernel
def outward_normal(ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """Unit normal on the right of the segment a-b; (0, 0) where it has no length."""
    dx, dy = bx - ax, by - ay
    length = math.sqrt(dx * dx + dy * dy)
    return (dy / length, -dx / length) if length > 0.0 else (0.0, 0.0)


@kernel
def segment_normal(contact: Contact, s: int, x: Floats, u: Floats) -> tuple[float, float]:
    """Current outward unit normal of master segment s."""
    ax, ay = position(contact.master_nodes[s], contact.start_shape[s], x, u)
    bx, by = position(contact.master_nodes[s], contact.end_shape[s], x, u)
    return outward_normal(ax, ay, bx, by)


@kernel
def nearest_segment(
    ends: Floats, segments: Ints, first: int, last: int, px: float, py: float
) -> tuple[float, int, float]:
    """Nearest of segments[first:last] to the point p: squared distance, m^2, number, and parameter t there.

    ends (s, 4) are those of all segments. Of equally near ones the first (the lowest number) is taken.
    """
    best, nearest, t_best = math.inf, -1, 0.0
    for c in range(first, last):
        s = segments[c]
        d2, t = closest(px, py, ends[s, 0], ends[s, 1], ends[s, 2], ends[s, 3])
        if d2 < best:
            best, nearest, t_best = d2, s, t
    return best, nearest, t_best


@kernel
def depth_at(
    contact: Contact, s: int, t: float, px: float, py: float, x: Floats, u: Floats
) -> tuple[float, float, float, float]:
    """Depth of the point p below the closest point t of master segment s.

    At a vertex between two segments the sum of their normals tells inside from outside, and the direction is
    radial. Beyond a free end the segment is taken as extended: its own normal alone decides.

    Returns
    -------
    gap, nx, ny, t : float
        Penetration, m, negative outside; direction of the force on the slave; where on the segment it acts.
    """
    ax, ay = position(contact.master_nodes[s], contact.start_shape[s], x, u)
    bx, by = position(contact.master_nodes[s], contact.end_shape[s], x, u)
    nx, ny = outward_normal(ax, ay, bx, by)
    neighbour = -1
    if t == 0.0:
        neighbour = contact.previous[s]
    elif t == 1.0:
        neighbour = contact.following[s]
    if (t == 0.0 or t == 1.0) and neighbour >= 0:
        rx, ry = (ax - px, ay - py) if t == 0.0 else (bx - px, by - py)
        distance = math.sqrt(rx * rx + ry * ry)
        if distance == 0.0:
            return 0.0, nx, ny, t
        ox, oy = segment_normal(contact, neighbour, x, u)
        if rx * (nx + ox) + ry * (ny + oy) > 0.0:
            return distance, rx / distance, ry / distance, t
        return -distance, -rx / distance, -ry / distance, t
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    free = ((px - ax) * dx + (py - ay) * dy) / length2 if length2 > 0.0 else 0.0
    return (ax - px) * nx + (ay - py) * ny, nx, ny, free


@kernel
def recess(contact: Contact, k: int, g: int, s: int, t: float) -> tuple[float, float]:
    """How far a point's own curve recedes before it, m, at the place t of segment s, and its slope there, m.

    In self contact the neighbourhood of a point is cut out of what it sees. Where that ends, a point could pass
    the end at some depth, which is the gradient of no energy. The surface therefore stands back by the reach at
    the distance D along the curve (nothing is deeper than the reach) and less and less so up to 2 D. The slope is
    by t.
    """
    if len(contact.exclusion) == 0 or not contact.exclusion[k] > 0.0:
        return 0.0, 0.0
    curve, middle, half, length = contact.master_place[s]
    if contact.slave_place[g, 0] != curve:
        return 0.0, 0.0
    forth = middle + (2.0 * t - 1.0) * half - contact.slave_place[g, 1]
    apart, sign = abs(forth), 1.0 if forth > 0.0 else -1.0
    if length - apart < apart:
        apart, sign = length - apart, -sign
    steep = contact.reach[k] / contact.exclusion[k]
    back = 2.0 * contact.reach[k] - steep * apart
    return (back, -steep * sign * 2.0 * half) if back > 0.0 else (0.0, 0.0)


@kernel
def add_recess_forces(
    contact: Contact, g: int, s: int, pull: float, px: float, py: float, x: Floats, u: Floats, force: Floats
) -> tuple[float, float]:
    """Add pull grad t, N/m, for the place t = (p - a).d/d.d on segment s with d = b - a; the part on the point."""
    ax, ay = position(contact.master_nodes[s], contact.start_shape[s], x, u)
    bx, by = position(contact.master_nodes[s], contact.end_shape[s], x, u)
    dx, dy, rx, ry = bx - ax, by - ay, px - ax, py - ay
    square = dx * dx + dy * dy
    twice = 2.0 * (rx * dx + ry * dy) / square
    pull /= square
    fx, fy = pull * dx, pull * dy
    qx, qy = pull * (rx - twice * dx), pull * (ry - twice * dy)  # on b; a takes what is left
    for c in range(4):
        n, share = contact.slave_nodes[g, c], contact.slave_shape[g, c]
        force[n, 0] += share * fx
        force[n, 1] += share * fy
        n, start, end = contact.master_nodes[s, c], contact.start_shape[s, c], contact.end_shape[s, c]
        force[n, 0] += end * qx - start * (fx + qx)
        force[n, 1] += end * qy - start * (fy + qy)
    return fx, fy


@kernel
def add_contact_forces(
    contact: Contact,
    candidates: Candidates,
    x: Floats,
    u: Floats,
    force: Floats,
    pair_force: Floats,
    gap: Floats,
    normal: Floats,
) -> None:
    """Add the contact forces to ``force`` and record them.

    Parameters
    ----------
    contact : Contact
    candidates : Candidates
        Every segment within reach of every point, from :func:`phantomnode.solver.search.build_candidates`.
    x, u : (n, 2) float64, metres
    force : (n, 2) float64, N/m
        Added to, in the order of the slave points.
    pair_force : (k, 2) float64, N/m
        Overwritten: force on the slave of each pair that is reported (:func:`reported`).
    gap : (g,) float64, metres
        Penetration of each candidate point, ``OPEN`` where it touches nothing.
    normal : (g, 2) float64
        Overwritten where closed: direction of the force on the slave.
    """
    place_ends(contact, candidates, x, u)
    for k in range(len(pair_force)):
        pair_force[k, 0], pair_force[k, 1] = 0.0, 0.0
    for k in range(len(contact.penalty)):
        total_x, total_y = 0.0, 0.0
        reach2 = contact.reach[k] * contact.reach[k]
        for i in range(candidates.near_first[k], candidates.near_first[k + 1]):
            g = candidates.near[i]
            gap[g] = OPEN
            px, py = position(contact.slave_nodes[g], contact.slave_shape[g], x, u)
            first, last = candidates.first[i], candidates.first[i + 1]
            d2, s, t = nearest_segment(candidates.ends, candidates.segments, first, last, px, py)
            if d2 > reach2:
                continue
            depth, nx, ny, t = depth_at(contact, s, t, px, py, x, u)
            back, slope = recess(contact, k, g, s, t)
            depth -= contact.offset[g] + back
            if depth <= 0.0:
                continue
            pressure = contact.penalty[k] * contact.slave_weight[g] * depth
            fx, fy = pressure * nx, pressure * ny
            for c in range(4):
                n, share = contact.slave_nodes[g, c], contact.slave_shape[g, c]
                force[n, 0] += share * fx
                force[n, 1] += share * fy
                share = (1.0 - t) * contact.start_shape[s, c] + t * contact.end_shape[s, c]
                n = contact.master_nodes[s, c]
                force[n, 0] -= share * fx
                force[n, 1] -= share * fy
            if slope != 0.0 and t != 0.0 and t != 1.0:
                ex, ey = add_recess_forces(contact, g, s, pressure * slope, px, py, x, u, force)
                fx, fy = fx + ex, fy + ey
            total_x += fx
            total_y += fy
            gap[g], normal[g, 0], normal[g, 1] = depth, nx, ny
        pair, sign = reported(contact, k)
        pair_force[pair, 0] += sign * total_x
        pair_force[pair, 1] += sign * total_y


def reference_length(contact: Contact) -> Floats:
    """(g,) Reference length of the slave points, m: their weights are stiffer beside the tips of cracks."""
    return contact.slave_weight * contact.slave_jump if len(contact.slave_jump) else contact.slave_weight


def pairs_of(contact: Contact) -> int:
    """Number of pairs that are reported: all passes of a pair count as one."""
    return len(contact.penalty) if len(contact.pair) == 0 else int(contact.pair[-1]) + 1


def contact_energy(contact: Contact, gap: Floats) -> float:
    """Energy sum eps w g^2/2 of the closed points, J/m, from their (g,) gaps, m."""
    penalty = np.repeat(contact.penalty, np.diff(contact.slave_first))
    return float(0.5 * np.sum(penalty * contact.slave_weight * np.maximum(gap, 0.0) ** 2))
