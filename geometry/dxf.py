"""Curves of the model space of a DXF drawing."""

from __future__ import annotations

import io
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Geometry
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import CHORD_ERROR, Evaluate, arc_pieces, trace
from phantomnode.geometry.loops import assemble, diagonal
from phantomnode.geometry.units import INSUNITS, chosen, metres

Floats = NDArray[np.float64]

MOST_ENTITIES = 100_000
"""Entities of a drawing with its blocks expanded; nested blocks and arrays of inserts grow without bound."""

PLANE = 1e-9
"""Part of the coordinates' size by which z may differ between curves of one plane."""

SOLIDS = {"3DSOLID", "BODY", "SURFACE", "EXTRUDEDSURFACE", "REVOLVEDSURFACE", "LOFTEDSURFACE", "SWEPTSURFACE",
          "PLANESURFACE", "NURBSURFACE", "MESH", "3DFACE", "POLYFACE", "POLYMESH"}  # fmt: skip

SOLID = (
    "this is a 3D drawing, and a plane problem needs a planar outline: "
    "draw the section in the xy plane (constant z)"
)


@dataclass
class _Drawing:
    """What was found so far: exact pieces, free-form curves, heights, and entities of other kinds."""

    pieces: list[Curve] = field(default_factory=list)
    free: list[tuple[Evaluate, Floats, str]] = field(default_factory=list)
    heights: list[float] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)

    def add(self, points: Floats, bulges: Floats, layer: str) -> None:
        """Add lines and arcs through (n + 1, 3) points."""
        self.heights += points[:, 2].tolist()
        self.pieces.append(Curve(points[:, :2], bulges, (layer,) * len(bulges)))


def read_dxf(content: bytes, unit: str | None, time_limit: float) -> Geometry:
    """Regions and curves of a DXF drawing, in metres.

    LINE, ARC, CIRCLE, ELLIPSE, LWPOLYLINE, POLYLINE and SPLINE of the model space, also in blocks (INSERT), on
    layers that are shown. Layers become the names of pieces; layer "0" gives none. Other kinds are noted.

    Raises
    ------
    GeometryError
        For a damaged or 3D drawing, one without curves, and one without a unit where none is given.
    """
    import ezdxf

    document, notes = _load(content)
    name, unit_notes = chosen(unit, INSUNITS.get(int(document.header.get("$INSUNITS", 0))))
    drawing = _Drawing()
    try:
        _collect_all(drawing, document, time.monotonic() + time_limit)
    except ezdxf.DXFError as error:
        raise GeometryError(f"the DXF file is damaged ({error}); export it again") from error
    pieces = _flattened(drawing)
    if drawing.left_out:
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(drawing.left_out.items()))
        notes.append(f"left out: {listed}")
    factor = metres(name)
    geometry = assemble([piece.scaled(factor) for piece in pieces])
    return Geometry(geometry.regions, geometry.curves, (*unit_notes, *notes, *geometry.notes))


def _collect_all(drawing: _Drawing, document: Any, deadline: float) -> None:
    """Fill the drawing from the model space, without the layers that are not shown."""
    hidden = {layer.dxf.name.lower() for layer in document.layers if layer.is_off() or layer.is_frozen()}
    for entity, layer in _expanded(document, deadline):
        if layer.lower() in hidden:
            drawing.left_out[f"{entity.dxftype()} on hidden layer '{layer}'"] += 1
        else:
            _collect(drawing, entity, "" if layer == "0" else layer)


def _load(content: bytes) -> tuple[Any, list[str]]:
    """The ezdxf document; mended with a note where its structure is not that of the standard."""
    import ezdxf
    from ezdxf import recover

    try:
        document = ezdxf.read(io.StringIO(_decoded(content)))
        return document, []
    except (ezdxf.DXFError, ValueError, TypeError, KeyError, AttributeError, IndexError):
        pass  # many real drawings miss required tags: the recover mode reads those, or says why it cannot
    try:
        document, auditor = recover.read(io.BytesIO(content))
    except Exception as error:  # ezdxf raises many kinds on damaged files
        raise GeometryError(f"the DXF file is damaged ({error}); export it again") from error
    return document, [f"the DXF file does not keep to the standard ({len(auditor.errors)} errors mended)"]


def _decoded(content: bytes) -> str:
    """The text of an ASCII DXF file: UTF-8 from 2007 on, a Windows code page before."""
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def _expanded(document: Any, deadline: float) -> Iterator[tuple[Any, str]]:
    """Every entity of the model space and its layer, blocks replaced by what they hold."""
    stack: list[Iterator[tuple[Any, str]]] = [iter([(e, _layer(e)) for e in document.modelspace()])]
    count = 0
    while stack:
        entity, layer = next(stack[-1], (None, ""))
        if entity is None:
            stack.pop()
            continue
        count += 1
        if count > MOST_ENTITIES or time.monotonic() > deadline:
            raise GeometryError(
                f"the drawing holds more than {min(count, MOST_ENTITIES)} entities with its blocks expanded, "
                "too many to read in the time: explode or purge its blocks, keep the outline only"
            )
        if entity.dxftype() != "INSERT":
            yield entity, layer
        elif len(stack) > 30:
            raise GeometryError(f"blocks are nested more than 30 deep at '{entity.dxf.name}'; explode them")
        else:
            stack.append(_inside(entity, layer))


def _inside(insert: Any, layer: str) -> Iterator[tuple[Any, str]]:
    """What an INSERT shows, one array place after the other; layer "0" in a block means the insert's layer."""
    places = insert.multi_insert() if insert.mcount > 1 else [insert]
    for place in places:
        for entity in place.virtual_entities():
            own = _layer(entity)
            yield entity, layer if own == "0" else own


def _layer(entity: Any) -> str:
    """The layer of an entity; damaged files hold entities that cannot have one."""
    return str(entity.dxf.layer) if entity.dxf.is_supported("layer") else "0"


def _collect(drawing: _Drawing, entity: Any, layer: str) -> None:
    """Add one entity to the drawing, or count it among those left out."""
    from ezdxf import DXFError

    kind = entity.dxftype()
    try:
        if kind == "LINE":
            drawing.add(np.array([entity.dxf.start, entity.dxf.end]), np.zeros(1), layer)
        elif kind in ("ARC", "CIRCLE") and entity.dxf.radius == 0.0:
            drawing.left_out[f"{kind} of radius 0"] += 1
        elif kind in ("ARC", "CIRCLE"):
            _add_arc(drawing, entity, layer)
        elif kind in ("LWPOLYLINE", "POLYLINE") and _is_path(entity):
            _add_polyline(drawing, entity, layer)
        elif kind == "ELLIPSE":
            tool = entity.construction_tool()
            start, end = tool.start_param, tool.end_param
            end += 2.0 * np.pi if end <= start else 0.0
            _add_free(drawing, lambda t: list(tool.vertices(t)), np.array([start, end]), layer)
        elif kind == "SPLINE":
            spline = entity.construction_tool()
            knots = np.unique(spline.knots())
            knots = knots[
                (knots >= spline.knots()[spline.order - 1]) & (knots <= spline.knots()[-spline.order])
            ]
            _add_free(drawing, lambda t: list(spline.points(t)), knots, layer)
        else:
            drawing.left_out[entity.get_mode().upper() if kind == "POLYLINE" else kind] += 1
    except GeometryError:
        raise
    except (DXFError, ValueError, ArithmeticError, IndexError, TypeError, AttributeError) as error:
        raise GeometryError(
            f"{kind} with handle {entity.dxf.handle} on layer '{layer or 0}' cannot be read ({error}); "
            "redraw or delete it"
        ) from error


def _add_arc(drawing: _Drawing, entity: Any, layer: str) -> None:
    """ARC and CIRCLE, exact; drawn from below (extrusion -z) they run the other way."""
    system, radius = entity.ocs(), float(entity.dxf.radius)
    first, sweep = 0.0, 2.0 * np.pi
    if entity.dxftype() == "ARC":
        first = np.radians(entity.dxf.start_angle)
        sweep = np.radians((entity.dxf.end_angle - entity.dxf.start_angle) % 360.0 or 360.0)
    local = np.array(entity.dxf.center)
    angles = np.array([first, first + sweep])
    rim = [tuple(local + radius * np.array([np.cos(a), np.sin(a), 0.0])) for a in angles]
    start, end, centre = (np.array(system.to_wcs(point)) for point in (*rim, tuple(local)))
    _flat_extrusion(entity)
    if sweep == 2.0 * np.pi:
        end = start
    turn = sweep if entity.dxf.extrusion.z > 0.0 else -sweep
    points, bulges = arc_pieces(start[:2], end[:2], centre[:2], turn)
    drawing.add(np.column_stack([points, np.full(len(points), centre[2])]), bulges, layer)


def _is_path(entity: Any) -> bool:
    """Whether a polyline is a curve, not a mesh."""
    return bool(entity.dxftype() == "LWPOLYLINE" or entity.is_2d_polyline or entity.is_3d_polyline)


def _add_polyline(drawing: _Drawing, entity: Any, layer: str) -> None:
    """LWPOLYLINE and POLYLINE: lines, and arcs where a vertex has a bulge."""
    if entity.dxftype() == "LWPOLYLINE":
        points = np.array([tuple(point) for point in entity.vertices_in_wcs()]).reshape(-1, 3)
        bulges = np.array([bulge for (bulge,) in entity.get_points("b")])
        closed = entity.closed
    else:
        vertices = [v for v in entity.vertices if not v.dxf.flags & v.SPLINE_FRAME_CONTROL_POINT]
        places = [v.dxf.location for v in vertices]
        if entity.is_2d_polyline:
            height = entity.dxf.elevation.z if entity.dxf.hasattr("elevation") else 0.0
            places = list(entity.ocs().points_to_wcs([type(p)(p.x, p.y, height) for p in places]))
        points = np.array([tuple(p) for p in places]).reshape(-1, 3)
        bulges = np.array([v.dxf.bulge for v in vertices])
        closed = entity.is_closed
    if np.any(bulges):
        _flat_extrusion(entity)
    if entity.dxf.get("extrusion", (0.0, 0.0, 1.0))[2] < 0.0:
        bulges = -bulges
    if closed:
        points = np.vstack([points, points[:1]])
    bulges = bulges[: len(points) - 1]
    moved = np.any(np.diff(points, axis=0) != 0.0, axis=1)
    if np.any(moved):
        drawing.add(points[np.concatenate([[True], moved])], bulges[moved], layer)


def _add_free(drawing: _Drawing, places: Any, breaks: Floats, layer: str) -> None:
    """A curve that is flattened once the size of the drawing is known."""

    def evaluate(parameter: Floats) -> Floats:
        return np.array([(p[0], p[1]) for p in places(parameter)])

    drawing.heights += [p[2] for p in places(np.linspace(breaks[0], breaks[-1], 17))]
    drawing.free.append((evaluate, breaks, layer))


def _flat_extrusion(entity: Any) -> None:
    """Refuse arcs in a plane that is not horizontal."""
    x, y, z = entity.dxf.get("extrusion", (0.0, 0.0, 1.0))
    if np.hypot(x, y) > PLANE * abs(z):
        raise GeometryError(SOLID)


def _flattened(drawing: _Drawing) -> list[Curve]:
    """The pieces of the drawing, free-form curves among them, after making sure that they lie in one plane."""
    if not drawing.pieces and not drawing.free:
        if SOLIDS & set(drawing.left_out):
            raise GeometryError(f"{SOLID}")
        listed = ", ".join(sorted(drawing.left_out)) or "nothing at all"
        raise GeometryError(
            f"the model space of the drawing holds no curves (it holds {listed}); explode or draw the outline "
            "with lines, arcs, circles, ellipses, polylines or splines on a layer that is shown"
        )
    coarse = [Curve(f(np.linspace(b[0], b[-1], 17)), np.zeros(16)) for f, b, _ in drawing.free]
    size = diagonal([*drawing.pieces, *coarse])
    if not np.isfinite(size):
        raise GeometryError("a curve has coordinates that are not finite: the file is damaged")
    if np.ptp(drawing.heights) > PLANE * max(size, float(np.max(np.abs(drawing.heights)))):
        raise GeometryError(f"{SOLID}")
    pieces = list(drawing.pieces)
    for evaluate, breaks, layer in drawing.free:
        points, bulges = trace(evaluate, breaks, CHORD_ERROR * size)
        pieces.append(Curve(points, bulges, (layer,) * len(bulges)))
    return pieces
