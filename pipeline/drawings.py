"""The files of a case: read at the same time, and each once."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, NamedTuple

from phantomnode.geometry.curves import Geometry
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.readers import Reading, geometry_reading, quads_reading
from phantomnode.pipeline.crosscheck import tables_with_files
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.shapes import Drawing, FileGrid

AT_ONCE = min(4, os.cpu_count() or 1)
"""Processes that read at the same time; each has a second's work or so, and some hundred MB."""


class Request(NamedTuple):
    """What begins a reading, the file, and how it is read."""

    begin: Callable[..., Reading[Any]]
    path: Path
    options: tuple[tuple[str, Any], ...]

    def begun(self) -> Reading[Any]:
        """The reading, begun."""
        return self.begin(self.path, **dict(self.options))


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
        with ExitStack() as ending:
            for reading in self._reading.values():
                ending.callback(reading.end)

    def _request(self, table: Drawing | FileGrid) -> Request:
        """How the file of a table is read."""
        assert table.file is not None
        path = self._case.path(table.file)
        common = ("unit", table.unit), ("time_limit", table.time_limit)
        if isinstance(table, FileGrid):
            return Request(quads_reading, path, common)
        options = (
            ("layers", table.layers),
            ("without_layers", table.without_layers),
            ("trust_scripts", table.trust_scripts),
            ("face", table.face),
            ("section", table.section and (table.section.axis, table.section.at)),
        )
        return Request(geometry_reading, path, (*common, *options))

    def _result(self, table: Drawing | FileGrid) -> Any:
        """What the file of a table holds, read once."""
        request = self._request(table)
        if request not in self._read:
            with self._reading.pop(request, None) or request.begun() as reading:
                self._read[request] = reading.result()
            self._begin_more()
        return self._read[request]

    def _begin_more(self) -> None:
        """Begin with the next files, as many as may be read at the same time."""
        while self._ahead and len(self._reading) < AT_ONCE:
            request = self._ahead.pop(0)
            if request not in self._reading and request not in self._read:
                with suppress(GeometryError):  # what is wrong is told where the file is asked for
                    self._reading[request] = request.begun()
