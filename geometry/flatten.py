"""Free-form curves into straight lines and circular arcs.

A curve is given by a function of its parameter. Where it is a straight line or a circular arc it becomes one
(drawings hold circles as splines and as ellipses with equal axes); everything else becomes an inscribed polygon
whose distance from the curve stays below a stated chord error.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError

Floats = NDArray[np.float64]
Evaluate = Callable[[Floats], Floats]
"""(k,) parameters to (k, 2) points."""

CHORD_ERROR = 1e-6
"""Chord error of flattened ellipses and splines over the drawing's diagonal: a thousandth of a cell where a
thousand cells span the drawing, far below the 1e-3 of a cell's area that the straight cut of a cell leaves out."""

RECOGNISED = 1e-3
"""A curve is taken for a line or an arc when it keeps within this part of the chord error from it, so that
recognition is never worse than flattening."""

MOST_VERTICES = 200_000
"""Vertices of one flattened curve beyond which something is wrong with it."""


def trace(evaluate: Evaluate, breaks: Floats, chord_error: float) -> tuple[Floats, Floats]:
    """Vertices and bulges of a curve: one line, one or two arcs, or an inscribed polygon.

    Parameters
    ----------
    evaluate : (k,) parameters -> (k, 2) points
    breaks : (b,) float64
        Ascending parameters: the ends, and knots between them where the curve may have a kink.
    chord_error : float
        Largest distance between curve and polygon, in the units of the points.

    Returns
    -------
    (n + 1, 2) points and (n,) bulges
    """
    evaluate = _finite(evaluate)
    samples = evaluate(_starting(breaks))
    tolerance = RECOGNISED * chord_error
    if _is_line(samples, tolerance):
        return samples[[0, -1]], np.zeros(1)
    arcs = _as_arcs(samples, tolerance)
    return arcs if arcs is not None else _polygon(flatten(evaluate, breaks, chord_error))


def flatten(evaluate: Evaluate, breaks: Floats, chord_error: float) -> Floats:
    """(n, 2) Vertices of an inscribed polygon within ``chord_error`` of the curve (arguments as :func:`trace`).

    Every interval of the parameter is halved until the curve at its quarters lies within the chord error of the
    chord. Sixteen intervals between any two breaks to begin with keep a wave from hiding between the quarters.
    A jump becomes a steep line.
    """
    evaluate = _finite(evaluate)
    ends = _starting(breaks)
    accepted = [ends[:1], ends[-1:]]
    left, right = ends[:-1], ends[1:]
    smallest = 1e-12 * (ends[-1] - ends[0])
    while len(left):
        deviation = _deviation(evaluate, left, right)
        split = (deviation > chord_error) & (right - left > smallest)
        accepted.append(right[~split])
        middle = 0.5 * (left + right)[split]
        left, right = np.concatenate([left[split], middle]), np.concatenate([middle, right[split]])
        if len(left) > MOST_VERTICES:
            raise GeometryError(
                f"a curve needs more than {MOST_VERTICES} lines to keep within {chord_error:.1e}: is it finite "
                "everywhere, and the chord error not too small?"
            )
    return evaluate(np.unique(np.concatenate(accepted)))


def _starting(breaks: Floats) -> Floats:
    """Sixteen intervals between any two breaks."""
    parts = [np.linspace(a, b, 17) for a, b in zip(breaks, breaks[1:], strict=False)]
    return np.asarray(np.unique(np.concatenate(parts)))


def _finite(evaluate: Evaluate) -> Evaluate:
    """The same function, refusing points that are not finite."""

    def checked(parameter: Floats) -> Floats:
        points = evaluate(parameter)
        bad = ~np.all(np.isfinite(points), axis=1)
        if np.any(bad):
            raise GeometryError(f"a curve is not finite near its parameter {parameter[bad][0]:g}")
        return points

    return checked


def _deviation(evaluate: Evaluate, left: Floats, right: Floats) -> Floats:
    """(k,) Distance from the chord of the curve at the quarters of (k,) intervals; the largest of the three."""
    quarters = np.array([0.25, 0.5, 0.75])
    a, b = evaluate(left)[:, None], evaluate(right)[:, None]
    inner = evaluate((left[:, None] + quarters * (right - left)[:, None]).ravel()).reshape(-1, 3, 2)
    chord = b - a
    square = np.sum(chord**2, axis=-1)
    along = np.sum((inner - a) * chord, axis=-1) / np.where(square > 0.0, square, 1.0)
    foot = a + np.clip(along, 0.0, 1.0)[..., None] * chord
    return np.asarray(np.max(np.hypot(*np.moveaxis(inner - foot, -1, 0)), axis=1))


def _polygon(points: Floats) -> tuple[Floats, Floats]:
    """The vertices without repeated ones, and as many zero bulges as lines."""
    keep = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])
    return points[keep], np.zeros(np.count_nonzero(keep) - 1)


def _is_line(samples: Floats, tolerance: float) -> bool:
    """Whether (k, 2) samples run straight on from the first to the last."""
    chord = samples[-1] - samples[0]
    length = float(np.hypot(*chord))
    if length <= tolerance:
        return False
    offset = samples - samples[0]
    across = (chord[0] * offset[:, 1] - chord[1] * offset[:, 0]) / length
    along = offset @ chord / length
    return bool(np.all(np.abs(across) <= tolerance) and np.all(np.diff(along) > -tolerance))


def _as_arcs(samples: Floats, tolerance: float) -> tuple[Floats, Floats] | None:
    """The circular arc through (k, 2) samples, as two arcs where it exceeds a half circle; None if it is none."""
    third = len(samples) // 3
    centre = _circumcentre(samples[0], samples[third], samples[2 * third])
    if centre is None:
        return None
    arm = samples - centre
    radius = float(np.mean(np.hypot(*arm.T)))
    if np.max(np.abs(np.hypot(*arm.T) - radius)) > tolerance:
        return None
    turns = np.arctan2(
        arm[:-1, 0] * arm[1:, 1] - arm[:-1, 1] * arm[1:, 0], np.sum(arm[:-1] * arm[1:], axis=1)
    )
    sweep = float(np.sum(turns))
    if np.any(turns * sweep < 0.0) or abs(sweep) > 2.0 * np.pi + 1e-9:
        return None
    closed = abs(abs(sweep) - 2.0 * np.pi) * radius <= tolerance
    return arc_pieces(
        samples[0],
        samples[0] if closed else samples[-1],
        centre,
        np.sign(sweep) * 2.0 * np.pi if closed else sweep,
    )


def arc_pieces(start: Floats, end: Floats, centre: Floats, sweep: float) -> tuple[Floats, Floats]:
    """Vertices and bulges of the arc from ``start`` to ``end`` by ``sweep`` radians, positive to the left.

    Half a circle stays one arc; more becomes two, since the bulge of a full circle is infinite.
    """
    if abs(sweep) <= np.pi * (1.0 + 1e-12):
        return np.array([start, end]), np.array([np.tan(0.25 * sweep)])
    arm = np.asarray(start) - centre
    c, s = np.cos(0.5 * sweep), np.sin(0.5 * sweep)
    middle = centre + np.array([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]])
    if abs(sweep) == 2.0 * np.pi:
        middle = centre - arm
    return np.array([start, middle, end]), np.full(2, np.tan(0.125 * sweep))


def _circumcentre(a: Floats, b: Floats, c: Floats) -> Floats | None:
    """(2,) Centre of the circle through three points; None where they lie on a line."""
    u, v = b - a, c - a
    cross = u[0] * v[1] - u[1] * v[0]
    if abs(cross) <= 1e-9 * float(np.hypot(*u) * np.hypot(*v)):
        return None
    uu, vv = u @ u, v @ v
    return np.asarray(a + np.array([v[1] * uu - u[1] * vv, u[0] * vv - v[0] * uu]) / (2.0 * cross))
