"""``phantomnode plot`` and ``animate``: which picture is meant, and the files that they become."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.curve_pictures import HISTORIES, bearing_times, draw_history, draw_pressure
from phantomnode.pipeline.drawing import FORMATS, moment, readable, save
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.field_pictures import Limits, draw_field
from phantomnode.pipeline.messages import listed, suggestion
from phantomnode.pipeline.quantities import QUANTITIES
from phantomnode.pipeline.results import NAMED, Results, Time

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PRESSURE, LEVEL_SET, NODES = "contact_pressure", "level_set", "nodes"
KNOWN = (*QUANTITIES, PRESSURE, *HISTORIES, LEVEL_SET, NODES)
"""All pictures, beside those of single columns of history.csv."""
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
NEAR = 1e-6
"""A time may be beyond the last frame by this part of the run."""

SAME = 0.05
"""Of the time between two frames: one that is no farther from the time that was asked for is not told as another."""


def picture(
    results: Results,
    what: str,
    times: Sequence[Time] = ("peak",),
    *,
    pair: str | None = None,
    limits: tuple[float, float] | None = None,
    box: Sequence[float] | None = None,
    smooth: bool = False,
) -> Figure:
    """One picture of a run; of fields at the first of the times.

    Parameters
    ----------
    results : Results
    what : str
        A field, ``contact_pressure``, one of ``HISTORIES``, a column of history.csv, ``level_set`` or ``nodes``.
    times : sequence of float, s, or "start", "peak", "end"
    pair : str, optional
        The contact pair, where there are several; the first unless given.
    limits : (float, float), SI, optional
        Of the colours of a field.
    box : (x0, y0, x1, y1), m, optional
        What is shown of the bodies.
    smooth : bool
        Draw fields as means over neighbouring cells.

    Raises
    ------
    CaseError
        Naming the pictures that there are.
    """
    corners, span = box_from(box), limits_from(limits)
    if what in QUANTITIES:
        return draw_field(
            results.frame(times[0]), what, results.title, limits=span, box=corners, smooth=smooth
        )
    if what == PRESSURE:
        if not results.pairs:
            raise CaseError(f"{results.path}: the case has no contact pair")
        return draw_pressure(results, pair or results.pairs[0], times)
    if what in (LEVEL_SET, NODES):
        from phantomnode.pipeline.mesh_pictures import draw_level_sets, draw_nodes

        draw = draw_level_sets if what == LEVEL_SET else draw_nodes
        return draw(results.prepared, results.title, corners)
    if what in HISTORIES or what in results.history:
        return draw_history(results, what)
    raise CaseError(_no_picture(results, what))


def _no_picture(results: Results, what: str) -> str:
    """That there is no such picture, and which there are."""
    near = suggestion(what, (*KNOWN, *results.history))
    return f"--what {what}: is no picture{near}; there are: {listed(KNOWN)}, and the columns of history.csv"


def box_from(box: Sequence[float] | None) -> NDArray[np.float64] | None:
    """(2, 2) Corners of what is shown, from x0, y0, x1, y1; None for all.

    Raises
    ------
    CaseError
        Where they span no area.
    """
    if box is None:
        return None
    corners = np.array(box, dtype=np.float64).reshape(2, 2)
    if not np.all(corners[0] < corners[1]):
        raise CaseError(
            f"--zoom {' '.join(f'{value:g}' for value in box)}: write x0 y0 x1 y1 with x0 < x1, y0 < y1"
        )
    return corners


def limits_from(limits: tuple[float, float] | None) -> Limits | None:
    """The values at the ends of the colours; None for those of the field.

    Raises
    ------
    CaseError
        Where the first is not below the second.
    """
    if limits is None:
        return None
    if not limits[0] < limits[1]:
        raise CaseError(f"--range {limits[0]:g} {limits[1]:g}: the first value must be below the second")
    return Limits(*limits)


def plot_files(
    results: Results,
    what: Sequence[str],
    times: Sequence[Time],
    out: Path | None,
    *,
    pair: str | None = None,
    limits: tuple[float, float] | None = None,
    box: Sequence[float] | None = None,
    smooth: bool = False,
) -> list[tuple[Path, str]]:
    """Write pictures of a run.

    Parameters
    ----------
    times : sequence of float, s, or "start", "peak", "end"
        Empty: fields at the peak, and the contact pressure at some times at which the pair bears.
    out : Path, optional
        A file, where it ends in .png, .svg or .pdf (numbered where there are several pictures), else a folder; that
        of the run unless given.

    Returns
    -------
    list of (Path, str)
        The files, and what is to be said of each: the time of a frame that is not the one asked for.

    Raises
    ------
    CaseError
        Where something asked for does not exist.
    """
    for one in what:  # all of them, before the first one is drawn
        if one not in KNOWN and one not in results.history:
            raise CaseError(_no_picture(results, one))
    for time in times:
        _in_the_run(results, time)
    written = []
    wanted = [(one, [time]) for one in what if one in QUANTITIES for time in times or ("peak",)]
    wanted += [(one, list(times) or _own_times(results, one, pair)) for one in what if one not in QUANTITIES]
    for number, (one, at) in enumerate(wanted):
        named = at if one in QUANTITIES or (one == PRESSURE and times) else []
        parts = [
            one,
            *([pair] if pair and one == PRESSURE else []),
            *(_time_named(results, time) for time in named),
        ]
        path = _path_of(results, parts, out, number, len(wanted))
        figure = picture(results, one, at, pair=pair, limits=limits, box=box, smooth=smooth)
        path.parent.mkdir(parents=True, exist_ok=True)
        save(figure, path)
        timed = one in QUANTITIES or one == PRESSURE
        written.append((path, _said_of(results, at) if timed else ""))
    return written


def _in_the_run(results: Results, time: Time) -> None:
    """Refuse a time that the run has not, or not yet."""
    if isinstance(time, str):
        return
    last = float(results.times[results.nearest("end")])
    if not -NEAR * last <= time <= (1.0 + NEAR) * last:
        raise CaseError(f"--time {time:g}: frames go from 0 to {last:.7g} s ({_exact(last)})")


def _own_times(results: Results, what: str, pair: str | None) -> list[Time]:
    """The times of a picture where none are asked for: of the contact pressure those at which the pair bears."""
    name = pair or (results.pairs[0] if results.pairs else None)
    if what != PRESSURE or name not in results.pairs:
        return ["peak"]
    return [*bearing_times(results, name)] or ["peak"]


def parse_time(text: str) -> Time:
    """A time as the user wrote it: seconds, with or without a unit ("4.5 ms"), "start", "peak" or "end".

    Raises
    ------
    CaseError
        Saying what can be written.
    """
    clean = text.strip()
    if clean in NAMED:
        return clean
    number, unit = clean, "s"
    for suffix in sorted(SECONDS, key=len, reverse=True):
        if clean.endswith(suffix):
            number, unit = clean.removesuffix(suffix), suffix
            break
    try:
        time = float(number) * SECONDS[unit]
    except ValueError:
        time = np.nan
    if not np.isfinite(time):
        raise CaseError(f'--time {text}: write seconds, "4.5 ms", or {listed(NAMED)}')
    return time


def _time_named(results: Results, time: Time) -> str:
    """The time of a frame, for the name of a file: "4.5ms"."""
    return moment(results.times[results.nearest(time)]).replace(" ", "").replace("µ", "u")


def _path_of(results: Results, parts: Sequence[str], out: Path | None, number: int, count: int) -> Path:
    """The file of a picture, named after what it shows, which pair, and which times."""
    if out is not None and out.suffix.lower().removeprefix(".") in FORMATS:
        return out if count == 1 else out.with_name(f"{out.stem}-{number + 1}{out.suffix}")
    if out is not None and out.suffix:
        raise CaseError(f"--out {out}: pictures end in {listed('.' + name for name in FORMATS)}")
    return (out or results.path) / f"plot.{'.'.join(parts)}.png"


def _exact(time: float) -> str:
    """A time to seven digits, by which neighbouring frames differ: "105.0102 µs"."""
    factor, unit = readable(time, "s")
    return f"{time * factor:.7g} {unit}"


def _said_of(results: Results, times: Sequence[Time]) -> str:
    """When the peak is, and which frames are drawn in place of times that have none."""
    told = []
    for time in times:
        if time == "peak":
            found = float(results.times[results.nearest(time)])
            told.append(f"{moment(found)}: the frame of the largest internal energy; --time chooses another")
        elif not isinstance(time, str):
            found = float(results.times[results.nearest(time)])
            if abs(found - time) > SAME * float(results.times[-1]) / max(len(results.times) - 1, 1):
                told.append(f"{_exact(time)}: no frame; drawn is the nearest, {_exact(found)}")
    return "; ".join(told)
