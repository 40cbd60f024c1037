"""The files of a case: read at the same time, and each once."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from phantomnode.geometry.curves import Geometry
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.readers import Reading, geometry_reading, quads_reading
from phantomnode.pipeline.crosscheck import tables_with_files
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.shapes import Drawing, FileGrid

AT_ONCE = 4
"""Processes that read at the same time; each has a second's work or so, and some hundred MB."""

Request = tuple[Callable[..., Reading[Any]], Path, tuple[tuple[str, Any], ...]]
"""What begins a reading, the file, and how it is read."""


class Drawings:
    """Reads the geometry and grid files of a case; a context, which ends what still reads.

    Parameters
    ----------
    case : Case
    """

    def __init__(self, case: Case) -> None:
        self._case = case
        self._ahead: list[Request] = []
        self._reading: dict[Request, Reading[Any]] = {}
        self._read: dict[Request, Any] = {}

    def read_ahead(self) -> None:
        """Begin with all files of the case, before they are asked for."""
        self._ahead = [self._request(table) for _, table in tables_with_files(self._case)]
        self._begin_more()

    def geometry(self, drawing: Drawing) -> Geometry:
        """The geometry of a drawing's file, not placed.

        Raises
        ------
        GeometryError
            Naming the file, what is wrong and what to do.
        """
        geometry: Geometry = self._result(drawing)
        return geometry

    def quads(self, grid: FileGrid) -> BackgroundGrid:
        """The background grid of a file; raises as ``geometry`` does."""
        quads: BackgroundGrid = self._result(grid)
        return quads

    def __enter__(self) -> Drawings:
        return self

    def __exit__(self, *failure: object) -> None:
        for reading in self._reading.values():
            reading.end()

    def _request(self, table: Drawing | FileGrid) -> Request:
        """How the file of a table is read."""
        assert table.file is not None
        path, every = self._case.path(table.file), ("unit", "time_limit")
        if isinstance(table, FileGrid):
            return quads_reading, path, tuple((key, getattr(table, key)) for key in every)
        section = None if table.section is None else (table.section.axis, table.section.at)
        keys = (*every, "layers", "without_layers", "trust_scripts", "face")
        return geometry_reading, path, (*((key, getattr(table, key)) for key in keys), ("section", section))

    def _result(self, table: Drawing | FileGrid) -> Any:
        """What the file of a table holds, read once."""
        request = self._request(table)
        if request not in self._read:
            with self._reading.pop(request, None) or _begun(request) as reading:
                self._read[request] = reading.result()
            self._begin_more()
        return self._read[request]

    def _begin_more(self) -> None:
        """Begin with the next files, as many as may be read at the same time."""
        while self._ahead and len(self._reading) < AT_ONCE:
            request = self._ahead.pop(0)
            if request not in self._reading and request not in self._read:
                with suppress(GeometryError):  # of a file that is not there; told where it is asked for
                    self._reading[request] = _begun(request)


def _begun(request: Request) -> Reading[Any]:
    """A reading, begun."""
    begin, path, options = request
    return begin(path, **dict(options))
