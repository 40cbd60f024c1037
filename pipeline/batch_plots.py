"""Pictures of a batch: an output over an axis, a curve for each choice of the other axes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phantomnode.pipeline.ledger import Ledger
from phantomnode.pipeline.names import said
from phantomnode.pipeline.one_case import DONE
from phantomnode.pipeline.outputs import in_words, named, output_of, unit_of, unit_of_key
from phantomnode.pipeline.sweep import Plot

MOST_LABELS = 12
"""Curves that a legend can name."""

Curves = dict[str, list[tuple[Any, float]]]


def draw_plots(ledger: Ledger, folder: Path) -> list[Path]:
    """Draw the pictures that a sweep asks for, of the cases that are done.

    Parameters
    ----------
    ledger : Ledger
    folder : Path
        Of the pictures, plot.NAME.png.

    Returns
    -------
    list of Path
        The pictures; none of one for which no case is done.
    """
    pictures = []
    for name, plot in ledger.study.sweep.plot.items():
        if found := curves(ledger, plot):
            pictures.append(folder / f"plot.{name}.png")
            _draw(plot, found, _x_unit(ledger, plot), ledger.study.sweep.title, pictures[-1])
    return pictures


def curves(ledger: Ledger, plot: Plot) -> Curves:
    """The points of each curve, by its label, in the order of the axis; random axes make no curves of their own."""
    axes, together = (
        ledger.study.sweep.axis,
        {plot.x}.union(*(g for g in ledger.study.sweep.zip if plot.x in g)),
    )
    others = [
        name
        for name, axis in axes.items()
        if name not in together
        and not axis.random
        and len({said(point.values[name]) for point in ledger.study.points}) > 1
    ]
    found: Curves = {}
    for point, outcome in zip(ledger.study.points, ledger.outcomes, strict=True):
        y = output_of(outcome.figures, plot.y) if outcome.status == DONE else None
        if y is not None:
            label = ", ".join(f"{name} {said(point.values[name])}" for name in others)
            found.setdefault(label, []).append((point.values[plot.x], y))
    return {label: sorted(points) if _numeric(points) else points for label, points in found.items()}


def _numeric(points: Sequence[tuple[Any, float]]) -> bool:
    """Whether the places along the axis are numbers; texts and lists stand side by side."""
    return all(isinstance(x, int | float) for x, _ in points)


def _x_unit(ledger: Ledger, plot: Plot) -> str:
    """The unit of the axis along which a picture goes, where its values are numbers."""
    axis = ledger.study.sweep.axis[plot.x]
    return "" if axis.names else unit_of_key(axis.paths[0])


def _draw(plot: Plot, found: Curves, x_unit: str, title: str, path: Path) -> None:
    """One picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from phantomnode.pipeline.drawing import readable, save

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    factor, unit = readable(np.array([y for points in found.values() for _, y in points]), unit_of(plot.y))
    for label, points in found.items():
        x = [value if _numeric(points) else said(value) for value, _ in points]
        axes.plot(x, [factor * y for _, y in points], marker="o", markersize=4.0, linewidth=1.0, label=label)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set(xlabel=named(in_words(plot.x), x_unit), ylabel=named(in_words(plot.y), unit), title=title)
    for direction in plot.log:
        getattr(axes, f"set_{direction}scale")("log")
    if 1 < len(found) <= MOST_LABELS:
        axes.legend(fontsize="small")
    save(figure, path)
