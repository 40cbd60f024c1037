"""The pictures of ``[figure.NAME]`` tables, and the data in them as tidy rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.curve_pictures import unit_of
from phantomnode.pipeline.drawing import equal_axes, fill, lines, moment, new_figure, readable
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.field_pictures import Limits, ends_beyond, limits_of, map_of, view_box
from phantomnode.pipeline.figure_checks import MISSED
from phantomnode.pipeline.figure_sources import Shown
from phantomnode.pipeline.figure_tables import TOTAL, Figure
from phantomnode.pipeline.frames import FieldsFrame
from phantomnode.pipeline.messages import listed, suggestion
from phantomnode.pipeline.quantities import quantity
from phantomnode.pipeline.results import History, Results, Surface

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

Floats = NDArray[np.float64]

WIDTH, PANELS = 10.0, 8.2
"""Of a picture, and of its panels without the colour bar and the numbers at the axes, inches."""
SPENT = ("kinetic", "internal", "hourglass", "contact", "friction", "damping")
"""What the external work goes into."""


class Curve(NamedTuple):
    """A curve or the cells of a panel as columns of numbers by name, all of one length; the first is drawn over."""

    case: str
    label: str
    columns: dict[str, Floats]


class Drawn(NamedTuple):
    """A picture, and its data: one table a curve."""

    picture: Picture
    data: list[Curve]


def draw(figure: Figure, runs: Sequence[Shown], title: str) -> Drawn:
    """A picture of some runs, and its data.

    Raises
    ------
    CaseError
        Where the runs do not hold what it shows.
    """
    makers: dict[str, Callable[[Figure, Sequence[Shown]], Drawn]] = {
        "field": _fields, "pressure": _pressures, "history": _histories,
    }  # fmt: skip
    drawn = makers[figure.kind](figure, runs)
    _add_legends(drawn.picture)
    drawn.picture.suptitle(figure.title or title, fontsize=11)
    return drawn


def _fields(figure: Figure, runs: Sequence[Shown]) -> Drawn:
    """A panel for each run and time; all in the same colours and the same window."""
    what = quantity(figure.quantity or "")
    frames = [(run, _frame(run.results, time)) for run in runs for time in figure.times]
    values = [what.values(frame) for _, frame in frames]
    limits = Limits(*figure.limits) if figure.limits else limits_of(np.concatenate(values), what)
    factor, unit = readable(np.array(limits), what.unit)
    box = view_box(*(frame for _, frame in frames))
    across = _columns(len(runs), len(figure.times))
    down = math.ceil(len(frames) / across)
    shape = float((box[1, 1] - box[0, 1]) / (box[1, 0] - box[0, 0]))
    size = 1.0 if across > 1 else 0.6
    picture = new_figure(size * WIDTH, (size * PANELS / across * shape + 0.45) * down + 0.8)
    picture.set_layout_engine("compressed")  # panels of one scale leave no room between them
    panels = picture.subplots(down, across, squeeze=False, sharex=True, sharey=True).ravel()
    style = {"cmap": map_of(limits, what), "clim": tuple(factor * value for value in limits)}
    data, cells = list[Curve](), list[Any]()
    for panel, (run, frame), value in zip(panels, frames, values, strict=False):
        whole = len(frame.quads)
        for corners, part in ((frame.quads, value[:whole]), (frame.triangles, value[whole:])):
            cells += [fill(panel, frame.points[corners], array=factor * part, edgecolor="face", **style)]
        lines(panel, frame.reference[frame.outline], color="0.65", linewidths=0.5, linestyles="--")
        lines(panel, frame.points[frame.outline], color="black", linewidths=0.5)
        equal_axes(panel, box)
        panel.label_outer()
        panel.set(xlim=box[:, 0], ylim=box[:, 1])
        panel.set_title(_joined(run.label, f"t = {moment(frame.time)}"), fontsize=9)
        data.append(Curve(run.label, "", _cell_columns(frame, figure.quantity or "", value)))
    for panel in panels[len(frames) :]:
        panel.set_axis_off()
    label = f"{what.label}, {unit}" if unit else what.label
    beyond = ends_beyond(np.concatenate(values), limits)
    picture.colorbar(cells[0], ax=list(panels), label=label, shrink=0.8, extend=beyond)
    return Drawn(picture, data)


def _frame(results: Results, time: float) -> FieldsFrame:
    """The frame at a time."""
    _refuse_missed(results, time)
    return results.frame(time)


def _refuse_missed(results: Results, time: float) -> None:
    """There is a frame at the time, but for a small part of the run."""
    nearest = float(results.times[results.nearest(time)])
    if abs(nearest - time) > MISSED * float(results.times[-1]):
        raise CaseError(
            f"times: {results.path} has no frame at {time:g} s, the nearest is at {nearest:g} s; choose "
            "output.fields.count such that frames fall on it"
        )


def _cell_columns(frame: FieldsFrame, name: str, values: Floats) -> dict[str, Floats]:
    """Time, current middles, m, and values, SI, of all cells."""
    x, y = (frame.means(frame.points[:, axis]) for axis in (0, 1))
    return {"time": np.full(len(values), frame.time), "x": x, "y": y, name: values}


def _pressures(figure: Figure, runs: Sequence[Shown]) -> Drawn:
    """Contact pressure over arc length: curves are runs, with a panel for each time, or the other way round."""
    data = [_pressure(figure, run, time) for run in runs for time in figure.times]
    what = "pressure_filtered" if figure.filtered else "pressure"
    values = np.concatenate([curve.columns[what] for curve in data])
    factor, unit = readable(values, "Pa")
    touched = np.concatenate([c.columns["arc_length"][c.columns[what] > 0.0] for c in data] or [np.zeros(0)])
    arcs = np.concatenate([curve.columns["arc_length"] for curve in data])
    scale, arc_unit = readable(touched if len(touched) else arcs, "m")
    by_case = (figure.curves or ("cases" if len(runs) > 1 else "times")) == "cases"
    picture, panels = _panels(data, by_case)
    for panel, curves in panels:
        for curve in curves:
            label = curve.case if by_case else curve.label
            label += "" if curve.columns[what].any() else " (no contact)"
            panel.plot(
                curve.columns["arc_length"] * scale,
                curve.columns[what] * factor,
                lw=1.2,
                marker=".",
                ms=3,
                label=label,
            )
        panel.set_xlabel(f"arc length along the undeformed surface, {arc_unit}")
        if values.min() == 0.0:
            panel.set_ylim(bottom=0.0)
        panel.set_ylabel(f"contact pressure, {unit}")
        if len(touched):
            space = 0.1 * float(np.ptp(touched)) + 1e-12
            panel.set_xlim(scale * (touched.min() - space), scale * (touched.max() + space))
    return Drawn(picture, data)


def _pressure(figure: Figure, run: Shown, time: float) -> Curve:
    """The contact pressure of a run at a time, in the order of the arc length."""
    results = run.results
    _refuse_missed(results, time)
    if not results.pairs:
        raise CaseError(f"{results.path}: the case has no contact pair")
    pair = figure.pair or results.pairs[0]
    surface, frame = results.surface(pair), results.contact(time)
    arc = arc_length(surface, figure.origin)
    order = np.argsort(arc)
    place = surface.ends.mean(axis=1)[order]
    columns = {
        "arc_length": arc[order],
        "x": place[:, 0],
        "y": place[:, 1],
        "time": np.full(len(arc), frame.time),
    }
    for name in ("pressure", "pressure_filtered"):
        columns[name] = frame.of_pair(results.pairs.index(pair), name)[surface.order][order]
    return Curve(run.label, f"t = {moment(frame.time)}", columns)


def arc_length(surface: Surface, origin: tuple[float, float] | None) -> Floats:
    """(k,) Arc length from the place nearest to an origin, m, growing to the right there.

    Without an origin it counts from the left end, on a closed surface from its leftmost place; with one, it is
    negative on the other side. So it is the same on any mesh.
    """
    corners = np.vstack([surface.ends[:, 0], surface.ends[-1:, 1]])
    length = np.hypot(*(surface.ends[:, 1] - surface.ends[:, 0]).T)
    until = np.concatenate([[0.0], np.cumsum(length)])
    if origin is not None:
        start, segment = _nearest(surface.ends, np.array(origin), until)
    else:
        leftmost = int(np.lexsort(corners.T[::-1])[0]) if surface.closed else _left_end(corners)
        start, segment = float(until[leftmost]), min(leftmost, len(length) - 1)
    arc = surface.arc - start
    direction = np.sign(surface.ends[segment, 1, 0] - surface.ends[segment, 0, 0]) or 1.0
    if surface.closed and origin is not None:
        return np.asarray(direction * (np.mod(arc + 0.5 * until[-1], until[-1]) - 0.5 * until[-1]))
    if surface.closed:
        return np.asarray(np.mod(direction * arc, until[-1]))
    return np.asarray(direction * arc)


def _left_end(corners: Floats) -> int:
    """The number of the end of an open line that lies further left."""
    return 0 if corners[0, 0] <= corners[-1, 0] else len(corners) - 1


def _nearest(ends: Floats, point: Floats, until: Floats) -> tuple[float, int]:
    """Arc length at, and number of, the segment nearest to a point."""
    along = ends[:, 1] - ends[:, 0]
    size = np.maximum(np.einsum("sk,sk->s", along, along), np.finfo(np.float64).tiny)
    part = np.clip(np.einsum("sk,sk->s", point - ends[:, 0], along) / size, 0.0, 1.0)
    away = np.hypot(*(ends[:, 0] + part[:, None] * along - point).T)
    nearest = int(np.argmin(away))
    return float(until[nearest] + part[nearest] * np.sqrt(size[nearest])), nearest


def _histories(figure: Figure, runs: Sequence[Shown]) -> Drawn:
    """Columns of history.csv: curves are runs, with a panel for each column, or the other way round."""
    data = [
        Curve(run.label, name, {"time": run.results.history.time, name: _column(run.results.history, name)})
        for run in runs
        for name in figure.columns
    ]
    by_case = (figure.curves or ("cases" if len(runs) > 1 else "columns")) == "cases"
    picture, panels = _panels(data, by_case)
    for panel, curves in panels:
        time, second = readable(max(float(c.columns["time"][-1]) for c in curves), "s")
        unit = "J/m" if curves[0].label == TOTAL else unit_of(curves[0].label)
        factor, shown = readable(np.concatenate([c.columns[c.label] for c in curves]), unit)
        for curve in curves:
            label = curve.case if by_case else curve.label.replace("_", " ")
            panel.plot(curve.columns["time"] * time, curve.columns[curve.label] * factor, lw=1.1, label=label)
        panel.set_xlabel(f"time, {second}")
        name = curves[0].label if by_case else ("energy" if unit == "J/m" else "")
        panel.set_ylabel(f"{name}, {shown}".strip(", "))
    return Drawn(picture, data)


def _column(history: History, name: str) -> Floats:
    """A column of history.csv, or the total."""
    if name == TOTAL:
        stored = np.sum([history[part] for part in SPENT], axis=0)
        return np.asarray(stored - history["external_work"])
    if name not in history:
        raise CaseError(
            f"columns: history.csv has no column {name!r}{suggestion(name, history)}; there are: {listed(history)}"
        )
    return history[name]


def _panels(data: Sequence[Curve], by_case: bool) -> tuple[Picture, list[tuple[Axes, list[Curve]]]]:
    """A figure with a panel for each time or column, or for each case, and the curves of each panel."""
    keys = list(dict.fromkeys(curve.label if by_case else curve.case for curve in data))
    across = _columns(1, len(keys))
    down = math.ceil(len(keys) / across)
    picture = new_figure(WIDTH if across > 1 else 0.8 * WIDTH, 3.4 * down + 0.6)
    panels = picture.subplots(down, across, squeeze=False).ravel()
    found = []
    for panel, key in zip(panels, keys, strict=False):
        found.append((panel, [c for c in data if (c.label if by_case else c.case) == key]))
        panel.set_title(key.replace("_", " "), fontsize=9)
        panel.grid(alpha=0.3)
    for panel in panels[len(keys) :]:
        panel.set_axis_off()
    return picture, found


def _add_legends(picture: Picture) -> None:
    """A legend in each panel that has several curves; beside them all where they have the same curves."""
    several = [panel for panel in picture.axes if len(panel.get_legend_handles_labels()[1]) > 1]
    kinds = {tuple(panel.get_legend_handles_labels()[1]) for panel in several}
    if len(several) > 1 and len(kinds) == 1:
        picture.legend(
            *several[0].get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside right upper"
        )
        return
    for panel in several:
        panel.legend(frameon=False, fontsize=8)


def _columns(runs: int, times: int) -> int:
    """Panels side by side: the times of a run, or three in a row where there is one kind only."""
    if runs > 1 and times > 1:
        return times
    count = max(runs, times)
    return 2 if count in (2, 4) else min(count, 3)


def _joined(*parts: str) -> str:
    return ", ".join(part for part in parts if part)
