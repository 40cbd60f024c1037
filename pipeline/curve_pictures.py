"""Curves: contact pressure along a surface, energies, forces and motion over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.drawing import moment, new_figure, readable
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.messages import listed, suggestion
from phantomnode.pipeline.results import History, Results, Surface, Time

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Curves = Mapping[str, Floats]

BEARING = 4
"""Curves in the picture of the contact pressure, where no times are asked for."""
BESIDE = 0.15
"""Of the length of the touched stretch of a surface, shown on either side of it."""
LEVEL = 1e-6
"""Of the length of a surface: places that differ by less are at one height."""
NOTHING = 1e-6
"""Of the largest value of some curves: what stays below it is zero to the eye."""
FEW = 40
"""Segments that ever bear, up to which each one has a mark."""
TIP = 3
"""Segments that bear where the sum of the pressures is largest, up to which it is a tip that bears."""
ENERGIES = {
    "kinetic": "kinetic",
    "internal": "internal",
    "hourglass": "hourglass",
    "contact": "contact (springs)",
    "friction": "dissipated by friction",
    "damping": "dissipated by damping",
    "external_work": "external work",
}
HISTORIES = ("energies", "forces", "impulses", "reactions", "motion", "quality")
"""The pictures of histories; any column of history.csv is one too."""


def draw_pressure(results: Results, pair: str, times: Sequence[Time]) -> Figure:
    """Contact pressure over the arc length of the undeformed slave surface of a pair, a curve for each time.

    The line is the pressure through the hat filter; pale behind it that of each segment.
    """
    along, number = results.surface(pair), results.pairs.index(pair)
    frames = [results.contact(time) for time in times]
    raw = [frame.of_pair(number, "pressure")[along.order] for frame in frames]
    smooth = [frame.of_pair(number, "pressure_filtered")[along.order] for frame in frames]
    along, order = unrolled(along, np.max([*raw, *smooth], axis=0) > 0.0)
    arc_factor, arc_unit = readable(along.length, "m")
    factor, unit = readable(np.array(smooth), "Pa")

    figure = new_figure(8.0, 4.5)
    axes = figure.add_subplot()
    breaks = np.flatnonzero(np.diff(along.chain)) + 1
    x = np.insert(along.arc * arc_factor, breaks, np.nan)
    few = int(np.sum(np.max(smooth, axis=0) > 0.0)) <= FEW
    for frame, rough, fine in zip(frames, raw, smooth, strict=True):
        curve, label = np.insert(fine[order] * factor, breaks, np.nan), f"t = {moment(frame.time)}"
        (line,) = axes.plot(x, curve, lw=1.6, marker="o" if few else None, ms=3.5, label=label)
        axes.plot(
            x, np.insert(rough[order] * factor, breaks, np.nan), lw=0.7, alpha=0.4, color=line.get_color()
        )
    axes.set_xlim(touched_range(x, np.insert(np.max([*raw, *smooth], axis=0)[order], breaks, 0.0)))
    axes.set_ylim(bottom=0.0)
    place = start_of(along, arc_factor, arc_unit)
    axes.set_xlabel(f"arc length along the undeformed surface, {arc_unit}; 0 at {place}")
    axes.set_ylabel(f"contact pressure, {unit}")
    explained = "line: through the hat filter, pale: of each segment" + (
        "\n" + told if (told := of_tip(raw)) else ""
    )
    axes.set_title(f"{results.title}: {pair} on {surfaces_of(results, pair)}\n{explained}", fontsize=10)
    axes.legend(frameon=False, fontsize=9)
    axes.grid(alpha=0.3)
    return figure


def of_tip(pressure: Sequence[Floats]) -> str:
    """What is to be said of the (k,) pressures of the segments at some times: nothing, unless a tip bears."""
    most = max(pressure, key=lambda one: float(one.sum()))
    if not 0 < np.count_nonzero(most) <= TIP:
        return ""
    return "a tip bears on a segment or two: its pressure depends on the cells, force and impulse do not"


def bearing_times(results: Results, pair: str) -> list[float]:
    """Times of frames, s, in which a pair bears, spread over its contact, and that of the largest force."""
    history = results.history
    size = np.hypot(history[f"contact.{pair}.fx"], history[f"contact.{pair}.fy"])
    force = np.interp(results.times, history.time, size)
    bearing = np.flatnonzero(force > 0.01 * force.max()) if force.max() > 0.0 else np.zeros(0, dtype=int)
    if len(bearing) == 0:
        return []
    spread = bearing[np.linspace(0, len(bearing) - 1, BEARING).astype(int)]
    return [float(results.times[k]) for k in sorted({*spread.tolist(), int(np.argmax(force))})]


def surfaces_of(results: Results, pair: str) -> str:
    """Which surfaces of a pair have a pressure: in two passes both."""
    table = results.table["contact"][pair]
    return f"{table['slave']} and {table['master']}" if table.get("passes") == 2 else str(table["slave"])


def start_of(along: Surface, factor: float, unit: str) -> str:
    """Where the arc length is zero, in a unit, without what is only rounding: "(0.5, 1.32) m"."""
    place = np.where(np.abs(along.start) > 1e-9 * along.length, along.start, 0.0)
    x, y = factor * place
    return f"({x:.4g}, {y:.4g}) {unit}"


def unrolled(along: Surface, touched: NDArray[np.bool_]) -> tuple[Surface, NDArray[np.int64]]:
    """A closed surface cut open in the middle of its longest stretch without contact, and its new order.

    Its arc length is zero at its lowest place (the leftmost of them) wherever it is cut, so that runs of one part can
    be compared. ``touched`` (k,) tells of each segment along the surface whether it ever bears.
    """
    order = np.arange(len(along.arc))
    on = np.flatnonzero(touched)
    if not along.closed or along.chain[-1] > 0 or len(on) == 0:
        return along, order
    gaps = np.mod(np.diff(along.arc[np.append(on, on[0])]), along.length)
    gaps[gaps == 0.0] = along.length
    widest = int(np.argmax(gaps))
    seam = np.mod(along.arc[on[widest]] + 0.5 * gaps[widest], along.length)
    arc = np.mod(along.arc - seam, along.length)
    order = np.argsort(arc)
    place, at = _lowest(along)
    return along._replace(arc=arc[order] - np.mod(at - seam, along.length), start=place), order


def _lowest(along: Surface) -> tuple[Floats, float]:
    """(2,) The lowest corner of a surface, m, the leftmost of them to rounding, and its arc length."""
    corners = along.ends[:, 0]
    until = np.cumsum(np.hypot(*(along.ends[:, 1] - along.ends[:, 0]).T))
    level = np.round((corners[:, 1] - corners[:, 1].min()) / (LEVEL * along.length))
    lowest = int(np.lexsort((corners[:, 0], level))[0])
    return corners[lowest], float(until[lowest - 1]) if lowest else 0.0


def touched_range(x: Floats, pressure: Floats) -> tuple[float, float]:
    """The stretch of (k,) places that ever bears, and a little beside it; all where nothing does."""
    on, first, last = x[pressure > 0.0], float(np.nanmin(x)), float(np.nanmax(x))
    if len(on) == 0:
        return first, last
    low, high = float(on.min()), float(on.max())
    space = max(BESIDE * (high - low), 0.01 * (last - first))
    return max(low - space, first), min(high + space, last)


def draw_history(results: Results, what: str) -> Figure:
    """Curves over time: one of ``HISTORIES``, or a column of history.csv.

    Raises
    ------
    CaseError
        Naming what there is.
    """
    history = results.history
    panels = history_panels(results, what)
    figure = new_figure(9.5, 1.2 + 3.2 * len(panels))
    factor, unit = readable(float(history.time[-1]), "s")
    column = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (label, si, curves) in zip(column, panels, strict=True):
        scale, shown = readable(np.concatenate(list(curves.values())), si)
        for name, values in curves.items():
            axes.plot(history.time * factor, values * scale, lw=1.2, label=name)
        axes.set_ylabel(f"{label}, {shown}" if shown else label)
        axes.grid(alpha=0.3)
        axes.legend(
            frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0)
        )  # beside the curves
    column[-1].set_xlabel(f"time, {unit}")
    column[0].set_title(results.title, fontsize=10)
    return figure


def history_panels(results: Results, what: str) -> list[tuple[str, str, Curves]]:
    """Label, SI unit and curves of each panel of a picture."""
    history = results.history
    if what == "energies":
        return [("energy", "J/m", energies(history))]
    if what == "forces":
        return [("contact force on the slave", "N/m", _components(history, "contact", "f", results))]
    if what == "impulses":
        return [("impulse on the slave", "N s/m", _components(history, "contact", "i", results))]
    if what == "reactions":
        return [("force of the boundary on its body", "N/m", _components(history, "reaction", "f", results))]
    if what == "motion":
        return [
            ("displacement of the centre of mass", "m", _components(history, "body", "u", results)),
            ("velocity of the centre of mass", "m/s", _components(history, "body", "v", results)),
        ]
    if what == "quality":
        return [
            ("energy error over the largest energy", "", {"energy error": history["energy_error"]}),
            ("smallest J", "", {"smallest J": history["smallest_j"]}),
            ("stable step over the step taken", "", _steps(results)),
        ]
    if what in history:
        return [(what, unit_of(what), {what: history[what]})]
    known = (*HISTORIES, *history)
    raise CaseError(f"{what!r} is no history{suggestion(what, known)}; there are: {listed(known)}")


def histories_of(results: Results) -> list[str]:
    """Those of ``HISTORIES`` that a run has: not every case has contact pairs or boundaries."""
    there = {
        "forces": bool(results.pairs),
        "impulses": bool(results.pairs),
        "reactions": bool(_held(results)),
        "quality": "dt" in results.summary,
    }
    return [what for what in HISTORIES if there.get(what, True)]


def _held(results: Results) -> list[str]:
    """Columns of reactions but those of obstacles, which bear what their contact pairs give them."""
    obstacles = results.table.get("rigid", {})
    return [name for name in results.history.names("reaction.") if name.split(".")[1] not in obstacles]


def energies(history: History) -> dict[str, Floats]:
    """Energies that are not zero throughout, and their balance, J/m."""
    curves = {label: history[name] for name, label in ENERGIES.items() if np.any(history[name])}
    stored = ("kinetic", "internal", "hourglass", "contact", "friction", "damping")
    curves["sum less external work"] = (
        np.sum([history[name] for name in stored], axis=0) - history["external_work"]
    )
    return curves


def _steps(results: Results) -> Curves:
    """The stable step of the deformed state over the step that the run takes."""
    stable = results.history["stable_step"]
    step = results.summary.get("dt")
    if step is None:
        raise CaseError(f"{results.path}: the run has not ended (no summary.json); its step is not known yet")
    return {"stable in the deformed state": stable / step, "taken": np.ones_like(stable)}


def _components(history: History, kind: str, letter: str, results: Results) -> dict[str, Floats]:
    """The x and y columns of a kind of thing, by readable labels, but for those that stay at zero.

    Raises
    ------
    CaseError
        Where the run has none.
    """
    names = [name for name in history.names(f"{kind}.") if name.endswith((f".{letter}x", f".{letter}y"))]
    if not names:
        missing = {"contact": "contact pairs", "reaction": "boundaries", "body": "bodies"}[kind]
        raise CaseError(f"{results.path}: the case has no {missing}")
    largest = max(float(np.max(np.abs(history[name]))) for name in names)
    shown = [name for name in names if np.max(np.abs(history[name])) > NOTHING * largest] or names
    return {f"{name.split('.')[1]}, {name[-1]}": history[name] for name in shown}


def unit_of(column: str) -> str:
    """The SI unit of a column of history.csv."""
    if column in (*ENERGIES,):
        return "J/m"
    if column in ("time", "stable_step"):
        return "s"
    kind, _, value = column.rpartition(".")
    if kind.startswith("body."):
        return {"u": "m", "v": "m/s", "c": "m", "p": "kg/s", "l": "kg m/s"}[value[0]]
    return {"f": "N/m", "t": "N/m", "i": "N s/m"}.get(value[0], "") if kind else ""
