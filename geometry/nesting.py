"""Closed loops nested into regions, after making sure that none crosses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Region, diagonal
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.findings import Finding, place
from phantomnode.geometry.flatten import CHORD_ERROR

Floats = NDArray[np.float64]


def nest(loops: Sequence[Curve], name: str = "") -> tuple[Region, ...]:
    """Closed loops as regions by their depth: even ones bound material, odd ones are holes of the loop around them.

    Raises
    ------
    GeometryError
        Where a loop crosses itself or another one, with the point.
    """
    return _nested(loops, check_simple(loops), name) if loops else ()


def sort_out(loops: Sequence[Curve]) -> tuple[tuple[Region, ...], tuple[Curve, ...], tuple[Finding, ...]]:
    """Regions as :func:`nest` gives them, the loops that make none, and why.

    A loop that crosses itself or another one makes no region, and neither do those inside or around it: nothing
    tells what there is material and what is hole.
    """
    if not loops:
        return (), (), ()
    lines = _lines(loops)
    found = _crossings(loops, lines)
    if not found:
        return _nested(loops, lines, ""), (), ()
    bad = _entangled(lines, {k for _, pair in found for k in pair})
    good = [k for k in range(len(loops)) if k not in bad]
    regions = _nested([loops[k] for k in good], [lines[k] for k in good], "")
    return regions, tuple(loops[k] for k in sorted(bad)), tuple(finding for finding, _ in found)


def check_simple(loops: Sequence[Curve]) -> list[Floats]:
    """The loops as closed polygons, (k, 2) vertices each, after making sure that none crosses.

    Raises
    ------
    GeometryError
        Where a loop crosses or touches itself, or two loops cross or share a stretch; with the point.
    """
    lines = _lines(loops)
    for finding, members in _crossings(loops, lines):
        x, y = finding.at
        if finding.kind == "self":
            raise GeometryError(
                f"{_called(loops[members[0]])} crosses itself at ({x:g}, {y:g}) m; an outline must not"
            )
        first, second = (_called(loops[k]) for k in members)
        raise GeometryError(
            f"{first} and {second} cross or share a stretch at ({x:g}, {y:g}) m; outlines must not"
        )
    return lines


def _lines(loops: Sequence[Curve]) -> list[Floats]:
    """Each loop as a polygon within the chord error."""
    return [loop.polyline(CHORD_ERROR * diagonal([loop])) for loop in loops]


def _nested(loops: Sequence[Curve], lines: Sequence[Floats], name: str) -> tuple[Region, ...]:
    """Loops that do not cross as regions."""
    if not loops:
        return ()
    from shapely import Polygon, STRtree

    polygons = [Polygon(line) for line in lines]
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


def _entangled(lines: Sequence[Floats], bad: set[int]) -> set[int]:
    """The bad loops, and those that lie within one of them or around one."""
    import shapely

    solids = [
        shapely.Polygon(line).buffer(0.0) if k in bad else shapely.Polygon(line)
        for k, line in enumerate(lines)
    ]
    tree = shapely.STRtree(solids)
    first, second = tree.query([solids[k] for k in sorted(bad)], predicate="intersects")
    del first
    return bad | {int(k) for k in second}


def _crossings(loops: Sequence[Curve], lines: Sequence[Floats]) -> list[tuple[Finding, tuple[int, ...]]]:
    """Every loop that meets itself and every two that cross or share a stretch."""
    import shapely

    rings = [shapely.LineString(line) for line in lines]
    found: list[tuple[Finding, tuple[int, ...]]] = []
    for k, ring in enumerate(rings):
        if not ring.is_simple:
            found.append((Finding("self", _self_crossing(ring)), (k,)))
    bad = {k for _, (k,) in found}  # type: ignore[misc]
    for a, b in zip(*shapely.STRtree(rings).query(rings, predicate="intersects"), strict=True):
        if a < b and not bad & {a, b}:
            ring, other = rings[a], rings[b]
            if ring.crosses(other) or ring.overlaps(other) or ring.equals(other):
                where = _shared_stretch(loops[a], loops[b], ring, other)
                if where is not None:
                    found.append((Finding("crossing", where), (int(a), int(b))))
    return found


def _shared_stretch(first: Curve, second: Curve, a: object, b: object) -> tuple[float, float] | None:
    """Where two loops cross or share a stretch; None where one only touches the other from one side."""
    import shapely

    inside, outside = shapely.Polygon(a), shapely.Polygon(b)
    common = shapely.intersection(inside, outside).area
    # Where arcs touch, their polygons may overlap by as much as they differ from the arcs.
    slack = 2.0 * CHORD_ERROR * (inside.length + outside.length) * diagonal([first, second])
    apart = common <= slack or min(inside.area, outside.area) - common <= slack
    # Polygons of arcs that touch may have a side in common, about sqrt(8 R CHORD_ERROR) long.
    shared = shapely.intersection(a, b)
    if shared.length > 4.0 * CHORD_ERROR**0.5 * diagonal([first, second]) or not apart:
        return place(min(shapely.get_coordinates(shared), key=tuple))
    return None


def _self_crossing(ring: object) -> tuple[float, float]:
    """A point where a ring that is not simple meets itself."""
    import shapely

    segments = np.stack([shapely.get_coordinates(ring)[:-1], shapely.get_coordinates(ring)[1:]], axis=1)
    lines = shapely.linestrings(segments)
    first, second = shapely.STRtree(lines).query(lines, predicate="intersects")
    last = len(lines) - 1
    for i, j in zip(first, second, strict=True):
        shared = shapely.intersection(lines[i], lines[j])
        neighbours = j == i + 1 or (i == 0 and j == last)
        if i < j and not (neighbours and shared.geom_type == "Point"):
            return place(shapely.get_coordinates(shared)[0])
    raise AssertionError("a ring that is not simple meets itself somewhere")


def _called(curve: Curve) -> str:
    """The curve in words, for a message."""
    name = curve.name or next(filter(None, curve.names), "")
    return f"the outline '{name}'" if name else "the outline"
