"""``[figure.NAME]`` drawn: figure.NAME.png, and its data as figure.NAME.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phantomnode.pipeline.drawing import save
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.figure_pictures import Curve, draw
from phantomnode.pipeline.figure_sources import chosen, figures_in
from phantomnode.pipeline.files import write_atomically


def draw_figures(folder: Path, out: Path | None = None) -> list[Path]:
    """Draw all figures that the case or the sweep of a results folder asks for, of the cases that are done.

    Parameters
    ----------
    folder : Path
        Of a run, or of a batch.
    out : Path, optional
        Of the pictures and tables, made where it is missing; the folder itself unless given.

    Returns
    -------
    list of Path
        The pictures, each with its data beside it; none of a figure of which no case is done.

    Raises
    ------
    CaseError
        Where the folder holds no results, or a figure asks for what they do not hold; it names the figure.
    """
    figures, sources, title = figures_in(folder)
    pictures, target = [], out or folder
    target.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        runs = chosen(figure, sources)
        if not runs:
            continue
        try:
            drawn = draw(figure, runs, title)
        except CaseError as error:
            raise CaseError([f"figure.{name}: {message}" for message in error.messages]) from error
        pictures.append(target / f"figure.{name}.png")
        save(drawn.picture, pictures[-1])
        write_atomically(pictures[-1].with_suffix(".csv"), _table(drawn.data))
    return pictures


def _table(data: list[Curve]) -> str:
    """One row a value: the case, then its columns; curves over the same first column stand side by side."""
    blocks: dict[str, dict[str, np.ndarray]] = {}
    for number, curve in enumerate(data):
        tied = curve.label in curve.columns  # a history: its columns share the times of the run
        blocks.setdefault(curve.case if tied else f"{curve.case}\n{number}", {}).update(curve.columns)
    columns = list(dict.fromkeys(name for block in blocks.values() for name in block))
    lines = [",".join(("case", *columns))]
    for key, block in blocks.items():
        case = key.partition("\n")[0]
        case = f'"{case}"' if "," in case else case
        rows = zip(*(block[name].tolist() for name in columns), strict=True)
        lines += [",".join((case, *map(repr, row))) for row in rows]
    return "\n".join(lines) + "\n"
