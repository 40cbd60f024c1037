"""Pictures of what the grid became: level sets and relocated nodes, fragments with real and phantom nodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.levelset import LevelSet
from phantomnode.pipeline.bodies import background_grid
from phantomnode.pipeline.drawing import BODY_COLOURS, CUT, PHANTOM, box_of, fill, lines, map_figure, marks
from phantomnode.pipeline.drawings import Drawings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phantomnode.pipeline.prepare import Body, Prepared

Floats = NDArray[np.float64]

BANDS = 3.0
"""The level set is coloured within so many cells of its zero line; further away its sign is all that counts."""
REAL, MOVED = "#1b7837", "#c0392b"


def draw_level_sets(prepared: Prepared, title: str = "", box: Floats | None = None) -> Figure:
    """Each body's background grid with its level set, signed distance, and relocated nodes (Fig. 10a, 11).

    Parameters
    ----------
    prepared : Prepared
    title : str
    box : (2, 2) float64, m, optional
        What is shown; all grids unless given.
    """
    box = _margin(box_of(np.concatenate([body.grid.xy for body in prepared.bodies]))) if box is None else box
    shown = [body for body in prepared.bodies if _meet(box, body.grid.box)] or list(prepared.bodies)
    panels = [(body, name, levels) for body in shown for name, levels in _level_sets_of(body)]
    figure, row = map_figure(box, 6.5 * len(panels), len(panels), used=0.72)
    heading = f"{title}\n" if len(panels) == 1 and title else ""
    for axes, (body, name, levels) in zip(row, panels, strict=True):
        painted = _level_set(axes, body, levels)
        _curves(axes, body)
        _relocated(axes, prepared, body)
        axes.set(xlim=box[:, 0], ylim=box[:, 1])
        relocated = f"{body.relocated} of {body.grid.node_count} nodes relocated"
        axes.set_title(f"{heading}{name}: {relocated}", fontsize=9)
    handles, labels = row[0].get_legend_handles_labels()
    style: dict[str, Any] = {"fontsize": 8, "frameon": False, "markerscale": 2.0}
    figure.legend(handles, labels, loc="outside lower center", **style)
    figure.colorbar(painted, ax=row, label="signed distance over cell size", shrink=0.8)
    if not heading:
        figure.suptitle(title, fontsize=10)
    return figure


def draw_nodes(prepared: Prepared, title: str = "", box: Floats | None = None) -> Figure:
    """Uncut elements, the fragments of cut ones, and their real and phantom nodes (Fig. 5, 6 and 10b).

    A grid node may stand for several nodes, one for each connected piece of material about it: the ring around a
    dot is a phantom node of one side over a real one of the other.

    Parameters
    ----------
    prepared : Prepared
    title : str
    box : (2, 2) float64, m, optional
        What is shown; all bodies unless given.
    """
    used = np.concatenate([body.mesh.xy for body in prepared.bodies])
    box = _margin(box_of(used)) if box is None else box
    figure, (axes,) = map_figure(box)
    size = _dot(box, min(body.grid.cell_size for body in prepared.bodies))
    for number, body in enumerate(prepared.bodies):
        lines(axes, body.grid.xy[body.grid.edges], color="0.8", linewidths=0.4, zorder=0.5)
        _fragments(axes, body, BODY_COLOURS[number % len(BODY_COLOURS)])
        _curves(axes, body)
    real = np.concatenate([body.mesh.xy[body.mesh.real] for body in prepared.bodies])
    phantom = np.concatenate([body.mesh.xy[~body.mesh.real] for body in prepared.bodies])
    marks(axes, real, "o", REAL, size, f"real nodes ({len(real)})")
    axes.plot(
        *phantom.T, "o", mfc="none", mec=PHANTOM, ms=1.7 * size, mew=0.3 * size, zorder=5, ls="",
        label=f"phantom nodes ({len(phantom)})",
    )  # fmt: skip
    axes.set(xlim=box[:, 0], ylim=box[:, 1])
    legible = max(5.0 / size, 1.0)  # the dots themselves are small where cells are
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False, markerscale=legible)
    axes.set_title(title, fontsize=10)
    return figure


def _level_sets_of(body: Body) -> Iterator[tuple[str, LevelSet]]:
    """The level sets that cut a body's grid, by what they are: its outline, and each curve inside it."""
    yield f"outline of {body.name}, + in the material", LevelSet.of_regions(body.regions)
    for name, curve in body.interfaces:
        yield f"interface {name}, + on its left", LevelSet.of_curve(curve)


def _level_set(axes: Axes, body: Body, level_set: LevelSet) -> Any:
    """The signed distance at the grid's nodes, in cells, between them as the contours have it; the grid."""
    grid = body.grid
    distance = level_set.distance(grid.xy) / grid.cell_size
    split = np.concatenate([grid.quads[:, [0, 1, 2]], grid.quads[:, [0, 2, 3]]])
    levels = np.linspace(-BANDS, BANDS, 13)
    style = {"cmap": "RdBu_r", "alpha": 0.6, "extend": "both"}
    painted = axes.tricontourf(*grid.xy.T, split, distance, levels=levels, **style)
    lines(axes, grid.xy[grid.edges], color="0.45", linewidths=0.3)
    return painted


def _relocated(axes: Axes, prepared: Prepared, body: Body) -> None:
    """The nodes that were moved onto curves, with the way that they went."""
    with Drawings(prepared.case) as drawings:
        before = background_grid(prepared.case, body.name, body.regions, drawings).xy
    way = np.hypot(*(body.grid.xy - before).T)
    moved = way > 1e-9 * body.grid.cell_size
    lines(axes, np.stack([before[moved], body.grid.xy[moved]], axis=1), color=MOVED, linewidths=1.0, zorder=3)
    marks(axes, body.grid.xy[moved], "o", MOVED, 2.5, "relocated nodes")


def _fragments(axes: Axes, body: Body, colour: str) -> None:
    """The material of one body: uncut elements in its colour, fragments apart by their connected part."""
    mesh = body.mesh
    fill(axes, mesh.xy[mesh.elements[~mesh.cut]], facecolor=colour, edgecolor="white", alpha=0.6)
    part = mesh.component[mesh.triangle_element]
    tints = np.array([CUT, *(c for c in BODY_COLOURS if c != colour)])
    tint = tints[part % len(tints)]
    fill(axes, mesh.triangles, facecolor=tint, edgecolor=tint)


def _curves(axes: Axes, body: Body) -> None:
    """The CAD curves of a body: outlines and interfaces."""
    for curve in (loop for region in body.regions for loop in region.loops):
        axes.plot(*drawable(curve).T, color="black", lw=0.9)
    for _, curve in body.interfaces:
        axes.plot(*drawable(curve).T, color="black", lw=0.9, ls="--")


def drawable(curve: Curve) -> Floats:
    """(k, 2) Vertices of a curve, arcs flattened to 1e-4 of its box: less than a pixel."""
    return curve.polyline(1e-4 * float(np.max(curve.box[1] - curve.box[0])))


def _meet(first: Floats, second: Floats) -> bool:
    """Whether two (2, 2) boxes have a place in common."""
    return bool(np.all((first[0] <= second[1]) & (second[0] <= first[1])))


def _margin(box: Floats) -> Floats:
    space = 0.03 * float(np.max(box[1] - box[0]))
    return np.asarray(box + np.array([[-space], [space]]))


def _dot(box: Floats, cell: float) -> float:
    """Size of a dot that leaves the cells visible, points: a sixth of a cell on a picture of 8 inches."""
    return float(np.clip(72.0 * 8.0 * cell / (6.0 * float(box[1, 0] - box[0, 0])), 0.8, 7.0))
