"""The section of a CAD model that gmsh holds with a plane across an axis; in the reader's child."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.gmsh_cad import bounding, name_of, outlines, samples_of
from phantomnode.geometry.planes import FLAT, Plane

Floats = NDArray[np.float64]

BUILT_IN = (
    "a section is cut from solids of the OpenCASCADE kernel, and these are of gmsh's own: write "
    'SetFactory("OpenCASCADE"); at the head of the script, or choose a face'
)


def section(gmsh: Any, axis: str, at: float) -> dict[str, Any]:
    """The outlines of the section of all solids with the plane where a coordinate has a value.

    Regions have the names of their solids, curves those of the faces they lie on. Faces without a solid are cut
    along curves, whose closed chains become regions later.
    """
    occ, plane = gmsh.model.occ, Plane.across(axis, at)
    solids = occ.getEntities(3) or occ.getEntities(2)
    if not solids:
        raise GeometryError(
            BUILT_IN if gmsh.model.getEntities(2) else "it holds no solid to cut a section from"
        )
    boxes = np.array([np.reshape(gmsh.model.getBoundingBox(*solid), (2, 3)) for solid in solids])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    k = "xyz".index(axis)
    corners = _rectangle(plane, low - 0.1 * np.max(high - low), high + 0.1 * np.max(high - low))
    cut = [solid for solid, box in zip(solids, boxes, strict=True) if box[0, k] <= at <= box[1, k]]
    found = None
    if cut:
        found = (
            _of_solids(gmsh, cut, corners, plane) if cut[0][0] == 3 else _of_faces(gmsh, cut, corners, plane)
        )
    if found is None:
        return {"missed": [float(low[k]), float(high[k])]}
    return found


def _of_solids(gmsh: Any, solids: list[Any], corners: Floats, plane: Plane) -> dict[str, Any] | None:
    """The faces that solids and a rectangle have in common; None where there are none."""
    named = {tag: name for _, tag in gmsh.model.getEntities(2) if (name := name_of(gmsh, 2, tag))}
    names: dict[int, str] = {}
    for solid in solids:
        tool = (2, _face(gmsh, corners))
        _, parts = gmsh.model.occ.intersect([solid], [tool], removeObject=False, removeTool=True)
        gmsh.model.occ.synchronize()
        names.update({tag: name_of(gmsh, *solid) for dimension, tag in parts[-1] if dimension == 2})
    if not names:
        return None
    curves = bounding(gmsh, list(names))
    under = {curve: _face_under(gmsh, curve, named) for curve in curves}
    return outlines(gmsh, list(names), curves, plane, names, under)


def _of_faces(gmsh: Any, faces: list[Any], corners: Floats, plane: Plane) -> dict[str, Any] | None:
    """The curves along which faces split a rectangle; None where there are none."""
    tool = (2, _face(gmsh, corners))
    _, parts = gmsh.model.occ.fragment(faces, [tool])
    gmsh.model.occ.synchronize()
    edges = plane.project(corners)
    slack = 1e-9 * float(np.max(np.ptp(edges, axis=0)))
    inner = []
    for curve in bounding(gmsh, [tag for dimension, tag in parts[-1] if dimension == 2]):
        points = plane.project(samples_of(gmsh, curve))
        on_edge = [np.abs(points - corner) <= slack for corner in (edges[0], edges[2])]
        if not np.any(np.all(on_edge, axis=1)):
            inner.append(curve)
    return outlines(gmsh, [], inner, plane) if inner else None


def _rectangle(plane: Plane, low: Floats, high: Floats) -> Floats:
    """(4, 3) Corners of the rectangle of a plane across an axis within a box."""
    (u0, v0), (u1, v1) = plane.project(np.array([low, high]))
    corners = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
    return np.asarray(corners @ plane.frame[:2] + plane.offset * plane.frame[2])


def _face(gmsh: Any, corners: Floats) -> int:
    """A new face between four corners."""
    occ = gmsh.model.occ
    points = [occ.addPoint(*corner) for corner in corners]
    lines = [occ.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
    return int(occ.addPlaneSurface([occ.addCurveLoop(lines)]))


def _face_under(gmsh: Any, curve: int, named: dict[int, str]) -> str:
    """The name of the named face that a curve lies on, "" for none."""
    points = samples_of(gmsh, curve)
    near = FLAT * float(np.linalg.norm(np.ptp(points, axis=0)))
    for tag, name in named.items():
        # Whether it is inside is asked of the point's foot on the face's surface.
        foot, _ = gmsh.model.getClosestPoint(2, tag, points[7])
        if np.linalg.norm(foot - points[7]) <= near and gmsh.model.isInside(2, tag, points[7]):
            return name
    return ""
