"""Entities of a DXF drawing as lines, arcs and free-form curves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import Evaluate, arc_pieces
from phantomnode.geometry.splines import spline

Floats = NDArray[np.float64]

TILT = 1e-9
"""Slope of a plane against the xy plane that is rounding."""

AREAS = ("HATCH", "MPOLYGON", "SOLID", "TRACE")
"""Filled areas: their boundaries count where a drawing holds no curves."""


@dataclass(frozen=True)
class Item:
    """One curve of a drawing, in its units.

    Attributes
    ----------
    points, bulges : (n + 1, 2), (n,) float64
        Lines and arcs; of a free-form curve 17 points along it.
    heights : (k,) float64
        z along it.
    layer : str
        "" for layer "0".
    source : str
        The entity in words: kind, handle, layer.
    free : (function, breaks), optional
        A free-form curve, flattened once the size of the drawing is known.
    loop : int
        Curves of one number other than -1 make up one closed boundary, whatever else ends where they do.
    """

    points: Floats
    bulges: Floats
    heights: Floats
    layer: str
    source: str
    free: tuple[Evaluate, Floats] | None = None
    loop: int = -1


@dataclass
class Sheet:
    """The curves of a drawing, and how many entities of other kinds were left out."""

    items: list[Item] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    loop: int = -1
    loops: int = 0

    def add(self, entity: Any, layer: str, source: str) -> None:
        """Add the curves of one entity, or count it among those left out.

        Raises
        ------
        GeometryError
            Where the entity is damaged, naming it.
        """
        from ezdxf import DXFError

        kind = entity.dxftype()
        try:
            if kind not in _READERS or not _READERS[kind](self, entity, layer, source):
                self.left_out[entity.get_mode().upper() if kind == "POLYLINE" else kind] += 1
        except (
            GeometryError,
            DXFError,
            ValueError,
            ArithmeticError,
            LookupError,
            TypeError,
            AttributeError,
        ) as e:
            raise GeometryError(
                f"{source} cannot be read ({e}); redraw or delete it, or leave out its layer"
            ) from e

    def exact(self, points: Floats, bulges: Floats, layer: str, source: str) -> None:
        """Add lines and arcs through (n + 1, 3) points, without the pieces of no length."""
        if not np.all(np.isfinite(points)) or not np.all(np.isfinite(bulges)):
            raise GeometryError("its coordinates are not finite")
        moved = np.any(np.diff(points[:, :2], axis=0) != 0.0, axis=1)
        if not np.any(moved):
            self.left_out[f"{source.split()[0]} of no length"] += 1
            return
        keep = np.concatenate([[True], moved])
        self.items.append(Item(points[keep, :2], bulges[moved], points[:, 2], layer, source, None, self.loop))

    def free(self, evaluate: Evaluate, breaks: Floats, heights: Floats, layer: str, source: str) -> None:
        """Add a free-form curve."""
        points = evaluate(np.linspace(breaks[0], breaks[-1], 17))
        if not np.all(np.isfinite(points)) or not np.all(np.isfinite(heights)):
            raise GeometryError("its coordinates are not finite")
        self.items.append(Item(points, np.zeros(16), heights, layer, source, (evaluate, breaks), self.loop))


class SolidError(GeometryError):
    """An entity does not lie in a plane of constant z."""


def _line(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    sheet.exact(np.array([entity.dxf.start, entity.dxf.end]), np.zeros(1), layer, source)
    return True


def _arc(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    """ARC and CIRCLE, exact; drawn from below (extrusion -z) they run the other way."""
    dxf = entity.dxf
    if dxf.radius == 0.0:
        sheet.left_out[f"{entity.dxftype()} of radius 0"] += 1
        return True
    first, last = (dxf.start_angle, dxf.end_angle) if entity.dxftype() == "ARC" else (0.0, 360.0)
    points, bulges = _turned(np.array(dxf.center)[:2], abs(float(dxf.radius)), first, last)
    _in_plane(sheet, entity, float(dxf.center[2]), points, bulges, layer, source)
    return True


def _turned(centre: Floats, radius: float, first: float, last: float) -> tuple[Floats, Floats]:
    """Points and bulges of the arc between two angles in degrees, to the left."""
    sweep = np.radians((last - first) % 360.0 or 360.0)
    angles = np.radians(first) + np.array([0.0, sweep])
    start, end = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return arc_pieces(start, start if sweep == 2.0 * np.pi else end, centre, sweep)


def _side(entity: Any) -> float:
    """1 where the entity is drawn from above, -1 from below; in any other plane it is no plane curve."""
    x, y, z = entity.dxf.get("extrusion", (0.0, 0.0, 1.0))
    if np.hypot(x, y) > TILT * abs(z):
        raise SolidError("it lies in a plane that is not parallel to xy")
    return 1.0 if z > 0.0 else -1.0


def _in_plane(
    sheet: Sheet, entity: Any, z: float, points: Floats, bulges: Floats, layer: str, source: str
) -> None:
    """Add lines and arcs through (n + 1, 2) points in the entity's own plane at height z."""
    side = _side(entity)
    full = np.column_stack([side * points[:, 0], points[:, 1], np.full(len(points), side * z)])
    sheet.exact(full, side * bulges, layer, source)


def _lwpolyline(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    """Lines, and arcs where a vertex has a bulge."""
    rows = np.array(entity.get_points("xyb"), dtype=np.float64).reshape(-1, 3)
    _path(sheet, entity, float(entity.dxf.elevation), rows, bool(entity.closed), layer, source)
    return True


def _path(sheet: Sheet, entity: Any, z: float, rows: Floats, closed: bool, layer: str, source: str) -> None:
    """Add vertices, (n, 3) x, y and bulge, in the entity's own plane."""
    if closed:
        rows = np.vstack([rows, rows[:1]])
    if len(rows) < 2:
        sheet.left_out[f"{entity.dxftype()} of fewer than two points"] += 1
    elif not np.any(rows[:-1, 2]) and _tilted(entity):
        points = [tuple(p) for p in entity.ocs().points_to_wcs([(x, y, z) for x, y, _ in rows])]
        sheet.exact(np.array(points), np.zeros(len(rows) - 1), layer, source)
    else:
        _in_plane(sheet, entity, z, rows[:, :2], rows[:-1, 2], layer, source)


def _tilted(entity: Any) -> bool:
    x, y, z = entity.dxf.get("extrusion", (0.0, 0.0, 1.0))
    return bool(np.hypot(x, y) > TILT * abs(z))


def _polyline(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    """POLYLINE, 2D (with bulges) or 3D; meshes are none."""
    if not (entity.is_2d_polyline or entity.is_3d_polyline):
        return False
    vertices = [v for v in entity.vertices if not v.dxf.flags & v.SPLINE_FRAME_CONTROL_POINT]
    places = np.array([tuple(v.dxf.location) for v in vertices], dtype=np.float64).reshape(-1, 3)
    if entity.is_2d_polyline:
        bulges = np.array([v.dxf.bulge for v in vertices], dtype=np.float64)
        z = float(entity.dxf.elevation.z) if entity.dxf.hasattr("elevation") else 0.0
        rows = np.column_stack([places[:, :2], bulges])
        _path(sheet, entity, z, rows, bool(entity.is_closed), layer, source)
    else:
        if entity.is_closed:
            places = np.vstack([places, places[:1]])
        sheet.exact(places, np.zeros(max(len(places) - 1, 0)), layer, source)
    return True


def _ellipse(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    tool = entity.construction_tool()
    centre, major, minor = (np.array(tuple(v)) for v in (tool.center, tool.major_axis, tool.minor_axis))
    _add_ellipse(sheet, centre, major, minor, (tool.start_param, tool.end_param), layer, source)
    return True


def _add_ellipse(
    sheet: Sheet,
    centre: Floats,
    major: Floats,
    minor: Floats,
    span: tuple[float, float],
    layer: str,
    source: str,
) -> None:
    """Add centre + major cos t + minor sin t, (3,) each, from the first t to the last."""
    start, end = span
    end += 2.0 * np.pi if end <= start else 0.0

    def evaluate(t: Floats) -> Floats:
        return np.asarray(centre[:2] + np.outer(np.cos(t), major[:2]) + np.outer(np.sin(t), minor[:2]))

    t = np.linspace(start, end, 17)
    heights = centre[2] + np.cos(t) * major[2] + np.sin(t) * minor[2]
    sheet.free(evaluate, np.array([start, end]), heights, layer, source)


def _spline(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    """SPLINE; one with fit points alone as CAD programs draw it."""
    degree, knots, weights = int(entity.dxf.degree), np.array(entity.knots), np.array(entity.weights)
    points = np.array([tuple(p) for p in entity.control_points], dtype=np.float64).reshape(-1, 3)
    if len(points) == 0:
        if len(entity.fit_points) < 2:
            sheet.left_out["SPLINE of fewer than two points"] += 1
            return True
        tool = entity.construction_tool()
        degree, knots, weights = tool.degree, np.array(tool.knots()), np.array(tool.weights())
        points = np.array([tuple(p) for p in tool.control_points])
    evaluate, breaks = spline(degree, knots, points[:, :2], weights, periodic=bool(entity.dxf.flags & 2))
    sheet.free(evaluate, breaks, points[:, 2], layer, source)
    return True


def _solid(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    """The boundary of a SOLID or TRACE."""
    corners = np.array([tuple(p) for p in entity.wcs_vertices(close=True)])
    sheet.exact(corners, np.zeros(len(corners) - 1), layer, source)
    return True


def _hatch(sheet: Sheet, entity: Any, layer: str, source: str) -> bool:
    """The boundaries of a HATCH or MPOLYGON."""
    z = float(entity.dxf.elevation.z)
    for path in entity.paths:
        sheet.loop = sheet.loops
        sheet.loops += 1
        if hasattr(path, "vertices"):
            rows = np.array(path.vertices, dtype=np.float64).reshape(-1, 3)
            # A boundary of an area is closed, whatever its flag says.
            _path(sheet, entity, z, rows, True, layer, source)
        else:
            for edge in path.edges:
                _EDGES[type(edge).__name__](sheet, entity, z, edge, layer, source)
    sheet.loop = -1
    return True


def _line_edge(sheet: Sheet, hatch: Any, z: float, edge: Any, layer: str, source: str) -> None:
    points = np.array([tuple(edge.start), tuple(edge.end)])
    _in_plane(sheet, hatch, z, points, np.zeros(1), layer, source)


def _arc_edge(sheet: Sheet, hatch: Any, z: float, edge: Any, layer: str, source: str) -> None:
    centre = np.array(tuple(edge.center))
    points, bulges = _turned(centre, abs(float(edge.radius)), edge.start_angle, edge.end_angle)
    _in_plane(sheet, hatch, z, points, bulges, layer, source)


def _ellipse_edge(sheet: Sheet, hatch: Any, z: float, edge: Any, layer: str, source: str) -> None:
    tool, side = edge.construction_tool(), _side(hatch)
    mirror = np.array([side, 1.0, 0.0])
    centre, major, minor = (
        mirror * np.array(tuple(v)) for v in (tool.center, tool.major_axis, tool.minor_axis)
    )
    centre[2] = side * z
    _add_ellipse(sheet, centre, major, minor, (tool.start_param, tool.end_param), layer, source)


def _spline_edge(sheet: Sheet, hatch: Any, z: float, edge: Any, layer: str, source: str) -> None:
    side = _side(hatch)
    points = np.array([tuple(p)[:2] for p in edge.control_points], dtype=np.float64).reshape(-1, 2)
    knots, weights = np.array(edge.knot_values), np.array(edge.weights)
    if len(points) == 0:
        tool = edge.construction_tool()
        knots, weights = np.array(tool.knots()), np.array(tool.weights())
        points = np.array([tuple(p)[:2] for p in tool.control_points])
    evaluate, breaks = spline(
        int(edge.degree), knots, points * [side, 1.0], weights, periodic=bool(edge.periodic)
    )
    sheet.free(evaluate, breaks, np.array([side * z]), layer, source)


_READERS: dict[str, Callable[[Sheet, Any, str, str], bool]] = {
    "LINE": _line,
    "ARC": _arc,
    "CIRCLE": _arc,
    "LWPOLYLINE": _lwpolyline,
    "POLYLINE": _polyline,
    "ELLIPSE": _ellipse,
    "SPLINE": _spline,
    "HELIX": _spline,
    "SOLID": _solid,
    "TRACE": _solid,
    "HATCH": _hatch,
    "MPOLYGON": _hatch,
}
"""What reads each kind; it returns whether the entity is a curve after all."""

_EDGES: dict[str, Callable[[Sheet, Any, float, Any, str, str], None]] = {
    "LineEdge": _line_edge,
    "ArcEdge": _arc_edge,
    "EllipseEdge": _ellipse_edge,
    "SplineEdge": _spline_edge,
}
"""What reads each kind of edge of a hatch's boundary."""
