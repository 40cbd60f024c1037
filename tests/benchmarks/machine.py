"""The machine's own limits on one core: bytes from memory, and multiplications with an addition."""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np
from numpy.typing import NDArray

from .measure import Figure, Plan, rate, repeated

Floats = NDArray[np.float64]

TRIAD = 20_000_000
"""Numbers in each of three arrays: 480 MB, far beyond any cache."""

LANES = 128
"""Numbers that are worked on at once: as many as fit the vector registers and hide the latency of an FMA."""


@numba.njit(error_model="numpy")  # noqa: TID251 (compiled anew: it belongs to no package)
def triad(a: Floats, b: Floats, c: Floats, factor: float) -> None:
    """a = b + factor c (McCalpin's STREAM)."""
    for i in range(len(a)):
        a[i] = b[i] + factor * c[i]


@numba.njit(error_model="numpy", fastmath={"contract"})  # noqa: TID251
def multiply_add(x: Floats, rounds: int, factor: float, term: float) -> None:
    """x = factor x + term, over and over, on a few numbers."""
    for _ in range(rounds):
        for i in range(LANES):
            x[i] = factor * x[i] + term


def ceilings(plan: Plan) -> Iterator[Figure]:
    """The limits: of a kernel that streams its data, and of one that computes on what it has."""
    n = plan.sized(TRIAD)
    a, b, c = np.zeros(n), np.ones(n), np.ones(n)
    runs = repeated(lambda: triad(a, b, c, 0.5), plan.repeats)
    yield rate("DRAM triad, one core", 24e-9 * n, "GB/s", runs, "written lines count once")
    x, rounds = np.ones(LANES), plan.sized(5e6)
    runs = repeated(lambda: multiply_add(x, rounds, 0.999, 0.001), plan.repeats)
    yield rate("FMA, one core", 2e-9 * LANES * rounds, "GFLOP/s", runs, "vectors of doubles")
