"""The cut bodies before a run, as a file for ParaView, and the picture of a state in a frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.clip import ClippedBodies, cell_labels
from phantomnode.pipeline.drawing import save
from phantomnode.pipeline.field_pictures import draw_field
from phantomnode.pipeline.fields import cell_fields, tensors
from phantomnode.pipeline.frames import FieldsFrame
from phantomnode.pipeline.prepare import Prepared
from phantomnode.pipeline.vtu import VTK_QUAD, VTK_TRIANGLE, cells, vectors, vtu_pieces

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame


def preview_vtu(prepared: Prepared) -> bytes:
    """The clipped bodies in their reference position, as the content of a .vtu file."""
    clipped = ClippedBodies.of(prepared)
    grid = cells((VTK_QUAD, clipped.quads), (VTK_TRIANGLE, clipped.triangles))
    labels = cell_labels(prepared.bodies)
    cell_data: dict[str, NDArray[np.generic]] = {
        **labels._asdict(),
        "cut": (np.arange(len(labels.body)) >= len(clipped.quads)).astype(np.int32),
    }
    return b"".join(vtu_pieces(vectors(clipped.interpolate(prepared.model.x)), grid, {}, cell_data))


def frame_of_state(prepared: Prepared, frame: Frame) -> FieldsFrame:
    """What the files hold of a state of the solver."""
    clipped = ClippedBodies.of(prepared)
    state, u = cell_fields(prepared, clipped, frame.u), clipped.interpolate(frame.u)
    cell_data: dict[str, NDArray[np.generic]] = {
        "stress": tensors(*state.cauchy.T),
        "von_mises": state.mises,
        "J": state.j,
        "body": cell_labels(prepared.bodies).body,
    }
    points = clipped.interpolate(prepared.model.x) + u
    vectors_of = {"displacement": vectors(u), "velocity": vectors(clipped.interpolate(frame.v))}
    now = prepared.model.x + frame.u
    rigid = [now[obstacle.nodes][obstacle.segments] for obstacle in prepared.rigids]
    obstacles = np.concatenate([np.zeros((0, 2, 2)), *rigid])
    return FieldsFrame(frame.time, points, clipped.quads, clipped.triangles, vectors_of, cell_data, obstacles)


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
