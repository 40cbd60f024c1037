"""The interactive view of a page: frames of the clipped bodies, quantised, as many as fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.drawing import box_of, readable
from phantomnode.pipeline.field_pictures import MAPS, SOLID, joint_limits, limits_of, map_of, with_obstacles
from phantomnode.pipeline.frames import FieldsFrame
from phantomnode.pipeline.outlines import sides_of
from phantomnode.pipeline.packing import packed, quantised
from phantomnode.pipeline.quantities import QUANTITIES
from phantomnode.pipeline.results import Results

Floats = NDArray[np.float64]

FIELDS = ("von_mises", "mean_stress", "J", "velocity", "displacement")
"""Those that the view offers; the first ones where the frames are large."""
BUDGET = 5_200_000
"""Bytes of the page that the view may take; the libraries and pictures take about two million."""
ENOUGH = 20
"""Frames that show a motion; to keep so many, fields are left out."""


class Choice(NamedTuple):
    """What of a run is put into the view: every so-maniest frame, and these fields."""

    stride: int
    fields: tuple[str, ...]


def chosen(frames: int, still: int, points: int, field: int, budget: int = BUDGET) -> Choice | None:
    """As many frames and fields as the budget allows: first fields go, down to one, then frames.

    Parameters
    ----------
    frames : int
        Of the run.
    still, points, field : int
        Bytes of what stays the same, and of the positions and one field in a frame.
    budget : int
        Bytes.

    Returns
    -------
    Choice or None
        None where not even one frame of one field fits.
    """

    def size(stride: int, fields: int) -> int:
        return still + (-(-frames // stride) + 1) * (points + fields * field)

    least = max(frames // ENOUGH, 1)
    options = [(stride, count) for count in (5, 3, 1) for stride in range(1, least + 1)]
    options += [(stride, 1) for stride in range(least + 1, frames + 1)]
    return next((Choice(s, FIELDS[:n]) for s, n in options if size(s, n) <= budget), None)


def _sizes(frames: Sequence[FieldsFrame]) -> tuple[int, int, int]:
    """Bytes on a page of what stays the same, and of positions and a field in the largest of some frames."""
    first = frames[0]
    shapes = (first.quads, first.triangles, first.outline)
    still = sum(len(packed(part.astype(np.uint32))["data"]) for part in shapes)
    still += len(packed(first.reference.astype(np.float32))["data"])

    def steps(values: Floats) -> int:
        return len(packed(quantised(values, values.min(axis=0), values.max(axis=0)))["data"])

    points = max(steps(frame.points) for frame in frames)
    return still, points, max(steps(frame.values(name)) for frame in frames for name in FIELDS)


def view_data(results: Results) -> dict[str, Any] | None:
    """What the page's script needs to draw the bodies: geometry, frames, fields with colours and units.

    Returns None where the run is too large for a page.
    """
    first = results.frame("start")
    choice = chosen(len(results.times), *_sizes([first, results.frame("peak"), results.frame("end")]))
    if choice is None:
        return None
    shown = sorted({*range(0, len(results.times), choice.stride), len(results.times) - 1})
    box, spans = _extent(results, shown, choice.fields)
    points, obstacles = list[NDArray[np.uint16]](), list[Floats]()
    values = {name: list[NDArray[np.uint16]]() for name in choice.fields}
    for frame in _frames(results, shown):
        points.append(quantised(frame.points, box[0], box[1]))
        obstacles.append(frame.obstacles)
        for name, parts in values.items():
            parts.append(quantised(frame.values(name), *spans[name].range))
    return {
        "times": [float(results.times[number]) for number in shown],
        "every": choice.stride,
        "of": len(results.times),
        "start": int(np.argmin(np.abs(np.array(shown) - results.nearest("peak")))),
        "box": box.tolist(),
        "points": packed(np.stack(points)),
        "obstacles": packed(np.stack(obstacles).astype(np.float32)) if len(first.obstacles) else None,
        "solid": _solid(first.obstacles, SOLID * float(np.max(box[1] - box[0]))),
        "reference": packed(first.reference.astype(np.float32)),
        "quads": packed(first.quads.astype(np.uint32)),
        "triangles": packed(first.triangles.astype(np.uint32)),
        "outline": packed(first.outline.astype(np.uint32)),
        "fields": [_field(name, spans[name], np.stack(values[name])) for name in choice.fields],
        "maps": {name: _colours(name) for name in sorted({*MAPS.values()})},
    }


def _solid(obstacles: Floats, width: float) -> dict[str, Any] | None:
    """The solid sides of obstacles at the start, as triangles, and the segment with which each point moves."""
    if len(obstacles) == 0:
        return None
    import mapbox_earcut

    corners, triangles, segments = list[Floats](), list[NDArray[np.uint32]](), list[int]()
    for polygon, segment in sides_of(obstacles, width):
        own = mapbox_earcut.triangulate_float64(polygon.astype(np.float64), np.array([len(polygon)]))
        triangles.append(own.astype(np.uint32) + np.uint32(len(segments)))
        corners.append(polygon)
        segments += [segment] * len(polygon)
    return {
        "points": packed(np.concatenate(corners).astype(np.float32)),
        "triangles": packed(np.concatenate(triangles)),
        "segments": packed(np.array(segments, dtype=np.uint32)),
    }


class Span(NamedTuple):
    """The values of a field over a run: (low, high) of all, and at the ends of the colours, SI."""

    range: tuple[float, float]
    limits: tuple[float, float]


def _frames(results: Results, shown: list[int]) -> Iterator[FieldsFrame]:
    return (results.frame(float(results.times[number])) for number in shown)


def _extent(results: Results, shown: list[int], fields: tuple[str, ...]) -> tuple[Floats, dict[str, Span]]:
    """(2, 2) The box of all positions, and the span of each field."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    ranges = {name: list[tuple[float, float]]() for name in fields}
    limits = {name: list[tuple[float, float]]() for name in fields}
    for frame in _frames(results, shown):
        now = with_obstacles(box_of(frame.points), frame.obstacles.reshape(-1, 2))
        low, high = np.minimum(low, now[0]), np.maximum(high, now[1])
        for name in fields:
            values = frame.values(name)
            ranges[name].append((float(values.min()), float(values.max())))
            limits[name].append(limits_of(values, QUANTITIES[name]))
    spans = {
        name: Span(_widest(ranges[name]), joint_limits(limits[name], QUANTITIES[name])) for name in fields
    }
    return np.stack([low, high]), spans


def _widest(spans: list[tuple[float, float]]) -> tuple[float, float]:
    lows, highs = zip(*spans, strict=True)
    return min(lows), max(highs)


def _field(name: str, span: Span, steps: NDArray[np.uint16]) -> dict[str, Any]:
    """One field of the view, in a readable unit."""
    what = QUANTITIES[name]
    factor, unit = readable(np.array(span.limits), what.unit)
    return {
        "name": name,
        "label": f"{what.label}, {unit}" if unit else what.label,
        "unit": unit,
        "range": [factor * value for value in span.range],
        "limits": [factor * value for value in span.limits],
        "map": map_of(span.limits, what),
        "values": packed(steps),
    }


def _colours(name: str) -> list[list[int]]:
    """256 colours of a map of matplotlib's, red, green and blue from 0 to 255."""
    from matplotlib import colormaps

    table = colormaps[name](np.linspace(0.0, 1.0, 256))[:, :3]
    return [[int(part) for part in colour] for colour in np.round(255.0 * table)]
