"""A case becomes a model: geometry, grids, relocation, cutting, doubling, then arrays for the kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.doubling import CutMesh
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.pipeline.case import Case
from phantomnode.solver.model import Model
from phantomnode.solver.timestep import StepEstimate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Body:
    """One body, cut out of its background grid.

    Attributes
    ----------
    name : str
    regions : tuple of Region
        Its outlines, as placed by the case.
    interfaces : tuple of (str, Curve)
        The curves inside the body (interfaces, cracks) with their names.
    grid : BackgroundGrid
        After node relocation.
    relocated : int
        Number of grid nodes that were relocated.
    mesh : CutMesh
    nodes : slice
        Its nodes in the model.
    elements, cut_elements : slice
        Its elements in ``model.elements`` and ``model.cut_elements``; both keep the order of the mesh.
    rho : float, kg/m^3
    """

    name: str
    regions: tuple[Region, ...]
    interfaces: tuple[tuple[str, Curve], ...]
    grid: BackgroundGrid
    relocated: int
    mesh: CutMesh
    nodes: slice
    elements: slice
    cut_elements: slice
    rho: float


@dataclass(frozen=True)
class Pair:
    """One contact pair: where its slave segments are, for the output.

    Attributes
    ----------
    name, slave, master : str
        Names as in the case file.
    segment_nodes : (s, 4) int64
        Model nodes of the parent element of each slave segment.
    start_shape, end_shape : (s, 4) float64
        Shape functions at the ends of each segment.
    points : slice
        Its slave points in the model; ``points_per_segment`` to each segment, in the order of the segments.
    points_per_segment : int
    """

    name: str
    slave: str
    master: str
    segment_nodes: Ints
    start_shape: Floats
    end_shape: Floats
    points: slice
    points_per_segment: int


@dataclass(frozen=True)
class Boundary:
    """One boundary condition: the rows of the prescribed motion that it fills, -1 where a direction is free."""

    name: str
    channels: tuple[int, int]
    nodes: Ints


class Motion(Protocol):
    """The prescribed motions of a case."""

    def increments(self, first_step: int, steps: int, dt: float) -> Floats:
        """(steps, channels) Displacement increments over the steps that begin at times first_step*dt, ..."""


@dataclass(frozen=True)
class Prepared:
    """A case that is ready to run.

    Attributes
    ----------
    case : Case
    bodies : tuple of Body
    pairs : tuple of Pair
    boundaries : tuple of Boundary
    model : Model
    velocity : (n, 2) float64, m/s
        Initial velocity of every node.
    motion : Motion
    estimate : StepEstimate
        The stable time step and what limits it.
    dt : float, s
        The step that the run takes.
    warnings : tuple of str
        Resolution limits and the like, to be shown and logged.
    """

    case: Case
    bodies: tuple[Body, ...]
    pairs: tuple[Pair, ...]
    boundaries: tuple[Boundary, ...]
    model: Model
    velocity: Floats
    motion: Motion
    estimate: StepEstimate
    dt: float
    warnings: tuple[str, ...]
