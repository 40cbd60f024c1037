"""What a case became, in numbers: counts, areas, walls, penalties, places of obstacles, and what sets the step."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from phantomnode.geometry.walls import thinnest_wall
from phantomnode.pipeline.contacts import Pair
from phantomnode.pipeline.prepare import Body, Prepared
from phantomnode.pipeline.rigid import Rigid


def pair_penalty(prepared: Prepared, pair: Pair) -> float:
    """The penalty with which the surfaces of a pair meet, of all points together, Pa/m."""
    return float(pair.share * prepared.model.contact.penalty[pair.passes[0]])


def placed(rigid: Rigid) -> dict[str, Any]:
    """Where an obstacle is at the start: its box, m, and whether all its curves are closed."""
    return {
        "low": rigid.xy.min(axis=0),
        "high": rigid.xy.max(axis=0),
        "closed": all(curve.closed for curve in rigid.curves),
    }


def count(prepared: Prepared) -> dict[str, Any]:
    """Cells, elements and nodes of all bodies; a grid that bodies share counts once."""
    meshes = [body.mesh for body in prepared.bodies]
    grids = {id(body.grid): body for body in prepared.bodies}.values()
    return {
        "grid_cells": sum(body.grid.cell_count for body in grids),
        "elements": sum(len(mesh.elements) for mesh in meshes),
        "cut": sum(int(np.count_nonzero(mesh.cut)) for mesh in meshes),
        "doubled": sum(doubled_cells(body) for body in prepared.bodies),
        "nodes": sum(len(mesh.xy) for mesh in meshes),
        "phantom_nodes": sum(int(np.count_nonzero(~mesh.real)) for mesh in meshes),
        "relocated_nodes": sum(body.relocated for body in prepared.bodies),
        "smallest_fraction": min(float(mesh.fraction.min()) for mesh in meshes),
        "contact_points": len(prepared.model.contact.slave_weight),
    }


def doubled_cells(body: Body) -> int:
    """Number of grid cells that carry more than one element of the body."""
    return int(np.count_nonzero(np.unique(body.mesh.cell, return_counts=True)[1] > 1))


class Wall(NamedTuple):
    """The thinnest wall of a body: its thickness, m, infinite where there is none, and the cells through it."""

    thickness: float
    cells: float


def wall(body: Body) -> Wall:
    """The thinnest wall of a body, against its typical cell."""
    thickness = thinnest_wall(body.regions)
    return Wall(thickness, thickness / body.grid.typical_size)


def areas(body: Body) -> dict[str, float]:
    """Area of a body as cut and by its CAD curves, m^2."""
    return {"cut": float(body.mesh.area.sum()), "cad": float(sum(region.area for region in body.regions))}


def step_set_by(prepared: Prepared) -> str:
    """What sets the time step, in words."""
    estimate = prepared.estimate
    if prepared.xfem is not None:
        return f"the assembled X-FEM system ({prepared.case.xfem.mass} mass)"
    element, contact = estimate.element_frequency, estimate.contact_frequency
    uncut = len(prepared.model.elements.nodes)
    kind, number = (
        ("uncut", estimate.element) if estimate.element < uncut else ("cut", estimate.element - uncut)
    )
    slices = [
        (body.name, body.elements if kind == "uncut" else body.cut_elements) for body in prepared.bodies
    ]
    owner = next(name for name, part in slices if part.start <= number < part.stop)
    limit = f"{'an' if kind == 'uncut' else 'a'} {kind} element of body {owner}"
    if contact:
        springs = "contact and supports" if len(prepared.model.supports.stiffness) else "contact"
        limit += f", with {springs} ({np.hypot(element, contact) / element:.3g} times as long without)"
    if prepared.case.time.step != "auto":
        return f"the case (stable: {estimate.dt:.3g} s by {limit})"
    return limit
