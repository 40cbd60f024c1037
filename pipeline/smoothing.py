"""The hat filter of the contact pressure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SWEEPS = 200
"""Balancing stops after so many sweeps at the latest; what is left of the force is then given to its place."""


def hat_filter(
    sides: list[tuple[Floats, Floats, Floats, Floats]], half_width: float
) -> tuple[Ints, Ints, Floats]:
    """Weights that smooth a force per length over segments along their curve.

    Segment j gives to i what the hat 1 - |s_i - s_j|/h allows, over distances s along the curve in the reference
    configuration. The weights d_i hat_ij d_j are balanced so that they conserve the force, sum_i L_i w_ij = L_j,
    and leave a constant pressure as it is, sum_j w_ij = 1 (a symmetric scaling does both, Sinkhorn and Knopp
    1967).

    Parameters
    ----------
    sides : list of (curve, middle, length, whole), (s,) float64 each
        Number of the curve of each segment, the distance of its middle along it, m, its length, m, and that of
        the curve, infinite where it is open; the sides of a pair do not see each other.
    half_width : float, m

    Returns
    -------
    rows, columns, weights : (w,) int64, int64, float64
        The force per reference length of segment ``rows`` is the sum of ``weights`` times that of ``columns``.
    """
    made, first = [], 0
    for curve, middle, length, whole in sides:
        rows, columns, apart = _neighbours(curve, middle, whole, half_width)
        hat = 1.0 - apart / half_width
        scale = _balanced(rows, columns, hat, length)
        weights = scale[rows] * hat * scale[columns] * length[columns]
        # Rows are exact to the last sweep; what they miss stays where it is, in rows and columns alike.
        rest = 1.0 - np.bincount(rows, weights, len(length))
        weights = weights + np.where(rows == columns, rest[rows], 0.0)
        made.append((rows + first, columns + first, weights))
        first += len(length)
    empty = np.zeros(0, dtype=np.int64)
    return (
        np.concatenate([empty, *(rows for rows, _, _ in made)]),
        np.concatenate([empty, *(columns for _, columns, _ in made)]),
        np.concatenate([np.zeros(0), *(weights for _, _, weights in made)]),
    )


def _neighbours(curve: Floats, middle: Floats, whole: Floats, half_width: float) -> tuple[Ints, Ints, Floats]:
    """All pairs of segments of one curve whose middles are nearer than the half width, and how far apart."""
    # Segments at the beginning of a closed curve stand behind its end once more.
    again = np.flatnonzero((middle < half_width) & (whole > 2.0 * half_width) & np.isfinite(whole))
    number = np.concatenate([np.arange(len(middle)), again])
    curve, place = curve[number], np.concatenate([middle, middle[again] + whole[again]])
    order = np.lexsort((place, curve))
    each = np.arange(len(middle))
    rows, columns, apart = [each], [each], [np.zeros(len(middle))]
    for step in range(1, len(order)):
        a, b = order[:-step], order[step:]
        distance = place[b] - place[a]
        near = (curve[a] == curve[b]) & (distance < half_width) & (a < len(middle))
        if not np.any((curve[a] == curve[b]) & (distance < half_width)):
            break
        a, b = number[a[near]], number[b[near]]
        rows += [a, b]
        columns += [b, a]
        apart += [distance[near], distance[near]]
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(apart)


def _balanced(rows: Ints, columns: Ints, hat: Floats, length: Floats) -> Floats:
    """(s,) Factors d with d_i sum_j hat_ij d_j L_j = 1."""
    scale = np.ones(len(length))
    for _ in range(SWEEPS):
        sums = scale * np.bincount(rows, hat * (scale * length)[columns], len(length))
        if np.all(np.abs(sums - 1.0) < 1e-14):
            break
        scale = scale / np.sqrt(sums)
    return scale
