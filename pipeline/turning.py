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


def sharp_or_narrow(ends: Floats, following: Ints, spacing: float) -> Ints:
    """The same, and those on roundings that turn by more than a sharp corner over a way of ``spacing``, m.

    Points of another surface that stand so far apart find a rounding of so small a radius, spacing/SHARP, late or
    never: for them it is a corner, spread over its vertices.
    """
    turns = _turns(ends, following)
    corners = turns > SHARP
    length, smooth = np.hypot(*(ends[:, 1] - ends[:, 0]).T), np.where(corners, 0.0, turns)
    for order, closed in _chains(following) if spacing > 0.0 else ():
        turn = smooth[order]
        narrow = (_turned(turn, length[order], spacing, closed) > SHARP) & (turn > STRAIGHT)
        part = np.floor(np.cumsum(np.where(narrow, turn, 0.0)) / EVERY)
        corners[order[narrow & (np.diff(part, prepend=-1.0) > 0.0)]] = True
    return np.flatnonzero(corners)


def narrowest(ends: Floats, following: Ints, spacing: float) -> float:
    """The smallest radius, m, of what sticks out beside sharp corners, over a way of ``spacing``, m; or infinite."""
    turns, most = _turns(ends, following), 0.0
    length, smooth = np.hypot(*(ends[:, 1] - ends[:, 0]).T), np.where(turns > SHARP, 0.0, turns)
    for order, closed in _chains(following):
        turned = _turned(smooth[order], length[order], spacing, closed)
        most = max(most, float(turned.max()))
    return spacing / most if most > STRAIGHT else float("inf")


def _turns(ends: Floats, following: Ints) -> Floats:
    """(s,) By what angle a surface turns at the end of each segment, positive where it sticks out; 0 at free ends."""
    along, turns = ends[:, 1] - ends[:, 0], np.zeros(len(ends))
    here = np.flatnonzero(following >= 0)
    (ax, ay), (bx, by) = along[here].T, along[following[here]].T
    turns[here] = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
    return turns


def _turned(turn: Floats, length: Floats, spacing: float, closed: bool) -> Floats:
    """(k,) By what angle a chain turns within half the spacing of the end of each of its segments.

    Each turn is spread from the middle of its segment to that of the next one, as that of an arc is.
    """
    at, turns, way, lap = np.cumsum(length), turn, spacing, 1
    if closed:
        lap, way = 3, min(spacing, float(at[-1]))
        turns = np.tile(turn, lap)
    middle = np.cumsum(np.tile(length, lap)) - 0.5 * np.tile(length, lap)
    until = np.cumsum(turns) - turns
    here = at + (at[-1] if closed else 0.0)
    return np.asarray(np.interp(here + 0.5 * way, middle, until) - np.interp(here - 0.5 * way, middle, until))


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
