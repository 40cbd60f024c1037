"""Shapes of an SVG drawing."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Geometry
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import CHORD_ERROR, arc_pieces, trace
from phantomnode.geometry.loops import GAPS, assemble
from phantomnode.geometry.units import chosen, metres

Floats = NDArray[np.float64]

PIXEL = 0.0254 / 96
"""Metres in a pixel (CSS, absolute lengths)."""

_LENGTH = r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|in)\s*"

ROUND = 1e-12
"""Part by which the radii of an arc may differ where it is one of a circle: the rounding of transforms."""

MOST_SEGMENTS = 100_000
"""Segments of all paths, with what is used again and again."""


def read_svg(content: bytes, unit: str | None) -> Geometry:
    """Regions and curves of an SVG drawing, in metres, with y upwards from the lower end of its viewBox.

    Paths and basic shapes with all transforms. Lines and circular arcs stay exact, elliptical ones and Bezier curves
    become polygons within 1e-6 of the diagonal. The id of an element names its pieces. Where the width of the drawing
    is given in mm, cm or in, it has the size it says; else, or where ``unit`` is another one, its numbers count.
    Lengths within it that have units of their own are right to 5e-7 (svgelements takes an inch for 25.39999 mm).

    Raises
    ------
    GeometryError
        For damaged XML, a drawing without shapes, and one without a unit where none is given.
    """
    with _damage_told():
        from svgelements import SVG

        drawing = SVG.parse(io.BytesIO(content), reify=False)
        own, scale = _size(drawing)
        name, notes = chosen(unit, own)
        paths, left_out = _paths(drawing)
        boxes = np.array([box for path, _ in paths if (box := path.bbox()) is not None])
        if not len(boxes):
            raise GeometryError(
                f"the drawing holds no curves (it holds {_listed(left_out) or 'nothing at all'})"
            )
        size = float(np.hypot(*(boxes[:, 2:].max(axis=0) - boxes[:, :2].min(axis=0))))
        pieces = [curve for path, label in paths for curve in _curves(path, label, size)]
    found = assemble([piece.scaled(scale if name == own else metres(name)) for piece in pieces])
    left = (f"left out: {_listed(left_out)}",) if left_out else ()
    return replace(found, notes=(*notes, *left, *found.notes), unit=name)


@contextmanager
def _damage_told() -> Iterator[None]:
    """Say of what svgelements stumbles over that the drawing is damaged."""
    try:
        yield
    except GeometryError:
        raise
    except RecursionError as error:
        raise GeometryError("an element of the SVG drawing uses itself") from error
    except (SyntaxError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
        # ElementTree's ParseError is a SyntaxError; the others come of attributes that are not what they must be.
        raise GeometryError(f"the SVG drawing is damaged ({error}); export it again") from error


def _size(drawing: Any) -> tuple[str | None, float]:
    """The unit in which the drawing states its width, None for none, and metres in one of its numbers."""
    lengths = [re.fullmatch(_LENGTH, str(drawing.values.get(key) or "")) for key in ("width", "height")]
    stated = [(float(length[1]), length[2]) if length else None for length in lengths]
    if stated[0] is None:
        return None, 1.0
    if drawing.viewbox is None:
        return stated[0][1], PIXEL
    spans = (drawing.viewbox.width, drawing.viewbox.height)
    scales = [
        length[0] * metres(length[1]) / span for length, span in zip(stated, spans, strict=True) if length
    ]
    if max(scales) > (1.0 + 1e-3) * min(scales):
        raise GeometryError("the width and height of the SVG drawing do not fit its viewBox; scale it evenly")
    return stated[0][1], scales[0]


def _paths(drawing: Any) -> tuple[list[tuple[Any, str]], Counter[str]]:
    """The visible shapes as paths with y upwards and their names, and what else there is."""
    from svgelements import Group, Image, Matrix, Path, Shape, Text

    placed = Matrix(drawing.viewbox_transform or "")
    placed.inverse()  # what remains are the numbers of the drawing
    placed.post_scale(1.0, -1.0)
    if drawing.viewbox is not None:
        placed.post_translate(0.0, drawing.viewbox.y + drawing.viewbox.height)
    paths, left_out, segments = [], Counter[str](), 0
    for element in drawing.elements():
        if isinstance(element, Shape) and element.values.get("visibility") not in ("hidden", "collapse"):
            path = abs(Path(element) * placed)
            segments += len(path)
            if segments > MOST_SEGMENTS:
                raise GeometryError(f"the drawing holds more than {MOST_SEGMENTS} segments; simplify it")
            paths.append((path, element.id or ""))
        elif isinstance(element, Shape | Text | Image) and not isinstance(element, Group):
            hidden = "hidden " if isinstance(element, Shape) else ""
            left_out[hidden + type(element).__name__.lower()] += 1
    return paths, left_out


def _curves(path: Any, name: str, size: float) -> list[Curve]:
    """A curve for each subpath of a path in a drawing of some size."""
    from svgelements import Close

    found = []
    for subpath in path.as_subpaths():
        parts = [part for segment in subpath if (part := _piece(segment, CHORD_ERROR * size)) is not None]
        if parts:
            points = np.vstack([parts[0][0][:1], *(points[1:] for points, _ in parts)])
            bulges = np.concatenate([bulges for _, bulges in parts])
            if isinstance(subpath[-1], Close) and np.hypot(*(points[-1] - points[-2])) <= GAPS[0] * size:
                points, bulges = np.vstack([points[:-2], points[:1]]), bulges[:-1]  # closed but for rounding
            found.append(Curve(points, bulges, (name,) * len(bulges)))
    return found


def _piece(segment: Any, chord_error: float) -> tuple[Floats, Floats] | None:
    """Vertices and bulges of a segment; None for one without length."""
    from svgelements import Arc, Close, Line, Move

    if isinstance(segment, Move) or segment.start is None or segment.end is None:
        return None
    start, end = np.array([*segment.start]), np.array([*segment.end])
    if not np.all(np.isfinite([start, end])):
        raise GeometryError("a path has coordinates that are not finite: the drawing is damaged")
    if isinstance(segment, Line | Close):
        return None if np.array_equal(start, end) else (np.array([start, end]), np.zeros(1))
    if isinstance(segment, Arc) and abs(segment.rx - segment.ry) <= ROUND * abs(segment.rx):
        return arc_pieces(start, end, np.array([*segment.center]), float(segment.sweep))
    points, bulges = trace(
        lambda t: np.asarray(segment.npoint(t), dtype=np.float64), np.array([0.0, 1.0]), chord_error
    )
    points[0], points[-1] = start, end
    return points, bulges


def _listed(left_out: Counter[str]) -> str:
    """What was left out, in words."""
    return ", ".join(f"{count} {kind}" for kind, count in sorted(left_out.items()))
