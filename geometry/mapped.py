"""Structured grids that follow a shape: polar ones, and those between four curves."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid, Numbers, check, require_finite, whole_counts

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Pair = tuple[float, float]

JOIN = 1e-6
"""Curves of a mapped grid meet where their ends are this close, in sizes of the whole."""


class StructuredGrid(BackgroundGrid):
    """Cells in rows, the first direction running fastest: their nodes follow from their numbers.

    ``quads`` are made where somebody asks for them.
    """

    def __init__(self, xy: Floats, shape: tuple[int, int]) -> None:
        """Nodes (n, 2), metres, and cells in either direction; closed where the last row has none of its own."""
        object.__setattr__(self, "xy", xy)
        object.__setattr__(self, "shape", shape)

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        assert self.shape is not None
        return self.shape[0] * self.shape[1]

    @property
    def quads(self) -> Numbers:  # type: ignore[override]
        """(m, 4) Nodes of all cells."""
        return self.corners(np.arange(self.cell_count, dtype=np.int32))

    def corners(self, cells: Numbers) -> Numbers:
        """(k, 4) Nodes of some cells, counter-clockwise."""
        assert self.shape is not None
        low = cells + cells // self.shape[0]
        high = (low + (self.shape[0] + 1)) % ((self.shape[0] + 1) * (self.shape[1] + (not self.closed)))
        return np.stack([low, low + 1, high + 1, high], axis=-1)

    def moved(self, nodes: Ints, positions: Floats) -> StructuredGrid:
        """The grid with some nodes (k,), ascending, at other positions (k, 2), metres."""
        assert self.shape is not None
        xy = self.xy.copy()
        xy[nodes] = positions
        return StructuredGrid(xy, self.shape)


def polar(
    centre: Pair, radii: Pair, angles: Pair = (0.0, 360.0), *, counts: tuple[int, int]
) -> BackgroundGrid:
    """A ring or a part of one: the first direction is radial, the second runs counter-clockwise.

    Parameters
    ----------
    centre : (x, y), metres
    radii : (r0, r1), metres
        0 < r0 < r1.
    angles : (start, end), degrees
        From x towards y; a span of 360 closes the ring, with no node twice.
    counts : (n_r, n_theta)

    Raises
    ------
    GeometryError
        For radii or angles out of order, a full ring of fewer than three cells around, or bad counts.
    """
    require_finite("a polar grid", (*centre, *radii, *angles))
    if not 0.0 < radii[0] < radii[1]:
        raise GeometryError(f"the radii of a polar grid must be 0 < r0 < r1, not {radii}")
    span = angles[1] - angles[0]
    if not 0.0 < span <= 360.0:
        raise GeometryError(f"the angles of a polar grid must span more than 0 and at most 360, not {angles}")
    n_r, n_theta = whole_counts(counts)
    if span / n_theta >= 180.0:
        raise GeometryError(f"{n_theta} cells around {span:g} degrees: each must span less than 180 degrees")
    closed = span == 360.0
    r = np.linspace(radii[0], radii[1], n_r + 1)
    degrees = np.linspace(angles[0], angles[1], n_theta + 1)[: n_theta if closed else None]
    theta = np.radians(degrees)
    # Exactly on the axes at right angles.
    direction = np.column_stack([np.cos(theta), np.sin(theta)])
    direction = np.where(np.mod(degrees, 90.0)[:, None] == 0.0, np.round(direction), direction)
    xy = np.asarray(centre) + r[None, :, None] * direction[:, None, :]
    return check(StructuredGrid(xy.reshape(-1, 2), (n_r, n_theta)))


def mapped(bottom: Curve, right: Curve, top: Curve, left: Curve, counts: tuple[int, int]) -> BackgroundGrid:
    """A structured grid between four curves (transfinite interpolation, Gordon and Hall 1973).

    Nodes are equally spaced along each curve; those on the outside lie on the curves.

    Parameters
    ----------
    bottom, right, top, left : Curve
        Open curves that meet at four corners, each run either way; counter-clockwise in this order.
    counts : (int, int)
        Cells along bottom and top, and along right and left.

    Raises
    ------
    GeometryError
        Where the curves do not meet, or the cells fold over.
    """
    n_u, n_v = whole_counts(counts)
    bottom, right, top, left = _joined(bottom, right, top, left)
    u, v = np.linspace(0.0, 1.0, n_u + 1), np.linspace(0.0, 1.0, n_v + 1)
    b, t, r, w = (_spread(c, n) for c, n in ((bottom, u), (top, u), (right, v), (left, v)))
    u1, v1 = u[None, :, None], v[:, None, None]
    ruled = (1.0 - v1) * b[None] + v1 * t[None] + (1.0 - u1) * w[:, None] + u1 * r[:, None]
    corners = (1.0 - v1) * ((1.0 - u1) * b[0] + u1 * b[-1]) + v1 * ((1.0 - u1) * t[0] + u1 * t[-1])
    xy = ruled - corners
    xy[:, 0], xy[:, -1], xy[0], xy[-1] = w, r, b, t
    return check(StructuredGrid(xy.reshape(-1, 2), (n_u, n_v)))


def _joined(*curves: Curve) -> tuple[Curve, Curve, Curve, Curve]:
    """Bottom, right, top, left, turned so that bottom and top run to the right, right and left upwards."""
    names = ("bottom", "right", "top", "left")
    for curve, name in zip(curves, names, strict=True):
        if curve.closed:
            raise GeometryError(f"the {name} curve of a mapped grid is closed; it must be open")
    every = np.vstack([curve.points for curve in curves])
    size = float(np.ptp(every, axis=0).max())
    best: tuple[float, str, list[Curve]] | None = None
    for turns in itertools.product((False, True), repeat=4):
        b, r, t, w = turned = [c.reversed() if turn else c for c, turn in zip(curves, turns, strict=True)]
        meets = {
            "bottom and right": (b.points[-1], r.points[0]),
            "right and top": (r.points[-1], t.points[-1]),
            "top and left": (t.points[0], w.points[-1]),
            "left and bottom": (w.points[0], b.points[0]),
        }
        gap, where = max((float(np.hypot(*(p - q))), name) for name, (p, q) in meets.items())
        if best is None or gap < best[0]:
            best = gap, where, turned
    assert best is not None
    if best[0] > JOIN * size:
        raise GeometryError(
            f"the curves of a mapped grid must meet at four corners: {best[1]} are {best[0]:.3g} m apart"
        )
    b, r, t, w = best[2]
    return b, r, t, w


def _spread(curve: Curve, fractions: Floats) -> Floats:
    """(k, 2) Points at the given fractions of a curve's length; its ends exactly."""
    until = np.concatenate([[0.0], np.cumsum(curve.lengths)])
    target = fractions * until[-1]
    piece = np.clip(np.searchsorted(until, target, side="right") - 1, 0, len(curve.bulges) - 1)
    s = np.clip((target - until[piece]) / curve.lengths[piece], 0.0, 1.0)
    points = curve.at(piece, s)
    points[0], points[-1] = curve.points[0], curve.points[-1]
    return points
