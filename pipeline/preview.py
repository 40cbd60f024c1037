"""Pictures: the cut bodies before a run (preview.png, preview.vtu), and the state in a frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.clip import ClippedBodies
from phantomnode.pipeline.drawing import (
    BODY_COLOURS,
    CUT,
    HELD,
    MASTER,
    PHANTOM,
    SLAVE,
    fill,
    lines,
    map_figure,
    marks,
    save,
)
from phantomnode.pipeline.field_pictures import draw_field
from phantomnode.pipeline.fields import cell_fields, tensors
from phantomnode.pipeline.frames import FieldsFrame
from phantomnode.pipeline.mesh_pictures import drawable
from phantomnode.pipeline.prepare import Body, Floats, Prepared
from phantomnode.pipeline.vtu import VTK_QUAD, VTK_TRIANGLE, cells, vectors, vtu_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phantomnode.solver.explicit import Frame


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
    boxes = np.array([region.box for body in prepared.bodies for region in body.regions])
    figure, (axes,) = map_figure(np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]))
    clipped = ClippedBodies.of(prepared)
    points = clipped.interpolate(prepared.model.x)
    tint = np.array([BODY_COLOURS[k % len(BODY_COLOURS)] for k in clipped.body])
    uncut = len(clipped.quads)
    fill(axes, points[clipped.quads], facecolor=tint[:uncut], edgecolor="white", alpha=0.5)
    fill(axes, points[clipped.triangles], facecolor=CUT, edgecolor=CUT)
    for body in prepared.bodies:
        _draw_body(axes, body)
    _draw_contact(axes, prepared)
    held = np.unique(np.concatenate([np.zeros(0, np.int64), *(b.nodes for b in prepared.boundaries)]))
    size = _marker_size(figure, prepared)
    marks(axes, prepared.model.x[held], "s", HELD, max(size, 2.5), f"held ({len(held)} nodes)")
    phantom = np.concatenate([body.mesh.xy[~body.mesh.real] for body in prepared.bodies])
    marks(axes, phantom, "o", PHANTOM, size, f"phantom nodes ({len(phantom)})")
    legend = figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    for handle in legend.legend_handles:
        if handle is not None and hasattr(handle, "set_markersize"):
            handle.set_markersize(5.0)
    axes.set_title(prepared.case.title or prepared.case.name, fontsize=10)
    save(figure, path)


def frame_of_state(prepared: Prepared, frame: Frame) -> FieldsFrame:
    """What the files hold of a state of the solver."""
    clipped = ClippedBodies.of(prepared)
    state, u = cell_fields(prepared, clipped, frame.u), clipped.interpolate(frame.u)
    cell_data: dict[str, NDArray[np.generic]] = {
        "stress": tensors(*state.cauchy.T),
        "von_mises": state.von_mises,
        "J": state.volume_ratio,
        "body": clipped.body,
    }
    points = clipped.interpolate(prepared.model.x) + u
    vectors_of = {"displacement": vectors(u), "velocity": vectors(clipped.interpolate(frame.v))}
    return FieldsFrame(frame.time, points, clipped.quads, clipped.triangles, vectors_of, cell_data)


def draw_result(prepared: Prepared, frame: Frame, path: Path, quantity: str = "von_mises") -> None:
    """Write a picture of the clipped, deformed bodies over their undeformed outlines.

    Parameters
    ----------
    prepared : Prepared
    frame : Frame
        From the solver.
    path : Path
        The .png file.
    quantity : str
        A field of ``quantities.QUANTITIES``.
    """
    title = prepared.case.title or prepared.case.name
    save(draw_field(frame_of_state(prepared, frame), quantity, title), path)


def _draw_body(axes: Axes, body: Body) -> None:
    """The body's grid (light) and its CAD curves."""
    edges = body.grid.xy[body.grid.edges]
    lines(axes, edges, color="0.8", linewidths=0.25, zorder=0.5)
    loops = [loop for region in body.regions for loop in region.loops]
    for curve in (*loops, *(curve for _, curve in body.interfaces)):
        axes.plot(*drawable(curve).T, color="black", lw=0.7)


def _draw_contact(axes: Axes, prepared: Prepared) -> None:
    """Slave segments and master segments of all pairs."""
    x, contact = prepared.model.x, prepared.model.contact

    def ends(nodes: NDArray[np.int64], start: Floats, end: Floats) -> Floats:
        return np.stack([np.einsum("si,sik->sk", shape, x[nodes]) for shape in (start, end)], axis=1)

    for pair in prepared.pairs:
        k = pair.passes[0]
        master = slice(contact.master_first[k], contact.master_first[k + 1])
        segments = ends(contact.master_nodes[master], contact.start_shape[master], contact.end_shape[master])
        lines(axes, segments, color=MASTER, linewidths=1.8, label=f"master of {pair.name} (whole outline)")
        segments = ends(pair.segment_nodes, pair.start_shape, pair.end_shape)
        lines(axes, segments, color=SLAVE, linewidths=1.8, label=f"slave of {pair.name}")


def _marker_size(figure: Figure, prepared: Prepared) -> float:
    """Size of a marker that leaves the cells visible, points: a fifth of the smallest body's cell."""
    cell = min(body.grid.cell_size for body in prepared.bodies)
    boxes = np.array([region.box for body in prepared.bodies for region in body.regions])
    width = float(np.ptp(boxes[..., 0]))
    return float(np.clip(0.2 * 72.0 * 8.0 * cell / width, 1.2, 4.0))
