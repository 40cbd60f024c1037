"""Splines of CAD files as functions of their parameter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import Evaluate

Floats = NDArray[np.float64]

HIGHEST_DEGREE = 25
"""No CAD kernel writes splines of a higher degree (OCC's limit)."""


def spline(
    degree: int, knots: Floats, points: Floats, weights: Floats | None = None, *, periodic: bool = False
) -> tuple[Evaluate, Floats]:
    """A rational or plain B-spline from its degree, knots and control points.

    Parameters
    ----------
    degree : int
    knots : (m,) float64
        Ascending. The standard m = n + degree + 1; also two fewer, as some programs leave out the first and the
        last, which have no effect; of a periodic spline also the m = n + 1 distinct ones, after which the control
        points begin again; or none, for uniform ones that repeat at the ends.
    points : (n, 2) float64
    weights : (n,) float64, optional
    periodic : bool
        Whether the file says that the spline closes smoothly upon itself.

    Returns
    -------
    (k,) parameters -> (k, 2) points, and the parameters of ends and knots, ascending

    Raises
    ------
    GeometryError
        Where the numbers do not fit together.
    """
    weights = np.ones(len(points)) if weights is None or len(weights) == 0 else np.asarray(weights)
    _check(degree, knots, points, weights)
    homogeneous = np.column_stack([points * weights[:, None], weights])
    knots, homogeneous = _standard(degree, np.asarray(knots, dtype=np.float64), homogeneous, periodic)
    first, last = knots[degree], knots[len(homogeneous)]
    if not first < last:
        raise GeometryError("its knots are all the same")
    from scipy.interpolate import BSpline

    curve = BSpline(knots, homogeneous, degree)

    def evaluate(parameter: Floats) -> Floats:
        place = curve(np.clip(parameter, first, last))
        return np.asarray(place[:, :2] / place[:, 2:])

    inner = knots[(knots > first) & (knots < last)]
    return evaluate, np.concatenate([[first], np.unique(inner), [last]])


def _check(degree: int, knots: Floats, points: Floats, weights: Floats) -> None:
    """Refuse what no spline has."""
    if not 1 <= degree <= HIGHEST_DEGREE:
        raise GeometryError(f"its degree is {degree}, and must lie in 1 to {HIGHEST_DEGREE}")
    if len(points) < 2:
        raise GeometryError(f"it has {len(points)} control points")
    if len(weights) != len(points):
        raise GeometryError(f"it has {len(weights)} weights for {len(points)} control points")
    if not (np.all(np.isfinite(points)) and np.all(np.isfinite(knots)) and np.all(np.isfinite(weights))):
        raise GeometryError("its numbers are not all finite")
    if np.any(weights <= 0.0):
        raise GeometryError("a weight is not positive")
    if np.any(np.diff(knots) < 0.0):
        raise GeometryError("its knots do not ascend")


def _standard(degree: int, knots: Floats, points: Floats, periodic: bool) -> tuple[Floats, Floats]:
    """Knots and control points in the standard numbers."""
    count = len(points)
    if periodic and len(knots) == count + 1 and np.all(np.diff(knots) > 0.0):
        period = knots[-1] - knots[0]
        before, after = knots[-1 - degree : -1] - period, knots[1 : degree + 1] + period
        if degree <= count:
            return np.concatenate([before, knots, after]), np.vstack([points, points[:degree]])
    if count > degree:
        if len(knots) == count + degree + 1:
            return knots, points
        if len(knots) == count + degree - 1:
            return np.concatenate([knots[:1], knots, knots[-1:]]), points
        if len(knots) == 0:
            inner = np.arange(count - degree + 1, dtype=np.float64)
            return np.concatenate([[0.0] * degree, inner, [inner[-1]] * degree]), points
    raise GeometryError(
        f"a spline of degree {degree} with {count} control points has {count + degree + 1} knots, not {len(knots)}"
    )
