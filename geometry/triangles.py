"""Faces of an arrangement into triangles."""

from __future__ import annotations

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.arrangement import Arrangement
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.noding import cross

Ints = NDArray[np.int64]


def triangles_of_faces(arrangement: Arrangement, faces: Ints) -> tuple[Ints, Ints]:
    """Divide some (k,) faces of an arrangement, convex ones of as many corners all at once.

    Returns
    -------
    vertices : (t, 3) int64
        Of counter-clockwise triangles that fill the faces exactly, none without area, in the order of the faces.
    face : (t,) int64
        The face of each.

    Raises
    ------
    GeometryError
        Where the areas do not sum to those of the faces (never met; a guard).
    """
    lengths = np.array([len(arrangement.cycles[face]) for face in faces], dtype=np.int64)
    corners, owner = [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for length in np.unique(lengths):
        some = faces[lengths == length]
        walks = arrangement.origin[np.array([arrangement.cycles[face] for face in some])]
        along = np.roll(arrangement.vertices[walks], -1, axis=1) - arrangement.vertices[walks]
        convex = np.all(cross(along, np.roll(along, -1, axis=1)) >= 0, axis=1)
        convex &= np.all(walks != np.roll(walks, 2, axis=1), axis=1)  # no spike
        fan = np.array([[0, k, k + 1] for k in range(1, length - 1)], dtype=np.int64).reshape(-1, 3)
        corners.append(walks[convex][:, fan].reshape(-1, 3))
        owner.append(np.repeat(some[convex], len(fan)))
        for face, walk in zip(some[~convex], walks[~convex], strict=True):
            corners.append(_triangulated(walk, arrangement.vertices))
            owner.append(np.full(len(corners[-1]), face))
    triangles, face_of = np.concatenate(corners), np.concatenate(owner)
    order = np.argsort(face_of, kind="stable")
    triangles, face_of = triangles[order], face_of[order]
    a, b, c = arrangement.vertices[triangles.T]
    twice = cross(b - a, c - a)
    filled = np.zeros(len(arrangement.cycles), dtype=np.int64)
    np.add.at(filled, face_of, twice)
    if np.any(twice < 0) or np.any(filled[faces] != arrangement.doubled_areas[faces]):
        raise GeometryError("a fragment could not be divided into triangles: report this geometry as a bug")
    return triangles[twice != 0], face_of[twice != 0]


def _triangulated(walk: Ints, vertices: Ints) -> Ints:
    """(t, 3) Vertices of counter-clockwise triangles of a polygon given by its walk."""
    walk = _without_spikes(walk)
    local = vertices[walk] - vertices[walk[0]]
    turn = cross(np.roll(local, -1, axis=0) - local, np.roll(local, -2, axis=0) - np.roll(local, -1, axis=0))
    if np.all(turn >= 0):
        return walk[np.array([[0, k, k + 1] for k in range(1, len(walk) - 1)], dtype=np.int64).reshape(-1, 3)]
    flat = mapbox_earcut.triangulate_float64(local.astype(np.float64), np.array([len(walk)]))
    index = np.asarray(flat, dtype=np.int64).reshape(-1, 3)
    a, b, c = local[index.T]
    index[cross(b - a, c - a) < 0] = index[cross(b - a, c - a) < 0][:, ::-1]
    return np.asarray(walk[index])


def _without_spikes(walk: Ints) -> Ints:
    """A walk without its forays along slits and bridges (a, b, a becomes a)."""
    points = walk.tolist()
    k = 0
    while len(points) > 2 and k < len(points):
        if points[k - 2] == points[k]:
            # points[k-2], points[k-1], points[k]: drop the tip and one of the two equal ends.
            for index in sorted(((k - 1) % len(points), k), reverse=True):
                points.pop(index)
            k = 0
        else:
            k += 1
    return np.array(points, dtype=np.int64)
