"""A case becomes a model: geometry, grids, relocation, cutting, doubling, then arrays for the kernels."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve, Geometry, Region
from phantomnode.geometry.doubling import CutMesh
from phantomnode.geometry.errors import OutlineError
from phantomnode.geometry.findings import Finding
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.pipeline.bodies import CutBody, cut_body
from phantomnode.pipeline.boundaries import Boundary, Conditions, conditions
from phantomnode.pipeline.contacts import Pair, contact_passes, offsets, own_reach, reported_pairs
from phantomnode.pipeline.drawings import Drawings
from phantomnode.pipeline.elements import ElementLists, element_lists
from phantomnode.pipeline.errors import OverlapError
from phantomnode.pipeline.meeting import too_fast, unpaired
from phantomnode.pipeline.motion import PrescribedMotion
from phantomnode.pipeline.pairing import ContactPass, joined_contact
from phantomnode.pipeline.rigid import Rigid, rigid_obstacles
from phantomnode.pipeline.scaling import heavy_bodies, largest_jump, scaled
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.step import run_step
from phantomnode.pipeline.xfem import MassMatrix, classic_xfem
from phantomnode.solver.current_step import StepMonitor
from phantomnode.solver.mass_scaling import lumped_mass
from phantomnode.solver.model import Model
from phantomnode.solver.timestep import StepEstimate, stable_step

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LOG = logging.getLogger(__name__)


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
class Prepared:
    """A case that is ready to run.

    Attributes
    ----------
    case : Case
    bodies : tuple of Body
    pairs : tuple of Pair
    boundaries : tuple of Boundary
    model : Model
    motion : PrescribedMotion
    estimate : StepEstimate
        The stable time step and what limits it.
    dt : float, s
        The step that the run takes.
    warnings : tuple of str
        Resolution limits and the like, which want a look before the result is trusted.
    notes : tuple of str
        What was mended in the drawings, and what of them does not count.
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
    motion: PrescribedMotion
    estimate: StepEstimate
    dt: float
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    xfem: MassMatrix | None = None
    rigids: tuple[Rigid, ...] = ()

    @property
    def velocity(self) -> Floats:
        """(n, 2) Initial velocity of every node, m/s: an array of its own, by columns as the state has it."""
        velocity = np.zeros(self.model.x.shape, order="F")
        for body in self.bodies:
            velocity[body.nodes] = self.case.body[body.name].initial_velocity
        return velocity

    @cached_property
    def monitor(self) -> StepMonitor:
        """The stable step at any displacement."""
        return StepMonitor(self.model, largest_jump(self.case, self.motion))

    @cached_property
    def _start(self) -> float:
        """The monitor's step of the undeformed state."""
        return self.monitor.at(np.zeros_like(self.model.x))

    def stable_step(self, u: Floats) -> float:
        """The stable step at (n, 2) displacements, s, without the part that is kept for safety.

        Undeformed it is that of the estimate, also for classic X-FEM with its other mass matrix.
        """
        return self.estimate.dt / self.case.time.safety * (self.monitor.at(u) / self._start)


def prepare(case: Case) -> Prepared:
    """Everything that a run needs, from a validated case.

    Raises
    ------
    CaseError
        Naming the key at fault: a file that cannot be read, a body outside its grid, an unknown part, surfaces
        that overlap at the start, a step that is not stable.
    """
    with Drawings(case) as drawings:
        drawings.read_ahead()
        cut = {name: _cut(case, name, drawings) for name in case.body}
        bodies = _bodies(case, cut)
        rigids = rigid_obstacles(case, cut, bodies[-1].nodes.stop, drawings)
    first_node = {body.name: body.nodes.start for body in bodies}
    passes = contact_passes(case, cut, first_node, rigids)
    lists = element_lists(case, bodies)
    held = conditions(case, cut, {body.name: body.nodes for body in bodies}, lists.mass, rigids)
    model = _model(lists, rigids, passes, held)
    contact, thin = own_reach(case, model)
    model = model._replace(contact=contact)
    with _shown_where_overlapping(cut, rigids):
        model = model._replace(contact=contact._replace(offset=offsets(case, cut, passes, model)))
    jump = largest_jump(case, held.motion)
    model = scaled(case, model, jump)
    estimate, xfem = stable_step(model, case.time.safety, jump), None
    if case.method == "xfem":
        model, estimate, xfem = classic_xfem(case, bodies, model)
    dt = run_step(case, estimate)
    notes = tuple(note for body in cut.values() for note in body.notes)
    coarse = (warning for body in cut.values() for warning in body.warnings)
    warnings = (*coarse, *thin, *unpaired(case, cut), *too_fast(case), *heavy_bodies(bodies, model))
    pairs = reported_pairs(case, cut, passes)
    boundaries, motion = tuple(held.boundaries), held.motion
    return Prepared(
        case, bodies, pairs, boundaries, model, motion, estimate, dt, warnings, notes, xfem, rigids
    )


@contextmanager
def _shown_where_overlapping(cut: dict[str, CutBody], rigids: tuple[Rigid, ...]) -> Iterator[None]:
    """Give an overlap the bodies and obstacles as its cause, to be drawn."""
    try:
        yield
    except OverlapError as error:
        regions = tuple(region for body in cut.values() for region in body.regions)
        curves = tuple(curve for rigid in rigids for curve in rigid.curves)
        shown = Geometry(regions, curves, findings=(Finding("overlap", error.at),))
        raise error from OutlineError(str(error), shown)


def _cut(case: Case, name: str, drawings: Drawings) -> CutBody:
    """A body, cut, and how long it took."""
    began = time.perf_counter()
    body = cut_body(case, name, drawings)
    counts = len(body.mesh.elements), int(body.mesh.cut.sum())
    LOG.info("body %s: %d elements, %d of them cut, in %.2f s", name, *counts, time.perf_counter() - began)
    return body


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
    lists: ElementLists, rigids: tuple[Rigid, ...], passes: list[ContactPass], held: Conditions
) -> Model:
    """The arrays of all bodies behind each other, with a quarter of each element's mass on its nodes."""
    x, load = lists.x, lists.load
    if rigids:
        x = np.vstack([x, *(rigid.xy for rigid in rigids)])
        if len(load):
            load = np.asfortranarray(np.vstack([load, np.zeros((len(x) - len(load), 2))]))
    return Model(
        x=x,
        mass=lumped_mass(len(x), lists.elements, lists.cut_elements),
        load=load,
        channel=held.channel,
        channels=len(held.channels),
        elements=lists.elements,
        cut_elements=lists.cut_elements,
        contact=joined_contact(passes),
        full=lists.full,
        damping=lists.damping,
        loads=held.loads,
        supports=held.supports,
    )
