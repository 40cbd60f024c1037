"""The results of a run, from its folder: summary, history, frames, contact surfaces, pictures."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.drawing import moment
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.frames import ContactFrame, FieldsFrame
from phantomnode.pipeline.messages import listed, suggestion
from phantomnode.pipeline.outlines import chains
from phantomnode.pipeline.places import RESULTS
from phantomnode.pipeline.vtu_reader import read_pvd

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from phantomnode.pipeline.case import Case
    from phantomnode.pipeline.prepare import Prepared

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Time = float | str
"""A time, s, or one of the ``NAMED`` times."""

NAMED = ("start", "peak", "end")
"""The first frame, that of the largest internal energy, the last one."""


BEYOND = 1e-6
"""Of the run: by so much a time may be beyond its last frame."""

LISTED = 6
"""Folders that a message names."""


def open_results(folder: str | Path) -> Results:
    """The results of a run, read from its folder as they are asked for; also while the run goes on.

    Parameters
    ----------
    folder : str or Path
        As ``"results/ring_impact"``.

    Raises
    ------
    CaseError
        Where the folder holds no results of a run.

    Examples
    --------
    >>> results = open_results("results/ring_impact")  # doctest: +SKIP
    >>> results.history["kinetic"]  # J/m, at the times results.history.time  # doctest: +SKIP
    >>> results.frame("peak").values("von_mises")  # Pa, of each cell  # doctest: +SKIP
    >>> results.plot("von_mises", 4.5e-3)  # a picture, in notebooks at once  # doctest: +SKIP
    """
    return Results(Path(folder))


class History(Mapping[str, Floats]):
    """history.csv: (k,) float64 arrays by the names of its columns, SI, per metre of thickness."""

    def __init__(self, path: Path) -> None:
        try:
            with path.open(encoding="utf-8") as file:
                names = file.readline().strip().split(",")
                table = np.loadtxt(file, delimiter=",", ndmin=2)
        except FileNotFoundError:
            raise CaseError(f"{path}: there is no such file; is {path.parent} the folder of a run?") from None
        except ValueError as error:
            raise CaseError(f"{path}: is no table of numbers ({error})") from error
        self._columns = dict(zip(names, table.reshape(-1, len(names)).T, strict=True))

    @property
    def time(self) -> Floats:
        """(k,) The times of the rows, s."""
        return self["time"]

    def names(self, start: str = "") -> list[str]:
        """The columns whose names begin so, as ``"contact."``."""
        return [name for name in self if name.startswith(start)]

    def __getitem__(self, name: str) -> Floats:
        if name not in self._columns:
            raise KeyError(f"history.csv has no column {name!r}{suggestion(name, self)}")
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


class Surface(NamedTuple):
    """The slave surface of a contact pair, in order along it.

    Attributes
    ----------
    order : (k,) int64
        The segments of the pair, along the surface.
    arc : (k,) float64, m
        Arc length to the middle of each, on the undeformed surface.
    chain : (k,) int64
        Which connected piece of the surface it is on.
    closed : bool
        Whether the first piece is a closed curve.
    ends : (k, 2, 2) float64, m
        Where each begins and ends, undeformed.
    start : (2,) float64, m
        Where the arc length is zero, undeformed.
    length : float, m
        Of all pieces.
    """

    order: Ints
    arc: Floats
    chain: Ints
    closed: bool
    ends: Floats
    start: Floats
    length: float


def no_results(path: Path) -> CaseError:
    """A folder that holds no run, and where its run may be: results/NAME, and those numbered after it."""
    own = re.compile(re.escape(path.resolve().name) + r"(-\d+)?")
    runs = [file.parent for file in RESULTS.glob("*/history.csv") if own.fullmatch(file.parent.name)]
    newest = max(runs, key=lambda run: (run / "history.csv").stat().st_mtime, default=None)
    hint = f"; did you mean {newest}?" if newest is not None else ""
    if not path.is_dir():
        return CaseError(f"{path}: there is no such folder{hint or '; name the folder of a run'}")
    inside = sorted(file.parent for file in path.glob("*/history.csv"))
    if inside and not hint:
        more = f" and {len(inside) - LISTED} more" if len(inside) > LISTED else ""
        hint = f"; it holds the runs {', '.join(map(str, inside[:LISTED]))}{more}"
    return CaseError(f"{path}: holds no results of a run (no history.csv){hint}")


class Results:
    """The results of a run; :func:`open_results` makes one.

    Attributes
    ----------
    path : Path
        The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not (path / "history.csv").is_file():
            if (path / "results.csv").is_file():
                raise CaseError(f"{path}: holds a batch; open one of its cases, as {_a_case_in(path)}")
            raise no_results(path)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The content of summary.json; empty where the run has not ended."""
        try:
            found: dict[str, Any] = json.loads((self.path / "summary.json").read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        return found

    @cached_property
    def table(self) -> dict[str, Any]:
        """The resolved case as its file has it."""
        return tomllib.loads((self.path / "case.toml").read_text(encoding="utf-8"))

    @cached_property
    def case(self) -> Case:
        """The resolved case."""
        from phantomnode.pipeline.case import load_case

        return load_case(self.path / "case.toml")

    @cached_property
    def prepared(self) -> Prepared:
        """The case, prepared again: grids, cut meshes, model (a second or more)."""
        from phantomnode.pipeline.prepare import prepare

        return prepare(self.case)

    @cached_property
    def history(self) -> History:
        """Energies, forces and motion over time."""
        return History(self.path / "history.csv")

    @property
    def title(self) -> str:
        """The title of the case, or its name."""
        return str(self.table.get("title") or self.table.get("name") or self.path.resolve().name)

    @cached_property
    def pairs(self) -> tuple[str, ...]:
        """The names of the contact pairs, in the order of ``ContactFrame.pair``."""
        return tuple(self.table.get("contact", {}))

    @cached_property
    def times(self) -> Floats:
        """(k,) The times of the frames, s."""
        return np.array([time for time, _ in self._frames])

    def nearest(self, time: Time) -> int:
        """The number of the frame nearest to a time, s, or at ``"start"``, ``"peak"`` (internal energy), ``"end"``.

        Raises
        ------
        CaseError
            Where the time is none of these, or there is no frame.
        """
        if len(self.times) == 0:
            raise CaseError(f"{self.path}: no frame is written yet")
        if isinstance(time, str):
            if time not in NAMED:
                raise CaseError(f"{time!r} is no time; write seconds, or one of: {listed(NAMED)}")
            if time != "peak":
                return 0 if time == "start" else len(self.times) - 1
            internal = np.interp(self.times, self.history.time, self.history["internal"])
            return int(np.argmax(internal))
        return int(np.argmin(np.abs(self.times - time)))

    def frame(self, time: Time = "end") -> FieldsFrame:
        """The bodies in the frame nearest to a time, s, or at ``"start"``, ``"peak"``, ``"end"``.

        Raises
        ------
        CaseError
            Where the time or the file is at fault.
        """
        when, file = self._frames[self.nearest(time)]
        last = float(self.times[-1])
        if not isinstance(time, str) and not -BEYOND * last <= time <= (1.0 + BEYOND) * last:
            raise CaseError(
                f"{self.path}: frames go from 0 to {last:.7g} s; {time:g} s, in seconds, is beyond them"
            )
        frame = FieldsFrame.read(file, when)
        if not self.table.get("rigid"):
            return frame
        contact = self.contact(when)
        return replace(frame, obstacles=contact.ends[contact.pair < 0])

    def frames(self) -> Iterator[FieldsFrame]:
        """All frames, one after the other."""
        return (self.frame(float(time)) for time in self.times)

    def contact(self, time: Time = "end") -> ContactFrame:
        """The contact surfaces in the frame nearest to a time.

        Raises
        ------
        CaseError
            Where the case has no contact pair, or the time or the file is at fault.
        """
        number = self.nearest(time)
        series = read_pvd(self._of_contact())
        when, file = series[min(number, len(series) - 1)]
        return ContactFrame.read(file, when)

    def surface(self, pair: str) -> Surface:
        """The slave surface of a contact pair, in order along it.

        Raises
        ------
        CaseError
            Naming the pairs that there are.
        """
        if pair not in self.pairs:
            raise CaseError(f"there is no contact pair {pair!r}; there are: {listed(self.pairs)}")
        first = self.contact("start")
        ends = first.ends[first.pair == self.pairs.index(pair)]
        length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
        found = chains(ends)
        order = np.concatenate([chain.order for chain in found])
        until = np.cumsum(length[order])
        piece = np.repeat(np.arange(len(found)), [len(chain.order) for chain in found])
        arc = until - 0.5 * length[order]
        return Surface(order, arc, piece, found[0].closed, ends[order], ends[order[0], 0], float(until[-1]))

    def pressure(self, pair: str, time: Time = "end", *, filtered: bool = True) -> tuple[Floats, Floats]:
        """Contact pressure over the arc length of the undeformed slave surface.

        Parameters
        ----------
        pair : str
        time : float or str
        filtered : bool
            Through the hat filter (one cell to either side, the same force), or as each segment has it.

        Returns
        -------
        (k,) arc length, m; (k,) pressure, Pa
        """
        along = self.surface(pair)
        name = "pressure_filtered" if filtered else "pressure"
        return along.arc, self.contact(time).of_pair(self.pairs.index(pair), name)[along.order]

    def plot(self, what: str = "von_mises", time: Time | Sequence[Time] = "peak", **options: Any) -> Figure:
        """A picture; ``phantomnode plot`` draws the same.

        Parameters
        ----------
        what : str
            A field (``von_mises``, ``stress_xx``, ``velocity``, ...), ``contact_pressure``, ``energies``, ``forces``,
            ``impulses``, ``reactions``, ``motion``, ``quality``, a column of history.csv, ``level_set`` or ``nodes``.
        time : float, str, or several
            Of fields and of the contact pressure: s, ``"start"``, ``"peak"`` or ``"end"``.
        **options
            Those of :func:`phantomnode.pipeline.plot.picture`.

        Raises
        ------
        CaseError
            Where there is no such picture.
        """
        from phantomnode.pipeline.plot import picture

        times = [time] if isinstance(time, str | float | int) else list(time)
        return picture(self, what, times, **options)

    def dataset(self, time: Time = "end") -> Any:
        """The bodies at a time as a ``pyvista.UnstructuredGrid``; needs ``pip install "phantomnode[vtk]"``.

        Raises
        ------
        CaseError
            Where pyvista is not installed.
        """
        try:
            import pyvista
        except ImportError:
            raise CaseError('this needs pyvista: pip install "phantomnode[vtk]"') from None
        return pyvista.read(self._frames[self.nearest(time)][1])

    def __repr__(self) -> str:
        last = moment(float(self.history.time[-1])) if len(self.history.time) else "no row yet"
        status = self.summary.get("status", "not ended")
        return f"<Results {self.path}: {self.title}, {status}, {len(self.times)} frames to {last}>"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        from phantomnode.pipeline.notebook import results_html

        return results_html(self)

    @cached_property
    def _frames(self) -> list[tuple[float, Path]]:
        return read_pvd(self.path / "fields.pvd")

    def _of_contact(self) -> Path:
        if not self.pairs:
            raise CaseError(f"{self.path}: the case has no contact pair")
        return self.path / "contact.pvd"


def _a_case_in(batch: Path) -> Path:
    """A case of a batch, for a message."""
    cases = sorted(file.parent for file in batch.glob("*/history.csv"))
    return cases[0] if cases else batch / "CASE"
