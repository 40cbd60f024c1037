"""A case becomes a model: geometry, grids, relocation, cutting, doubling, then arrays for the kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.doubling import CutMesh
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.pipeline.bodies import CutBody, at, cut_body
from phantomnode.pipeline.contacts import Pair, contact_passes, offsets, own_reach, reported_pairs
from phantomnode.pipeline.elements import element_lists
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.expressions import time_function
from phantomnode.pipeline.motion import Channel, Kind, PrescribedMotion
from phantomnode.pipeline.pairing import ContactPass, joined_contact
from phantomnode.pipeline.rigid import Rigid, rigid_obstacles
from phantomnode.pipeline.scaling import heavy_bodies, largest_jump, scaled
from phantomnode.pipeline.schema import Boundary as BoundaryTable
from phantomnode.pipeline.schema import Case, Directions
from phantomnode.pipeline.step import run_step
from phantomnode.pipeline.surfaces import nodes_on_edges, surface
from phantomnode.pipeline.xfem import MassMatrix, classic_xfem
from phantomnode.solver.mass_scaling import lumped_mass
from phantomnode.solver.model import Model
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
class Boundary:
    """One boundary condition, or a rigid obstacle: the rows of the prescribed motion that it fills, -1 where free."""

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
    rigids : tuple of Rigid
        Rigid obstacles; their nodes follow those of the bodies.
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
    rigids: tuple[Rigid, ...] = ()


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
    rigids = rigid_obstacles(case, cut, bodies[-1].nodes.stop)
    passes = contact_passes(case, cut, first_node, rigids)
    channel, motion, boundaries = _boundaries(case, cut, bodies, rigids)
    model = _model(case, bodies, rigids, passes, channel, len(motion.channels))
    contact, thin = own_reach(case, model)
    model = model._replace(contact=contact)
    model = model._replace(contact=contact._replace(offset=offsets(case, cut, passes, model)))
    jump = largest_jump(case, motion)
    model = scaled(case, model, jump)
    estimate, xfem = stable_step(model, case.time.safety, jump), None
    if case.method == "xfem":
        model, estimate, xfem = classic_xfem(case, bodies, model)
    dt = run_step(case, estimate)
    velocity = np.zeros_like(model.x)
    for body in bodies:
        velocity[body.nodes] = case.body[body.name].initial_velocity
    notes = (note for body in cut.values() for note in body.notes)
    warnings = (*notes, *thin, *heavy_bodies(bodies, model))
    pairs = reported_pairs(case, cut, passes)
    return Prepared(
        case, bodies, pairs, boundaries, model, velocity, motion, estimate, dt, warnings, xfem, rigids
    )


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
    bodies: tuple[Body, ...],
    rigids: tuple[Rigid, ...],
    passes: list[ContactPass],
    channel: Ints,
    channels: int,
) -> Model:
    """The arrays of all bodies behind each other, with a quarter of each element's mass on its nodes."""
    lists = element_lists(case, bodies)
    obstacles = [rigid.xy for rigid in rigids]
    x = np.vstack([lists.x, *obstacles])
    load = np.vstack([lists.load, *(np.zeros_like(xy) for xy in obstacles)])
    return Model(
        x=x,
        mass=lumped_mass(len(x), lists.elements, lists.cut_elements),
        load=load,
        channel=channel,
        channels=channels,
        elements=lists.elements,
        cut_elements=lists.cut_elements,
        contact=joined_contact(passes),
        full=lists.full,
        damping=lists.damping,
    )


def _boundaries(
    case: Case, cut: dict[str, CutBody], bodies: tuple[Body, ...], rigids: tuple[Rigid, ...]
) -> tuple[Ints, PrescribedMotion, tuple[Boundary, ...]]:
    """Which motion holds each degree of freedom of the model, real and phantom nodes alike."""
    offset = {body.name: body.nodes.start for body in bodies}
    count = rigids[-1].nodes.stop if rigids else bodies[-1].nodes.stop
    channel = np.full((count, 2), -1, dtype=np.int64)
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
    for rigid in rigids:
        nodes, row = np.arange(rigid.nodes.start, rigid.nodes.stop), len(channels)
        channel[nodes] = (row, row + 1)
        channels += _rigid_channels(case, rigid.name)
        boundaries.append(Boundary(rigid.name, (row, row + 1), nodes))
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
    kinds: tuple[Kind, ...] = ("displacement", "velocity", "acceleration")
    for kind in kinds:
        directions = getattr(table, kind)
        if directions is not None:
            velocity = case.body[body].initial_velocity
            made += _directions(case, f"boundary.{name}.{kind}", kind, directions, velocity)
    return made


def _rigid_channels(case: Case, name: str) -> list[Channel]:
    """The motions of a rigid obstacle in x and y; at rest where none is given."""
    table, rest = case.rigid[name], Channel("displacement", np.zeros_like)
    given: list[Channel | None] = [None, None]
    if table.displacement is not None:
        given = _directions(case, f"rigid.{name}.displacement", "displacement", table.displacement)
    elif table.velocity is not None:
        given = _directions(case, f"rigid.{name}.velocity", "velocity", table.velocity)
    return [rest if made is None else made for made in given]


def _directions(
    case: Case, key: str, kind: Kind, directions: Directions, velocity: tuple[float, float] = (0.0, 0.0)
) -> list[Channel | None]:
    """The motion in x and in y, None where it is not given."""
    made: list[Channel | None] = []
    for axis, value in enumerate((directions.x, directions.y)):
        here = f"{key}.{'xy'[axis]}"
        if value is None:
            made.append(None)
            continue
        function = time_function(value)
        with at(case, here):
            start = float(function(np.zeros(1))[0])
            function(np.linspace(0.0, case.time.end, 1001))  # finite over the whole run
        if kind == "displacement" and start != 0.0:
            raise CaseError(
                f"{here}: the displacement is {start:g} m at t = 0, a jump; let it start from 0, "
                f'for instance "{start:g}*min(t/{0.1 * case.time.end:g}, 1)"'
            )
        made.append(Channel(kind, function, velocity[axis]))
    return made
