"""Boundary conditions of a case: motions held at nodes or by springs, tractions, pressures, gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.bodies import CutBody, at
from phantomnode.pipeline.boundary_tables import Boundary as BoundaryTable
from phantomnode.pipeline.boundary_tables import Directions, TimeValue
from phantomnode.pipeline.contact_tables import Penalty
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.expressions import TimeFunction, time_function
from phantomnode.pipeline.motion import Channel, Kind, PrescribedMotion
from phantomnode.pipeline.quadrature import SurfacePoints, surface_points
from phantomnode.pipeline.rigid import Rigid
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.surfaces import Surface, inside_cells, nodes_on_edges, surface
from phantomnode.solver.model import Loads, Supports, no_loads, no_supports

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOTIONS: tuple[Kind, ...] = ("displacement", "velocity", "acceleration")

SUPPORT_PENALTY = 20.0
"""The automatic penalty of weak supports in E/h: the surface gives by h/20 of the strain beside it, and the stable
step halves. Measured on a ring held at its rim, 37 cells across: displacements err by 4.3 % at 5 E/h (step 0.77),
1.0 % at 20 (0.51), 0.3 % at 50 (0.35); the stress does not change, and at 1000 E/h it is no rougher yet."""


@dataclass(frozen=True)
class Boundary:
    """One boundary condition, or a rigid obstacle.

    Attributes
    ----------
    name : str
    channels : (int, int)
        The prescribed motions of x and y, -1 where a direction is free.
    nodes : (k,) int64
        Nodes of the model that it holds or acts on.
    kind : str
        "held": the nodes follow the motion; "weak": springs hold the surface; "load": traction or pressure.
    rows : tuple of int
        Its load rows.
    penalty : float, Pa/m
        Of the springs; 0 where there are none.
    """

    name: str
    channels: tuple[int, int]
    nodes: Ints
    kind: Literal["held", "weak", "load"] = "held"
    rows: tuple[int, ...] = ()
    penalty: float = 0.0


@dataclass
class Conditions:
    """All boundary conditions and loads of a case, as they are gathered.

    Attributes
    ----------
    channel : (n, 2) int32
        Which prescribed motion holds each degree of freedom of the model, -1 where none does.
    channels, functions : list
        The prescribed motions, and the functions of time of the load rows.
    boundaries : list of Boundary
    load_parts, support_parts : list
        Loads and supports of each boundary.
    """

    channel: NDArray[np.int32]
    channels: list[Channel] = field(default_factory=list)
    functions: list[TimeFunction] = field(default_factory=list)
    boundaries: list[Boundary] = field(default_factory=list)
    load_parts: list[Loads] = field(default_factory=list)
    support_parts: list[Supports] = field(default_factory=list)
    weakly_held: list[tuple[str, str, int, Ints]] = field(default_factory=list)

    @property
    def motion(self) -> PrescribedMotion:
        """The prescribed motions and the functions of the loads."""
        return PrescribedMotion(tuple(self.channels), tuple(self.functions))

    @property
    def loads(self) -> Loads:
        """All load rows."""
        joined = _joined([no_loads(), *self.load_parts], Loads._fields[:-1])
        return no_loads()._replace(**joined, rows=len(self.functions))

    @property
    def supports(self) -> Supports:
        """All weak supports."""
        return no_supports()._replace(**_joined([no_supports(), *self.support_parts], Supports._fields))


def _joined(parts: Sequence[Loads | Supports], names: Sequence[str]) -> dict[str, Any]:
    """The named arrays of several parts behind each other."""
    return {name: np.ascontiguousarray(np.concatenate([getattr(p, name) for p in parts])) for name in names}


def conditions(
    case: Case,
    cut: dict[str, CutBody],
    nodes: Mapping[str, slice],
    mass: Floats,
    rigids: Sequence[Rigid] = (),
) -> Conditions:
    """Everything that holds or loads the bodies of a case.

    Parameters
    ----------
    case : Case
    cut : dict
        The cut bodies by name.
    nodes : mapping
        The nodes of each body in the model.
    mass : (n,) float64, kg/m
        Lumped masses of the nodes of bodies, on which gravity acts.
    rigids : sequence of Rigid
        Obstacles, whose nodes stand behind those of the bodies.

    Raises
    ------
    CaseError
        With the key of the boundary at fault.
    """
    count = rigids[-1].nodes.stop if rigids else len(mass)
    made = Conditions(np.full((count, 2), -1, dtype=np.int32))
    for name, table in case.boundary.items():
        if table.traction is not None or table.pressure is not None:
            _add_load(made, case, name, table, cut, nodes)
        else:
            _add_motion(made, case, name, table, cut, nodes)
    for rigid in rigids:
        _move_obstacle(made, case, rigid)
    for axis, value in enumerate(case.gravity):
        if not isinstance(value, float):
            for span in nodes.values():
                _add_gravity(made, time_function(value), axis, np.arange(span.start, span.stop), mass)
    return made


def constant_gravity(case: Case) -> Floats:
    """(2,) The part of gravity that does not change with time, m/s^2."""
    return np.array([value if isinstance(value, float) else 0.0 for value in case.gravity])


def _add_motion(
    made: Conditions,
    case: Case,
    name: str,
    table: BoundaryTable,
    cut: dict[str, CutBody],
    nodes: Mapping[str, slice],
) -> None:
    """A prescribed motion, of nodes where the part follows grid lines and by springs elsewhere."""
    key = f"boundary.{name}.on"
    if not isinstance(table.on, str):
        held = _nodes_in_box(table, cut, key) + nodes[table.on.body].start
        return _hold(made, case, name, table, table.on.body, held)
    part = surface(table.on, cut, key)
    through = inside_cells(cut[part.body], part.segments)
    weak = bool(through.any()) if table.weak is None else table.weak
    if weak:
        return _support(made, case, name, table, part, cut, nodes[part.body].start)
    if table.penalty is not None:
        raise CaseError(
            f'boundary.{name}.penalty: "{table.on}" follows grid lines, so its nodes are held and need no '
            "penalty; leave it out, or add weak = true for springs"
        )
    held = nodes_on_edges(cut[part.body], part.segments, key, table.on) + nodes[part.body].start
    return _hold(made, case, name, table, part.body, held)


def _hold(made: Conditions, case: Case, name: str, table: BoundaryTable, body: str, nodes: Ints) -> None:
    """Nodes, real and phantom alike, that follow the motion."""
    rows = [-1, -1]
    for axis, motion in enumerate(_motions(case, name, table, body)):
        if motion is None:
            continue
        taken = made.channel[nodes, axis]
        if np.any(taken >= 0):
            first = next(b.name for b in made.boundaries if taken.max() in b.channels)
            raise CaseError(
                f"boundary.{name}: {np.count_nonzero(taken >= 0)} nodes are already moved in "
                f"{'xy'[axis]} by boundary.{first}; leave one of the two out there"
            )
        rows[axis] = len(made.channels)
        made.channel[nodes, axis] = len(made.channels)
        made.channels.append(motion)
    made.boundaries.append(Boundary(name, (rows[0], rows[1]), nodes))


def _support(
    made: Conditions,
    case: Case,
    name: str,
    table: BoundaryTable,
    part: Surface,
    cut: dict[str, CutBody],
    first_node: int,
) -> None:
    """Springs between the surface and its prescribed position, each direction on its own."""
    points = surface_points(cut[part.body], part.segments)
    rows = [-1, -1]
    for axis, motion in enumerate(_motions(case, name, table, part.body)):
        if motion is None:
            continue
        for other, body, held_axis, segments in made.weakly_held:
            twice = np.intersect1d(segments, part.segments)
            if (body, held_axis) == (part.body, axis) and len(twice):
                raise CaseError(
                    f"boundary.{name}: {len(twice)} segments are already held in {'xy'[axis]} by "
                    f"boundary.{other}; leave one of the two out there"
                )
        made.weakly_held.append((name, part.body, axis, part.segments))
        rows[axis] = len(made.channels)
        made.channels.append(motion)
    young = case.material[case.body[part.body].material].E
    penalty = support_penalty(table.penalty, young, cut[part.body].grid.typical_size)
    nodes = points.nodes + first_node
    channel = np.tile(np.array(rows, dtype=np.int64), (len(nodes), 1))
    made.support_parts.append(Supports(nodes, points.shape, penalty * points.length, channel))
    boundary = Boundary(name, (rows[0], rows[1]), np.unique(nodes), "weak", penalty=penalty)
    made.boundaries.append(boundary)


def support_penalty(penalty: str | Penalty | None, young: float, cell: float) -> float:
    """The penalty of weak supports, Pa/m."""
    auto = SUPPORT_PENALTY * young / cell
    return auto if penalty is None or isinstance(penalty, str) else penalty.stiffness(auto, young)


def _add_load(
    made: Conditions,
    case: Case,
    name: str,
    table: BoundaryTable,
    cut: dict[str, CutBody],
    nodes: Mapping[str, slice],
) -> None:
    """A traction (dead) or a pressure (follower unless told otherwise) on a part of a surface."""
    assert isinstance(table.on, str)  # the schema refuses loads on boxes
    part = surface(table.on, cut, f"boundary.{name}.on")
    points = surface_points(cut[part.body], part.segments)
    points = points._replace(nodes=points.nodes + nodes[part.body].start)
    rows = []
    if table.pressure is not None:
        rows.append(len(made.functions))
        follower = table.follower is None or table.follower
        load = _follower(points, rows[0]) if follower else _dead(points, rows[0], -points.normal)
        made.load_parts.append(load)
        made.functions.append(_checked(case, f"boundary.{name}.pressure", table.pressure))
    else:
        for axis, value in enumerate(_both(table.traction)):
            if value is not None:
                rows.append(len(made.functions))
                made.load_parts.append(
                    _dead(points, rows[-1], np.tile(np.eye(2)[axis], (len(points.length), 1)))
                )
                made.functions.append(_checked(case, f"boundary.{name}.traction.{'xy'[axis]}", value))
    made.boundaries.append(Boundary(name, (-1, -1), np.unique(points.nodes), "load", tuple(rows)))


def _dead(points: SurfacePoints, row: int, direction: Floats) -> Loads:
    """Integrals of N_I times (q, 2) directions over the reference boundary, by degree of freedom (Eq. 14)."""
    size = int(points.nodes.max()) + 1
    total = np.zeros((size, 2))
    share = points.length[:, None] * points.shape
    np.add.at(total, points.nodes, share[:, :, None] * direction[:, None, :])
    node, axis = np.nonzero(total)
    rows = np.full(len(node), row, dtype=np.int64)
    return no_loads()._replace(node=node, axis=axis, row=rows, coefficient=total[node, axis])


def _follower(points: SurfacePoints, row: int) -> Loads:
    """A pressure along the current normal."""
    rows = np.full(len(points.length), row, dtype=np.int64)
    return no_loads()._replace(
        point_nodes=points.nodes, point_shape=points.shape, point_slope=points.slope, point_row=rows
    )


def _add_gravity(made: Conditions, function: TimeFunction, axis: int, nodes: Ints, mass: Floats) -> None:
    """Gravity that changes with time, on the nodes of one body."""
    rows = np.full(len(nodes), len(made.functions), dtype=np.int64)
    axes = np.full(len(nodes), axis, dtype=np.int64)
    made.load_parts.append(no_loads()._replace(node=nodes, axis=axes, row=rows, coefficient=mass[nodes]))
    made.functions.append(function)


def _nodes_in_box(table: BoundaryTable, cut: dict[str, CutBody], key: str) -> Ints:
    """Nodes, real and phantom alike, of a body inside a box."""
    assert not isinstance(table.on, str)
    xy = cut[table.on.body].mesh.xy
    low, high = np.array(table.on.box)
    margin = 1e-9 * cut[table.on.body].grid.cell_size  # a node drawn on the side of the box is in it
    nodes = np.flatnonzero(np.all((xy >= low - margin) & (xy <= high + margin), axis=1))
    if len(nodes) == 0:
        (x0, y0), (x1, y1) = xy.min(axis=0), xy.max(axis=0)
        span = f"[[{x0:.6g}, {y0:.6g}], [{x1:.6g}, {y1:.6g}]] m"
        raise CaseError(f"{key}: no node of {table.on.body} lies in the box; it spans {span}")
    return nodes


def _move_obstacle(made: Conditions, case: Case, rigid: Rigid) -> None:
    """All nodes of a rigid obstacle, at rest where no motion is given."""
    table, rest = case.rigid[rigid.name], Channel("displacement", np.zeros_like)
    given: list[Channel | None] = [None, None]
    if table.displacement is not None:
        given = _directions(case, f"rigid.{rigid.name}.displacement", "displacement", table.displacement)
    elif table.velocity is not None:
        given = _directions(case, f"rigid.{rigid.name}.velocity", "velocity", table.velocity)
    nodes, row = np.arange(rigid.nodes.start, rigid.nodes.stop), len(made.channels)
    made.channel[nodes] = (row, row + 1)
    made.channels += [rest if motion is None else motion for motion in given]
    made.boundaries.append(Boundary(rigid.name, (row, row + 1), nodes))


def _motions(case: Case, name: str, table: BoundaryTable, body: str) -> list[Channel | None]:
    """The motions of a boundary in x and y."""
    made: list[Channel | None] = []
    for kind in MOTIONS:
        directions = getattr(table, kind)
        if directions is not None:
            velocity = case.body[body].initial_velocity
            made += _directions(case, f"boundary.{name}.{kind}", kind, directions, velocity)
    return made


def _directions(
    case: Case, key: str, kind: Kind, directions: Directions, velocity: tuple[float, float] = (0.0, 0.0)
) -> list[Channel | None]:
    """The motion in x and in y, None where it is not given."""
    made: list[Channel | None] = []
    for axis, value in enumerate(_both(directions)):
        if value is None:
            made.append(None)
            continue
        here = f"{key}.{'xy'[axis]}"
        function = _checked(case, here, value)
        start = float(function(np.zeros(1))[0])
        if kind == "displacement" and start != 0.0:
            raise CaseError(
                f"{here}: the displacement is {start:g} m at t = 0, a jump; let it start from 0, "
                f'for instance "{start:g}*min(t/{0.1 * case.time.end:g}, 1)"'
            )
        made.append(Channel(kind, function, velocity[axis]))
    return made


def _both(directions: Directions | None) -> tuple[TimeValue | None, ...]:
    """The values of x and y, nothing where the table is not there."""
    return () if directions is None else (directions.x, directions.y)


def _checked(case: Case, key: str, value: TimeValue) -> TimeFunction:
    """A function of time that is finite over the whole run."""
    function = time_function(value)
    with at(case, key):
        function(np.linspace(0.0, case.time.end, 1001))
    return function
