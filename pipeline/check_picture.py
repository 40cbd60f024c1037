"""The picture of ``check``: what a case became, before its first step."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.grid import Numbers
from phantomnode.pipeline.drawing import (
    BODY_COLOURS,
    CUT,
    HELD,
    MASTER,
    PHANTOM,
    SLAVE,
    box_of,
    equal_axes,
    fill,
    lines,
    marks,
    new_figure,
    readable,
    save,
    solid,
)
from phantomnode.pipeline.field_pictures import MARGIN, SOLID, with_obstacles
from phantomnode.pipeline.gaps import ends_of, initial_gaps, master_ends
from phantomnode.pipeline.mesh_pictures import drawable
from phantomnode.pipeline.outlines import solid_sides
from phantomnode.pipeline.preflight import element_place, step_place
from phantomnode.pipeline.prepare import Body, Floats, Prepared

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FINE = 40_000
"""Cells up to this number are drawn one by one; more of them are less than a few pixels each."""

SAME = 1e-6
"""Of a cell: the middles of two elements that are nearer to each other are one."""

VISIBLE = 0.03
"""Of the size of what is shown: a wider gap has an arrow, a narrower one a mark."""

CLOSE = 3.5
"""Half the width of a close-up, in cells."""

LOAD, SPOT = "#c0392b", "#d6336c"
HOLDS = {(True, True): "x and y", (True, False): "x", (False, True): "y"}


class Spot(NamedTuple):
    """A place to look at closely: what is there, where, m, and the size of a cell there, m."""

    title: str
    place: Floats
    cell: float


def draw_preview(prepared: Prepared, path: Path) -> None:
    """Write a picture of what a case became, also of millions of cells.

    Left, all of it: outlines over grids, cut cells, names, what is held and loaded, contact pairs with their gaps.
    Right, close up: the smallest fragment, and the element that sets the step, with their real and phantom nodes.

    Parameters
    ----------
    prepared : Prepared
    path : Path
        The .png file.
    """
    spots = list(_spots(prepared))
    box = _shown_box(prepared)
    wide, tall = np.maximum(box[1] - box[0], 1e-300)
    height = float(np.clip(8.0 * tall / wide, 5.0, 10.0))
    figure = new_figure(12.5, height + 1.6)
    grid = figure.add_gridspec(max(len(spots), 1), 2, width_ratios=(2.6, 1.0))
    axes = figure.add_subplot(grid[:, 0])
    equal_axes(axes, box)
    _draw_bodies(axes, prepared)
    _draw_obstacles(axes, prepared, box)
    _draw_contact(axes, prepared, float(np.max(box[1] - box[0])))
    _draw_boundaries(axes, prepared)
    for number, spot in enumerate(spots):
        marks(axes, spot.place[None], "*", SPOT, 9.0, "")
        style: dict[str, Any] = {
            "textcoords": "offset points",
            "color": SPOT,
            "fontweight": "bold",
            "zorder": 7,
        }
        axes.annotate("ab"[number], _pair(spot.place), (5, 5 - 17 * number), **style)
        panel = figure.add_subplot(grid[number, 1])
        equal_axes(panel, box)
        _draw_close(panel, prepared, spot, f"{'ab'[number]}: {spot.title}")
    axes.set_title(prepared.case.title or prepared.case.name, fontsize=11)
    axes.set(xlim=box[:, 0], ylim=box[:, 1])
    _name_kinds(axes)
    handles, labels = axes.get_legend_handles_labels()
    shown = [pair for pair in zip(handles, labels, strict=True) if pair[1]]
    figure.legend(*zip(*shown, strict=True), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    save(figure, path)


def _shown_box(prepared: Prepared) -> Floats:
    """(2, 2) What is shown: the bodies, and obstacles as far as they are near, with a margin."""
    box = box_of(np.concatenate(_boxes(prepared)))
    if prepared.rigids:
        box = with_obstacles(box, np.concatenate([rigid.xy for rigid in prepared.rigids]))
    space = MARGIN * float(np.max(box[1] - box[0]))
    return np.asarray(box + np.array([[-space], [space]]))


def _name_kinds(axes: Axes) -> None:
    """Entries of the legend for what stands in every panel: cells and nodes by their kinds."""
    square: dict[str, Any] = {"marker": "s", "ms": 8.0, "ls": "", "mew": 0.0}
    axes.plot([], [], color=BODY_COLOURS[0], alpha=0.5, label="uncut cells, a colour a body", **square)
    axes.plot([], [], color=CUT, label="cut cells", **square)
    axes.plot([], [], "o", color="black", ms=2.5, label="real nodes (right)")
    axes.plot([], [], "o", mfc="none", mec=PHANTOM, ms=5.0, label="phantom nodes (right)")


def _spots(prepared: Prepared) -> Iterator[Spot]:
    """Where the smallest fragment is, and the element that sets the step; once where they are one."""
    place, step = None, ""
    if prepared.xfem is None:
        place, step = step_place(prepared), f"sets the step, {prepared.estimate.dt:.3g} s"
    cut = [body for body in prepared.bodies if body.mesh.cut.any()]
    if cut:
        body = min(cut, key=lambda each: float(each.mesh.fraction.min()))
        least = int(np.argmin(body.mesh.fraction))
        title = f"smallest fragment, {body.mesh.fraction[least]:.3g} of its cell"
        smallest, cell = element_place(body.mesh, least), body.grid.cell_size
        if place is not None and np.hypot(*(place - smallest)) < SAME * cell:
            yield Spot(f"{title};\n{step}", place, cell)
            return
        yield Spot(title, smallest, cell)
    if place is not None:
        nearest = min(prepared.bodies, key=lambda each: _outside(each, place))
        yield Spot(step, place, nearest.grid.cell_size)


def _outside(body: Body, place: Floats) -> float:
    """How far a place is from the box of a body."""
    low, high = box_of(body.mesh.xy)
    return float(np.hypot(*np.maximum(np.maximum(low - place, place - high), 0.0)))


def _boxes(prepared: Prepared) -> list[Floats]:
    return [np.asarray(region.box) for body in prepared.bodies for region in body.regions]


def _draw_bodies(axes: Axes, prepared: Prepared) -> None:
    """Outlines, material, cells (or, of very many, the cut ones as dots), names."""
    fine = sum(body.grid.cell_count for body in prepared.bodies) <= FINE
    for number, body in enumerate(prepared.bodies):
        colour, mesh = BODY_COLOURS[number % len(BODY_COLOURS)], body.mesh
        if fine:
            lines(axes, body.grid.xy[body.grid.edges], color="0.8", linewidths=0.25, zorder=0.5)
            uncut = mesh.xy[mesh.elements[~mesh.cut]]
            fill(axes, uncut, facecolor=colour, edgecolor="white", alpha=0.5)
            fill(axes, mesh.triangles, facecolor=CUT, edgecolor=CUT)
        else:
            _fill_regions(axes, body, colour)
            middle = mesh.xy[mesh.elements[mesh.cut]].mean(axis=1)
            axes.plot(*middle.T, ",", color=CUT, zorder=1, rasterized=True)
        for curve in (loop for region in body.regions for loop in region.loops):
            axes.plot(*drawable(curve).T, color="black", lw=0.7)
        for name, curve in body.interfaces:
            axes.plot(*drawable(curve).T, color="black", lw=0.9, ls="--")
            _name(axes, drawable(curve)[len(drawable(curve)) // 2], name)
        _name(axes, _within(body), body.name)


def _draw_obstacles(axes: Axes, prepared: Prepared, box: Floats) -> None:
    """Rigid obstacles with their solid side, and a name there."""
    width = SOLID * float(np.max(box[1] - box[0]))
    for rigid in prepared.rigids:
        ends = rigid.xy[rigid.segments]
        solid(axes, ends, width)
        lines(axes, ends, color="black", linewidths=1.5)
        inside = shapely.union_all([shapely.Polygon(side) for side in solid_sides(ends, width)])
        seen = inside.buffer(0.0).intersection(shapely.box(*box.ravel()))
        if not seen.is_empty:
            place = seen.centroid if seen.contains(seen.centroid) else seen.representative_point()
            _name(axes, np.array([place.x, place.y]), f"{rigid.name} (rigid)")


def _fill_regions(axes: Axes, body: Body, colour: str) -> None:
    """The material by its outlines alone."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    for region in body.regions:
        loops = [drawable(loop) for loop in region.loops]
        codes = [np.r_[Outline.MOVETO, np.full(len(loop) - 1, Outline.LINETO)] for loop in loops]
        axes.add_patch(
            PathPatch(
                Outline(np.concatenate(loops), np.concatenate(codes)), facecolor=colour, alpha=0.5, lw=0.0
            )
        )
    axes.autoscale_view()


def _within(body: Body) -> Floats:
    """A place inside the largest region of a body."""
    region = max(body.regions, key=lambda each: each.area)
    shell, *holes = (drawable(loop) for loop in region.loops)
    inner = shapely.Polygon(shell, holes).buffer(0.0).representative_point()
    return np.array([inner.x, inner.y])


def _name(axes: Axes, place: Floats, name: str) -> None:
    plate = {"boxstyle": "round,pad=0.2", "facecolor": "white", "alpha": 0.75, "linewidth": 0.0}
    axes.text(*_pair(place), name, fontsize=9, ha="center", va="center", bbox=plate, zorder=6, clip_on=True)


def _draw_contact(axes: Axes, prepared: Prepared, size: float) -> None:
    """Slave and master segments of all pairs, and where they are nearest; ``size`` is of what is shown, m."""
    for pair, gap in zip(prepared.pairs, initial_gaps(prepared), strict=True):
        masters = master_ends(prepared, pair.passes[0])
        lines(
            axes,
            masters,
            color=MASTER,
            linewidths=1.2,
            label=f"{pair.name}: master {pair.master} (whole outline)",
        )
        slaves = ends_of(prepared, pair.segment_nodes, pair.start_shape, pair.end_shape)
        what = "" if gap is None else f", gap {_length(gap.distance)}" if gap.distance >= 0.0 else (
            f", overlap {_length(-gap.distance)} taken as zero"
        )  # fmt: skip
        lines(axes, slaves, color=SLAVE, linewidths=1.0, label=f"{pair.name}: slave {pair.slave}{what}")
        if gap is None:
            continue
        if not gap.distance > VISIBLE * size:
            ring: dict[str, Any] = {"mfc": "none", "mec": SLAVE, "ms": 8.0, "ls": "", "zorder": 5}
            axes.plot(*gap.slave[:, None], "o", label=f"{pair.name}: where the two are nearest", **ring)
        else:
            arrow = {"arrowstyle": "<->", "color": SLAVE, "lw": 1.0}
            axes.annotate("", _pair(gap.master), _pair(gap.slave), arrowprops=arrow, zorder=5)


def _length(value: float) -> str:
    """A length to three digits, in a unit that suits it: "0.6 mm"."""
    value = float(f"{value:.3g}")  # 0.9999 mm is 1 mm, not 1000 um
    factor, unit = readable(value, "m")
    return f"{value * factor:.3g} {unit}"


def _draw_boundaries(axes: Axes, prepared: Prepared) -> None:
    """The nodes of each boundary, by what it does."""
    obstacles = {rigid.name for rigid in prepared.rigids}  # drawn as what they are
    for boundary in (each for each in prepared.boundaries if each.name not in obstacles):
        holds = HOLDS.get((boundary.channels[0] >= 0, boundary.channels[1] >= 0), "nothing")
        sign, colour, what = {
            "held": ({"x and y": "s", "x": ">", "y": "^"}.get(holds, "s"), HELD, f"{holds} held"),
            "weak": ("D", HELD, f"{holds} held by springs"),
            "load": ("v", LOAD, "load"),
        }[boundary.kind]
        places = prepared.model.x[boundary.nodes]
        size = 3.0 if len(places) < 400 else 1.5
        marks(axes, places, sign, colour, size, f"{boundary.name}: {what} ({len(places)} nodes)")


def _draw_close(axes: Axes, prepared: Prepared, spot: Spot, title: str) -> None:
    """The elements about a place, one by one, with their real and phantom nodes."""
    box = spot.place + CLOSE * spot.cell * np.array([[-1.0, -1.0], [1.0, 1.0]])
    for number, body in enumerate(prepared.bodies):
        mesh, colour = body.mesh, BODY_COLOURS[number % len(BODY_COLOURS)]
        near = _near(mesh.xy, mesh.elements, box)
        corners = mesh.xy[mesh.elements[near]]
        lines(axes, np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2), color="0.75",
              linewidths=0.5)  # fmt: skip
        fill(axes, corners[~mesh.cut[near]], facecolor=colour, edgecolor="white", alpha=0.5)
        own = mesh.triangles[near[mesh.triangle_element]]
        fill(axes, own, facecolor=CUT, edgecolor=CUT)
        used = np.unique(mesh.elements[near])
        real = mesh.real[used]
        axes.plot(*mesh.xy[used[real]].T, "o", color="black", ms=2.5)
        axes.plot(*mesh.xy[used[~real]].T, "o", mfc="none", mec=PHANTOM, ms=5.0)
    for curve in _curves(prepared):
        axes.plot(*curve.polyline(1e-3 * spot.cell).T, color="black", lw=0.9)
    axes.plot(*spot.place, "*", color=SPOT, ms=9.0)
    axes.set(xlim=box[:, 0], ylim=box[:, 1], xlabel="", ylabel="")
    axes.tick_params(labelsize=7)
    axes.locator_params(nbins=5)
    axes.set_title(title, fontsize=9)


def _near(xy: Floats, elements: Numbers, box: Floats) -> NDArray[np.bool_]:
    """(m,) Elements that reach into a box."""
    inside = np.column_stack([(xy >= box[0]), (xy <= box[1])])
    corners = inside[elements]  # (m, 4 nodes, 4 sides): a corner within each side is enough
    return np.asarray(np.all(np.any(corners, axis=1), axis=1))


def _pair(place: Floats) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _curves(prepared: Prepared) -> Iterator[Curve]:
    """All outlines and interfaces."""
    for body in prepared.bodies:
        for region in body.regions:
            yield from region.loops
        for _, curve in body.interfaces:
            yield curve
