"""One moment of a run, as arrays: the bodies with their fields, the contact surfaces with their pressures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.outlines import open_edges
from phantomnode.pipeline.quantities import quantity
from phantomnode.pipeline.vtu import VTK_LINE, VTK_QUAD, VTK_TRIANGLE
from phantomnode.pipeline.vtu_reader import Array, Grid, read_vtu

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Numbers = NDArray[np.int32] | NDArray[np.int64]


@dataclass(frozen=True)
class FieldsFrame:
    """The bodies at one time, clipped to their material.

    Cells are quadrilaterals, then triangles; arrays of cells have that order.

    Attributes
    ----------
    time : float, s
    points : (p, 2) float64, m
        Where the points are now.
    quads : (q, 4) int32 or int64
        Points of each quadrilateral, counter-clockwise.
    triangles : (t, 3) int32 or int64
        Points of each triangle, counter-clockwise.
    point_data : dict of str to (p, 3) arrays
        ``displacement``, m, and ``velocity``, m/s.
    cell_data : dict of str to (q + t,) or (q + t, k) arrays
        As in fields.pvd: ``stress``, ``von_mises``, ``hencky_strain``, ``J``, ``body``, ``side``, ``fraction``.
    obstacles : (r, 2, 2) float64, m
        Start and end of the segments of rigid obstacles, now.
    """

    time: float
    points: Floats
    quads: Numbers
    triangles: Numbers
    point_data: Mapping[str, Array]
    cell_data: Mapping[str, Array]
    obstacles: Floats = field(default_factory=lambda: np.zeros((0, 2, 2)))

    @classmethod
    def read(cls, path: Path, time: float) -> FieldsFrame:
        """A frame from its file.

        Raises
        ------
        CaseError
            Where the file cannot be read.
        """
        grid = read_vtu(path)
        quads, triangles = grid.cells(VTK_QUAD).reshape(-1, 4), grid.cells(VTK_TRIANGLE).reshape(-1, 3)
        points = grid.points[:, :2].astype(np.float64)
        return cls(time, points, quads, triangles, grid.point_data, grid.cell_data)

    @cached_property
    def reference(self) -> Floats:
        """(p, 2) Where the points were at the start, m."""
        return np.asarray(self.points - self.point("displacement")[:, :2])

    @cached_property
    def outline(self) -> Ints:
        """(b, 2) Points of the edges that belong to one cell only: boundaries and open interfaces."""
        return open_edges([self.quads, self.triangles], self.reference)

    def cell(self, name: str) -> Floats:
        """(m,) or (m, k) An array of the cells, float64."""
        return _named(self.cell_data, name, "cells")

    def point(self, name: str) -> Floats:
        """(p, k) An array of the points, float64."""
        return _named(self.point_data, name, "points")

    def means(self, values: Floats) -> Floats:
        """(m,) Means over the corners of each cell, from (p,) values at the points."""
        return np.concatenate([values[self.quads].mean(axis=1), values[self.triangles].mean(axis=1)])

    def smoothed(self, values: Floats) -> Floats:
        """(m,) Values of the cells, each the mean over its corners of the means, by area, of the cells about these.

        Across outlines and open interfaces nothing is mixed: there cells have no corner in common.
        """
        nodes = np.concatenate([self.quads.reshape(-1), self.triangles.reshape(-1)])
        area = np.concatenate([_areas(self.points[cells]) for cells in (self.quads, self.triangles)])
        corners = np.repeat([4, 3], [len(self.quads), len(self.triangles)])
        weight, weighted = np.repeat(area, corners), np.repeat(area * values, corners)
        about = np.bincount(nodes, weight, len(self.points))
        mean = np.bincount(nodes, weighted, len(self.points)) / np.where(about > 0.0, about, 1.0)
        return self.means(mean)

    def values(self, name: str) -> Floats:
        """(m,) A field of each cell, SI; vectors as the mean over the corners.

        Parameters
        ----------
        name : str
            ``von_mises``, ``stress_xx``, ``displacement``, ``velocity_y``, ...: the keys of
            ``phantomnode.pipeline.quantities.QUANTITIES``.

        Raises
        ------
        CaseError
            Naming the fields that there are.
        """
        return quantity(name).values(self)


def _areas(corners: Floats) -> Floats:
    """(m,) Areas of the (m, k, 2) corners of polygons, not below zero."""
    x, y = corners[..., 0], corners[..., 1]
    twice = np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)
    return np.asarray(np.maximum(0.5 * twice, 0.0))


@dataclass(frozen=True)
class ContactFrame:
    """The slave surfaces of all contact pairs at one time, and rigid obstacles as segments of the pair -1.

    Attributes
    ----------
    time : float, s
    ends : (s, 2, 2) float64, m
        Start and end of each segment, now.
    pair : (s,) int64
        Which pair of the case it belongs to.
    cell_data : dict of str to (s,) or (s, 3) arrays
        As in contact.pvd: ``pressure``, ``pressure_filtered``, ``traction``, ``gap``, ``normal``.
    """

    time: float
    ends: Floats
    pair: Ints
    cell_data: dict[str, Array]

    @classmethod
    def read(cls, path: Path, time: float) -> ContactFrame:
        """A frame from its file.

        Raises
        ------
        CaseError
            Where the file cannot be read.
        """
        grid: Grid = read_vtu(path)
        ends = grid.points[:, :2].astype(np.float64)[grid.cells(VTK_LINE).reshape(-1, 2)]
        return cls(time, ends, grid.cell_data["pair"].astype(np.int64), grid.cell_data)

    def of_pair(self, number: int, name: str) -> Floats:
        """(k,) or (k, 3) An array of the segments of one pair, in their order."""
        return np.asarray(_named(self.cell_data, name, "segments")[self.pair == number])


def _named(data: Mapping[str, Array], name: str, what: str) -> Floats:
    if name not in data:
        raise CaseError(f"the {what} of this frame have no {name!r}; they have {', '.join(data)}")
    return np.asarray(data[name], dtype=np.float64)
