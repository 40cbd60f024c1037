"""Outlines and background grids out of a mesh that gmsh holds; in the reader's child."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.gmsh_cad import name_of, names_of, split
from phantomnode.geometry.planes import Plane

SOLID = "this is a 3D mesh, or one in several planes, and a plane problem needs a planar outline: take one flat face"

Floats = NDArray[np.float64]

QUAD = 3
"""gmsh's number for the four-node quadrilateral."""


def outline(gmsh: Any, wanted: str | int | None) -> dict[str, Any]:
    """The 1D elements of a mesh, and the edges of its 2D elements that only one of them has.

    Of a face of a 3D mesh, wanted by its name or number, the edges alone.
    """
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    place = dict(zip(tags.tolist(), np.asarray(xyz).reshape(-1, 3), strict=True))
    pieces: dict[tuple[int, int], dict[str, Any]] = {}
    uses: dict[str, Counter[tuple[int, int]]] = {}
    for dimension, entity in _entities(gmsh, wanted):
        name = name_of(gmsh, dimension, entity)
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
    plane = Plane.through(np.vstack([piece["points"] for piece in pieces.values()]))
    if plane is None:
        raise GeometryError(SOLID + _choice(gmsh))
    for piece in pieces.values():
        piece["points"] = plane.project(np.asarray(piece["points"])).tolist()
    # Where a loop begins depends on the mesh, not on the numbers in the file.
    pieces = dict(sorted(pieces.items(), key=lambda item: (item[1]["points"], item[1]["name"])))
    if wanted is not None:
        pieces = {key: piece for key, piece in pieces.items() if any(counts[key] for counts in uses.values())}
    return {**split(pieces, uses, set()), "plane": [plane.frame.tolist(), plane.offset]}


def _entities(gmsh: Any, wanted: str | int | None) -> list[tuple[int, int]]:
    """The lines and faces of the mesh, or its lines and the wanted faces."""
    lines, faces = gmsh.model.getEntities(1), gmsh.model.getEntities(2)
    if wanted is None and gmsh.model.getEntities(3):
        raise GeometryError(SOLID + _choice(gmsh))
    if wanted is not None:
        faces = [(2, tag) for _, tag in faces if wanted in (tag, *names_of(gmsh, 2, tag))]
        if not faces:
            raise GeometryError(f"no face of the mesh is {wanted!r}" + _choice(gmsh))
    return [*lines, *faces]


def _choice(gmsh: Any) -> str:
    """The faces that can be chosen, in words."""
    faces = [f"{tag} {name_of(gmsh, 2, tag)!r}".removesuffix(" ''") for _, tag in gmsh.model.getEntities(2)]
    more = f", and {len(faces) - 12} more" if len(faces) > 12 else ""
    return f"; its faces are {', '.join(faces[:12]) or 'none'}{more} (face = NUMBER or NAME)"


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


def quads(gmsh: Any) -> tuple[Floats, NDArray[np.int64]]:
    """(n, 2) Nodes and (m, 4) four-node quadrilaterals of a mesh that holds no other faces."""
    if gmsh.model.getEntities(3):
        raise GeometryError("this is a 3D mesh, and a background grid is one in the xy plane (constant z)")
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
    plane = Plane.through(points)
    if plane is None or plane.frame[2, 2] != 1.0:
        raise GeometryError("this is a 3D mesh, and a background grid is one in the xy plane (constant z)")
    return points[:, :2], number.reshape(-1, 4)
