"""Curves and regions: chains of straight lines and circular arcs, in metres.

A chain is kept as its vertices and one *bulge* a piece, b = tan(angle/4), where the angle is that of the
arc from one vertex to the next, positive when it turns left; b = 0 is a straight line. Ends that meet are
one and the same vertex, so a closed chain is closed exactly, and arcs stay arcs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError

if TYPE_CHECKING:
    from phantomnode.geometry.findings import Finding

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

CORNER_ANGLE = np.radians(1.0)
"""A vertex is a sharp corner (kept exactly by the cut) where the tangent turns by more than this."""

SIDES = ("bottom", "right", "top", "left")


@dataclass(frozen=True)
class Curve:
    """A chain of lines and arcs.

    Attributes
    ----------
    points : (n + 1, 2) float64, metres
        The vertices; the first equals the last, to the bit, where the chain is closed.
    bulges : (n,) float64
        tan(angle / 4) of the arc from vertex i to vertex i + 1; 0 for a straight line.
    names : tuple of n str
        The name of each piece (a physical group, a layer), "" where it has none.
    name : str
        The name of the chain as a whole, "" where it has none.
    """

    points: Floats
    bulges: Floats
    names: tuple[str, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", np.ascontiguousarray(self.points, dtype=np.float64))
        object.__setattr__(self, "bulges", np.ascontiguousarray(self.bulges, dtype=np.float64))
        if not self.names:
            object.__setattr__(self, "names", ("",) * len(self.bulges))
        if self.points.shape != (len(self.bulges) + 1, 2) or len(self.names) != len(self.bulges):
            raise ValueError(f"{len(self.bulges)} pieces need one more point and as many names")

    @property
    def closed(self) -> bool:
        """Whether the last vertex is the first."""
        return bool(np.array_equal(self.points[0], self.points[-1]))

    @cached_property
    def angles(self) -> Floats:
        """(n,) Angle of each piece, radians, positive to the left; 0 for a straight line."""
        return 4.0 * np.arctan(self.bulges)

    @cached_property
    def chords(self) -> Floats:
        """(n,) Straight distance between the ends of each piece, metres."""
        return np.asarray(np.hypot(*np.diff(self.points, axis=0).T))

    @cached_property
    def lengths(self) -> Floats:
        """(n,) Length of each piece along the curve, metres."""
        half = np.where(self.bulges == 0.0, 1.0, 0.5 * self.angles)
        return self.chords * np.where(self.bulges == 0.0, 1.0, half / np.sin(half))

    @property
    def signed_area(self) -> float:
        """Area inside a closed chain, m^2, exact with its arcs; positive when it runs counter-clockwise."""
        local = self.points - self.points[0]
        (x0, y0), (x1, y1) = local[:-1].T, local[1:].T
        # A circular segment on chord c with angle t: c^2 (t - sin t) / (8 sin^2(t/2)), the sign of t.
        t = np.where(self.bulges == 0.0, 1.0, self.angles)
        caps = self.chords**2 * (t - np.sin(t)) / (8.0 * np.sin(0.5 * t) ** 2)
        return float(0.5 * np.sum(x0 * y1 - x1 * y0) + np.sum(np.where(self.bulges == 0.0, 0.0, caps)))

    @cached_property
    def tangents(self) -> tuple[Floats, Floats]:
        """((n, 2), (n, 2)) Unit tangents at the start and at the end of each piece."""
        chord = np.diff(self.points, axis=0) / self.chords[:, None]
        half = 0.5 * self.angles
        return _rotate(chord, -half), _rotate(chord, half)

    @cached_property
    def corners(self) -> Bools:
        """(n + 1,) Whether each vertex is a sharp corner or a free end; the last repeats a closed first."""
        start, end = self.tangents
        turn = np.zeros(len(self.points))
        turn[1:-1] = _angle_between(end[:-1], start[1:])
        turn[[0, -1]] = _angle_between(end[-1:], start[:1])[0] if self.closed else np.pi
        return np.asarray(turn > CORNER_ANGLE)

    def at(self, piece: NDArray[np.int64], s: Floats) -> Floats:
        """(k, 2) Points at the fraction s (0..1 of the angle or length) of the given pieces, (k,) each."""
        a, b = self.points[piece], self.points[piece + 1]
        straight = np.where((s == 1.0)[:, None], b, a + s[:, None] * (b - a))  # the ends to the bit
        if not np.any(self.bulges[piece]):
            return straight
        # On the arc: chord point a + r(s) (b - a) turned by (s - 1) angle/2, r = sin(s t/2) / sin(t/2).
        half = np.where(self.bulges[piece] == 0.0, 1.0, 0.5 * self.angles[piece])
        ratio = np.sin(s * half) / np.sin(half)
        arc = a + ratio[:, None] * _rotate(b - a, (s - 1.0) * half)
        arc = np.where((s == 1.0)[:, None], b, arc)
        return np.where((self.bulges[piece] == 0.0)[:, None], straight, arc)

    def subdivided(self, longest: float) -> Curve:
        """The same curve with every piece cut into equal parts no longer than ``longest`` (metres)."""
        parts = np.maximum(1, np.ceil(self.lengths / longest).astype(np.int64))
        piece = np.repeat(np.arange(len(parts)), parts)
        within = np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)
        starts = self.at(piece, within / parts[piece])
        bulges = np.tan(self.angles[piece] / (4.0 * parts[piece]))
        points = np.vstack([starts, self.points[-1:]])
        return Curve(points, bulges, tuple(self.names[k] for k in piece), self.name)

    def polyline(self, chord_error: float) -> Floats:
        """(k, 2) Vertices of an inscribed polygon whose sagitta is at most ``chord_error`` (metres)."""
        angle, length = np.abs(self.angles), self.lengths
        radius = np.where(angle > 0.0, length / np.where(angle > 0.0, angle, 1.0), np.inf)
        # The sagitta r (1 - cos(step/2)) = 2 r sin^2(step/4); arccos would lose the small ones.
        step = 4.0 * np.arcsin(np.sqrt(np.minimum(0.5 * chord_error / radius, 1.0)))
        parts = np.where(angle > 0.0, np.ceil(angle / np.where(step > 0.0, step, 1.0)), 1.0)
        parts = np.maximum(1, parts).astype(np.int64)
        piece = np.repeat(np.arange(len(parts)), parts)
        within = np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)
        return np.vstack([self.at(piece, within / parts[piece]), self.points[-1:]])

    def reversed(self) -> Curve:
        """The same curve run the other way."""
        return Curve(self.points[::-1], -self.bulges[::-1], self.names[::-1], self.name)

    def scaled(self, factor: float) -> Curve:
        """The curve with all coordinates times ``factor`` (a unit in metres)."""
        return Curve(self.points * factor, self.bulges, self.names, self.name)

    @cached_property
    def box(self) -> Floats:
        """(2, 2) Lower left and upper right corner of the bounding box, metres, arcs included."""
        every = self.points
        bent = np.flatnonzero(self.bulges)
        if len(bent):
            extremes = [_arc_extremes(self.points[k], self.points[k + 1], self.bulges[k]) for k in bent]
            every = np.vstack([every, *extremes])
        return np.array([every.min(axis=0), every.max(axis=0)])


@dataclass(frozen=True)
class Region:
    """A bounded plane region: an outer loop and holes.

    Attributes
    ----------
    outer : Curve
        Closed, counter-clockwise (turned round where it is not).
    holes : tuple of Curve
        Closed, clockwise (turned round where they are not).
    name : str
        The name of the region, "" where it has none.
    """

    outer: Curve
    holes: tuple[Curve, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        for loop in (self.outer, *self.holes):
            if not loop.closed:
                raise GeometryError("the outline of a region must be a closed curve")
        if self.outer.signed_area < 0.0:
            object.__setattr__(self, "outer", self.outer.reversed())
        turned = tuple(hole if hole.signed_area < 0.0 else hole.reversed() for hole in self.holes)
        object.__setattr__(self, "holes", turned)

    @property
    def loops(self) -> tuple[Curve, ...]:
        """The outer loop first, then the holes; the material is on the left of each."""
        return (self.outer, *self.holes)

    @property
    def area(self) -> float:
        """Area, m^2, exact with its arcs."""
        return sum(loop.signed_area for loop in self.loops)

    @property
    def box(self) -> Floats:
        """(2, 2) Lower left and upper right corner of the bounding box, metres."""
        return self.outer.box


@dataclass(frozen=True)
class Contents:
    """What one layer of a file holds.

    Attributes
    ----------
    name : str
    kinds : tuple of (str, int)
        Kinds of entities and how many there are of each.
    state : str
        Why it does not count ("off", "frozen", "left out"); "" where it does.
    """

    name: str
    kinds: tuple[tuple[str, int], ...]
    state: str = ""


@dataclass(frozen=True)
class Geometry:
    """What a file (or a shape of the case file) holds, in metres.

    Attributes
    ----------
    regions : tuple of Region
    curves : tuple of Curve
        Open curves, and closed ones that are no outline.
    notes : tuple of str
        What the reader left out or mended, for the log and for ``check``.
    unit, format : str
        The unit that the numbers of the file were taken to have, and its format in words.
    contents : tuple of Contents
        The layers of a drawing, whether they count or not.
    findings : tuple of Finding
        What was mended in the drawing and what cannot be, with its place.
    """

    regions: tuple[Region, ...] = ()
    curves: tuple[Curve, ...] = ()
    notes: tuple[str, ...] = ()
    unit: str = "m"
    format: str = ""
    contents: tuple[Contents, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """What cannot be mended: outlines that cross."""
        return tuple(finding for finding in self.findings if finding.wrong)


def diagonal(curves: Sequence[Curve]) -> float:
    """Diagonal of the common bounding box of the curves; 0 where there are none."""
    if not curves:
        return 0.0
    boxes = np.array([curve.box for curve in curves])
    return float(np.hypot(*(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0))))


def part_names(regions: tuple[Region, ...]) -> tuple[str, ...]:
    """Every name that :func:`part` knows for these regions, in a readable order."""
    own = {name for region in regions for loop in region.loops for name in (*loop.names, loop.name) if name}
    holes = ("inner",) if any(region.holes for region in regions) else ()
    sides = tuple(side for side in SIDES if any(mask.any() for mask in part(regions, side)))
    return tuple(dict.fromkeys(("boundary", "outer", *holes, *sides, *sorted(own))))


def part(regions: tuple[Region, ...], name: str) -> tuple[Bools, ...]:
    """Which pieces of the outlines a name means.

    Parameters
    ----------
    regions : tuple of Region
        The regions of one body.
    name : str
        "boundary" (everything), "outer", "inner" (all holes), a side of the bounding box ("bottom", "right",
        "top", "left": the pieces that lie on it), or the name of a loop or piece (layer, physical group).
        A name given in the file goes before the side of the box.

    Returns
    -------
    tuple of (pieces,) bool
        One mask for each loop of each region, in order; all False where the name means nothing here.
    """
    masks = []
    loops = [(loop, k > 0) for region in regions for k, loop in enumerate(region.loops)]
    given = bool(name) and any(name in (loop.name, *loop.names) for loop, _ in loops)
    low, high = np.min([r.box[0] for r in regions], axis=0), np.max([r.box[1] for r in regions], axis=0)
    for loop, is_hole in loops:
        if given:
            mask = np.array([name in (own, loop.name) for own in loop.names])
        elif name in ("boundary", "outer", "inner"):
            mask = np.full(len(loop.bulges), name == "boundary" or (name == "inner") == is_hole)
        elif name in SIDES:
            axis, target = {"bottom": (1, low), "right": (0, high), "top": (1, high), "left": (0, low)}[name]
            on = np.abs(loop.points[:, axis] - target[axis]) <= 1e-9 * float(np.max(high - low))
            mask = on[:-1] & on[1:] & (loop.bulges == 0.0)
        else:
            mask = np.zeros(len(loop.bulges), dtype=bool)
        masks.append(mask)
    return tuple(masks)


def _rotate(vectors: Floats, angles: Floats) -> Floats:
    """(k, 2) Vectors turned left by (k,) angles, radians."""
    c, s = np.cos(angles), np.sin(angles)
    x, y = vectors[:, 0], vectors[:, 1]
    return np.column_stack([c * x - s * y, s * x + c * y])


def _angle_between(a: Floats, b: Floats) -> Floats:
    """(k,) Unsigned angle between (k, 2) unit vectors, radians."""
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.asarray(np.abs(np.arctan2(cross, np.sum(a * b, axis=1))))


def arc_centre(a: Floats, b: Floats, bulge: Floats) -> Floats:
    """(..., 2) Centre of the arcs from a to b, (..., 2) each, with (...,) bulges, none zero."""
    # The centre lies (1 - bulge^2) / (4 bulge) chords to the left of the chord's middle.
    offset = (1.0 - bulge**2) / (4.0 * bulge)
    chord = b - a
    left = np.stack([-chord[..., 1], chord[..., 0]], axis=-1)
    return np.asarray(0.5 * (a + b) + offset[..., None] * left)


def _arc_extremes(a: Floats, b: Floats, bulge: float) -> Floats:
    """(k, 2) Points of an arc where x or y is extreme (k up to 4)."""
    centre = arc_centre(a, b, np.asarray(bulge))
    radius = float(np.hypot(*(a - centre)))
    start, sweep = np.arctan2(*(a - centre)[::-1]), 4.0 * np.arctan(bulge)
    quarter = np.arange(4) * 0.5 * np.pi
    along = np.mod((quarter - start) * np.sign(sweep), 2.0 * np.pi)
    hit = quarter[along <= abs(sweep)]
    return np.asarray(centre + radius * np.column_stack([np.cos(hit), np.sin(hit)]))
