"""Where a surface turns so much that points of another one that stand apart miss what sticks out."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SHARP = math.radians(20.0)
"""A surface that turns by more at a vertex has a corner there: more than the pieces of an arc over a cell do."""

EVERY = math.radians(2.5)
"""Of a rounding one vertex is taken in so much of its turn: between two it sticks out by 2.4e-4 of its radius."""

STRAIGHT = 1e-6
"""A vertex that turns by less is one of a straight line: the lattice of the cut rounds so much."""


def sharp(ends: Floats, following: Ints) -> Ints:
    """Numbers of the segments that end at a sharp corner which sticks out.

    Parameters
    ----------
    ends : (s, 2, 2) float64, metres
        Start and end of each segment, the material on its left.
    following : (s,) int64
        The segment that goes on from each, -1 where there is none.
    """
    return np.flatnonzero(_turns(ends, following) > SHARP)


def sharp_or_narrow(ends: Floats, following: Ints, spacing: float) -> tuple[Ints, Ints]:
    """The same, and those on roundings that turn by more than a sharp corner over a way of ``spacing``, m.

    Points of another surface that stand so far apart find a rounding of so small a radius, spacing/SHARP, late or
    never: for them it is a corner, spread over its vertices.

    Returns
    -------
    at : (c,) int64
        Numbers of the segments that end there, ascending.
    rounding : (c,) int64
        Vertices of one rounding have a number in common; every sharp corner has its own.
    """
    turns = _turns(ends, following)
    corners = turns > SHARP
    length, smooth = _lengths(ends), np.where(corners, 0.0, turns)
    rounding, roundings = np.arange(len(turns)), len(turns)
    for order, closed in _chains(following) if spacing > 0.0 else ():
        turn, reach = smooth[order], length[order]
        narrow = (_turned(turn, reach, spacing, closed) > SHARP) & (turn > STRAIGHT)
        goes_on = narrow & np.roll(narrow, 1) & (reach <= spacing)
        goes_on[0] &= closed
        number = np.cumsum(~goes_on)
        number[number == 0] = number[-1]  # the seam of a closed chain
        part = np.floor(np.cumsum(np.where(narrow, turn, 0.0)) / EVERY)
        taken = narrow & ((np.diff(part, prepend=-1.0) > 0.0) | ~goes_on)
        corners[order[taken]] = True
        rounding[order[narrow]] = roundings + number[narrow]
        roundings += len(order) + 1
    at = np.flatnonzero(corners)
    return at, rounding[at]


def most_turned(ends: Floats, following: Ints, spacing: float) -> float:
    """The largest angle by which what sticks out turns over a way of ``spacing``, m, sharp corners left out."""
    turns = _turns(ends, following)
    length, smooth = _lengths(ends), np.where(turns > SHARP, 0.0, turns)
    return max(
        (float(_turned(smooth[k], length[k], spacing, closed).max()) for k, closed in _chains(following)),
        default=0.0,
    )


def _lengths(ends: Floats) -> Floats:
    """(s,) Of segments, m."""
    return np.asarray(np.hypot(*(ends[:, 1] - ends[:, 0]).T))


def _turns(ends: Floats, following: Ints) -> Floats:
    """(s,) By what angle a surface turns at the end of each segment, positive where it sticks out; 0 at free ends."""
    along, turns = ends[:, 1] - ends[:, 0], np.zeros(len(ends))
    here = np.flatnonzero(following >= 0)
    (ax, ay), (bx, by) = along[here].T, along[following[here]].T
    turns[here] = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
    return turns


def _turned(turn: Floats, length: Floats, spacing: float, closed: bool) -> Floats:
    """(k,) By what angle a chain turns within half the spacing of the end of each of its segments.

    Each turn is spread over half of the shorter segment beside it on either side: over all of an arc of equal chords,
    but not along the flanks beside a rounding.
    """
    beyond = np.roll(length, -1)
    if not closed:
        beyond[-1] = length[-1]
    half, at, turns, start = 0.5 * np.minimum(length, beyond), np.cumsum(length), turn, 0.0
    way = min(spacing, float(at[-1])) if closed else spacing
    where = at
    if closed:  # its last lap, itself, and its next one
        start = float(at[-1])
        turns, half = np.tile(turn, 3), np.tile(half, 3)
        where = np.concatenate([at, at + start, at + 2.0 * start])
    places = np.column_stack([where - half, where + half]).ravel()
    until = np.cumsum(turns)
    sums = np.column_stack([until - turns, until]).ravel()
    here = at + start
    return np.asarray(np.interp(here + 0.5 * way, places, sums) - np.interp(here - 0.5 * way, places, sums))


def _chains(following: Ints) -> Iterator[tuple[Ints, bool]]:
    """Segments that go on from each other, in order, and whether the last leads to the first."""
    left = np.ones(len(following), dtype=bool)
    starts = np.setdiff1d(np.arange(len(following)), following)
    for first in (*starts.tolist(), *range(len(following))):
        order, here = list[int](), first
        while here >= 0 and left[here]:
            left[here] = False
            order.append(here)
            here = int(following[here])
        if order:
            yield np.array(order), here == order[0]
