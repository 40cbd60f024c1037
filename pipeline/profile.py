"""Profiles: a quantity along a straight line at given times, as profile.NAME.csv and as a picture of several runs."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from phantomnode.pipeline.checkpoint import Tree
from phantomnode.pipeline.clip import ClippedBodies
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.fields import cell_fields
from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.observer import Sampled
from phantomnode.pipeline.prepare import Floats, Ints, Prepared
from phantomnode.solver.stress import States

if TYPE_CHECKING:
    from phantomnode.pipeline.schema import Profile
    from phantomnode.solver.explicit import Frame

TOUCH = 1e-6
"""Pieces of the line shorter than this part of it only touch a cell."""

PLACE_COLUMNS = 3
"""Columns of a profile's table that tell the place."""


class Stations(NamedTuple):
    """Where a line runs through the undeformed bodies, in its direction.

    cell (s,) the drawn cell (:class:`ClippedBodies`) at each station; distance (s,) from the start of the line to
    the middle of its piece in that cell, m; point (s, 2), m.
    """

    cell: Ints
    distance: Floats
    point: Floats


def stations(prepared: Prepared) -> dict[str, Stations]:
    """The stations of every profile of a case.

    Raises
    ------
    CaseError
        Where a line meets no body.
    """
    profiles = prepared.case.output.profile
    if not profiles:
        return {}
    clipped = ClippedBodies.of(prepared)
    points = clipped.interpolate(prepared.model.x)
    corners = np.concatenate([points[clipped.quads], points[clipped.triangles[:, [0, 1, 2, 2]]]])
    found = {name: _along(np.array(profile.line), corners) for name, profile in profiles.items()}
    for name, line in found.items():
        if len(line.cell) == 0:
            raise CaseError(
                f"output.profile.{name}.line: meets no body; it is drawn on the undeformed bodies"
            )
    return found


def _along(line: Floats, corners: Floats) -> Stations:
    """The cells, (m, 4, 2) counter-clockwise corners, along a line (2, 2): clipped edge by edge (Cyrus, Beck)."""
    start, along = line[0], line[1] - line[0]
    edge = np.roll(corners, -1, axis=1) - corners
    inward = np.stack([-edge[..., 1], edge[..., 0]], axis=-1)
    inside = np.einsum("mka,mka->mk", inward, start - corners)  # of the start; grows by `rate` along the line
    rate = inward @ along
    flat = np.abs(rate) <= TOUCH * np.hypot(*along) * np.hypot(inward[..., 0], inward[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = -inside / rate
    enter = np.where(~flat & (rate > 0.0), meets, 0.0).max(axis=1).clip(min=0.0)
    leave = np.where(~flat & (rate < 0.0), meets, 1.0).min(axis=1).clip(max=1.0)
    outside = np.any(flat & (inside < 0.0), axis=1)
    cell = np.flatnonzero(~outside & (leave - enter > TOUCH))
    middle = 0.5 * (enter + leave)[cell]
    order = np.lexsort([cell, np.round(middle, 6)])
    cell, middle = cell[order], middle[order]
    # A line along the edge of two cells runs through both: the first of them stands for the piece.
    first = np.diff(middle, prepend=-1.0) > TOUCH
    cell, middle = cell[first], middle[first]
    return Stations(cell, middle * float(np.hypot(*along)), start + middle[:, None] * along)


def profile_steps(prepared: Prepared, profile: Profile) -> list[int]:
    """The steps nearest to the times of a profile."""
    return [round(time / prepared.dt) for time in profile.times]


class ProfileWriter(Sampled):
    """Writes profile.NAME.csv: distance, x, y, and a column for each of its times.

    Parameters
    ----------
    prepared : Prepared
    name : str
        Of the profile in the case.
    line : Stations
    folder : Path
        The results folder.
    saved : dict or None
        Go on from what :meth:`saved` gave.
    """

    def __init__(
        self, prepared: Prepared, name: str, line: Stations, folder: Path, saved: Tree | None = None
    ) -> None:
        profile = prepared.case.output.profile[name]
        super().__init__(frozenset(profile_steps(prepared, profile)))
        self._prepared, self._line, self._quantity = prepared, line, profile.quantity
        self._path = folder / f"profile.{name}.csv"
        self._clipped = ClippedBodies.of(prepared)
        self._columns: dict[str, Floats] = {"distance": line.distance, "x": line.point[:, 0]}
        self._columns["y"] = line.point[:, 1]
        if saved is not None:
            self._seen = saved["seen"]
            self._columns |= saved["columns"]
            self._path.unlink(missing_ok=True)
            if len(self._columns) > PLACE_COLUMNS:
                self._write()

    def take(self, frame: Frame) -> None:
        """Add a column, where the frame is one of the profile's times, and write the file anew."""
        if not self.due(frame.step):
            return
        values = quantity(cell_fields(self._prepared, self._clipped, frame.u), self._quantity)
        self._columns[f"{self._quantity} at {frame.time!r} s"] = values[self._line.cell]
        self._write()

    def reach_disk(self) -> None:
        """It does, with every column."""

    def saved(self) -> Tree:
        """The columns so far."""
        return {"seen": self._seen, "columns": dict(self._columns)}

    def _write(self) -> None:
        rows = zip(*(column.tolist() for column in self._columns.values()), strict=True)
        lines = [",".join(self._columns), *(",".join(map(repr, row)) for row in rows)]
        write_atomically(self._path, "\n".join(lines) + "\n")


def quantity(state: States, name: str) -> Floats:
    """(m,) One quantity of every drawn cell."""
    if name == "von_mises":
        return np.asarray(state.mises, np.float64)
    if name == "J":
        return np.asarray(state.j, np.float64)
    column = ("stress_xx", "stress_yy", "stress_zz", "stress_xy").index(name)
    return np.asarray(state.cauchy[:, column], np.float64)


def draw_profiles(runs: Mapping[str, Path], out: Path) -> list[Path]:
    """Draw the profiles of several runs over each other, one picture for each name of a profile.

    Parameters
    ----------
    runs : mapping of str to Path
        Results folders by the labels of their curves.
    out : Path
        The folder of the pictures, profile.NAME.png.

    Returns
    -------
    list of Path
        The pictures.
    """
    names = sorted({file.stem for folder in runs.values() for file in folder.glob("profile.*.csv")})
    return [_draw(name, runs, out / f"{name}.png") for name in names]


def read_profile(path: Path) -> tuple[Floats, dict[str, Floats]]:
    """(s,) Distances, m, and the (s,) values by the names of their columns."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    table = np.array(rows, dtype=np.float64).T
    return table[0], dict(zip(header[3:], table[3:], strict=True))


def _draw(name: str, runs: Mapping[str, Path], path: Path) -> Path:
    """One picture, with the times side by side."""
    from phantomnode.pipeline.drawing import moment, new_figure, readable, save

    found = {label: folder / f"{name}.csv" for label, folder in runs.items()}
    curves = {label: read_profile(file) for label, file in found.items() if file.exists()}
    times = max(len(columns) for _, columns in curves.values())
    what = next(column.partition(" at ")[0] for _, columns in curves.values() for column in columns)
    along, length = readable(max(float(distance[-1]) for distance, _ in curves.values()), "m")
    values = [column for _, columns in curves.values() for column in columns.values()]
    scale, unit = readable(np.concatenate(values), "" if what == "J" else "Pa")
    figure = new_figure(5.0 * times, 5.5)
    figure.suptitle(f"{name.removeprefix('profile.')}: {what.replace('_', ' ')} along a line", fontsize=11)
    for number, axes in enumerate(figure.subplots(1, times, sharey=True, squeeze=False)[0]):
        for place, (label, (distance, columns)) in enumerate(curves.items()):
            if number < len(columns):
                column = list(columns)[number]
                # The case itself lies broad and pale under its variants.
                style = {"lw": 2.4, "color": "0.6"} if place == 0 and len(curves) > 1 else {"lw": 1.0}
                axes.plot(along * distance, scale * columns[column], label=label, **style)
                axes.set_title(f"t = {moment(float(column.partition(' at ')[2].removesuffix(' s')))}")
                axes.set_ylabel((what + (f", {unit}" if unit else "")) if number == 0 else "")
        axes.set_xlabel(f"distance along the line, {length}")
        axes.grid(alpha=0.3)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    save(figure, path)
    return path
