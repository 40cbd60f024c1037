"""The charts of a page: histories and contact pressures as data for its script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.curve_pictures import (
    histories_of,
    history_panels,
    of_tip,
    start_of,
    surfaces_of,
    touched_range,
    unit_of,
    unrolled,
)
from phantomnode.pipeline.drawing import readable
from phantomnode.pipeline.packing import packed
from phantomnode.pipeline.results import History, Results

Floats = NDArray[np.float64]

OVERLAID = 24
"""Runs whose histories are laid over each other: more curves are not told apart."""
OVERLAY_BUDGET = 2_500_000
"""Bytes of the histories that are laid over each other, before they are packed."""


def chart(title: str, x: Floats, x_label: str, y_label: str, curves: Mapping[str, Floats]) -> dict[str, Any]:
    """One chart: its labels, (k,) places and curves, float32."""
    return {
        "title": title,
        "x": packed(x.astype(np.float32)),
        "xLabel": x_label,
        "yLabel": y_label,
        "series": [
            {"label": name, "values": packed(values.astype(np.float32))} for name, values in curves.items()
        ],
    }


def history_charts(results: Results) -> list[dict[str, Any]]:
    """Energies, forces, impulses, reactions, motion and quality over time, as far as the case has them."""
    time = results.history.time
    factor, unit = readable(float(time[-1]), "s")
    charts = []
    for what in histories_of(results):
        for label, si, curves in history_panels(results, what):
            scale, shown = readable(np.concatenate(list(curves.values())), si)
            scaled = {name: values * scale for name, values in curves.items()}
            title = label[0].upper() + label[1:]
            charts.append(chart(title, time * factor, f"time, {unit}", shown, scaled))
    return charts


def overlay(runs: Mapping[str, Path]) -> dict[str, Any] | None:
    """The columns of history.csv that several runs have in common, as data for one chart over all of them.

    Of long histories every so-maniest row is taken, so that the page stays small, and of many runs the first.
    None where fewer than two runs have a history.
    """
    files = {name: folder / "history.csv" for name, folder in runs.items()}
    there = {name: file for name, file in files.items() if file.is_file()}
    histories = {name: History(file) for name, file in list(there.items())[:OVERLAID]}
    histories = {name: history for name, history in histories.items() if len(history.time) > 1}
    if len(histories) < 2:
        return None
    first, *others = histories.values()
    columns = [name for name in first if name != "time" and all(name in other for other in others)]
    numbers = sum(len(history.time) for history in histories.values()) * (len(columns) + 1)
    every = -(-4 * numbers // OVERLAY_BUDGET)
    factor, unit = readable(max(float(history.time[-1]) for history in histories.values()), "s")
    return {
        "xLabel": f"time, {unit}",
        "note": _overlay_note(every, len(histories), len(there)),
        "columns": [f"{name}, {si}" if (si := unit_of(name)) else name for name in columns],
        "runs": [
            {
                "name": name,
                "x": packed((history.time[::every] * factor).astype(np.float32)),
                "values": [packed(history[column][::every].astype(np.float32)) for column in columns],
            }
            for name, history in histories.items()
        ],
    }


def _overlay_note(every: int, shown: int, there: int) -> str:
    """What the chart leaves out."""
    rows = f", one row in {every}" if every > 1 else ""
    runs = f" Shown are the first {shown} of {there}." if shown < there else ""
    return f"Of each run its history.csv{rows}; a click on a name hides its curve.{runs}"


def pressure_charts(results: Results, times: Sequence[float]) -> list[dict[str, Any]]:
    """The contact pressure of each pair over arc length at some times, (frames, segments)."""
    frames = [results.contact(time) for time in times] if results.pairs else []
    charts = []
    for number, pair in enumerate(results.pairs):
        along = results.surface(pair)
        smooth = np.stack([f.of_pair(number, "pressure_filtered")[along.order] for f in frames])
        tip = of_tip([f.of_pair(number, "pressure") for f in frames])
        along, order = unrolled(along, smooth.max(axis=0) > 0.0)
        factor, unit = readable(smooth, "Pa")
        arc_factor, arc_unit = readable(along.length, "m")
        x = along.arc * arc_factor
        charts.append(
            {
                "title": f"Contact pressure of {pair} along {surfaces_of(results, pair)}",
                "x": packed(x.astype(np.float32)),
                "xRange": touched_range(x, smooth[:, order].max(axis=0)),
                "xLabel": f"arc length, {arc_unit}",
                "yLabel": unit,
                "note": f"Through the hat filter, on the undeformed surface, 0 at "
                f"{start_of(along, arc_factor, arc_unit)}{'; ' if tip else ''}{tip}.",
                "largest": float(smooth.max() * factor),
                "frames": packed((smooth[:, order] * factor).astype(np.float32)),
            }
        )
    return charts
