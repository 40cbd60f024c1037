"""Names of surfaces ("ring.outer", "mid.plus") into boundary segments and nodes of the cut meshes."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from phantomnode.geometry.curves import SIDES, part, part_names
from phantomnode.geometry.doubling import BoundarySegments
from phantomnode.pipeline.bodies import CutBody
from phantomnode.pipeline.errors import CaseError

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SIDES_OF_INTERFACE: tuple[str, ...] = ("plus", "minus")

STRIP = 0.1
"""Of the size of a body: the depth of the box that is suggested where a side has no straight line."""

ON_EDGE = 1e-5
"""Local coordinates this near to +-1 are on the edge of a cell: the lattice rounds them to 1e-6."""


@dataclass(frozen=True)
class Surface:
    """Some boundary segments of one body.

    Attributes
    ----------
    body : str
    segments : (k,) int64
        Numbers in the body's ``mesh.segments``, ascending.
    """

    body: str
    segments: Ints


def surface(place: str, bodies: dict[str, CutBody], key: str) -> Surface:
    """The segments that a name means.

    Parameters
    ----------
    place : str
        "BODY.PART" or "INTERFACE.plus" / "INTERFACE.minus".
    bodies : dict
        The cut bodies of the case by name.
    key : str
        Key of the case file, for messages.

    Raises
    ------
    CaseError
        Where the part does not exist, with those that do, or where nothing of it is left after cutting.
    """
    owner, _, what = place.partition(".")
    body_name, known = owner, SIDES_OF_INTERFACE
    if owner in bodies:
        body = bodies[owner]
        known = part_names(body.regions)
        chosen = _outline(body, what)
    else:
        body_name = next(name for name, body in bodies.items() if owner in dict(body.interfaces))
        body = bodies[body_name]
        chosen = _interface(body, owner, what)
    if not what or what not in known:
        close = get_close_matches(what, known, 1)
        hint = f'; did you mean "{owner}.{close[0]}"?' if close else ""
        if what in SIDES:
            instead = _instead(owner, body, what) if key.startswith("boundary.") else ""
            hint = f" (no straight line of it lies on the {what} of its bounding box{instead})"
        raise CaseError(f'{key}: "{place}" is unknown; the parts of {owner} are: {", ".join(known)}{hint}')
    if len(chosen) == 0:
        raise CaseError(
            f'{key}: nothing is left of "{place}" after cutting: it lies outside the body or within one cell; '
            "move it or use smaller cells"
        )
    return Surface(body_name, chosen)


def _instead(name: str, body: CutBody, side: str) -> str:
    """What a boundary can be on where a body only touches a side of its bounding box: the nodes near it."""
    boxes = np.array([region.box for region in body.regions])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    axis, depth = int(side in ("bottom", "top")), STRIP * (high - low)
    if side in ("bottom", "left"):
        high[axis] = low[axis] + depth[axis]
    else:
        low[axis] = high[axis] - depth[axis]
    box = ", ".join(f"[{x:.4g}, {y:.4g}]" for x, y in (low - 0.01 * depth, high + 0.01 * depth))
    return f'; the nodes there are {{ body = "{name}", box = [{box}] }}'


def _outline(body: CutBody, what: str) -> Ints:
    """(k,) Segments on a named part of the outlines."""
    segments = body.mesh.segments
    masks = part(body.regions, what)
    first = np.cumsum([0, *(len(mask) for mask in masks)])
    on_outline = np.flatnonzero(segments.side == 0)
    flat = np.concatenate(masks)
    return on_outline[flat[first[segments.curve[on_outline]] + segments.piece[on_outline]]]


def _interface(body: CutBody, name: str, what: str) -> Ints:
    """(k,) Segments on one side of a named interface."""
    loops = sum(len(region.loops) for region in body.regions)
    numbers = [loops + k for k, (label, _) in enumerate(body.interfaces) if label == name]
    segments = body.mesh.segments
    side = {"plus": 1, "minus": -1}.get(what, 0)
    return np.flatnonzero((segments.side == side) & np.isin(segments.curve, numbers) & (side != 0))


def closed_surface(segments: BoundarySegments, chosen: Ints, without: Ints) -> Ints:
    """The whole boundary loops that hold the chosen segments, but for some others of the same loops.

    A point that slides past the end of a master surface must not fall off it: energy errors of several times
    the work are the price of open ends, so the outer edges beside the interface are master segments too.
    """
    count = len(segments.ends)
    linked = np.flatnonzero(segments.following >= 0)
    graph = coo_array((np.ones(len(linked)), (linked, segments.following[linked])), shape=(count, count))
    _, loop = connected_components(graph, directed=False)
    if np.isin(loop[chosen], loop[without]).any():
        return chosen  # both faces of a crack are one loop: its master is the named face alone
    return np.flatnonzero(np.isin(loop, loop[chosen]))


CORNERS_ON_EDGE = {(0, -1.0): (3, 0), (0, 1.0): (1, 2), (1, -1.0): (0, 1), (1, 1.0): (2, 3)}
"""Corners at the ends of the edge on which a local coordinate (0 xi, 1 eta) has the value -1 or 1."""


def _on_edges(body: CutBody, chosen: Ints) -> dict[tuple[int, float], Bools]:
    """Which of the chosen segments run along each of the four edges of their cells."""
    local = body.mesh.segments.local[chosen]
    return {
        (axis, value): np.all(np.abs(local[:, :, axis] - value) < ON_EDGE, axis=1)
        for axis, value in CORNERS_ON_EDGE
    }


def inside_cells(body: CutBody, chosen: Ints) -> Bools:
    """(k,) Which of the chosen segments run through the inside of a cell."""
    return np.asarray(~np.any(list(_on_edges(body, chosen).values()), axis=0))


def nodes_on_edges(body: CutBody, chosen: Ints, key: str, place: str) -> Ints:
    """Nodes, real and phantom, of the cell edges along which the chosen segments run.

    Raises
    ------
    CaseError
        Where a segment runs through the inside of a cell: no node stands there to be held.
    """
    mesh = body.mesh
    inside = inside_cells(body, chosen)
    if inside.any():
        x, y = mesh.segments.ends[chosen[inside][0]].mean(axis=0)
        raise CaseError(
            f'{key}: "{place}" runs through the inside of cells, as at ({x:.6g}, {y:.6g}) m, where no node '
            "stands to be held: leave out weak = false, so that springs hold it, or let the grid follow it "
            "(aligned = true, or a polar or mapped grid)"
        )
    found = [
        mesh.nodes(mesh.segments.element[chosen[on]])[:, CORNERS_ON_EDGE[edge]]
        for edge, on in _on_edges(body, chosen).items()
    ]
    return np.unique(np.concatenate([nodes.reshape(-1) for nodes in found]))
