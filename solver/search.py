"""Contact search: which master segments can be the nearest to a slave point, from uniform bins.

Candidate lists hold every segment within ``reach + skin`` of a point at the time they are built. As long as
slave and master have moved by no more than the skin relative to each other, a list still holds every
segment within ``reach``; before that is exceeded the lists are built anew from the current positions, in
the same step. So no pair is missed at any speed, and the result never depends on when the lists were built.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.model import Contact

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SKIN = 0.5
"""Skin over reach: a larger one builds the lists less often and makes them longer."""


class Search(NamedTuple):
    """What the search needs besides the model.

    slave_nodes, master_nodes: the nodes of the slave and of the master side of each pair, each once; pair k
    has slave_first[k] .. slave_first[k + 1] and master_first[k] .. master_first[k + 1]. skin (k,), m.
    """

    slave_nodes: Ints
    slave_first: Ints
    master_nodes: Ints
    master_first: Ints
    skin: Floats


class Candidates(NamedTuple):
    """Candidate lists, and where the nodes were when they were built.

    near: the slave points that have candidates, ascending; pair k has near_first[k] .. near_first[k + 1], and
    what follows the last pair is unused; first, segments: the candidates of near[i] are segments[first[i]] ..
    segments[first[i + 1]], ascending; wanted: the segments that are in any list, ascending; ends (s, 4) current
    ends ax, ay, bx, by, m, of those segments (:func:`place_ends`); built_slave, built_master: the displacement of
    search.slave_nodes and search.master_nodes at the time the lists were built, m.
    """

    near: Ints
    near_first: Ints
    first: Ints
    segments: Ints
    wanted: Ints
    ends: Floats
    built_slave: Floats
    built_master: Floats


def prepare_search(contact: Contact) -> Search:
    """The nodes of each pair, and the skin."""
    pairs = len(contact.penalty)

    def sides(nodes: Ints, first: Ints) -> tuple[Ints, Ints]:
        unique = [np.unique(nodes[first[k] : first[k + 1]]) for k in range(pairs)]
        bounds = np.cumsum([0, *(len(each) for each in unique)], dtype=np.int64)
        return np.concatenate([np.empty(0, dtype=np.int64), *unique]), bounds

    slave_nodes, slave_first = sides(contact.slave_nodes, contact.slave_first)
    master_nodes, master_first = sides(contact.master_nodes, contact.master_first)
    return Search(slave_nodes, slave_first, master_nodes, master_first, SKIN * contact.reach)


@kernel
def position(nodes: Ints, shape: Floats, x: Floats, u: Floats) -> tuple[float, float]:
    """Current position, m, of the point with the (4,) shape functions in the element of the (4,) nodes."""
    px, py = 0.0, 0.0
    for i in range(4):
        px += shape[i] * (x[nodes[i], 0] + u[nodes[i], 0])
        py += shape[i] * (x[nodes[i], 1] + u[nodes[i], 1])
    return px, py


@kernel
def closest(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """Squared distance of the point p from the segment a-b, m^2, and the parameter t in [0, 1] there."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    t = ((px - ax) * dx + (py - ay) * dy) / length2 if length2 > 0.0 else 0.0
    if t <= 0.0:
        return (px - ax) ** 2 + (py - ay) ** 2, 0.0
    if t >= 1.0:
        return (px - bx) ** 2 + (py - by) ** 2, 1.0
    across = (px - ax) * dy - (py - ay) * dx
    return across * across / length2, t


@kernel
def movement_box(
    nodes: Ints, start: int, end: int, u: Floats, built: Floats
) -> tuple[float, float, float, float]:
    """Displacement of nodes[start:end] since ``built``, m: least and greatest x, least and greatest y."""
    x_low, x_high, y_low, y_high = math.inf, -math.inf, math.inf, -math.inf
    for i in range(start, end):
        n = nodes[i]
        dx, dy = u[n, 0] - built[i, 0], u[n, 1] - built[i, 1]
        x_low, x_high = min(x_low, dx), max(x_high, dx)
        y_low, y_high = min(y_low, dy), max(y_high, dy)
    return x_low, x_high, y_low, y_high


@kernel
def outdated(search: Search, candidates: Candidates, u: Floats) -> bool:
    """Whether slave and master of some pair may have moved by more than the skin relative to each other.

    Shape functions are a partition of unity and not negative, so points move within the box of their nodes.
    """
    for k in range(len(search.skin)):
        first, last = search.slave_first[k], search.slave_first[k + 1]
        sx0, sx1, sy0, sy1 = movement_box(search.slave_nodes, first, last, u, candidates.built_slave)
        first, last = search.master_first[k], search.master_first[k + 1]
        mx0, mx1, my0, my1 = movement_box(search.master_nodes, first, last, u, candidates.built_master)
        if sx0 <= sx1 and mx0 <= mx1:  # neither side is empty
            dx, dy = max(sx1 - mx0, mx1 - sx0), max(sy1 - my0, my1 - sy0)
            if dx * dx + dy * dy > search.skin[k] * search.skin[k]:
                return True
    return False


@kernel
def segment_ends(contact: Contact, first: int, last: int, x: Floats, u: Floats) -> Floats:
    """(last - first, 4) Current ends ax, ay, bx, by of master segments, m."""
    ends = np.empty((last - first, 4))
    for s in range(first, last):
        nodes, row = contact.master_nodes[s], ends[s - first]
        row[0], row[1] = position(nodes, contact.start_shape[s], x, u)
        row[2], row[3] = position(nodes, contact.end_shape[s], x, u)
    return ends


@kernel
def place_ends(contact: Contact, candidates: Candidates, x: Floats, u: Floats) -> None:
    """Write the ends of the wanted segments at the displacement u."""
    for w in range(len(candidates.wanted)):
        s = candidates.wanted[w]
        nodes, row = contact.master_nodes[s], candidates.ends[s]
        row[0], row[1] = position(nodes, contact.start_shape[s], x, u)
        row[2], row[3] = position(nodes, contact.end_shape[s], x, u)


@kernel
def listed(segments: Ints, filled: int, count: int) -> Ints:
    """Which of ``count`` numbers stand in segments[:filled], each once, ascending."""
    seen, total = np.zeros(count, dtype=np.bool_), 0
    for i in range(filled):
        total += not seen[segments[i]]
        seen[segments[i]] = True
    wanted = np.empty(total, dtype=np.int64)
    total = 0
    for s in range(count):
        if seen[s]:
            wanted[total] = s
            total += 1
    return wanted


@kernel
def bin_grid(ends: Floats, margin: float) -> tuple[float, float, float, int, int]:
    """A uniform grid of bins over the segments: lower left corner, bin size, m, and bins in x and y.

    Bins are no smaller than twice the margin, and no more numerous than four for each segment.
    """
    x_low, x_high, y_low, y_high = math.inf, -math.inf, math.inf, -math.inf
    for s in range(len(ends)):
        x_low, x_high = min(x_low, ends[s, 0], ends[s, 2]), max(x_high, ends[s, 0], ends[s, 2])
        y_low, y_high = min(y_low, ends[s, 1], ends[s, 3]), max(y_high, ends[s, 1], ends[s, 3])
    x_low, y_low, width, height = x_low - margin, y_low - margin, x_high - x_low, y_high - y_low
    width, height = width + 2.0 * margin, height + 2.0 * margin
    limit = 4.0 * len(ends)
    size = max(2.0 * margin, math.sqrt(width * height / limit), max(width, height) / limit)
    return x_low, y_low, size, int(width / size) + 1, int(height / size) + 1


@kernel
def bin_range(low: float, high: float, origin: float, size: float, count: int) -> tuple[int, int]:
    """First and last bin that the interval touches."""
    return max(0, int((low - origin) / size)), min(count - 1, int((high - origin) / size))


@kernel
def fill_bins(
    ends: Floats, margin: float, x0: float, y0: float, size: float, columns: int, rows: int
) -> tuple[Ints, Ints]:
    """Segments of each bin, ascending: first (bins + 1,) and the list."""
    first = np.zeros(columns * rows + 1, dtype=np.int64)
    members = np.empty(0, dtype=np.int64)
    for fill in (False, True):
        for s in range(len(ends)):
            ax, ay, bx, by = ends[s, 0], ends[s, 1], ends[s, 2], ends[s, 3]
            i0, i1 = bin_range(min(ax, bx) - margin, max(ax, bx) + margin, x0, size, columns)
            j0, j1 = bin_range(min(ay, by) - margin, max(ay, by) + margin, y0, size, rows)
            for j in range(j0, j1 + 1):
                for i in range(i0, i1 + 1):
                    b = j * columns + i
                    if fill:
                        members[first[b]] = s
                        first[b] += 1
                    else:
                        first[b + 1] += 1
        if not fill:
            for b in range(columns * rows):
                first[b + 1] += first[b]
            members = np.empty(first[columns * rows], dtype=np.int64)
    for b in range(columns * rows, 0, -1):  # filling moved every start to its end
        first[b] = first[b - 1]
    first[0] = 0
    return first, members


@kernel
def grown(values: Ints, needed: int) -> Ints:
    """The same list with room for ``needed`` entries, at least twice as much as before where it must grow."""
    if needed <= len(values):
        return values
    larger = np.empty(max(needed, 2 * len(values)), dtype=np.int64)
    for i in range(len(values)):
        larger[i] = values[i]
    return larger


@kernel
def rows_of(values: Floats, rows: Ints) -> Floats:
    """(k, 2) Copy of the rows with these numbers."""
    chosen = np.empty((len(rows), 2))
    for i in range(len(rows)):
        chosen[i, 0], chosen[i, 1] = values[rows[i], 0], values[rows[i], 1]
    return chosen


@kernel
def own_neighbourhood(contact: Contact, k: int, g: int, s: int) -> bool:
    """Whether all of segment s is so near to slave point g along their own curve that they see nothing of it."""
    if len(contact.exclusion) == 0 or not contact.exclusion[k] > 0.0:
        return False
    curve, middle, half, length = contact.master_place[s]
    if contact.slave_place[g, 0] != curve:
        return False
    apart = abs(contact.slave_place[g, 1] - middle)
    return min(apart, length - apart) + half < contact.exclusion[k]


@kernel
def build_candidates(contact: Contact, search: Search, x: Floats, u: Floats) -> Candidates:
    """Every master segment within reach + skin of every slave point, at the displacement u.

    In self contact without those of the point's own neighbourhood.
    """
    points, pairs = len(contact.slave_weight), len(contact.penalty)
    near, near_first = np.empty(points, dtype=np.int64), np.zeros(pairs + 1, dtype=np.int64)
    first, segments = np.zeros(points + 1, dtype=np.int64), np.empty(4 * points, dtype=np.int64)
    count, filled, all_ends = 0, 0, segment_ends(contact, 0, len(contact.master_nodes), x, u)
    for k in range(pairs):
        master = contact.master_first[k]
        ends = all_ends[master : contact.master_first[k + 1]]
        if len(ends) > 0:
            margin = contact.reach[k] + search.skin[k]
            x0, y0, size, columns, rows = bin_grid(ends, margin)
            bins, members = fill_bins(ends, margin, x0, y0, size, columns, rows)
            for g in range(contact.slave_first[k], contact.slave_first[k + 1]):
                px, py = position(contact.slave_nodes[g], contact.slave_shape[g], x, u)
                i, j = math.floor((px - x0) / size), math.floor((py - y0) / size)
                if not (0 <= i < columns and 0 <= j < rows):
                    continue
                b = int(j) * columns + int(i)
                segments = grown(segments, filled + bins[b + 1] - bins[b])
                start = filled
                for c in range(bins[b], bins[b + 1]):
                    s = members[c]
                    d2, _ = closest(px, py, ends[s, 0], ends[s, 1], ends[s, 2], ends[s, 3])
                    if d2 <= margin * margin and not own_neighbourhood(contact, k, g, master + s):
                        segments[filled] = master + s
                        filled += 1
                if filled > start:
                    near[count] = g
                    count += 1
                    first[count] = filled
        near_first[k + 1] = count
    built_slave, built_master = rows_of(u, search.slave_nodes), rows_of(u, search.master_nodes)
    wanted = listed(segments, filled, len(contact.master_nodes))
    return Candidates(near, near_first, first, segments, wanted, all_ends, built_slave, built_master)


@kernel
def nearest_wall(contact: Contact, k: int, x: Floats) -> float:
    """Smallest distance, m, from a slave point of pair k to a segment within reach that faces away from it.

    In the reference configuration x, (n, 2), without the neighbourhood of each point along its own curve;
    infinite where there is none.
    """
    wall, still = math.inf, np.zeros_like(x)
    ends = segment_ends(contact, contact.master_first[k], contact.master_first[k + 1], x, still)
    for g in range(contact.slave_first[k], contact.slave_first[k + 1]):
        px, py = position(contact.slave_nodes[g], contact.slave_shape[g], x, still)
        for s in range(len(ends)):
            ax, ay, bx, by = ends[s, 0], ends[s, 1], ends[s, 2], ends[s, 3]
            faces_away = (ax - px) * (by - ay) - (ay - py) * (bx - ax) > 0.0
            if faces_away and not own_neighbourhood(contact, k, g, contact.master_first[k] + s):
                d2, _ = closest(px, py, ax, ay, bx, by)
                if d2 < wall * wall and d2 < contact.reach[k] * contact.reach[k]:
                    wall = math.sqrt(d2)
    return wall
