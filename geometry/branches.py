"""Outlines among curves that branch: the outer boundary of what they enclose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, arc_centre, diagonal
from phantomnode.geometry.findings import Finding, place
from phantomnode.geometry.flatten import CHORD_ERROR

Floats = NDArray[np.float64]


def outlined(chains: Sequence[Curve], tolerance: float) -> tuple[list[Curve], list[Curve], list[Finding]]:
    """Closed loops among open chains that meet in common vertices, three or more, or end on one another.

    Where lines divide an area, nothing says which of its parts are material: the loops are the outer boundaries of
    all that the chains enclose together, and the chains within stay chains. What encloses nothing stays as it is.

    Parameters
    ----------
    chains : sequence of Curve
        Open; ends that meet are the same to the bit. A chain may end where it begins.
    tolerance : float, m
        How far from a chain an end may lie that is taken to lie on it.

    Returns
    -------
    loops, remaining chains, findings
    """
    if not chains:
        return [], [], []
    import shapely

    parts, owner = _split(chains, tolerance)
    error = CHORD_ERROR * diagonal(chains)
    lines = [part.polyline(error) for part in parts]
    edges = [shapely.LineString(line) for line in lines]
    tree = shapely.STRtree(edges)
    crossed = {int(k) for pair in tree.query(edges, predicate="crosses").T for k in pair}
    clean = [k for k in range(len(parts)) if k not in crossed and edges[k].is_simple]
    faces = shapely.get_parts(shapely.polygonize([edges[k] for k in clean]))
    if len(faces) == 0:
        return [], list(chains), []
    merged = shapely.get_parts(shapely.coverage_union_all(faces))
    segment = {}
    for k in clean:
        for a, b in zip(lines[k][:-1].tolist(), lines[k][1:].tolist(), strict=True):
            segment[*a, *b], segment[*b, *a] = (k, True), (k, False)
    loops, used, findings = [], set(), []
    for polygon in merged:
        for ring in (polygon.exterior, *polygon.interiors):
            path = _path(ring, segment)
            loops.append(_chained(parts, path))
            used |= {k for k, _ in path}
        findings.append(Finding("branch", place(loops[-1 - len(polygon.interiors)].points[0])))
    whole = {owner[k] for k in used}
    rest = [chain for k, chain in enumerate(chains) if k not in whole]
    rest += [part for k, part in enumerate(parts) if owner[k] in whole and k not in used]
    return loops, rest, findings


def _path(ring: Any, segment: dict[tuple[float, ...], tuple[int, bool]]) -> list[tuple[int, bool]]:
    """The parts along a ring in order, and whether each is run forwards."""
    import shapely

    points = shapely.get_coordinates(ring).tolist()
    steps = [segment[*a, *b] for a, b in zip(points[:-1], points[1:], strict=True)]
    first = next((k for k in range(len(steps)) if steps[k - 1] != steps[k]), 0)
    turned = steps[first:] + steps[:first]
    return [step for k, step in enumerate(turned) if k == 0 or step != turned[k - 1]]


def _chained(parts: Sequence[Curve], path: Sequence[tuple[int, bool]]) -> Curve:
    """The parts one after the other as one curve."""
    run = [parts[k] if forwards else parts[k].reversed() for k, forwards in path]
    points = np.vstack([run[0].points[:1], *(part.points[1:] for part in run)])
    names = tuple(name for part in run for name in part.names)
    return Curve(points, np.concatenate([part.bulges for part in run]), names)


def _split(chains: Sequence[Curve], tolerance: float) -> tuple[list[Curve], list[int]]:
    """The chains cut where ends of others lie on them, and the number of the chain that each part comes from."""
    import shapely

    ends = np.array([chain.points[k] for chain in chains for k in (0, -1)])
    lines = [shapely.LineString(chain.polyline(CHORD_ERROR * diagonal([chain]))) for chain in chains]
    # The polygon of an arc keeps within the chord error of it, and so may an end on the arc.
    reach = tolerance + CHORD_ERROR * diagonal(chains)
    near: dict[int, list[int]] = {}
    points = shapely.points(ends)
    for end, chain in zip(
        *shapely.STRtree(lines).query(points, predicate="dwithin", distance=reach), strict=True
    ):
        near.setdefault(int(chain), []).append(int(end))
    parts: list[Curve] = []
    owner: list[int] = []
    for k, chain in enumerate(chains):
        pieces = _cut(chain, ends[near.get(k, [])], tolerance)
        parts += pieces
        owner += [k] * len(pieces)
    return parts, owner


def _cut(chain: Curve, ends: Floats, tolerance: float) -> list[Curve]:
    """A chain cut at those of the (k, 2) points that lie on it, which become its vertices."""
    where: dict[tuple[int, float], Floats] = {}
    for end in ends:
        if np.min(np.hypot(*(chain.points[[0, -1]] - end).T)) > tolerance:
            piece, s, distance = _nearest(chain, end)
            if distance <= tolerance:
                where.setdefault((piece, s), end)
    parts = []
    last, cut_at = len(chain.bulges), 1.0  # the piece that was cut last, and the fraction of it that is left
    for (piece, s), end in sorted(where.items(), key=lambda item: item[0], reverse=True):
        head, tail = _divided(chain, piece, s / cut_at if piece == last else s, end, tolerance)
        if len(tail.bulges) and len(head.bulges):
            parts.append(tail)
            chain, last, cut_at = head, piece, s
    return [chain, *parts[::-1]]


def _nearest(chain: Curve, point: Floats) -> tuple[int, float, float]:
    """The piece of a chain that comes nearest to a point, the fraction along it, and the distance."""
    a, b = chain.points[:-1], chain.points[1:]
    along = np.clip(np.sum((point - a) * (b - a), axis=1) / chain.chords**2, 0.0, 1.0)
    bent = np.flatnonzero(chain.bulges)
    if len(bent):
        centre = arc_centre(a[bent], b[bent], chain.bulges[bent])
        sign, sweep = np.sign(chain.bulges[bent]), np.abs(chain.angles[bent])
        first, here = a[bent] - centre, point - centre
        turn = np.arctan2(first[:, 0] * here[:, 1] - first[:, 1] * here[:, 0], np.sum(first * here, axis=1))
        turn = np.mod(sign * turn, 2.0 * np.pi)
        beyond = turn - sweep  # past the end, nearer to it or to the start
        turn = np.where(beyond > 0.0, np.where(beyond < 0.5 * (2.0 * np.pi - sweep), sweep, 0.0), turn)
        along[bent] = turn / sweep
    distance = np.hypot(*(chain.at(np.arange(len(along)), along) - point).T)
    best = int(np.argmin(distance))
    return best, float(along[best]), float(distance[best])


def _divided(chain: Curve, piece: int, s: float, point: Floats, tolerance: float) -> tuple[Curve, Curve]:
    """A chain before and after a point on one of its pieces; a vertex within the tolerance becomes the point."""
    points, bulges, names = chain.points, chain.bulges, chain.names
    for vertex in (piece, piece + 1):
        if np.hypot(*(points[vertex] - point)) <= tolerance:
            head, tail = points[: vertex + 1].copy(), points[vertex:].copy()
            head[-1] = tail[0] = point
            return Curve(head, bulges[:vertex], names[:vertex]), Curve(tail, bulges[vertex:], names[vertex:])
    angle = chain.angles[piece]
    before, after = np.tan(0.25 * s * angle), np.tan(0.25 * (1.0 - s) * angle)
    head = np.vstack([points[: piece + 1], point])
    tail = np.vstack([point, points[piece + 1 :]])
    return (
        Curve(head, np.append(bulges[:piece], before), names[: piece + 1]),
        Curve(tail, np.append(after, bulges[piece + 1 :]), names[piece:]),
    )
