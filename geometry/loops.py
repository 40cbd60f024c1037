"""Pieces of curves into chains, closed chains into regions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Geometry, Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import CHORD_ERROR

Floats = NDArray[np.float64]

GAPS = (1e-9, 1e-6, 1e-4)
"""Gaps between ends that are closed, over the drawing's diagonal, the smallest first: of 52 real drawings 47
close at 1e-9, two need 1e-6 and three 1e-4. The first is rounding; the others are noted."""


@dataclass(frozen=True)
class Chains:
    """Pieces joined at their ends.

    Attributes
    ----------
    closed, open : tuple of Curve
    notes : tuple of str
        What was mended or left out on the way.
    """

    closed: tuple[Curve, ...]
    open: tuple[Curve, ...]
    notes: tuple[str, ...] = ()


def diagonal(curves: Sequence[Curve]) -> float:
    """Diagonal of the common bounding box of the curves; 0 where there are none."""
    if not curves:
        return 0.0
    boxes = np.array([curve.box for curve in curves])
    return float(np.hypot(*(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0))))


def assemble(pieces: Sequence[Curve], sources: Sequence[str] = ()) -> Geometry:
    """Loose pieces as regions (closed chains, nested) and open curves."""
    chains = join(pieces)
    return Geometry(nest(chains.closed), chains.open, chains.notes)


def join(pieces: Sequence[Curve]) -> Chains:
    """Join pieces whose ends meet into chains, closing gaps up to the largest of :data:`GAPS`.

    Where three or more ends meet nothing says which two belong together: chains end there (two loops that
    touch in a point are still two loops).
    """
    size = diagonal(pieces)
    notes: list[str] = []
    chains = _distinct(pieces, GAPS[0] * size, notes)
    closed: list[Curve] = []
    for gap in GAPS:
        chains, widest = _joined(chains, gap * size)
        closed += [chain for chain in chains if chain.closed]
        chains = [chain for chain in chains if not chain.closed]
        if gap > GAPS[0] and widest > 0.0:
            notes.append(f"gaps of up to {widest:.2e} (in metres) between ends of curves were closed")
    notes += _branches(chains, GAPS[0] * size)
    return Chains(tuple(map(_named, closed)), tuple(map(_named, chains)), tuple(notes))


def nest(loops: Sequence[Curve], name: str = "") -> tuple[Region, ...]:
    """Closed loops as regions by their depth: even ones bound material, odd ones are holes of the loop around them.

    Raises
    ------
    GeometryError
        Where a loop crosses itself or another one, with the point.
    """
    if not loops:
        return ()
    from shapely import Polygon, STRtree

    polygons = [Polygon(line) for line in check_simple(loops)]
    # No loop crosses another, so one point inside a loop tells what is around it (or within: hence the areas).
    inside = [polygon.representative_point() for polygon in polygons]
    around: dict[int, list[int]] = {k: [] for k in range(len(loops))}
    for inner, outer in zip(*STRtree(polygons).query(inside, predicate="within"), strict=True):
        if polygons[outer].area > polygons[inner].area:
            around[int(inner)].append(int(outer))
    holes = defaultdict(list)
    for k, parents in around.items():
        if len(parents) % 2:
            holes[min(parents, key=lambda p: polygons[p].area)].append(loops[k])
    return tuple(
        Region(loop, tuple(holes[k]), name) for k, loop in enumerate(loops) if len(around[k]) % 2 == 0
    )


def check_simple(loops: Sequence[Curve]) -> list[Floats]:
    """The loops as closed polygons, (k, 2) vertices each, after making sure that none crosses.

    Raises
    ------
    GeometryError
        Where a loop crosses or touches itself, or two loops cross or share a stretch; with the point.
    """
    import shapely

    lines = [loop.polyline(CHORD_ERROR * diagonal([loop])) for loop in loops]
    rings = [shapely.LineString(line) for line in lines]
    for loop, ring in zip(loops, rings, strict=True):
        if not ring.is_simple:
            raise GeometryError(
                f"{_called(loop)} crosses itself at {_self_crossing(ring)}; an outline must not"
            )
    for a, b in zip(*shapely.STRtree(rings).query(rings, predicate="intersects"), strict=True):
        if a < b and (rings[a].crosses(rings[b]) or rings[a].overlaps(rings[b]) or rings[a].equals(rings[b])):
            _check_pair(loops[a], loops[b], rings[a], rings[b])
    return lines


def _check_pair(first: Curve, second: Curve, a: object, b: object) -> None:
    """Refuse two loops that cross or share a stretch; one that only touches the other from one side is fine."""
    import shapely

    inside, outside = shapely.Polygon(a), shapely.Polygon(b)
    common = shapely.intersection(inside, outside).area
    # Where arcs touch, their polygons may overlap by as much as they differ from the arcs.
    slack = 2.0 * CHORD_ERROR * (inside.length + outside.length) * diagonal([first, second])
    apart = common <= slack or min(inside.area, outside.area) - common <= slack
    # Polygons of arcs that touch may have a side in common, about sqrt(8 R CHORD_ERROR) long.
    shared = shapely.intersection(a, b)
    if shared.length > 4.0 * CHORD_ERROR**0.5 * diagonal([first, second]) or not apart:
        where = shapely.get_coordinates(shared)[0]
        raise GeometryError(
            f"{_called(first)} and {_called(second)} cross or share a stretch at "
            f"({where[0]:g}, {where[1]:g}) m; outlines must not"
        )


def _self_crossing(ring: object) -> str:
    """A point where a ring that is not simple meets itself, as text."""
    import shapely

    segments = np.stack([shapely.get_coordinates(ring)[:-1], shapely.get_coordinates(ring)[1:]], axis=1)
    lines = shapely.linestrings(segments)
    first, second = shapely.STRtree(lines).query(lines, predicate="intersects")
    last = len(lines) - 1
    for i, j in zip(first, second, strict=True):
        shared = shapely.intersection(lines[i], lines[j])
        neighbours = j == i + 1 or (i == 0 and j == last)
        if i < j and not (neighbours and shared.geom_type == "Point"):
            x, y = shapely.get_coordinates(shared)[0]
            return f"({x:g}, {y:g}) m"
    raise AssertionError("a ring that is not simple meets itself somewhere")


def _called(curve: Curve) -> str:
    """The curve in words, for a message."""
    name = curve.name or next(filter(None, curve.names), "")
    return f"the outline '{name}'" if name else "the outline"


def _named(chain: Curve) -> Curve:
    """The chain under the name of its pieces, where they agree."""
    return Curve(
        chain.points, chain.bulges, chain.names, chain.names[0] if len(set(chain.names)) == 1 else ""
    )


def _distinct(pieces: Sequence[Curve], tolerance: float, notes: list[str]) -> list[Curve]:
    """The pieces without those of no length and without repetitions, noted."""
    kept = [piece for piece in pieces if float(np.sum(piece.lengths)) > tolerance]
    if len(kept) < len(pieces):
        notes.append(f"{len(pieces) - len(kept)} curves of no length were left out")
    seen: set[bytes] = set()
    unique = []
    for piece in kept:
        ways = {_fingerprint(way, tolerance) for way in (piece, piece.reversed())}
        if not seen & ways:
            unique.append(piece)
        seen |= ways
    if len(unique) < len(kept):
        notes.append(f"{len(kept) - len(unique)} curves drawn twice were taken once")
    return unique


def _fingerprint(piece: Curve, tolerance: float) -> bytes:
    """The piece rounded to about ten tolerances, equal for pieces that lie on each other."""
    grid = 10.0 * tolerance
    return (np.round(piece.points / grid) + 0.0).tobytes() + (np.round(piece.bulges, 6) + 0.0).tobytes()


def _joined(chains: list[Curve], tolerance: float) -> tuple[list[Curve], float]:
    """Chains joined where exactly two ends lie within the tolerance; and the widest gap that was closed."""
    if not chains:
        return [], 0.0
    ends = np.array([chain.points[[0, -1]] for chain in chains]).reshape(
        -1, 2
    )  # end 2k and 2k + 1 of chain k
    place = _clusters(ends, tolerance)
    for k, chain in enumerate(chains):
        # A chain shorter than a few gaps would vanish if its ends were joined to each other.
        if (
            place[2 * k] == place[2 * k + 1]
            and not chain.closed
            and float(np.sum(chain.lengths)) < 10.0 * tolerance
        ):
            place[2 * k + 1] = place.max() + 1
    partner = _partners(place)
    widest = max((float(np.hypot(*(ends[a] - ends[b]))) for a, b in partner.items()), default=0.0)
    corner = {int(p): ends[k] for k, p in reversed(list(enumerate(place)))}
    result = []
    used = np.zeros(len(chains), dtype=bool)
    free = [end for end in range(len(ends)) if end not in partner]
    free.sort(key=lambda end: end % 2)  # an open chain runs as its pieces do, whatever their order
    for start in [*free, *range(0, len(ends), 2)]:
        if not used[start // 2]:
            result.append(_walk(chains, start, partner, place, corner, used))
    return result, widest


def _branches(chains: list[Curve], tolerance: float) -> list[str]:
    """A note on the points where three or more ends of open chains meet."""
    if not chains:
        return []
    ends = np.array([chain.points[[0, -1]] for chain in chains]).reshape(-1, 2)
    place = _clusters(ends, tolerance)
    crowded = np.flatnonzero(np.bincount(place) > 2)
    if len(crowded) == 0:
        return []
    x, y = ends[np.argmax(place == crowded[0])]
    return [f"curves branch at {len(crowded)} points, the first ({x:g}, {y:g}) m: chains end there"]


def _clusters(ends: Floats, tolerance: float) -> NDArray[np.int64]:
    """(k,) The place of each end: ends within the tolerance of one another share one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(ends).query_pairs(tolerance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(ends), len(ends)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _partners(place: NDArray[np.int64]) -> dict[int, int]:
    """The other end of each end that meets exactly one other."""
    at = defaultdict(list)
    for end, where in enumerate(place):
        at[int(where)].append(end)
    pairs = [tuple(found) for found in at.values() if len(found) == 2]
    return {a: b for pair in pairs for a, b in (pair, pair[::-1])}


def _walk(
    chains: list[Curve], start: int, partner: dict[int, int], place: NDArray[np.int64], corner: dict[int, Floats],
    used: NDArray[np.bool_],
) -> Curve:  # fmt: skip
    """The chain that begins at one end and runs from partner to partner until it ends or closes."""
    points = [corner[int(place[start])][None]]
    bulges: list[Floats] = []
    names: list[str] = []
    end: int | None = start
    while end is not None and not used[end // 2]:
        used[end // 2] = True
        chain = chains[end // 2] if end % 2 == 0 else chains[end // 2].reversed()
        points += [chain.points[1:-1], corner[int(place[end ^ 1])][None]]
        bulges.append(chain.bulges)
        names += chain.names
        end = partner.get(end ^ 1)
    return Curve(np.vstack(points), np.concatenate(bulges), tuple(names))
