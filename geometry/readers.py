"""One door for geometry files: each is read in a process of its own, which cannot harm this one.

A file may be damaged, hostile or only large, and the libraries that read it may crash, loop or run what it says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from phantomnode.geometry import wire
from phantomnode.geometry.child import Child
from phantomnode.geometry.curves import Geometry
from phantomnode.geometry.errors import GeometryError, OutlineError
from phantomnode.geometry.findings import complaint
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.limits import TIME_LIMIT
from phantomnode.geometry.numbering import renumbered

MOST_BYTES = 1 << 30
"""Of a file: one of 1e7 nodes has as many, and reading it needs more memory than the reader gets."""

Result = TypeVar("Result")


class Reading(Generic[Result]):
    """A file that a process of its own reads from now on; a context, which ends that process.

    Parameters
    ----------
    path : str or Path
    request : dict
        What :mod:`phantomnode.geometry.reading_child` is to read.
    finish : function
        Makes the result of what it answers.
    time_limit : float, s
    """

    def __init__(
        self,
        path: str | Path,
        request: dict[str, Any],
        finish: Callable[[Any], Result],
        time_limit: float = TIME_LIMIT,
    ) -> None:
        self._path, self._finish = path, finish
        with _about(path):
            content = _content(Path(path))
            try:
                self._child = Child(request, content, time_limit)
            except OSError as error:
                raise GeometryError(f"no process can be started to read it ({error.strerror})") from error

    def result(self) -> Result:
        """Wait for it, no longer than the time limit from now on.

        Raises
        ------
        GeometryError
            Naming the file, what is wrong and what to do.
        """
        with _about(self._path):
            return self._finish(self._child.answer())

    def end(self) -> None:
        """End the process, if it still reads."""
        self._child.end()

    def __enter__(self) -> Reading[Result]:
        return self

    def __exit__(self, *failure: object) -> None:
        self.end()


def read_geometry(
    path: str | Path,
    unit: str | None = None,
    *,
    layers: Sequence[str] = (),
    without_layers: Sequence[str] = (),
    trust_scripts: bool = False,
    time_limit: float = TIME_LIMIT,
    face: str | int | None = None,
    section: tuple[str, float] | None = None,
) -> Geometry:
    """Read the regions and curves of a planar CAD file.

    DXF (ASCII or binary), SVG, STEP, IGES, BREP, XAO, gmsh scripts (.geo, .geo_unrolled), gmsh meshes (.msh 2.2 and
    4.1, whose lines and outer edges count), WKT and GeoJSON. Straight lines and circular arcs stay exact; ellipses
    and splines become polygons within 1e-6 of the drawing's diagonal. Closed chains become regions with their holes
    unless the file itself has faces; then these are the regions, and other curves are kept as curves.

    Parameters
    ----------
    path : str or Path
    unit : str, optional
        Unit of the numbers in the file ("mm", "m", "in", ...). It goes before the one that the file states, and
        must be given where the file states none (gmsh's own formats and BREP never do).
    layers, without_layers : sequence of str
        Layers of a DXF drawing, by name or pattern ("cut*"), that alone count or that do not; all that are shown
        count unless given.
    trust_scripts : bool
        Let a gmsh script run commands beyond geometry. It can then do whatever you can do.
    time_limit : float, s
    face : str or int, optional
        The flat face of a 3D part to take: its name, or its number (gmsh's; the message about a 3D part lists them).
        Faces of one name are taken together. Coordinates are (x, y) in a plane z = constant, (x, z) in y = constant,
        (y, z) in x = constant; of an oblique face a note tells them.
    section : (str, float), optional
        Axis "x", "y" or "z" and where on it (metres) to cut the solids of a 3D part; coordinates as of a face.

    Returns
    -------
    Geometry
        In metres. Names come from physical groups or layers; ``notes`` says what was mended or left out.

    Raises
    ------
    GeometryError
        Naming the file, what is wrong and what to do; an OutlineError, which holds the curves, where they make
        nothing but outlines that cross, a NoUnitError where there is no unit.
    """
    with geometry_reading(
        path, unit, layers=layers, without_layers=without_layers, trust_scripts=trust_scripts, time_limit=time_limit,
        face=face, section=section,
    ) as reading:  # fmt: skip
        return reading.result()


def geometry_reading(
    path: str | Path,
    unit: str | None = None,
    *,
    layers: Sequence[str] = (),
    without_layers: Sequence[str] = (),
    trust_scripts: bool = False,
    time_limit: float = TIME_LIMIT,
    face: str | int | None = None,
    section: tuple[str, float] | None = None,
) -> Reading[Geometry]:
    """What :func:`read_geometry` waits for, begun."""
    wanted = {
        "unit": unit,
        "layers": list(layers),
        "without_layers": list(without_layers),
        "trust_scripts": trust_scripts,
        "face": face,
        "section": section,
    }
    return Reading(path, {"read": "geometry", "wanted": wanted}, _geometry, time_limit)


def read_quads(
    path: str | Path, unit: str | None = None, *, time_limit: float = TIME_LIMIT
) -> BackgroundGrid:
    """Read an unstructured background grid: the four-node quadrilaterals of a gmsh mesh.

    Cells are turned counter-clockwise; nodes that belong to none are left out; the numbers are those of
    :func:`phantomnode.geometry.numbering.renumbered`.

    Raises
    ------
    GeometryError
        For a file that is no mesh, a mesh with triangles or other faces, folded cells, two nodes at one
        place, or no unit.
    """
    with quads_reading(path, unit, time_limit=time_limit) as reading:
        return reading.result()


def quads_reading(
    path: str | Path, unit: str | None = None, *, time_limit: float = TIME_LIMIT
) -> Reading[BackgroundGrid]:
    """What :func:`read_quads` waits for, begun."""
    return Reading(path, {"read": "quads", "wanted": {"unit": unit}}, _grid, time_limit)


def _geometry(answer: Any) -> Geometry:
    """The geometry of an answer."""
    geometry = wire.decoded(answer)
    assert isinstance(geometry, Geometry)
    if geometry.wrong and not geometry.regions:
        raise OutlineError(complaint(geometry.findings, geometry.unit), geometry)
    return geometry


def _grid(answer: Any) -> BackgroundGrid:
    """The grid of an answer."""
    xy, quads = renumbered(np.array(answer["xy"]), np.array(answer["quads"], dtype=np.int64))
    _check_convex(xy[quads])
    return BackgroundGrid(xy, quads)


@contextmanager
def _about(path: str | Path) -> Iterator[None]:
    """Put the file's name before every message."""
    try:
        yield
    except GeometryError as error:
        error.args = (f"{path}: {error}",)
        raise


def _content(path: Path) -> bytes:
    """The bytes of an ordinary file of bearable size."""
    if path.is_dir():
        raise GeometryError("is a folder; name the geometry file in it")
    if not path.exists():
        raise GeometryError("no such file")
    if not path.is_file():
        raise GeometryError("is no ordinary file (a pipe or a device)")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise GeometryError(f"the file has more than {MOST_BYTES >> 20} MB; keep the outline only")
        return path.read_bytes()
    except OSError as error:
        raise GeometryError(f"cannot be read ({error.strerror})") from error


def _check_convex(corners: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    """Refuse (m, 4, 2) cells with a corner of 180 degrees or more: the bilinear map folds there."""
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = corners - np.roll(corners, 1, axis=1)
    turn = behind[..., 0] * ahead[..., 1] - behind[..., 1] * ahead[..., 0]
    folded = np.flatnonzero(np.any(turn <= 0.0, axis=1))
    if len(folded):
        x, y = corners[folded[0]].mean(axis=0)
        raise GeometryError(
            f"{len(folded)} cells are folded or flat, the first about ({x:g}, {y:g}) m; mesh again"
        )
