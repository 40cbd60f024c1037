"""Planes in space, and plane coordinates in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError

Floats = NDArray[np.float64]

FLAT = 1e-6
"""Points within this part of their diagonal from a plane lie in it (CAD kernels keep coordinates to 1e-7)."""

LARGEST = 1e12
"""Coordinates beyond this are damage: no drawing is that many millimetres wide."""

AXES = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
"""The plane coordinates where one axis is held: as the views from the right, the front and above show them."""


@dataclass(frozen=True)
class Plane:
    """A plane n . p = offset with plane coordinates (u . p, v . p).

    Attributes
    ----------
    frame : (3, 3) float64
        Rows u, v and the normal n: orthonormal, v never pointing down, and u, v unit vectors of the axes (to the
        bit, so that coordinates stay what they are) where n is one.
    offset : float
        In the unit of the points.
    """

    frame: Floats
    offset: float

    @classmethod
    def across(cls, axis: str, offset: float) -> Plane:
        """The plane where the coordinate ``axis`` has a value; its coordinates are those of :data:`AXES`."""
        number = {"x": 0, "y": 1, "z": 2}
        u, v = AXES[axis]
        return cls(np.eye(3)[[number[u], number[v], number[axis]]], offset)

    @classmethod
    def through(cls, points: Floats) -> Plane | None:
        """The plane that (k, 3) points lie in, one of constant z, y or x where that is one; None for none.

        Raises
        ------
        GeometryError
            Where they are not finite, or far too large.
        """
        if not np.all(np.abs(points) <= LARGEST):
            raise GeometryError(f"a coordinate is beyond {LARGEST:.0e} or no number: the file is damaged")
        tolerance = FLAT * float(np.linalg.norm(np.ptp(points, axis=0)))
        for axis, values in zip("zyx", points.T[::-1], strict=True):
            if np.ptp(values) <= tolerance:
                return cls.across(axis, float(values[0]))
        centre = points.mean(axis=0)
        normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
        if np.max(np.abs((points - centre) @ normal)) > tolerance:
            return None
        u = np.cross([0.0, 0.0, 1.0], normal)
        u /= np.linalg.norm(u)
        normal = normal if u[np.argmax(np.abs(u))] > 0.0 else -normal
        u = u if u[np.argmax(np.abs(u))] > 0.0 else -u
        return cls(np.array([u, np.cross(normal, u), normal]), float(centre @ normal))

    def project(self, points: Floats) -> Floats:
        """(k, 2) Plane coordinates of (k, 3) points."""
        return points @ self.frame[:2].T

    def holds(self, points: Floats, tolerance: float) -> bool:
        """Whether (k, 3) points lie within ``tolerance`` of it."""
        return bool(np.all(np.abs(points @ self.frame[2] - self.offset) <= tolerance))

    def words(self, factor: float) -> str:
        """The plane in words, its offset in metres (``factor`` a unit of length)."""
        u, v, normal = self.frame
        at = round(factor * self.offset, 12) + 0.0  # kernels leave 1e-19 where 0 is meant
        for axis, held in zip("xyz", np.eye(3), strict=True):
            if np.array_equal(normal, held):
                return f"{axis} = {at:.6g} m"
        return f"the plane with normal {_vector(normal)}, {at:.6g} m from the origin"

    def coordinates(self) -> str:
        """What the plane coordinates are, in words: "(y, z)", or two directions."""
        for axis, held in zip("xyz", np.eye(3), strict=True):
            if np.array_equal(self.frame[2], held):
                return f"({', '.join(AXES[axis])})"
        return f"distances along {_vector(self.frame[0])} and {_vector(self.frame[1])}"


def _vector(vector: Floats) -> str:
    """Three components for a message."""
    return f"({', '.join(f'{component + 0.0:.4g}' for component in np.round(vector, 6))})"


def extruded_along(curves: list[Floats]) -> str | None:
    """The axis of an extrusion: each of its curves lies across it at one of the two ends, or runs along it.

    Parameters
    ----------
    curves : list of (k, 3) float64
        Points of each curve.
    """
    every = np.vstack(curves)
    low, high = every.min(axis=0), every.max(axis=0)
    tolerance = FLAT * float(np.linalg.norm(high - low))
    for axis in (2, 1, 0):
        across = [c for c in curves if np.ptp(c[:, axis]) <= tolerance]
        along = [c for c in curves if np.all(np.ptp(np.delete(c, axis, 1), axis=0) <= tolerance)]
        ends = [min(abs(c[0, axis] - low[axis]), abs(c[0, axis] - high[axis])) <= tolerance for c in across]
        if len(across) + len(along) == len(curves) and along and all(ends):
            return "xyz"[axis]
    return None
