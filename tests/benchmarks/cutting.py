"""Preprocessing: signed distances, relocation, cutting and doubling."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry import grid as grids
from phantomnode.geometry.curves import Region
from phantomnode.geometry.cut import cut
from phantomnode.geometry.doubling import CutMesh, double
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.levelset import LevelSet
from phantomnode.geometry.noding import Lattice
from phantomnode.geometry.relocate import relocate
from phantomnode.geometry.shapes import polygon

from .blocks import side_of
from .measure import Figure, Plan, clocked, duration, repeated

Floats = NDArray[np.float64]

LOBES, MEAN, DEPTH = 20, 0.36, 0.11
"""A flower in the unit square, m; its outline runs through 1e4 cells of a grid of 1e6."""


def flower(segments: int) -> Region:
    """A closed outline with lobes, of straight segments."""
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    radius = MEAN + DEPTH * np.sin(LOBES * angle)
    return polygon(0.5 + np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))


def unit_grid(side: int) -> BackgroundGrid:
    """side x side cells on the unit square."""
    return grids.cartesian((0.0, 0.0), (1.0, 1.0), counts=(side, side), aligned=True)


def distance(plan: Plan) -> Iterator[Figure]:
    """Signed distance of the nodes of a grid of 1e6 cells."""
    xy = unit_grid(side_of(1e6, plan)).xy
    for segments, name in ((1000, "1e3"), (100_000, "1e5")):
        levels = LevelSet.of_regions([flower(plan.sized(segments, least=60))])
        runs = repeated(lambda levels=levels: levels.distance(xy), plan.processes)
        yield duration(f"signed distance, 1e6 nodes x {name} segments", runs, "tree of chords built before")


def cutting(plan: Plan) -> Iterator[Figure]:
    """From a grid of 1e6 cells and an outline to elements with phantom nodes."""
    side, region = side_of(1e6, plan), flower(plan.sized(1000, least=60))
    meshes: list[CutMesh] = []
    relocating, doubling = [], []
    for _ in range(plan.processes + 1):
        meshes.clear()
        grid = unit_grid(side)  # anew: it keeps what it has worked out
        found: list[BackgroundGrid] = []
        relocating.append(clocked(lambda grid=grid, found=found: found.append(moved(grid, region))))
        doubling.append(clocked(lambda found=found: meshes.append(cut_and_double(found[0], region))))
    cells = f"{np.count_nonzero(meshes[0].cut)} cut elements"
    yield duration("relocate nodes, 1e6 cells", relocating[1:])
    yield duration("cut and double, 1e6 cells", doubling[1:], cells)


def moved(grid: BackgroundGrid, region: Region) -> BackgroundGrid:
    """The relocated grid."""
    return relocate(grid, list(region.loops)).grid


def cut_and_double(grid: BackgroundGrid, region: Region) -> CutMesh:
    """The elements of the region."""
    return double(grid, cut(grid, (region,), (), Lattice.of(grid)))
