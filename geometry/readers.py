"""One door for geometry files: what a file is, is decided by what is in it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phantomnode.geometry.curves import Geometry
from phantomnode.geometry.dxf_load import BINARY, is_whole
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.loops import diagonal
from phantomnode.geometry.numbering import renumbered
from phantomnode.geometry.scripts import cleaned, objection
from phantomnode.geometry.units import chosen, iges_unit, metres, size_note, step_unit

TIME_LIMIT = 60.0
"""Seconds after which reading a file is given up."""

_WORDS = {
    "step": "STEP", "iges": "IGES", "brep": "BREP", "xao": "XAO", "msh": "gmsh mesh", "geo": "gmsh script",
    "dxf": "DXF",
}  # fmt: skip
_SUFFIXES = {"step": ".step", "iges": ".igs", "brep": ".brep", "xao": ".xao", "msh": ".msh", "geo": ".geo"}

_FOREIGN = (
    (rb"AC10\d\d", "a DWG drawing: save it as DXF"),
    (rb"%PDF|%!PS", "a PDF or PostScript drawing: export DXF"),
    (rb"(?s)\s*(<\?xml.*?)?<svg", "an SVG drawing: export DXF"),
    (rb"solid\s", "an STL surface, which is 3D: export the outline as DXF or STEP"),
    (rb"# vtk|(?s:.{0,200})<VTKFile", "a VTK file: save the outline as DXF or STEP, or the mesh as .msh"),
    (rb"PK\x03\x04|\x1f\x8b", "a compressed archive: unpack it"),
)
"""Other formats, by how they begin, and what to do instead."""

_SCRIPT = re.compile(
    r"^\s*(SetFactory|Point|Line|Circle|Ellipse|Spline|BSpline|Bezier|Curve|Rectangle|Disk|Surface|Plane|Physical|"
    r"Merge|Include|SystemCall|NonBlockingSystemCall|For|If|Macro|Function|DefineConstant|Exit|Printf|Print|Geometry|Mesh|"
    r"\w+\s*=)[^;]*;",
    re.MULTILINE,
)

_ENDS = {"step": "END-ISO-10303-21;", "xao": "</XAO>", "msh": "$EndElements"}
"""What a whole file of each kind holds near its end."""


@dataclass(frozen=True)
class _File:
    """A file that was read and recognised."""

    kind: str
    content: bytes

    @property
    def text(self) -> str:
        """The content as text; these formats are ASCII but for names and comments."""
        return self.content.decode("utf-8", errors="replace")


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

    DXF (ASCII or binary), STEP, IGES, BREP, XAO, gmsh scripts (.geo, .geo_unrolled) and gmsh meshes (.msh 2.2 and
    4.1, whose lines and outer edges count). Straight lines and circular arcs stay exact; ellipses and splines become
    polygons within 1e-6 of the drawing's diagonal. Closed chains become regions with their holes unless the file
    itself has faces; then these are the regions, and other curves are kept as curves.

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
        Naming the file, what is wrong and what to do.
    """
    with _about(path):
        file = _recognised(Path(path))
        if unit is not None:
            metres(unit)
        if file.kind == "dxf":
            if face is not None or section is not None:
                raise GeometryError("a DXF drawing has no faces or solids; leave face and section out")
            from phantomnode.geometry.dxf import read_dxf

            geometry = read_dxf(file.content, unit, time_limit, layers, without_layers)
        elif layers or without_layers:
            raise GeometryError(
                f"this is a {_WORDS[file.kind]} file; only DXF drawings have layers to choose from"
            )
        else:
            geometry = _read_by_gmsh(file, unit, trust_scripts, time_limit, face, section)
        if not geometry.regions and not geometry.curves:
            raise GeometryError("the file holds no curve of any length")
    loops = [loop for region in geometry.regions for loop in region.loops]
    unlikely = size_note(diagonal([*loops, *geometry.curves]), geometry.unit)
    return replace(geometry, notes=(unlikely, *geometry.notes)) if unlikely else geometry


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
    from phantomnode.geometry.gmsh_reader import run_child

    with _about(path):
        file = _recognised(Path(path))
        if file.kind != "msh":
            raise GeometryError(
                f"this is a {_WORDS[file.kind]} file; a background grid is read from a gmsh mesh (.msh)"
            )
        factor = metres(chosen(unit, None)[0])
        data = run_child({"read": "quads"}, file.content, ".msh", time_limit)
        xy = np.array(data["xy"], dtype=np.float64) * factor
        xy, quads = renumbered(xy, np.array(data["quads"], dtype=np.int64))
        _check_convex(xy[quads])
    return BackgroundGrid(xy, quads)


@contextmanager
def _about(path: str | Path) -> Iterator[None]:
    """Put the file's name before every message."""
    try:
        yield
    except GeometryError as error:
        raise GeometryError(f"{path}: {error}") from error.__cause__


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


def _read_by_gmsh(
    file: _File, unit: str | None, trust_scripts: bool, time_limit: float,
    face: str | int | None, section: tuple[str, float] | None,
) -> Geometry:  # fmt: skip
    """A file of the gmsh family; gmsh gives STEP and IGES in mm, all others in their own numbers."""
    from phantomnode.geometry.gmsh_reader import read_curves

    content = file.content
    own = None
    if file.kind == "geo":
        content = _vetted(file, trust_scripts)
    elif file.kind == "step":
        own = step_unit(file.text)
    elif file.kind == "iges":
        own = iges_unit(file.text)
    name, notes = chosen(unit, own)
    factor = metres(name)
    if file.kind in ("step", "iges"):
        # gmsh gives these in millimetres, by the unit in the file (millimetres where it has none).
        factor = 1e-3 if name == own else 1e-3 * metres(name) / metres(own or "mm")
    geometry = read_curves(content, _SUFFIXES[file.kind], factor, time_limit, face=face, section=section)
    return replace(geometry, notes=(*notes, *geometry.notes), unit=name)


def _vetted(file: _File, trust_scripts: bool) -> bytes:
    """The script that gmsh gets to see: as it is (with a last line end) if trusted, else checked and cleaned."""
    if trust_scripts:
        return file.content + b"\n"  # gmsh silently loses what follows the first statement without it
    script = cleaned(file.text)
    reason = objection(script)
    if reason is not None:
        raise GeometryError(
            f"{reason} is not needed to describe geometry and could run, read or write something; take "
            "it out, save the geometry as .step, .xao or .msh, or trust the script (--trust-scripts)"
        )
    return script.encode("utf-8")


def _recognised(path: Path) -> _File:
    """The file, its kind by content, after making sure that it is there and whole."""
    if path.is_dir():
        raise GeometryError("is a folder; name the geometry file in it")
    if not path.exists():
        raise GeometryError("no such file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise GeometryError(f"cannot be read ({error.strerror})") from error
    if not content.strip():
        raise GeometryError("the file is empty")
    file = _File(_kind(content), content)
    _check_whole(file)
    return file


def _kind(content: bytes) -> str:
    """Which format the content is."""
    head = content[:4000].decode("utf-8-sig", errors="replace").lstrip()
    first = content.split(b"\n", 1)[0].rstrip(b"\r")
    if head.startswith("ISO-10303-21"):
        return "step"
    if head.startswith(("$MeshFormat", "$Comments")):
        return "msh"
    if "<XAO" in head[:1000]:
        return "xao"
    if "DBRep_DrawableShape" in head[:1000] or head.startswith("CASCADE Topology"):
        return "brep"
    if len(first) >= 73 and first[72:73] == b"S" and first[73:80].strip().isdigit():
        return "iges"
    if content.startswith(BINARY) or re.match(r"(999\s*\n[^\n]*\n\s*)*0\s*\n\s*SECTION\b", head):
        return "dxf"
    for pattern, what in _FOREIGN:
        if re.match(pattern, content):
            raise GeometryError(f"this is {what}")
    if b"\0" not in content and _SCRIPT.search(cleaned(content.decode("utf-8", errors="replace"))):
        return "geo"
    raise GeometryError(
        "the content is of no known kind; geometry is read from DXF, STEP, IGES, BREP, XAO, gmsh "
        "scripts (.geo) and gmsh meshes (.msh)"
    )


def _check_whole(file: _File) -> None:
    """Refuse a file whose end is missing: gmsh and ezdxf read the rest without a word."""
    tail = file.content[-20_000:].decode("utf-8", errors="replace")
    whole = True
    if file.kind in _ENDS:
        whole = (
            _ENDS[file.kind].upper() in file.text.upper()
            if file.kind == "msh"
            else _ENDS[file.kind].upper() in tail.upper()
        )
    elif file.kind == "iges":
        whole = _iges_is_whole(file.text)
    elif file.kind == "dxf":
        whole = is_whole(file.content)
    elif file.kind == "brep":
        # The last line of a BREP file is the location of the root shape, after the table of shapes.
        whole = "TShapes" in file.text and re.search(r"\n[+-]\d+ \d+\s*(\n0\s*)?$", tail) is not None
    if not whole:
        raise GeometryError(
            f"the end of this {_WORDS[file.kind]} file is missing or damaged; export it again"
        )


def _iges_is_whole(text: str) -> bool:
    """Whether the last line counts the lines of every section as they are."""
    lines = [line for line in text.splitlines() if len(line) > 72]
    counted = dict(re.findall(r"([SGDP])\s*(\d+)", lines[-1][:72])) if lines[-1][72] == "T" else {}
    return bool(counted) and all(
        int(number) == sum(line[72] == section for line in lines) for section, number in counted.items()
    )
