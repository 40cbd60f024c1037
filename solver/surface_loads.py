"""Loads on surfaces and bodies, and surfaces held by springs, wherever the boundary runs through the grid.

Dead loads (Eq. 14) are integrals over the reference boundary with the shape functions of the parent element,
done once: what is left is a coefficient for each degree of freedom. A follower pressure acts on the current
line element, -p n ds with n ds = (dy, -dx) for material on the left; the trace of a bilinear element along a
straight segment is quadratic, so that two Gauss points are exact. A constant pressure is then the exact
gradient of p times the enclosed area: on a closed curve it has no resultant, and what it gives comes back.

Weak supports are springs of the penalty between surface points and their prescribed positions (section 3.2),
the gradient of sum k (u - held)^2/2. Their energy is part of the contact energy; the work of moving the
prescribed end is external.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.model import Loads, Supports

Floats = NDArray[np.float64]


@kernel
def add_loads(
    loads: Loads, value: Floats, x: Floats, u: Floats, force: Floats, applied: Floats, point_force: Floats
) -> None:
    """Add the forces of all load rows and record them.

    Parameters
    ----------
    loads : Loads
    value : (rows,) float64, Pa or m/s^2
        Current value of each load row.
    x, u : (n, 2) float64, m
    force : (n, 2) float64, N/m
        Added to.
    applied : (rows, 2) float64, N/m
        Overwritten: resultant of each row.
    point_force : (q, 2) float64, N/m
        Overwritten: force of each follower point on the body.
    """
    for r in range(loads.rows):
        applied[r, 0], applied[r, 1] = 0.0, 0.0
    for e in range(len(loads.node)):
        row, d = loads.row[e], loads.axis[e]
        f = loads.coefficient[e] * value[row]
        force[loads.node[e], d] += f
        applied[row, d] += f
    for q in range(len(loads.point_row)):
        row = loads.point_row[q]
        dx, dy = 0.0, 0.0
        for i in range(4):
            n, slope = loads.point_nodes[q, i], loads.point_slope[q, i]
            dx += slope * (x[n, 0] + u[n, 0])
            dy += slope * (x[n, 1] + u[n, 1])
        fx, fy = -value[row] * dy, value[row] * dx
        for i in range(4):
            n, share = loads.point_nodes[q, i], loads.point_shape[q, i]
            force[n, 0] += share * fx
            force[n, 1] += share * fy
        applied[row, 0] += fx
        applied[row, 1] += fy
        point_force[q, 0], point_force[q, 1] = fx, fy


@kernel
def load_power(loads: Loads, value: Floats, point_force: Floats, v: Floats) -> float:
    """Power of the current load forces at (n, 2) nodal velocities, W/m."""
    power = 0.0
    for e in range(len(loads.node)):
        power += loads.coefficient[e] * value[loads.row[e]] * v[loads.node[e], loads.axis[e]]
    for q in range(len(loads.point_row)):
        vx, vy = 0.0, 0.0
        for i in range(4):
            n, share = loads.point_nodes[q, i], loads.point_shape[q, i]
            vx += share * v[n, 0]
            vy += share * v[n, 1]
        power += point_force[q, 0] * vx + point_force[q, 1] * vy
    return power


@kernel
def add_support_forces(supports: Supports, held: Floats, u: Floats, force: Floats, support: Floats) -> None:
    """Add the spring forces of weak supports and record them.

    Parameters
    ----------
    supports : Supports
    held : (channels,) float64, m
        Current prescribed displacement of each channel.
    u : (n, 2) float64, m
    force : (n, 2) float64, N/m
        Added to.
    support : (channels,) float64, N/m
        Overwritten: force of the springs of each channel on the body.
    """
    for c in range(len(support)):
        support[c] = 0.0
    for p in range(len(supports.stiffness)):
        for d in range(2):
            c = supports.channel[p, d]
            if c < 0:
                continue
            slip = -held[c]
            for i in range(4):
                slip += supports.shape[p, i] * u[supports.nodes[p, i], d]
            f = -supports.stiffness[p] * slip
            for i in range(4):
                force[supports.nodes[p, i], d] += supports.shape[p, i] * f
            support[c] += f


def support_energy(supports: Supports, held: Floats, u: Floats) -> float:
    """Energy sum k (u - held)^2/2 of the springs of weak supports, J/m."""
    on = supports.channel >= 0
    if not on.any():
        return 0.0
    here = np.einsum("pi,pid->pd", supports.shape, u[supports.nodes])
    slip = np.where(on, here - held[np.where(on, supports.channel, 0)], 0.0)
    return float(0.5 * np.sum(supports.stiffness[:, None] * slip**2))


def support_stiffness(supports: Supports, nodes: int) -> Floats:
    """(nodes, 2) Bound on what the springs add to the stiffness of each degree of freedom, N/m.

    (sum N_I u_I)^2 <= sum N_I u_I^2 as the N_I are shares that sum to one.
    """
    bound = np.zeros((nodes, 2))
    share = supports.stiffness[:, None] * supports.shape
    for axis in range(2):
        on = supports.channel[:, axis] >= 0
        np.add.at(bound[:, axis], supports.nodes[on], share[on])
    return bound
