"""A case becomes a model: geometry, grids, relocation, cutting, doubling, then arrays for the kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.doubling import CutMesh
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.levelset import LevelSet
from phantomnode.pipeline.assembly import (
    POINTS_PER_SEGMENT,
    PairSurfaces,
    joined_contact,
    pair_surfaces,
)
from phantomnode.pipeline.bodies import CutBody, at, cut_body
from phantomnode.pipeline.elements import element_lists
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.expressions import time_function
from phantomnode.pipeline.motion import Channel, PrescribedMotion
from phantomnode.pipeline.scaling import heavy_bodies, largest_jump, scaled
from phantomnode.pipeline.schema import Boundary as BoundaryTable
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.schema import Contact as ContactTable
from phantomnode.pipeline.step import run_step
from phantomnode.pipeline.surfaces import Surface, nodes_on_edges, surface
from phantomnode.pipeline.xfem import MassMatrix, classic_xfem
from phantomnode.solver.leapfrog import initial_state
from phantomnode.solver.mass_scaling import lumped_mass
from phantomnode.solver.model import Model
from phantomnode.solver.search import prepare_search
from phantomnode.solver.timestep import StepEstimate, stable_step

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
    motion : PrescribedMotion
    estimate : StepEstimate
        The stable time step and what limits it.
    dt : float, s
        The step that the run takes.
    warnings : tuple of str
        Resolution limits and the like, to be shown and logged.
    xfem : MassMatrix or None
        The mass matrix of classic X-FEM, where the case asks for it.
    """

    case: Case
    bodies: tuple[Body, ...]
    pairs: tuple[Pair, ...]
    boundaries: tuple[Boundary, ...]
    model: Model
    velocity: Floats
    motion: PrescribedMotion
    estimate: StepEstimate
    dt: float
    warnings: tuple[str, ...]
    xfem: MassMatrix | None = None


OVERLAP = 1e-6
"""Depth, in cell sizes, up to which surfaces touch at the start and do not overlap (the lattice: 2e-7)."""

AUTO_PENALTY = 5.0
"""The automatic penalty in E/h: 1 to 10 is the range where it is stiff and the pressure still smooth."""


def prepare(case: Case) -> Prepared:
    """Everything that a run needs, from a validated case.

    Raises
    ------
    CaseError
        Naming the key at fault: a file that cannot be read, a body outside its grid, an unknown part, surfaces
        that overlap at the start, a step that is not stable.
    """
    cut = {name: cut_body(case, name) for name in case.body}
    bodies = _bodies(case, cut)
    first_node = {body.name: body.nodes.start for body in bodies}
    surfaces = {
        name: tuple(surface(place, cut, f"contact.{name}.{end}") for end, place in _ends(pair))
        for name, pair in case.contact.items()
    }
    contact = [pair_surfaces(slave, master, cut, first_node) for slave, master in surfaces.values()]
    channel, motion, boundaries = _boundaries(case, cut, bodies)
    model = _model(case, cut, bodies, surfaces, contact, channel, len(motion.channels))
    model = model._replace(contact=model.contact._replace(offset=_offsets(case, cut, surfaces, model)))
    jump = largest_jump(case, motion)
    model = scaled(case, model, jump)
    estimate, xfem = stable_step(model, case.time.safety, jump), None
    if case.method == "xfem":
        model, estimate, xfem = classic_xfem(case, bodies, model)
    dt = run_step(case, estimate)
    velocity = np.vstack([np.tile(case.body[b.name].initial_velocity, (len(b.mesh.xy), 1)) for b in bodies])
    warnings = (*(note for body in cut.values() for note in body.notes), *heavy_bodies(bodies, model))
    pairs = _pairs(case, contact)
    return Prepared(case, bodies, pairs, boundaries, model, velocity, motion, estimate, dt, warnings, xfem)


def _ends(pair: ContactTable) -> tuple[tuple[str, str], tuple[str, str]]:
    """The two surfaces of a pair with their keys."""
    return ("slave", pair.slave), ("master", pair.master)


def _bodies(case: Case, cut: dict[str, CutBody]) -> tuple[Body, ...]:
    """The bodies with their places in the lists of the model."""
    bodies, node, element, cut_element = [], 0, 0, 0
    for name, body in cut.items():
        nodes, whole = len(body.mesh.xy), int(np.count_nonzero(~body.mesh.cut))
        parts = len(body.mesh.elements) - whole
        bodies.append(
            Body(
                name=name,
                regions=body.regions,
                interfaces=body.interfaces,
                grid=body.grid,
                relocated=body.relocated,
                mesh=body.mesh,
                nodes=slice(node, node + nodes),
                elements=slice(element, element + whole),
                cut_elements=slice(cut_element, cut_element + parts),
                rho=case.material[case.body[name].material].rho,
            )
        )
        node, element, cut_element = node + nodes, element + whole, cut_element + parts
    return tuple(bodies)


def _model(
    case: Case,
    cut: dict[str, CutBody],
    bodies: tuple[Body, ...],
    surfaces: dict[str, tuple[Surface, ...]],
    contact: list[PairSurfaces],
    channel: Ints,
    channels: int,
) -> Model:
    """The arrays of all bodies behind each other, with a quarter of each element's mass on its nodes."""
    lists = element_lists(case, bodies)
    penalty = [_penalty(case, name, cut, *pair) for name, pair in surfaces.items()]
    reach = [max(cut[surface.body].grid.cell_size for surface in pair) for pair in surfaces.values()]
    return Model(
        x=lists.x,
        mass=lumped_mass(len(lists.x), lists.elements, lists.cut_elements),
        load=lists.load,
        channel=channel,
        channels=channels,
        elements=lists.elements,
        cut_elements=lists.cut_elements,
        contact=joined_contact(contact, np.array(penalty, dtype=float), np.array(reach, dtype=float)),
        full=lists.full,
        damping=lists.damping,
    )


def _penalty(case: Case, name: str, cut: dict[str, CutBody], slave: Surface, master: Surface) -> float:
    """The penalty of a pair, Pa/m."""
    penalty = case.contact[name].penalty
    moduli = [case.material[case.body[surface.body].material].E for surface in (slave, master)]
    if isinstance(penalty, str):
        return AUTO_PENALTY * min(moduli) / cut[slave.body].grid.typical_size
    return penalty.value if penalty.value is not None else float(penalty.times_E or 0.0) * moduli[0]


def _pairs(case: Case, contact: list[PairSurfaces]) -> tuple[Pair, ...]:
    """The contact pairs with the places of their slave points in the model."""
    pairs, first = [], 0
    for (name, table), surfaces in zip(case.contact.items(), contact, strict=True):
        points = slice(first, first + len(surfaces.weight))
        first = points.stop
        pairs.append(
            Pair(
                name=name,
                slave=table.slave,
                master=table.master,
                segment_nodes=surfaces.slave_nodes,
                start_shape=surfaces.slave_start,
                end_shape=surfaces.slave_end,
                points=points,
                points_per_segment=POINTS_PER_SEGMENT,
            )
        )
    return tuple(pairs)


def _boundaries(
    case: Case, cut: dict[str, CutBody], bodies: tuple[Body, ...]
) -> tuple[Ints, PrescribedMotion, tuple[Boundary, ...]]:
    """Which motion holds each degree of freedom of the model, real and phantom nodes alike."""
    offset = {body.name: body.nodes.start for body in bodies}
    channel = np.full((bodies[-1].nodes.stop, 2), -1, dtype=np.int64)
    channels: list[Channel] = []
    boundaries: list[Boundary] = []
    for name, table in case.boundary.items():
        owner, nodes = _held_nodes(table, cut, f"boundary.{name}.on")
        nodes = nodes + offset[owner]
        rows = [-1, -1]
        for axis, made in enumerate(_channels(case, name, table, owner)):
            if made is None:
                continue
            taken = channel[nodes, axis]
            if np.any(taken >= 0):
                first = next(b.name for b in boundaries if taken.max() in b.channels)
                raise CaseError(
                    f"boundary.{name}: {np.count_nonzero(taken >= 0)} nodes are already moved in "
                    f"{'xy'[axis]} by boundary.{first}; leave one of the two out there"
                )
            rows[axis] = len(channels)
            channel[nodes, axis] = len(channels)
            channels.append(made)
        boundaries.append(Boundary(name, (rows[0], rows[1]), nodes))
    return channel, PrescribedMotion(tuple(channels)), tuple(boundaries)


def _held_nodes(table: BoundaryTable, cut: dict[str, CutBody], key: str) -> tuple[str, Ints]:
    """The body that a boundary holds, and its nodes, real and phantom alike."""
    if isinstance(table.on, str):
        part = surface(table.on, cut, key)
        return part.body, nodes_on_edges(cut[part.body], part.segments, key, table.on)
    xy = cut[table.on.body].mesh.xy
    low, high = np.array(table.on.box)
    margin = 1e-9 * cut[table.on.body].grid.cell_size  # a node drawn on the side of the box is in it
    nodes = np.flatnonzero(np.all((xy >= low - margin) & (xy <= high + margin), axis=1))
    if len(nodes) == 0:
        raise CaseError(f"{key}: no node of {table.on.body} lies in the box; it spans {_span(xy)}")
    return table.on.body, nodes


def _span(xy: Floats) -> str:
    """The bounding box of nodes, for messages."""
    (x0, y0), (x1, y1) = xy.min(axis=0), xy.max(axis=0)
    return f"[[{x0:.6g}, {y0:.6g}], [{x1:.6g}, {y1:.6g}]] m"


def _channels(case: Case, name: str, table: BoundaryTable, body: str) -> list[Channel | None]:
    """The motions of a boundary in x and y."""
    made: list[Channel | None] = []
    for kind in ("displacement", "velocity", "acceleration"):
        directions = getattr(table, kind)
        if directions is None:
            continue
        for axis, value in enumerate((directions.x, directions.y)):
            key = f"boundary.{name}.{kind}.{'xy'[axis]}"
            if value is None:
                made.append(None)
                continue
            function = time_function(value)
            with at(case, key):
                start = float(function(np.zeros(1))[0])
                function(np.linspace(0.0, case.time.end, 1001))  # finite over the whole run
            if kind == "displacement" and start != 0.0:
                raise CaseError(
                    f"{key}: the displacement is {start:g} m at t = 0, a jump; let it start from 0, "
                    f'for instance "{start:g}*min(t/{0.1 * case.time.end:g}, 1)"'
                )
            made.append(Channel(kind, function, case.body[body].initial_velocity[axis]))
    return made


def _offsets(
    case: Case, cut: dict[str, CutBody], surfaces: dict[str, tuple[Surface, ...]], model: Model
) -> Floats:
    """(g,) The depth of each slave point at the start, where the case says that it counts as touching.

    Surfaces that overlap otherwise are refused: each millimetre would add energy eps g^2/2 from nothing.
    """
    contact = model.contact
    gaps = initial_state(model, np.zeros_like(model.x), prepare_search(contact)).gap
    offsets = np.zeros(len(gaps))
    for k, (name, (slave, master)) in enumerate(surfaces.items()):
        points = slice(*contact.slave_first[k : k + 2])
        depth = np.maximum(gaps[points], 0.0)
        ends = cut[slave.body].mesh.segments.ends[slave.segments]
        middle = np.repeat(ends.mean(axis=1), POINTS_PER_SEGMENT, axis=0)
        inside = np.zeros(len(depth))
        if slave.body != master.body:  # the drawing tells beyond the reach of the search, too
            inside = LevelSet.of_regions(cut[master.body].regions).distance(middle)
        worst = int(np.argmax(np.maximum(depth, inside)))
        deepest, here = (
            max(depth[worst], inside[worst]),
            f"({middle[worst, 0]:.6g}, {middle[worst, 1]:.6g}) m",
        )
        if deepest <= OVERLAP * cut[slave.body].grid.cell_size:
            continue
        table = case.contact[name]
        if table.overlap == "refuse":
            raise CaseError(
                f"contact.{name}: {table.slave} and {table.master} overlap at the start by {deepest:.3g} m near "
                f"{here}: move one of the bodies (geometry move = [dx, dy]), or measure gaps from this state "
                '(overlap = "offset")'
            )
        if deepest > contact.reach[k] / 2.0:
            raise CaseError(
                f"contact.{name}: {table.slave} lies {deepest:.3g} m deep in {table.master} near {here}, more than "
                "half a cell, which no offset can stand for: move one of the bodies (geometry move = [dx, dy])"
            )
        offsets[points] = depth
    return offsets
