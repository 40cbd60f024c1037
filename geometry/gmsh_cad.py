"""Outlines of a CAD model that gmsh holds: as they are in a planar one, or of one face; in the reader's child."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import CHORD_ERROR, trace
from phantomnode.geometry.planes import FLAT, Plane, extruded_along

Floats = NDArray[np.float64]

MOST_CURVES = 50_000
"""Curves of a model beyond which it is no outline to be cut from a grid."""

MOST_VERTICES = 2_000_000
"""Vertices of all curves together."""


def whole(gmsh: Any) -> dict[str, Any]:
    """The outlines of all faces of a planar model by name, and the curves that bound no face; else what is solid."""
    curves = [tag for _, tag in gmsh.model.getEntities(1)]
    if not curves:
        raise GeometryError("it holds no curves")
    faces = [tag for _, tag in gmsh.model.getEntities(2)]
    plane = Plane.through(np.vstack([samples_of(gmsh, tag) for tag in curves]))
    # A dome may stand on a plane outline.
    if plane is None or gmsh.model.getEntities(3) or any(_plane_of_face(gmsh, tag) is None for tag in faces):
        return {"solid": _solid(gmsh)}
    return outlines(gmsh, faces, curves, plane)


def face(gmsh: Any, wanted: str | int) -> dict[str, Any]:
    """The outline of one flat face by its number, or of the faces of a name that lie in one plane."""
    faces = [tag for _, tag in gmsh.model.getEntities(2)]
    chosen = [tag for tag in faces if wanted in (tag, *names_of(gmsh, 2, tag))]
    if not chosen:
        return {"solid": _solid(gmsh), "no_face": wanted}
    planes = [_plane_of_face(gmsh, tag) for tag in chosen]
    for tag, plane in zip(chosen, planes, strict=True):
        if plane is None:
            raise GeometryError(f"face {tag} is not flat ({gmsh.model.getType(2, tag)}); choose a flat one")
    curves = bounding(gmsh, chosen)
    common = (
        planes[0] if len(chosen) == 1 else Plane.through(np.vstack([samples_of(gmsh, t) for t in curves]))
    )
    if common is None:
        raise GeometryError(
            f"the faces named {wanted!r} ({', '.join(map(str, chosen))}) do not lie in one plane; choose one by its "
            "number"
        )
    return outlines(gmsh, chosen, curves, common)


def outlines(
    gmsh: Any, faces: list[int], curves: list[int], plane: Plane,
    face_names: dict[int, str] | None = None, curve_names: dict[int, str] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The outlines of faces by name and the curves that bound none, in the coordinates of their plane."""
    if len(curves) > MOST_CURVES:
        raise GeometryError(f"it holds {len(curves)} curves, more than {MOST_CURVES}; simplify it")
    points = plane.project(np.vstack([samples_of(gmsh, tag) for tag in curves]))
    chord_error = CHORD_ERROR * float(np.hypot(*np.ptp(points, axis=0)))
    pieces, vertices = {}, 0
    for tag in curves:
        name = (curve_names or {}).get(tag) or name_of(gmsh, 1, tag)
        pieces[tag] = {**_piece(gmsh, tag, plane, chord_error), "name": name}
        vertices += len(pieces[tag]["points"])
        if vertices > MOST_VERTICES:
            raise GeometryError(f"its curves need more than {MOST_VERTICES} vertices; simplify it")
    uses: dict[str, Counter[int]] = {}
    slits = set()
    for tag in faces:
        bounds = Counter(abs(t) for _, t in gmsh.model.getBoundary([(2, tag)], combined=False, oriented=True))
        name = (face_names or {}).get(tag) or name_of(gmsh, 2, tag)
        uses.setdefault(name, Counter()).update(bounds)
        slits |= {curve for curve, count in bounds.items() if count > 1}
    return {**split(pieces, uses, slits), "plane": [plane.frame.tolist(), plane.offset]}


def split(
    pieces: dict[Any, dict[str, Any]], uses: dict[str, Counter[Any]], slits: set[Any]
) -> dict[str, Any]:
    """Pieces into the outlines of the faces of each name, and the rest.

    Faces of one name that share a curve are one region: a curve that is used an even number of times lies inside.
    It is kept as a free curve where it has a name or is a slit of one face, and left out otherwise.
    """
    used = {key for counts in uses.values() for key in counts}
    edges = {name: {key for key, n in counts.items() if n % 2} for name, counts in uses.items()}
    inner = used - set().union(*edges.values())
    free = [
        key for key in pieces if key not in used or (key in inner and (key in slits or pieces[key]["name"]))
    ]
    groups = [
        {"name": name, "pieces": [piece for key, piece in pieces.items() if key in keys]}
        for name, keys in edges.items()
    ]
    dropped = len(inner - set(free))
    notes = [f"{dropped} unnamed curves between faces of one region were left out"] if dropped else []
    return {"groups": groups, "free": [pieces[key] for key in free], "notes": notes}


def name_of(gmsh: Any, dimension: int, tag: int) -> str:
    """The first of the names of an entity, "" where it has none."""
    return next(iter(names_of(gmsh, dimension, tag)), "")


def names_of(gmsh: Any, dimension: int, tag: int) -> list[str]:
    """Names of the physical groups of an entity, then its own."""
    groups = gmsh.model.getPhysicalGroupsForEntity(dimension, tag)
    found = [str(gmsh.model.getPhysicalName(dimension, group)) for group in groups]
    own = str(gmsh.model.getEntityName(dimension, tag)).rsplit("/", 1)[-1]
    if not own.startswith("Open CASCADE"):  # what OCC writes where nobody gave a name
        found.append(own)
    return [name for name in found if name]


def _solid(gmsh: Any) -> dict[str, Any]:
    """What there is to choose from in a 3D model: its flat faces, and the axis of an extrusion."""
    samples = [samples_of(gmsh, tag) for _, tag in gmsh.model.getEntities(1)]
    every = np.vstack(samples)
    flat = []
    for _, tag in gmsh.model.getEntities(2):
        plane = _plane_of_face(gmsh, tag)
        if plane is not None:
            size = np.ptp(plane.project(_face_samples(gmsh, tag)), axis=0)
            flat.append({"number": tag, "name": name_of(gmsh, 2, tag), "size": size.tolist(),
                         "plane": [plane.frame.tolist(), plane.offset]})  # fmt: skip
    return {
        "volumes": len(gmsh.model.getEntities(3)),
        "faces": len(gmsh.model.getEntities(2)),
        "flat": flat,
        "extruded": extruded_along(samples),
        "box": [every.min(axis=0).tolist(), every.max(axis=0).tolist()],
    }


def _plane_of_face(gmsh: Any, tag: int) -> Plane | None:
    """The plane that a face lies in, None where it is curved."""
    outline = _face_samples(gmsh, tag)
    plane = Plane.through(outline) if len(outline) else None
    if plane is None or gmsh.model.getType(2, tag) == "Plane":
        return plane
    low, high = gmsh.model.getParametrizationBounds(2, tag)
    u, v = (grid.ravel() for grid in np.meshgrid(*np.linspace(low, high, 9).T))
    inner = np.reshape(gmsh.model.getValue(2, tag, np.column_stack([u, v]).ravel()), (-1, 3))
    return plane if plane.holds(inner, FLAT * float(np.linalg.norm(np.ptp(outline, axis=0)))) else None


def _face_samples(gmsh: Any, tag: int) -> Floats:
    """(k, 3) Points along the outline of a face."""
    curves = bounding(gmsh, [tag])
    return np.vstack([samples_of(gmsh, curve) for curve in curves]) if curves else np.empty((0, 3))


def bounding(gmsh: Any, faces: list[int]) -> list[int]:
    """The curves that bound faces or are embedded in them."""
    found = []
    for tag in faces:
        found += [abs(t) for _, t in gmsh.model.getBoundary([(2, tag)], combined=False, oriented=True)]
        found += [t for dimension, t in gmsh.model.mesh.getEmbedded(2, tag) if dimension == 1]
    return list(dict.fromkeys(found))


def samples_of(gmsh: Any, tag: int) -> Floats:
    """(17, 3) Points along a curve."""
    (low,), (high,) = gmsh.model.getParametrizationBounds(1, tag)
    return np.asarray(gmsh.model.getValue(1, tag, np.linspace(low, high, 17))).reshape(-1, 3)


def _piece(gmsh: Any, tag: int, plane: Plane, chord_error: float) -> dict[str, Any]:
    """One curve as points and bulges, its ends those of the topology (which neighbours share to the bit)."""
    (low,), (high,) = gmsh.model.getParametrizationBounds(1, tag)

    def evaluate(parameter: Floats) -> Floats:
        return plane.project(np.asarray(gmsh.model.getValue(1, tag, parameter)).reshape(-1, 3))

    boundary = gmsh.model.getBoundary([(1, tag)], combined=False)
    ends = [plane.project(np.asarray(gmsh.model.getValue(0, abs(end), []))) for _, end in boundary]
    if gmsh.model.getType(1, tag) == "Line":
        points, bulges = evaluate(np.array([low, high])), np.zeros(1)
    else:
        points, bulges = trace(evaluate, np.array([low, high]), chord_error)
    for k in (0, -1):
        if ends:
            points[k] = min(ends, key=lambda end: float(np.hypot(*(end - points[k]))))
    return {"points": points.tolist(), "bulges": bulges.tolist()}
