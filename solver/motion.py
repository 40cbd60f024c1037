"""Velocities and displacements of all nodes over one step, on one thread or several."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from phantomnode.kernels import kernel

Floats = NDArray[np.float64]

NODE_RANGE = 16384
"""Nodes that one thread moves at a time."""


@kernel
def move_nodes(
    inverse_mass: Floats, load: Floats, u: Floats, v: Floats, force: Floats,
    kick: float, dt: float, threads: int | None,
) -> None:  # fmt: skip
    """V += kick F/m, then u += dt v; the forces are set to the constant load. Nodes without mass keep their v.

    Parameters
    ----------
    inverse_mass : (n,) float64, m/kg
    load : (n, 2) float64, N/m
        Empty where there is none.
    u, v, force : (n, 2) float64, m, m/s, N/m
        Written in place.
    kick, dt : float, s
    threads : int or None
        None for the caller's alone; the choice is made when this is compiled.
    """
    if threads is None:
        move_range(inverse_mass, load, 0, len(u), u, v, force, kick, dt)
    else:
        move_by_threads(inverse_mass, load, u, v, force, kick, dt)


@kernel(parallel=True)
def move_by_threads(
    inverse_mass: Floats, load: Floats, u: Floats, v: Floats, force: Floats, kick: float, dt: float
) -> None:
    """The same by several threads."""
    for k in prange((len(u) + NODE_RANGE - 1) // NODE_RANGE):
        first, last = k * NODE_RANGE, min(len(u), (k + 1) * NODE_RANGE)
        move_range(inverse_mass, load, first, last, u, v, force, kick, dt)


@kernel
def move_range(
    inverse_mass: Floats, load: Floats, first: int, last: int,
    u: Floats, v: Floats, force: Floats, kick: float, dt: float,
) -> None:  # fmt: skip
    """The same for the nodes from ``first`` to ``last``."""
    mobility = inverse_mass[first:last]
    for d in range(2):
        at, speed, f = u[first:last, d], v[first:last, d], force[first:last, d]
        for i in range(last - first):
            after = speed[i] + kick * (f[i] * mobility[i])
            speed[i] = after
            at[i] += dt * after
            f[i] = 0.0
    add_load(force, load, first, last)


@kernel
def add_load(force: Floats, load: Floats, first: int, last: int) -> None:
    """Add the constant load, N/m, to the forces of the nodes from ``first`` to ``last``, where there is any."""
    if len(load) > 0:
        for d in range(2):
            f, given = force[first:last, d], load[first:last, d]
            for i in range(last - first):
                f[i] += given[i]


@kernel
def reset(load: Floats, force: Floats) -> None:
    """Set all forces to the constant load."""
    for d in range(2):
        f = force[:, d]
        for i in range(len(f)):
            f[i] = 0.0
    add_load(force, load, 0, len(force))
