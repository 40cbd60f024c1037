"""Films of a run: a field over all frames, as GIF (by Pillow) or MP4 (by ffmpeg)."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomnode.pipeline.drawing import DPI
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.field_pictures import FieldPicture, coloured, joint_limits, limits_of, view_box
from phantomnode.pipeline.frames import FieldsFrame
from phantomnode.pipeline.plot import box_from, limits_from
from phantomnode.pipeline.quantities import quantity
from phantomnode.pipeline.results import Results

if TYPE_CHECKING:
    from matplotlib.animation import AbstractMovieWriter
    from matplotlib.figure import Figure
    from rich.console import Console

MARGIN = 0.08
"""Around a frame, inches."""

WIDTHS = (100, 4000)
"""Least and most pixels of a film."""


def write_film(
    results: Results,
    what: str = "von_mises",
    out: Path | None = None,
    *,
    fps: int = 15,
    width: int = 800,
    limits: tuple[float, float] | None = None,
    box: Sequence[float] | None = None,
    smooth: bool = False,
    console: Console | None = None,
) -> Path:
    """Write a film; colours and axes are the same in all its frames.

    Parameters
    ----------
    results : Results
    what : str
        A field, a key of ``quantities.QUANTITIES``.
    out : Path, optional
        Ending in .gif or .mp4; ``animation.WHAT.gif`` in the folder of the run unless given.
    fps : int
        Frames a second.
    width : int
        Pixels.
    limits : (float, float), SI, optional
        Of the colours; those of all frames unless given.
    box : (x0, y0, x1, y1), m, optional
    smooth : bool
        Means over neighbouring cells.
    console : rich Console, optional
        Where to show the progress, if it is a terminal.

    Returns
    -------
    Path

    Raises
    ------
    CaseError
        Where the field, the ending or a number cannot be, or MP4 is asked for without ffmpeg.
    """
    path = out or results.path / f"animation.{what}.gif"
    if not 1 <= fps <= 100:
        raise CaseError(f"--fps {fps}: must lie between 1 and 100")
    if not WIDTHS[0] <= width <= WIDTHS[1]:
        raise CaseError(f"--width {width}: must lie between {WIDTHS[0]} and {WIDTHS[1]} pixels")
    field, writer, corners, span = quantity(what), _writer(path, fps), box_from(box), limits_from(limits)
    frames = list(results.frames())
    if not frames:
        raise CaseError(f"{results.path}: no frame is written yet")
    values = [coloured(frame, field, smooth) for frame in frames]
    extremes = np.array([(each.min(), each.max()) for each in values])
    if span is None:
        span = joint_limits([limits_of(each, field) for each in values], field)
    if corners is None:
        corners = view_box(*frames)
    picture = FieldPicture(
        frames[0], what, results.title, limits=span, box=corners, smooth=smooth, extremes=extremes
    )
    for _ in range(2):  # the layout of axes of equal scale settles in two passes
        picture.figure.canvas.draw()
    picture.figure.set_layout_engine("none")  # as it is now, in all frames
    _whole(picture.figure)
    _even(picture, width)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        with writer.saving(picture.figure, part, picture.figure.dpi):
            for frame in _told(frames, console):
                picture.show(frame)
                writer.grab_frame()
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path


def _told(frames: list[FieldsFrame], console: Console | None) -> Iterable[FieldsFrame]:
    """The frames, with a bar on a terminal."""
    if console is None or not console.is_terminal or console.is_dumb_terminal:
        return frames
    from rich.progress import track

    return track(frames, "drawing frames", console=console, transient=True)


def _whole(figure: Figure) -> None:
    """Give the figure the size of what is drawn, and a margin: the layout cuts off labels of tall axes."""
    drawn, size = figure.get_tightbbox(), figure.get_size_inches()
    around = np.array([drawn.x1 - drawn.x0, drawn.y1 - drawn.y0]) + 2.0 * MARGIN
    for axes in figure.axes:
        place = axes.get_position().get_points() * size - (drawn.x0, drawn.y0) + MARGIN
        low, high = place / around
        axes.set_position((*low, *(high - low)))
    figure.set_size_inches(*around)


def _even(picture: FieldPicture, width: int) -> None:
    """Set the resolution such that the film has so many pixels across, an even number each way for MP4."""
    figure = picture.figure
    figure.set_dpi(DPI)
    across, up = figure.get_size_inches()
    dpi = width / across
    pixels = 2 * np.round(0.5 * dpi * np.array([across, up]))
    figure.set_dpi(dpi)
    figure.set_size_inches(*(pixels + 0.01) / dpi)


def _writer(path: Path, fps: int) -> AbstractMovieWriter:
    """What writes a film of this kind.

    Raises
    ------
    CaseError
        Where the ending is of no film, or ffmpeg is missing.
    """
    import matplotlib
    from matplotlib.animation import FFMpegWriter, PillowWriter

    kind = path.suffix.lower()
    if kind == ".gif":
        return PillowWriter(fps=fps)
    if kind != ".mp4":
        raise CaseError(f"--out {path}: films end in .gif or .mp4")
    matplotlib.rcParams["animation.ffmpeg_path"] = _ffmpeg()
    return FFMpegWriter(fps=fps, codec="libx264", extra_args=["-pix_fmt", "yuv420p", "-crf", "20"])


def _ffmpeg() -> str:
    """The program ffmpeg: that of the system, or of imageio-ffmpeg."""
    if found := shutil.which("ffmpeg"):
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        raise CaseError(
            'an MP4 needs ffmpeg, which is not found: pip install "phantomnode[film]", or write a .gif'
        ) from None
    return str(get_ffmpeg_exe())
