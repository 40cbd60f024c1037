"""What all pictures are made of: figures, cells, lines, colour bars, numbers with units, files."""

from __future__ import annotations

from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

BODY_COLOURS = ("#8fb3d9", "#e3b57a", "#9cc7a0", "#c9a3cf", "#d99a96", "#b5b5b5")
CUT, SLAVE, MASTER, PHANTOM, HELD = "#f2c14e", "#c0392b", "#1f4e9e", "#7d3c98", "#111111"
DPI = 160
FORMATS = ("png", "svg", "pdf")
MANY = 5000
"""Cells above this number become pixels within an SVG or PDF, which would be slow to open otherwise."""

VERY_MANY = 30_000
"""Cells above this number are painted as pixels from the start, without edges."""

PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
PREFIXED = ("Pa", "m", "s", "N/m", "J/m")
"""Units that take a prefix; metres per second and pure numbers do not."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, drawn without a screen; notebooks show it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = _shown_figure()(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


@cache
def _shown_figure() -> type[Figure]:
    """Figures that a notebook shows, also where pyplot was never imported, which else sees to it."""
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A figure that is its own picture."""

        def _repr_png_(self) -> bytes:
            content = BytesIO()
            self.savefig(content, format="png", bbox_inches="tight", dpi=0.6 * DPI)
            return content.getvalue()

    return ShownFigure


def map_figure(
    box: Floats, width: float = 9.0, pictures: int = 1, used: float = 0.9
) -> tuple[Figure, list[Axes]]:
    """A figure with equal axes in metres for a (2, 2) box, lower left and upper right; several side by side.

    Of its width so much is used by the axes themselves.
    """
    across, up = np.maximum(box[1] - box[0], 1e-12 * np.abs(box).max() + 1e-300)
    tall = float(np.clip(used * width / pictures * up / across, 3.0, 12.0))
    figure = new_figure(width, tall + 1.2)
    row = list(figure.subplots(1, pictures, squeeze=False)[0])
    for axes in row:
        equal_axes(axes, box)
    return figure, row


def equal_axes(axes: Axes, box: Floats) -> None:
    """One scale, and labels in a unit that suits a (2, 2) box in metres; what is drawn stays in metres."""
    from matplotlib.ticker import FuncFormatter

    factor, unit = readable(float(np.max(box[1] - box[0])), "m")
    axes.set_aspect("equal")
    axes.locator_params(axis="x", nbins=7)  # labels of six digits would touch
    for axis, name in ((axes.xaxis, "x"), (axes.yaxis, "y")):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value * factor:.6g}"))
        axis.set_label_text(f"{name}, {unit}")


def box_of(points: Floats) -> Floats:
    """(2, 2) Lower left and upper right corner of (n, 2) points."""
    return np.stack([points.min(axis=0), points.max(axis=0)])


def fill(axes: Axes, polygons: Floats, **style: Any) -> Any:
    """Filled polygons, (m, k, 2); thin edges of their own colour close the seams between them."""
    from matplotlib.collections import PolyCollection

    from phantomnode.pipeline.painted import PaintedCells

    kind: Any = PaintedCells if len(polygons) > VERY_MANY else PolyCollection
    # Upright cells must not be moved to whole pixels while their neighbours, a little turned, are not.
    collection = kind(polygons, **({"linewidths": 0.4, "snap": False} | style))
    collection.set_rasterized(len(polygons) > MANY)
    axes.add_collection(collection)
    axes.autoscale_view()
    return collection


def solid(axes: Axes, obstacles: Floats, width: float) -> Any:
    """The solid sides of obstacles, (s, 2, 2) their segments: pale, behind all else; strips are so broad, m."""
    from matplotlib.collections import PolyCollection

    from phantomnode.pipeline.outlines import solid_sides

    sides: Any = solid_sides(obstacles, width)
    collection = PolyCollection(sides, facecolor="0.86", edgecolor="none", zorder=0.4)
    axes.add_collection(collection, autolim=False)
    return collection


def lines(axes: Axes, ends: Floats, **style: Any) -> Any:
    """Straight lines, (m, 2, 2)."""
    from matplotlib.collections import LineCollection

    collection = LineCollection(list(ends), **({"snap": False} | style))
    collection.set_rasterized(len(ends) > MANY)
    axes.add_collection(collection)
    axes.autoscale_view()
    return collection


def marks(axes: Axes, points: Floats, marker: str, colour: str, size: float, label: str) -> None:
    """Marks on (k, 2) points."""
    axes.plot(*points.T, marker, color=colour, ms=size, mew=0, label=label, zorder=4)


def readable(values: NDArray[np.floating[Any]] | float, unit: str) -> tuple[float, str]:
    """A factor and a unit in which the largest of some values is between 1 and 1000: 1e-6 and "MPa"."""
    size = np.abs(np.asarray(values, dtype=np.float64))
    finite = size[np.isfinite(size)]
    largest = float(finite.max()) if finite.size else 0.0
    if unit not in PREFIXED or largest == 0.0:
        return 1.0, unit
    scale, prefix = next((p for p in PREFIXES if largest >= p[0] * (1.0 - 1e-9)), PREFIXES[-1])
    return 1.0 / scale, prefix + unit


def moment(time: float) -> str:
    """A time for people to read: "4.5 ms"."""
    factor, unit = readable(time, "s")
    return f"{time * factor:.4g} {unit}"


def save(figure: Figure, path: Path) -> None:
    """Write the picture in one step, as PNG, SVG or PDF by the ending of its name.

    Raises
    ------
    CaseError
        Where the ending is none of these.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise CaseError(f"{path}: pictures end in {', '.join('.' + name for name in FORMATS)}")
    from matplotlib import rc_context

    # The same picture is the same bytes: no date, no random names.
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    content = BytesIO()
    with rc_context({"svg.hashsalt": "phantomnode"}):
        figure.savefig(content, format=kind, bbox_inches="tight", metadata=dates.get(kind))
    write_atomically(path, content.getvalue())
