"""Reads one file with gmsh, in a process of its own: ``python -m phantomnode.geometry.gmsh_child``.

gmsh runs scripts, crashes on damaged files and ends the process on a script's ``Exit``; nothing of that reaches
the program this way. Arguments: task ("curves" or "quads"), file, file for the result, token, CPU seconds. The
result is JSON followed by the token, which says that it is whole and written here. Lengths are as gmsh gives them:
millimetres for STEP and IGES (Geometry.OCCTargetUnit = "M" is refused for an IGES file in a fresh process, and
OCC's tolerance of 1e-7 is finer in millimetres), the numbers of the file for all others.
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import CHORD_ERROR, trace

Floats = NDArray[np.float64]

ADDRESS_SPACE = 4 << 30
"""Bytes of memory: a planar drawing needs a hundredth of it."""

FILE_SIZE = 1 << 30
"""Bytes of any file written."""

PLANE = 1e-6
"""Curves whose z differs by less than this part of the drawing's diagonal lie in one plane (CAD kernels keep
coordinates to 1e-7)."""

QUAD = 3
"""gmsh's number for the four-node quadrilateral."""


def main(arguments: list[str]) -> None:
    """Read the file and write the result or the reason why there is none."""
    task, source, target, token, seconds = arguments
    _limit(int(seconds))
    try:
        import gmsh
    except OSError as error:
        result: dict[str, Any] = {"missing": str(error)}
    else:
        try:
            result = _read(gmsh, task, source)
        except GeometryError as error:
            result = {"error": str(error)}
    Path(target).write_text(json.dumps(result) + token, encoding="utf-8")


def _limit(seconds: int) -> None:
    """Bound memory, time and written bytes where the system can."""
    if os.name != "posix":
        return
    import resource

    for what, most in (
        (resource.RLIMIT_AS, ADDRESS_SPACE),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, FILE_SIZE),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _read(gmsh: Any, task: str, source: str) -> dict[str, Any]:
    """What the file holds, as plain data."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.logger.start()
    try:
        gmsh.open(source)
    except Exception as error:  # gmsh raises plain Exception, with its last error message
        raise GeometryError(
            f"gmsh cannot read it ({str(error).strip() or 'no reason given'}): the file is damaged"
        ) from error
    complaints = [line for line in gmsh.logger.get() if line.startswith("Error")]
    if complaints:
        raise GeometryError(f"gmsh cannot read it ({complaints[0]}): the file is damaged")
    if gmsh.model.getEntities(3):
        raise GeometryError("3D")
    meshed = bool(gmsh.model.mesh.getNodes()[0].size) and source.endswith(".msh")
    if task == "quads":
        return _quads(gmsh)
    return _mesh_outline(gmsh) if meshed else _outline(gmsh)


def _outline(gmsh: Any) -> dict[str, Any]:
    """The curves of a CAD model: the outlines of its faces by name, and the curves that bound no face."""
    curves = [tag for _, tag in gmsh.model.getEntities(1)]
    if not curves:
        raise GeometryError("it holds no curves")
    size, plane = _extent(np.vstack([_samples(gmsh, tag) for tag in curves]))
    pieces = {tag: _piece(gmsh, tag, plane, CHORD_ERROR * size) for tag in curves}
    names = {tag: _name(gmsh, 1, tag) for tag in curves}
    uses: dict[str, Counter[int]] = {}
    slits = set()
    for _, face in gmsh.model.getEntities(2):
        bounds = Counter(
            abs(t) for _, t in gmsh.model.getBoundary([(2, face)], combined=False, oriented=True)
        )
        uses.setdefault(_name(gmsh, 2, face), Counter()).update(bounds)
        slits |= {tag for tag, count in bounds.items() if count > 1}
    return _split({tag: {**pieces[tag], "name": names[tag]} for tag in curves}, uses, slits)


def _split(
    pieces: dict[Any, dict[str, Any]], uses: dict[str, Counter[Any]], slits: set[Any]
) -> dict[str, Any]:
    """Pieces into the outlines of the faces of each name, and the rest.

    Faces of one name that share a curve are one region: a curve that is used an even number of times lies inside.
    It is kept as a free curve where it has a name or is a slit of one face, and left out otherwise.
    """
    bounding = {key for counts in uses.values() for key in counts}
    outlines = {name: {key for key, n in counts.items() if n % 2} for name, counts in uses.items()}
    inner = bounding - set().union(*outlines.values())
    free = [
        key
        for key in pieces
        if key not in bounding or (key in inner and (key in slits or pieces[key]["name"]))
    ]
    dropped = len(inner - set(free))
    notes = [f"{dropped} unnamed curves between faces of one region were left out"] if dropped else []
    groups = [
        {"name": name, "pieces": [piece for key, piece in pieces.items() if key in keys]}
        for name, keys in outlines.items()
    ]
    return {"groups": groups, "free": [pieces[key] for key in free], "notes": notes}


def _samples(gmsh: Any, tag: int) -> Floats:
    """(17, 3) Points along a curve."""
    (low,), (high,) = gmsh.model.getParametrizationBounds(1, tag)
    return np.asarray(gmsh.model.getValue(1, tag, np.linspace(low, high, 17))).reshape(-1, 3)


def _extent(points: Floats) -> tuple[float, float]:
    """Diagonal of (k, 3) points and the height of their plane.

    Raises
    ------
    GeometryError
        Where they do not lie in one plane of constant z.
    """
    if not np.all(np.isfinite(points)):
        raise GeometryError("a curve has coordinates that are not finite: the file is damaged")
    spread = np.ptp(points, axis=0)
    size = float(np.hypot(*spread[:2]))
    if spread[2] > PLANE * max(size, float(spread[2])):
        raise GeometryError("3D")
    return size, float(points[0, 2])


def _piece(gmsh: Any, tag: int, plane: float, chord_error: float) -> dict[str, Any]:
    """One curve as points and bulges, its ends those of the topology (which neighbours share to the bit)."""
    (low,), (high,) = gmsh.model.getParametrizationBounds(1, tag)

    def evaluate(parameter: Floats) -> Floats:
        return np.asarray(gmsh.model.getValue(1, tag, parameter)).reshape(-1, 3)[:, :2]

    boundary = gmsh.model.getBoundary([(1, tag)], combined=False)
    ends = [np.asarray(gmsh.model.getValue(0, abs(end), []))[:2] for _, end in boundary]
    if gmsh.model.getType(1, tag) == "Line":
        points, bulges = evaluate(np.array([low, high])), np.zeros(1)
    else:
        points, bulges = trace(evaluate, np.array([low, high]), chord_error)
    for k in (0, -1):
        if ends:
            points[k] = min(ends, key=lambda end: float(np.hypot(*(end - points[k]))))
    return {"points": points.tolist(), "bulges": bulges.tolist()}


def _name(gmsh: Any, dimension: int, tag: int) -> str:
    """Name of the first named physical group of an entity, else of the entity itself, else ""."""
    for group in gmsh.model.getPhysicalGroupsForEntity(dimension, tag):
        name = gmsh.model.getPhysicalName(dimension, group)
        if name:
            return str(name)
    own = str(gmsh.model.getEntityName(dimension, tag)).rsplit("/", 1)[-1]
    return "" if own.startswith("Open CASCADE") else own  # what OCC writes where nobody gave a name


def _mesh_outline(gmsh: Any) -> dict[str, Any]:
    """The 1D elements of a mesh, and the edges of its 2D elements that only one of them has."""
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    place = dict(zip(tags.tolist(), np.asarray(xyz).reshape(-1, 3), strict=True))
    pieces: dict[tuple[int, int], dict[str, Any]] = {}
    uses: dict[str, Counter[tuple[int, int]]] = {}
    for dimension in (1, 2):
        for _, entity in gmsh.model.getEntities(dimension):
            name = _name(gmsh, dimension, entity)
            for edge in _element_edges(gmsh, dimension, entity):
                key = (min(edge[:2]), max(edge[:2]))
                path = [edge[0], *edge[2:], edge[1]]
                if key not in pieces:
                    pieces[key] = {"points": [place[n] for n in path], "bulges": [0.0] * (len(path) - 1),
                                   "name": name if dimension == 1 else ""}  # fmt: skip
                if dimension == 2:
                    uses.setdefault(name, Counter())[key] += 1
    if not pieces:
        raise GeometryError("it holds no lines and no faces")
    _extent(np.vstack([piece["points"] for piece in pieces.values()]))
    for piece in pieces.values():
        piece["points"] = np.asarray(piece["points"])[:, :2].tolist()
    # Where a loop begins depends on the mesh, not on the numbers in the file.
    pieces = dict(sorted(pieces.items(), key=lambda item: (item[1]["points"], item[1]["name"])))
    return {**_split(pieces, uses, set()), "notes": []}


def _element_edges(gmsh: Any, dimension: int, entity: int) -> list[list[int]]:
    """Node tags of every edge of the elements of an entity: the two ends, then the nodes between them."""
    edges: list[list[int]] = []
    for kind, _, nodes in zip(*gmsh.model.mesh.getElements(dimension, entity), strict=True):
        _, _, order, count, *_ = gmsh.model.mesh.getElementProperties(kind)
        elements = np.asarray(nodes).reshape(-1, count)
        if dimension == 1:
            edges += elements.tolist()
        else:
            found = np.asarray(gmsh.model.mesh.getElementEdgeNodes(kind, entity)).reshape(len(elements), -1)
            # gmsh 2.2 writes an element for every physical group that it belongs to.
            _, once = np.unique(elements, axis=0, return_index=True)
            edges += found[np.sort(once)].reshape(-1, order + 1).tolist()
    return edges


def _quads(gmsh: Any) -> dict[str, Any]:
    """Nodes and four-node quadrilaterals of a mesh that holds no other faces."""
    kinds, _, nodes = gmsh.model.mesh.getElements(2)
    others = [gmsh.model.mesh.getElementProperties(kind)[0] for kind in kinds if kind != QUAD]
    if others:
        raise GeometryError(
            f"the mesh holds {', '.join(others)} elements, and a background grid needs four-node quadrilaterals "
            "only; recombine the mesh (gmsh: Mesh.RecombineAll = 1, Mesh.SubdivisionAlgorithm = 1, order 1)"
        )
    if not kinds.size:
        raise GeometryError("the mesh holds no quadrilaterals")
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    quads = np.asarray(nodes[0]).reshape(-1, 4)
    used, number = np.unique(quads, return_inverse=True)
    order = np.argsort(tags)
    points = np.asarray(xyz).reshape(-1, 3)[order[np.searchsorted(tags, used, sorter=order)]]
    _extent(points)
    return {"xy": points[:, :2].tolist(), "quads": number.reshape(-1, 4).tolist()}


if __name__ == "__main__":
    main(sys.argv[1:])
