"""Simple shapes, as a case file or a script writes them; everything in metres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phantomnode.geometry.curves import SIDES, Curve, Geometry, Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import flatten
from phantomnode.geometry.nesting import check_simple

Floats = NDArray[np.float64]


def rectangle(low: ArrayLike, high: ArrayLike) -> Region:
    """The rectangle between two opposite corners; its pieces are named bottom, right, top and left.

    Raises
    ------
    GeometryError
        Unless low < high in both directions.
    """
    x0, y0 = _point(low, "the lower left corner of a rectangle")
    x1, y1 = _point(high, "the upper right corner of a rectangle")
    if not (x0 < x1 and y0 < y1):
        raise GeometryError(
            f"a rectangle needs low < high in x and y; got low = ({x0:g}, {y0:g}), high = ({x1:g}, {y1:g})"
        )
    points = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    return Region(Curve(points, np.zeros(4), SIDES))


def circle(centre: ArrayLike, radius: float) -> Region:
    """A disc, bounded by two half circles.

    Raises
    ------
    GeometryError
        Unless the radius is positive and finite.
    """
    return Region(_circle(centre, radius, "circle", "outer"))


def ring(centre: ArrayLike, outer_radius: float, inner_radius: float) -> Region:
    """The region between two circles about one centre; its loops are named outer and inner.

    Raises
    ------
    GeometryError
        Unless 0 < inner_radius < outer_radius.
    """
    outer = _circle(centre, outer_radius, "ring", "outer")
    inner = _circle(centre, inner_radius, "ring", "inner")
    if not inner_radius < outer_radius:
        raise GeometryError(
            f"a ring needs inner_radius < outer_radius; got {inner_radius:g} and {outer_radius:g}"
        )
    return Region(outer, (inner,))


def polygon(points: ArrayLike) -> Region:
    """The region inside a polygon of (n, 2) corners, in either direction; the last may repeat the first.

    Raises
    ------
    GeometryError
        For fewer than three corners, repeated ones, or sides that cross (with the point).
    """
    corners = _points(points, "a polygon")
    if len(corners) > 1 and np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    if len(corners) < 3:
        raise GeometryError(f"a polygon needs at least 3 corners; got {len(corners)}")
    loop = _chain(np.vstack([corners, corners[:1]]), "a polygon")
    check_simple([loop])
    return Region(loop)


def polyline(points: ArrayLike) -> Curve:
    """The chain of straight lines through (n, 2) points; closed where the last repeats the first.

    Raises
    ------
    GeometryError
        For fewer than two points, or a point that repeats the one before it.
    """
    vertices = _points(points, "a polyline")
    if len(vertices) < 2:
        raise GeometryError(f"a polyline needs at least 2 points; got {len(vertices)}")
    return _chain(vertices, "a polyline")


def graph(function: Callable[[Floats], Floats], x0: float, x1: float, chord_error: float) -> Curve:
    """The curve y = function(x) from x0 to x1 as an inscribed chain of straight lines.

    Parameters
    ----------
    function : (k,) float64 -> (k,) float64
    x0, x1 : float, metres
    chord_error : float, metres
        Largest distance between the curve and the chain; choose it small against the grid's cells.

    Raises
    ------
    GeometryError
        Unless x0 < x1 and the chord error is positive, or where the function is not finite.
    """
    if not (np.isfinite([x0, x1]).all() and x0 < x1):
        raise GeometryError(f"the graph of a function needs x0 < x1; got x0 = {x0:g}, x1 = {x1:g}")
    if not 0.0 < chord_error < np.inf:
        raise GeometryError(f"the chord error of a graph must be positive; got {chord_error:g}")

    def evaluate(x: Floats) -> Floats:
        with np.errstate(all="ignore"):  # values that are not finite are refused by flatten, with the place
            y = np.broadcast_to(np.asarray(function(x), dtype=np.float64), x.shape)
        return np.column_stack([x, y])

    return _chain(
        flatten(evaluate, np.array([x0, x1], dtype=np.float64), chord_error), "the graph of a function"
    )


def placed(
    geometry: Geometry, move: Sequence[float] = (0.0, 0.0), rotate: float = 0.0, scale: float = 1.0
) -> Geometry:
    """The geometry scaled, then rotated about the origin, then moved.

    Parameters
    ----------
    geometry : Geometry
    move : (x, y), metres
    rotate : float, degrees, positive to the left
        Multiples of 90 degrees are exact.
    scale : float

    Raises
    ------
    GeometryError
        For a scale that is not positive, or a number that is not finite.
    """
    shift = _point(move, "move")
    if not 0.0 < scale < np.inf:
        raise GeometryError(f"scale must be positive; got {scale:g}")
    if not np.isfinite(rotate):
        raise GeometryError(f"rotate must be a finite number of degrees; got {rotate:g}")
    quarters, rest = divmod(rotate, 90.0)
    c, s = np.cos(np.radians(rest)), np.sin(np.radians(rest))
    for _ in range(int(quarters) % 4):
        c, s = -s, c
    turn = scale * np.array([[c, s], [-s, c]])

    def move_curve(curve: Curve) -> Curve:
        return Curve(curve.points @ turn + shift, curve.bulges, curve.names, curve.name)

    regions = tuple(
        Region(move_curve(region.outer), tuple(map(move_curve, region.holes)), region.name)
        for region in geometry.regions
    )
    return replace(geometry, regions=regions, curves=tuple(map(move_curve, geometry.curves)))


def _circle(centre: ArrayLike, radius: float, shape: str, name: str) -> Curve:
    """A counter-clockwise circle as two half circles."""
    x, y = _point(centre, f"the centre of a {shape}")
    if not 0.0 < radius < np.inf:
        raise GeometryError(f"the radius of a {shape} must be positive; got {radius:g}")
    points = np.array([[x + radius, y], [x - radius, y], [x + radius, y]])
    return Curve(points, np.ones(2), (name, name), name)


def _chain(points: Floats, what: str) -> Curve:
    """Straight lines through (n, 2) points, none of them of no length."""
    repeated = np.flatnonzero(np.all(np.diff(points, axis=0) == 0.0, axis=1))
    if len(repeated):
        x, y = points[repeated[0]]
        raise GeometryError(f"{what} repeats the point ({x:g}, {y:g}); leave one of them out")
    return Curve(points, np.zeros(len(points) - 1))


def _point(value: ArrayLike, what: str) -> Floats:
    """(2,) A point, checked."""
    return np.asarray(_points([value], what)[0])


def _points(value: Any, what: str) -> Floats:
    """(n, 2) Points, checked."""
    try:
        points = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise GeometryError(f"{what} must be given by pairs of numbers (x, y); got {value!r}") from error
    if points.ndim != 2 or points.shape[1] != 2:
        raise GeometryError(f"{what} must be given by pairs of numbers (x, y); got {value!r}")
    if not np.all(np.isfinite(points)):
        raise GeometryError(f"{what} must be finite; got {value!r}")
    return points
