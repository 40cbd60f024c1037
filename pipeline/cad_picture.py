"""Pictures of geometry files: regions, curves by layer, what was mended and what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phantomnode.geometry.curves import Curve, Geometry, Region, diagonal
from phantomnode.geometry.errors import OutlineError
from phantomnode.geometry.findings import WRONG, Finding
from phantomnode.geometry.units import metres
from phantomnode.pipeline.drawing import BODY_COLOURS, map_figure, marks, save
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.files import make_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINE_COLOURS = ("#1f4e9e", "#c0392b", "#2e7d32", "#7d3c98", "#b8860b", "#00838f", "#6d4c41", "#c2185b")
MOST_LAYERS = 16
"""Names in the legend."""

SMALLEST_LABEL = 0.01
"""Regions narrower than this part of the drawing are counted, but get no number in the picture."""


@contextmanager
def drawn_where_refused(folder: Path) -> Iterator[None]:
    """Draw the geometry of a case that is refused for its outlines or overlaps, and name the picture."""
    try:
        yield
    except CaseError as error:
        refused = error.__cause__
        if not isinstance(refused, OutlineError):
            raise
        picture = folder / "problem.png"
        make_folder(folder)
        draw_geometry(refused.geometry, picture, "What cannot be used as it is")
        raise CaseError(tuple(f"{message}; drawn in {picture}" for message in error.messages)) from error


def draw_geometry(geometry: Geometry, path: Path, title: str, unit: str = "") -> None:
    """Write a picture of a drawing in the unit of its file; ``unit`` is what that is called, where it has none.

    Parameters
    ----------
    geometry : Geometry
    path : Path
        The .png file.
    title : str
    """
    factor = metres(geometry.unit)
    loops = [loop for region in geometry.regions for loop in region.loops]
    every = [*loops, *geometry.curves]
    size = diagonal(every)
    figure, axes = _figure(every, factor, unit or geometry.unit)
    for k, region in enumerate(geometry.regions):
        _fill(axes, region, factor, size, BODY_COLOURS[k % len(BODY_COLOURS)])
        if float(np.min(region.box[1] - region.box[0])) > SMALLEST_LABEL * size:
            x, y = _middle(region, size) / factor
            axes.text(x, y, str(k + 1), ha="center", va="center", fontsize=9, fontweight="bold")
    _draw_by_name(axes, loops, geometry.curves, factor, size)
    ends = np.array([c.points[k] for c in geometry.curves if not c.closed for k in (0, -1)]).reshape(-1, 2)
    if len(ends):
        marks(axes, ends / factor, "o", "black", 3.0, f"ends of open curves ({len(ends)})")
    _mark_findings(axes, geometry.findings, factor)
    axes.set_title(title, fontsize=10)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    save(figure, path)


def _figure(curves: list[Curve], factor: float, unit: str) -> tuple[Figure, Axes]:
    """A figure with equal axes in the unit of the file, with a margin."""
    from matplotlib.ticker import ScalarFormatter

    boxes = np.array([curve.box for curve in curves]) / factor
    box = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    box += 0.04 * float(np.max(box[1] - box[0])) * np.array([[-1.0], [1.0]])
    figure, (axes,) = map_figure(box)
    axes.set_xlim(*box[:, 0])
    axes.set_ylim(*box[:, 1])
    for axis, name in ((axes.xaxis, "x"), (axes.yaxis, "y")):
        axis.set_major_formatter(ScalarFormatter(useOffset=False))  # numbers as the file has them
        axis.set_label_text(f"{name}, {unit}")
    return figure, axes


def _fill(axes: Axes, region: Region, factor: float, size: float, colour: str) -> None:
    """The area of a region, without its holes."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = [Outline(loop.polyline(1e-4 * size) / factor, closed=True) for loop in region.loops]
    patch = PathPatch(Outline.make_compound_path(*rings), facecolor=colour, edgecolor="none", alpha=0.45)
    axes.add_patch(patch)


def _middle(region: Region, size: float) -> Any:
    """A point well inside a region, metres."""
    import shapely

    rings = [loop.polyline(1e-3 * size) for loop in region.loops]
    rings = [ring for ring in rings if len(ring) > 3]
    point = shapely.Polygon(rings[0], rings[1:]).buffer(0.0).representative_point()
    return np.array([point.x, point.y])


def _draw_by_name(
    axes: Axes, loops: list[Curve], curves: tuple[Curve, ...], factor: float, size: float
) -> None:
    """Outlines in full, other curves dashed, each name (layer, physical group) in a colour of its own."""
    from matplotlib.collections import LineCollection

    lines: dict[tuple[str, bool], list[Any]] = {}
    for curve, whole in [*((loop, True) for loop in loops), *((curve, False) for curve in curves)]:
        for name, run in _runs(curve):
            lines.setdefault((name, whole), []).append(run.polyline(1e-4 * size) / factor)
    names = list(dict.fromkeys(name for name, _ in lines))
    for (name, whole), found in lines.items():
        number = names.index(name)
        colour = LINE_COLOURS[number % len(LINE_COLOURS)] if name else "black"
        label = None
        if number < MOST_LAYERS and ((name, True) not in lines or whole):
            label = f"'{name}'" if name else ("outline without a name" if whole else "curve without a name")
        style = "solid" if whole else "dashed"
        axes.add_collection(
            LineCollection(found, colors=colour, linewidths=1.0, linestyles=style, label=label)
        )


def _runs(curve: Curve) -> list[tuple[str, Curve]]:
    """The stretches of a curve that have one name."""
    names = np.array(curve.names)
    starts = [0, *(np.flatnonzero(names[1:] != names[:-1]) + 1).tolist(), len(names)]
    return [
        (curve.names[a], Curve(curve.points[a : b + 1], curve.bulges[a:b]))
        for a, b in zip(starts[:-1], starts[1:], strict=True)
    ]


def _mark_findings(axes: Axes, findings: tuple[Finding, ...], factor: float) -> None:
    """Orange rings where something was mended, red crosses where something is wrong."""
    wrong = np.array([f.at for f in findings if f.kind in WRONG]).reshape(-1, 2) / factor
    mended = np.array([f.at for f in findings if f.kind not in WRONG]).reshape(-1, 2) / factor
    if len(mended):
        axes.plot(
            *mended.T,
            "o",
            mfc="none",
            mec="#e67e22",
            ms=8,
            mew=1.2,
            zorder=5,
            label=f"mended ({len(mended)})",
        )
    if len(wrong):
        axes.plot(
            *wrong.T, "x", color="#d00000", ms=12, mew=2.5, zorder=6, label=f"outlines cross ({len(wrong)})"
        )
