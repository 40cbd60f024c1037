"""Pictures: the cut bodies before a run (preview.png, preview.vtu), and the state in a frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.pipeline.clip import ClippedBodies
from phantomnode.pipeline.fields import cell_fields
from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.prepare import Body, Floats, Prepared
from phantomnode.pipeline.vtu import VTK_QUAD, VTK_TRIANGLE, cells, vtu_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phantomnode.solver.explicit import Frame

BODY_COLOURS = ("#8fb3d9", "#e3b57a", "#9cc7a0", "#c9a3cf", "#d99a96", "#b5b5b5")
CUT, SLAVE, MASTER, PHANTOM, HELD = "#f2c14e", "#c0392b", "#1f4e9e", "#7d3c98", "#111111"
Quantity = Literal["von_mises", "J"]


def preview_vtu(prepared: Prepared) -> bytes:
    """The clipped bodies in their reference position, as the content of a .vtu file."""
    clipped = ClippedBodies.of(prepared)
    grid = cells((VTK_QUAD, clipped.quads), (VTK_TRIANGLE, clipped.triangles))
    cell_data: dict[str, NDArray[np.generic]] = {
        "body": clipped.body,
        "side": clipped.side,
        "fraction": clipped.fraction,
        "cut": (np.arange(len(clipped.body)) >= len(clipped.quads)).astype(np.int32),
    }
    return vtu_bytes(clipped.interpolate(prepared.model.x), grid, {}, cell_data)


def draw_preview(prepared: Prepared, path: Path) -> None:
    """Write a picture of what the case became: curves, grids, elements, phantom nodes, contact, held nodes.

    Parameters
    ----------
    prepared : Prepared
    path : Path
        The .png file.
    """
    figure, axes = _figure(prepared)
    clipped = ClippedBodies.of(prepared)
    points = clipped.interpolate(prepared.model.x)
    tint = np.array([BODY_COLOURS[k % len(BODY_COLOURS)] for k in clipped.body])
    uncut = len(clipped.quads)
    _fill(axes, points[clipped.quads], facecolor=tint[:uncut], edgecolor="white", alpha=0.5)
    _fill(axes, points[clipped.triangles], facecolor=CUT, edgecolor=CUT)
    for body in prepared.bodies:
        _draw_body(axes, body)
    _draw_contact(axes, prepared)
    held = np.unique(np.concatenate([np.zeros(0, np.int64), *(b.nodes for b in prepared.boundaries)]))
    size = _marker_size(figure, prepared)
    _marks(axes, prepared.model.x[held], "s", HELD, max(size, 2.5), f"held ({len(held)} nodes)")
    phantom = np.concatenate([body.mesh.xy[~body.mesh.real] for body in prepared.bodies])
    _marks(axes, phantom, "o", PHANTOM, size, f"phantom nodes ({len(phantom)})")
    legend = figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    for handle in legend.legend_handles:
        if handle is not None and hasattr(handle, "set_markersize"):
            handle.set_markersize(5.0)
    axes.set_title(prepared.case.title or prepared.case.name, fontsize=10)
    save(figure, path)


def draw_result(prepared: Prepared, frame: Frame, path: Path, quantity: Quantity = "von_mises") -> None:
    """Write a picture of the clipped, deformed bodies over their undeformed outlines.

    Parameters
    ----------
    prepared : Prepared
    frame : Frame
    path : Path
        The .png file.
    quantity : "von_mises" (in MPa) or "J"
        What the colours show. Their range leaves out the highest 0.2 % of the cells, marked by an arrow
        on the bar, so that one point under contact does not darken the rest.
    """
    figure, axes = _figure(prepared)
    clipped = ClippedBodies.of(prepared)
    state = cell_fields(prepared, clipped, frame.u)
    values = state.von_mises / 1e6 if quantity == "von_mises" else state.volume_ratio
    label = "von Mises stress, MPa" if quantity == "von_mises" else "J = det F"
    reference = clipped.interpolate(prepared.model.x)
    points = reference + clipped.interpolate(frame.u)
    low = 0.0 if quantity == "von_mises" else float(values.min())
    high = max(float(np.quantile(values, 0.998)), low + np.finfo(np.float32).tiny)
    uncut = len(clipped.quads)
    for shapes, part in (
        (points[clipped.quads], values[:uncut]),
        (points[clipped.triangles], values[uncut:]),
    ):
        painted = _fill(axes, shapes, array=part, cmap="turbo", clim=(low, high), edgecolor="face")
    edges = clipped.outline()
    _lines(axes, reference[edges], color="0.65", linewidths=0.6, linestyles="--")
    _lines(axes, points[edges], color="black", linewidths=0.6)
    extend: Literal["max", "neither"] = "max" if values.max() > high else "neither"
    figure.colorbar(painted, ax=axes, label=label, shrink=0.8, extend=extend)
    axes.set_title(f"{prepared.case.title or prepared.case.name}, t = {frame.time * 1e3:.4g} ms", fontsize=10)
    save(figure, path)


def _figure(prepared: Prepared) -> tuple[Figure, Axes]:
    """A figure with equal axes in metres, sized to the bodies; drawn without a screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    boxes = np.array([region.box for body in prepared.bodies for region in body.regions])
    width, height = boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)
    tall = float(np.clip(8.0 * height / width, 3.0, 12.0))
    figure = Figure(figsize=(9.0, tall + 1.2), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    return figure, axes


def _draw_body(axes: Axes, body: Body) -> None:
    """The body's grid (light) and its CAD curves."""
    edges = body.grid.xy[body.grid.edges]
    _lines(axes, edges, color="0.8", linewidths=0.25, zorder=0.5)
    loops = [loop for region in body.regions for loop in region.loops]
    for curve in (*loops, *(curve for _, curve in body.interfaces)):
        axes.plot(*_drawable(curve).T, color="black", lw=0.7)


def _draw_contact(axes: Axes, prepared: Prepared) -> None:
    """Slave segments and master segments of all pairs."""
    x, contact = prepared.model.x, prepared.model.contact

    def ends(nodes: NDArray[np.int64], start: Floats, end: Floats) -> Floats:
        return np.stack([np.einsum("si,sik->sk", shape, x[nodes]) for shape in (start, end)], axis=1)

    for pair in prepared.pairs:
        k = pair.passes[0]
        master = slice(contact.master_first[k], contact.master_first[k + 1])
        lines = ends(contact.master_nodes[master], contact.start_shape[master], contact.end_shape[master])
        _lines(axes, lines, color=MASTER, linewidths=1.8, label=f"master of {pair.name} (whole outline)")
        lines = ends(pair.segment_nodes, pair.start_shape, pair.end_shape)
        _lines(axes, lines, color=SLAVE, linewidths=1.8, label=f"slave of {pair.name}")


def _drawable(curve: Curve) -> Floats:
    """(k, 2) Vertices of a curve, arcs flattened to 1e-4 of its box: less than a pixel."""
    return curve.polyline(1e-4 * float(np.max(curve.box[1] - curve.box[0])))


def _fill(axes: Axes, polygons: Floats, **style: Any) -> Any:
    """Filled polygons, (m, k, 2); thin edges of their own colour close the seams between them."""
    from matplotlib.collections import PolyCollection

    collection = PolyCollection(list(polygons), linewidths=0.3, **style)
    axes.add_collection(collection)
    axes.autoscale_view()
    return collection


def _marks(axes: Axes, points: Floats, marker: str, colour: str, size: float, label: str) -> None:
    """Marks on (k, 2) points."""
    axes.plot(*points.T, marker, color=colour, ms=size, mew=0, label=label, zorder=4)


def _lines(axes: Axes, lines: Floats, **style: Any) -> None:
    """Straight lines, (m, 2, 2)."""
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(lines), **style))
    axes.autoscale_view()


def _marker_size(figure: Figure, prepared: Prepared) -> float:
    """Size of a marker that leaves the cells visible, points: a fifth of the smallest body's cell."""
    cell = min(body.grid.cell_size for body in prepared.bodies)
    boxes = np.array([region.box for body in prepared.bodies for region in body.regions])
    width = float(np.ptp(boxes[..., 0]))
    return float(np.clip(0.2 * 72.0 * 8.0 * cell / width, 1.2, 4.0))


def save(figure: Figure, path: Path) -> None:
    """Write the picture in one step."""
    from io import BytesIO

    content = BytesIO()
    figure.savefig(content, format="png", bbox_inches="tight")
    write_atomically(path, content.getvalue())
