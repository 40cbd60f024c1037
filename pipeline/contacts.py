"""Contact pairs of a case: their passes, penalties, reach, and how deep they overlap at the start."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.levelset import LevelSet
from phantomnode.pipeline.bodies import CutBody
from phantomnode.pipeline.contact_tables import Contact as ContactTable
from phantomnode.pipeline.contact_tables import Penalty
from phantomnode.pipeline.corner_points import with_corners
from phantomnode.pipeline.errors import OverlapError
from phantomnode.pipeline.pairing import NOBODY, ContactPass, SlaveSide, master_side, slave_side
from phantomnode.pipeline.rigid import Rigid
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.smoothing import hat_filter
from phantomnode.pipeline.surfaces import Surface, closed_surface, surface
from phantomnode.solver.contact import depth_at, nearest_segment
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import initial_state
from phantomnode.solver.model import Contact, Model
from phantomnode.solver.search import nearest_wall, segment_ends

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

OVERLAP = 1e-6
"""Depth, in cell sizes, up to which surfaces touch at the start and do not overlap (the lattice: 2e-7)."""

AUTO_PENALTY = 5.0
"""The automatic penalty in E/h: 1 to 10 is the range where it is stiff and the pressure still smooth."""

OWN_CELLS = 3.0
"""In self contact a point does not see its own curve within so many cells on either side, and less of it up to
twice as far: the bends that a grid can follow take no less."""

THIN = 0.1
"""A reach below this part of a cell, because a wall is so thin, is worth a warning."""


@dataclass(frozen=True)
class Pair:
    """One contact pair: where its slave segments are, for the output.

    Attributes
    ----------
    name, slave, master : str
        Names as in the case file.
    segment_nodes : (s, 4) int64
        Model nodes of the parent element of each slave segment; in two passes those of both surfaces.
    start_shape, end_shape : (s, 4) float64
        Shape functions at the ends of each segment.
    points : slice
        Its slave points in the model; ``points_per_segment`` to each segment, in the order of the segments.
    points_per_segment : int
    passes : tuple of int
        The numbers of its passes in ``model.contact``; those of corners are not among them.
    corners : tuple of int
        The numbers of the passes of its sharp corners.
    share : int
        Number of times that a closed place of the surfaces bears: 2 where both surfaces have slave points,
        each at half the penalty. The pressure is so many times that of the points of one surface.
    friction : float
        Coulomb's coefficient.
    smoother : tuple of (rows, columns, weights), each (w,)
        The hat filter of the pressure along the slave surface: the force per reference length of segment
        ``rows`` takes ``weights`` times that of segment ``columns``.
    """

    name: str
    slave: str
    master: str
    segment_nodes: Ints
    start_shape: Floats
    end_shape: Floats
    points: slice
    points_per_segment: int
    passes: tuple[int, ...] = (0,)
    corners: tuple[int, ...] = ()
    share: int = 1
    friction: float = 0.0
    smoother: tuple[Ints, Ints, Floats] | None = None


def contact_passes(
    case: Case, cut: dict[str, CutBody], first_node: dict[str, int], rigids: tuple[Rigid, ...]
) -> list[ContactPass]:
    """The passes of all pairs, one behind the other.

    Raises
    ------
    CaseError
        Where a part does not exist.
    """
    obstacles = {rigid.name: rigid for rigid in rigids}
    passes: list[ContactPass] = []
    for number, (name, table) in enumerate(case.contact.items()):
        slave = surface(table.slave, cut, f"contact.{name}.slave")
        ends: Sequence[tuple[Surface, Surface | Rigid]]
        if table.master in obstacles:
            ends = [(slave, obstacles[table.master])]
        else:
            master = surface(table.master, cut, f"contact.{name}.master")
            ends = [(slave, master), (master, slave)][: table.passes]
        mine = [_one_pass(case, table, cut, first_node, number, *pair) for pair in ends]
        mine[1:] = [replace(each, sign=-1.0) for each in mine[1:]]
        if table.corners and _owner(table.slave, case) != _owner(table.master, case):
            penalties = table_share(table) * mine[0].penalty, table_share(table) * mine[0].tangential_penalty
            mine = with_corners(mine, *ends[0], cut, first_node, table.points, penalties)
        passes += mine
    return passes


def _one_pass(
    case: Case,
    table: ContactTable,
    cut: dict[str, CutBody],
    first_node: dict[str, int],
    number: int,
    slave: Surface,
    master: Surface | Rigid,
) -> ContactPass:
    """Points of one surface against another; each of two passes, and self contact, at half the penalty."""
    body, own = cut[slave.body], table.slave == table.master
    if isinstance(master, Rigid):
        segments, across, cells = master.master_side(), NOBODY, [body.grid.cell_size]
    else:
        other = cut[master.body]
        without = slave.segments if slave.body == master.body and not own else np.zeros(0, dtype=np.int64)
        closed = closed_surface(other.mesh.segments, master.segments, without)
        segments = master_side(closed, other, first_node[master.body], table.points)
        across = closed if len(without) else NOBODY
        cells = [body.grid.cell_size, other.grid.cell_size]
    penalty = _penalty(case, table, cut) / table_share(table)
    points = slave_side(slave, body, first_node[slave.body], table.points, across)
    return ContactPass(
        pair=number,
        slave=points,
        master=segments,
        penalty=penalty,
        tangential_penalty=_tangential_penalty(case, table, penalty),
        friction=table.friction,
        reach=max(cells),
        exclusion=_exclusion(body, segments.place[:, 3]) if own else 0.0,
    )


def table_share(table: ContactTable) -> int:
    """2 where both surfaces of a pair have slave points, each at half the penalty."""
    return 2 if table.passes == 2 or table.slave == table.master else 1


def _penalty(case: Case, table: ContactTable, cut: dict[str, CutBody]) -> float:
    """The penalty of a pair, Pa/m."""
    penalty, owners = table.penalty, [_owner(place, case) for place in (table.slave, table.master)]
    moduli = [case.material[case.body[owner].material].E for owner in owners if owner]
    auto = AUTO_PENALTY * min(moduli) / cut[owners[0]].grid.typical_size
    return auto if isinstance(penalty, str) else penalty.stiffness(auto, moduli[0])


def _owner(place: str, case: Case) -> str:
    """The body of a surface by its name; empty for a rigid obstacle."""
    owner = place.partition(".")[0]
    if owner in case.body:
        return owner
    return case.interface[owner].body if owner in case.interface else ""


def _tangential_penalty(case: Case, table: ContactTable, penalty: float) -> float:
    """The penalty of the stick, Pa/m: the normal one unless the case says otherwise."""
    given = table.tangential_penalty
    if not isinstance(given, Penalty):
        return penalty
    E = case.material[case.body[_owner(table.slave, case)].material].E
    share = table_share(table)
    return given.stiffness(share * penalty, E) / share


def _exclusion(body: CutBody, lengths: Floats) -> float:
    """How far along its own curve a point sees nothing, m; at most an eighth of the shortest curve."""
    return float(min(OWN_CELLS * body.grid.cell_size, 0.125 * lengths.min(initial=np.inf)))


def reported_pairs(case: Case, cut: dict[str, CutBody], passes: list[ContactPass]) -> tuple[Pair, ...]:
    """The contact pairs with the places of their slave points in the model."""
    pairs, first = [], 0
    for number, (name, table) in enumerate(case.contact.items()):
        every = [k for k, each in enumerate(passes) if each.pair == number]
        mine = [k for k in every if passes[k].crowd == 0.0]
        sides = [passes[k].slave for k in mine]
        points = slice(first, first + sum(len(side.weight) for side in sides))
        first += sum(len(passes[k].slave.weight) for k in every)
        width = cut[_owner(table.slave, case)].grid.cell_size
        pairs.append(
            Pair(
                name=name,
                slave=table.slave,
                master=table.master,
                segment_nodes=np.concatenate([side.nodes for side in sides]),
                start_shape=np.concatenate([side.start for side in sides]),
                end_shape=np.concatenate([side.end for side in sides]),
                points=points,
                points_per_segment=table.points.count,
                passes=tuple(mine),
                corners=tuple(every[len(mine) :]),
                share=table_share(table),
                friction=table.friction,
                smoother=hat_filter([_segments_along(side, table.points.count) for side in sides], width),
            )
        )
    return tuple(pairs)


def _segments_along(side: SlaveSide, count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Curve, middle along it, length, and length of the curve of the slave segments, (s,) each."""
    length = side.weight.reshape(-1, count).sum(axis=1)
    return side.place[::count, 0], side.half_way, length, side.whole


def own_reach(case: Case, model: Model) -> tuple[Contact, tuple[str, ...]]:
    """The contact with a reach, in self contact, of half the thinnest wall; warnings where that is very little.

    The far face of a wall faces away from a point on the near one: were it within reach, the point would seem to
    be as deep in the material as the wall is thick. Half the wall leaves room for its compression.
    """
    contact, notes, reach = model.contact, [], model.contact.reach.copy()
    for k, (name, table) in _passes_with_tables(case, contact):
        if len(contact.exclusion) == 0 or not contact.exclusion[k] > 0.0:
            continue
        wall = nearest_wall(contact._replace(reach=2.0 * contact.reach), k, model.x)
        reach[k] = min(contact.reach[k], 0.5 * wall)
        if reach[k] < THIN * contact.reach[k]:
            notes.append(
                f"contact {name}: a wall of {table.slave} is {wall:.3g} m thick, so that contact is found up to "
                f"{reach[k]:.3g} m deep only: use a stiffer penalty or name the two parts that touch"
            )
    return contact._replace(reach=reach), tuple(notes)


def _passes_with_tables(case: Case, contact: Contact) -> Iterator[tuple[int, tuple[str, ContactTable]]]:
    """The table of each pass."""
    tables = list(case.contact.items())
    for k in range(len(contact.penalty)):
        yield k, tables[contact.pair[k] if len(contact.pair) else k]


def offsets(case: Case, cut: dict[str, CutBody], passes: list[ContactPass], model: Model) -> Floats:
    """(g,) The depth of each slave point at the start, where the case says that it counts as touching.

    Surfaces that overlap otherwise are refused: each millimetre would add energy eps g^2/2 from nothing.
    """
    contact = model.contact
    if len(contact.slave_weight) == 0:
        return np.zeros(0)
    gaps = initial_state(model, np.zeros_like(model.x), prepare_layout(model)).gap
    found = np.zeros(len(gaps))
    for k, (name, table) in _passes_with_tables(case, contact):
        points = slice(*contact.slave_first[k : k + 2])
        each = passes[k]
        depth, middle = np.maximum(gaps[points], 0.0), each.slave.middle
        found[points] = each.allowed
        inside = _inside(case, cut, table, each, model, k)
        worst = int(np.argmax(np.maximum(depth, inside)))
        deepest = float(max(depth[worst], inside[worst]))
        at = float(middle[worst, 0]), float(middle[worst, 1])
        here = "({:.6g}, {:.6g}) m".format(*at)
        if deepest <= max(each.allowed, OVERLAP * cut[_owner(table.slave, case)].grid.cell_size):
            continue
        if table.overlap == "refuse":
            raise OverlapError(
                f"contact.{name}: {table.slave} and {table.master} overlap at the start by {deepest:.3g} m near "
                f"{here}: {_remedy(case, table)}, or measure gaps from this state "
                '(overlap = "offset")',
                at,
            )
        if deepest > contact.reach[k] / 2.0:
            raise OverlapError(
                f"contact.{name}: {table.slave} lies {deepest:.3g} m deep in {table.master} near {here}, more than "
                f"half a cell, which no offset can stand for: {_remedy(case, table)}",
                at,
            )
        found[points] += depth
    return found


def _remedy(case: Case, table: ContactTable) -> str:
    """What to do about an overlap."""
    if table.master in case.rigid:
        return (
            f"move one of the two (geometry move = [dx, dy]); an obstacle is on the left of its curve and inside "
            f'a closed one: the other side is rigid.{table.master}.side = "right"'
        )
    return "move one of the bodies (geometry move = [dx, dy])"


def _inside(
    case: Case, cut: dict[str, CutBody], table: ContactTable, each: ContactPass, model: Model, k: int
) -> Floats:
    """(g,) Depth of the middles of the slave segments beyond the reach of the search, too, m, by the drawing."""
    middle = each.slave.middle
    if table.master in case.rigid and each.sign > 0.0:
        return _behind(model.contact, k, middle, model.x)
    bodies = [_owner(place, case) for place in (table.slave, table.master)]
    if bodies[0] == bodies[1]:
        return np.zeros(len(middle))
    master = bodies[0 if each.sign < 0.0 else 1]
    return np.asarray(LevelSet.of_regions(cut[master].regions).distance(middle))


def _behind(contact: Contact, k: int, places: Floats, x: Floats) -> Floats:
    """(g,) Depth of places in the obstacle of pass k, m, at any distance but beyond its free ends."""
    first, last = contact.master_first[k : k + 2]
    segments, still = np.arange(last), np.zeros_like(x)
    ends = segment_ends(contact, 0, last, x, still)
    depths = np.zeros(len(places))
    for i, (px, py) in enumerate(places):
        _, s, t = nearest_segment(ends, segments, first, last, px, py)
        depth, _, _, t = depth_at(contact, s, t, px, py, x, still)
        depths[i] = depth if 0.0 <= t <= 1.0 else 0.0
    return depths
