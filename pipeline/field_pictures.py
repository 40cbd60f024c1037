"""Pictures of the bodies: a field on the deformed, clipped material over the undeformed outline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.drawing import box_of, fill, lines, map_figure, moment, readable, solid
from phantomnode.pipeline.frames import FieldsFrame
from phantomnode.pipeline.outlines import solid_sides
from phantomnode.pipeline.quantities import Quantity, quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

OUTLIERS = 0.002
"""The colours span all but this share of the cells at either end, so that single cells at corners do not pale the
others."""
ONE_SIDED = 0.02
"""A signed field that reaches less far to one side of zero than this part of the other is drawn from zero on."""
MARGIN = 0.05
"""Of the size of the bodies, about them."""
FAR = 0.25
"""Of the size of the bodies: obstacles are shown so far about them, however long they are."""
SOLID = 0.02
"""Of the size of a picture: how broad a strip shows on which side an obstacle is solid."""
MAPS = {"magnitude": "turbo", "signed": "RdBu_r", "ratio": "RdBu_r"}


class Limits(NamedTuple):
    """The values, SI, at the ends of the colour bar."""

    low: float
    high: float


def limits_of(values: Floats, what: Quantity) -> Limits:
    """The span of the colours for some values: from zero or to zero, about zero, or about one."""
    low, high = np.quantile(values, [OUTLIERS, 1.0 - OUTLIERS])
    return _limits(float(low), float(high), what)


def joint_limits(limits: Sequence[tuple[float, float]], what: Quantity) -> Limits:
    """The span of the colours of several pictures."""
    lows, highs = zip(*limits, strict=True)
    return _limits(min(lows), max(highs), what)


def _limits(low: float, high: float, what: Quantity) -> Limits:
    """The span of the colours for values from low to high."""
    tiny = float(np.finfo(np.float32).tiny)
    if what.kind == "magnitude":
        return Limits(0.0, max(high, tiny))
    centre = 1.0 if what.kind == "ratio" else 0.0
    below, above = centre - low, high - centre
    reach = max(below, above, 1e-12 if centre else tiny)
    if what.kind == "signed" and min(below, above) < ONE_SIDED * reach:
        return Limits(0.0, reach) if above >= below else Limits(-reach, 0.0)
    return Limits(centre - reach, centre + reach)


def _visible(limits: Limits) -> Limits:
    """Limits that a colour bar can have: those of a field that is zero everywhere are zero and one."""
    return limits if max(np.abs(limits)) > np.finfo(np.float32).tiny else Limits(0.0, 1.0)


def map_of(limits: tuple[float, float], what: Quantity) -> str:
    """The name of matplotlib's colour map: pale in the middle only where zero lies there."""
    one_sided = what.kind == "signed" and limits[0] * limits[1] >= 0.0
    return MAPS["magnitude" if one_sided else what.kind]


def view_box(*frames: FieldsFrame) -> Floats:
    """(2, 2) A box that holds the bodies as they were and as they are in some frames, with a margin."""
    box = box_of(np.concatenate([points for f in frames for points in (f.reference, f.points)]))
    box = with_obstacles(box, np.concatenate([frame.obstacles.reshape(-1, 2) for frame in frames]))
    space = MARGIN * float(np.max(box[1] - box[0]))
    return np.asarray(box + np.array([[-space], [space]]))


def with_obstacles(box: Floats, obstacles: Floats) -> Floats:
    """A (2, 2) box about bodies that holds the (n, 2) points of obstacles too, as far as these are not far off."""
    space = FAR * float(np.max(box[1] - box[0]))
    near = np.clip(obstacles, box[0] - space, box[1] + space)
    return box_of(np.concatenate([box, near]))


def coloured(frame: FieldsFrame, what: Quantity, smooth: bool) -> Floats:
    """(m,) The values that the colours of cells show, SI: their own, or means over neighbouring cells."""
    values = what.values(frame)
    return frame.smoothed(values) if smooth else values


class FieldPicture:
    """A field on the bodies; :meth:`show` goes on to another frame.

    Parameters
    ----------
    frame : FieldsFrame
    name : str
        Of the field, a key of ``quantities.QUANTITIES``.
    title : str
        The time stands behind it.
    limits : Limits, optional
        Of the colours; from the frame unless given.
    box : (2, 2) float64, m, optional
        Lower left and upper right corner of what is shown; all of the bodies, then and now, unless given.
    outlines : bool
        Draw the undeformed outline.
    smooth : bool
        Means over neighbouring cells, in place of the values of the cells.
    extremes : float64, optional
        Values by which the colour bar shows that some lie beyond its ends; those of the frame unless given.

    Attributes
    ----------
    figure : matplotlib Figure
    """

    def __init__(
        self,
        frame: FieldsFrame,
        name: str,
        title: str = "",
        *,
        limits: Limits | None = None,
        box: Floats | None = None,
        outlines: bool = True,
        smooth: bool = False,
        width: float = 9.0,
        extremes: Floats | None = None,
    ) -> None:
        self._what, self._title, self._smooth = quantity(name), title, smooth
        values = coloured(frame, self._what, smooth)
        limits = _visible(limits or limits_of(values, self._what))
        self._factor, unit = readable(np.array(limits), self._what.unit)
        box = view_box(frame) if box is None else box
        self.figure, (axes,) = map_figure(box, width)
        style = {"cmap": map_of(limits, self._what), "clim": tuple(self._factor * value for value in limits)}
        self._cells = [
            fill(axes, shapes, array=part, edgecolor="face", **style)
            for shapes, part in self._shapes(frame, values)
        ]
        if outlines:
            lines(axes, frame.reference[frame.outline], color="0.65", linewidths=0.6, linestyles="--")
        self._rim = lines(axes, frame.points[frame.outline], color="black", linewidths=0.4)
        self._solid_width = SOLID * float(np.max(box[1] - box[0]))
        self._solid = solid(axes, frame.obstacles, self._solid_width)
        self._obstacles = lines(axes, frame.obstacles, color="0.35", linewidths=1.8)
        label = f"{self._what.label}{', smoothed' if smooth else ''}{', ' if unit else ''}{unit}"
        beyond = ends_beyond(values if extremes is None else extremes, limits)
        self.figure.colorbar(self._cells[0], ax=axes, label=label, shrink=0.8, extend=beyond)
        axes.set(xlim=box[:, 0], ylim=box[:, 1])
        self._axes = axes
        self._axes.set_title(self._heading(frame), fontsize=10)

    def show(self, frame: FieldsFrame) -> None:
        """Draw another frame of the same bodies in its place."""
        for cells, (shapes, part) in zip(
            self._cells, self._shapes(frame, coloured(frame, self._what, self._smooth)), strict=True
        ):
            cells.set_verts(shapes)
            cells.set_array(part)
        self._rim.set_segments(list(frame.points[frame.outline]))
        self._solid.set_verts(solid_sides(frame.obstacles, self._solid_width))
        self._obstacles.set_segments(list(frame.obstacles))
        self._axes.set_title(self._heading(frame), fontsize=10)

    def _shapes(self, frame: FieldsFrame, values: Floats) -> list[tuple[Floats, Floats]]:
        """Corners and shown values of quadrilaterals and of triangles."""
        shown, whole = self._factor * values, len(frame.quads)
        return [
            (frame.points[frame.quads], shown[:whole]),
            (frame.points[frame.triangles], shown[whole:]),
        ]

    def _heading(self, frame: FieldsFrame) -> str:
        return f"{self._title}, t = {moment(frame.time)}".removeprefix(", ")


def draw_field(frame: FieldsFrame, name: str, title: str = "", **options: Any) -> Figure:
    """A picture of a field; the options are those of :class:`FieldPicture`."""
    return FieldPicture(frame, name, title, **options).figure


def ends_beyond(values: Floats, limits: Limits) -> str:
    """Which ends of the colour bar have an arrow: where values lie beyond."""
    below, above = bool(values.min() < limits.low), bool(values.max() > limits.high)
    return {(0, 0): "neither", (0, 1): "max", (1, 0): "min", (1, 1): "both"}[below, above]
