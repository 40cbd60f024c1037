"""Reads the content of one file; in the child process of :mod:`phantomnode.geometry.readers`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from phantomnode.geometry.curves import Geometry, diagonal
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.findings import notes
from phantomnode.geometry.formats import SUFFIXES, WORDS, File, recognised
from phantomnode.geometry.scripts import cleaned, objection
from phantomnode.geometry.units import chosen, iges_unit, metres, size_note, step_unit


def geometry(content: bytes, wanted: dict[str, Any], time_limit: float) -> Geometry:
    """What :func:`phantomnode.geometry.readers.read_geometry` returns, of the content of a file.

    ``wanted`` holds its keyword arguments.
    """
    file = recognised(content)
    if wanted["unit"] is not None:
        metres(wanted["unit"])
    if file.kind != "dxf" and (wanted["layers"] or wanted["without_layers"]):
        raise GeometryError(
            f"this is a {WORDS[file.kind]} file; only DXF drawings have layers to choose from"
        )
    if file.kind not in SUFFIXES and (wanted["face"] is not None or wanted["section"] is not None):
        raise GeometryError(f"a {WORDS[file.kind]} file has no faces or solids; leave face and section out")
    found = _read(file, wanted, time_limit)
    if not found.regions and not found.curves:
        raise GeometryError("the file holds no curve of any length")
    said = [*found.notes, *notes(found.findings, found.unit)]
    loops = [loop for region in found.regions for loop in region.loops]
    unlikely = size_note(diagonal([*loops, *found.curves]), found.unit)
    if unlikely:
        said.insert(0, unlikely)
    return replace(found, notes=tuple(said), format=WORDS[file.kind])


def quads(content: bytes, unit: str | None) -> dict[str, Any]:
    """Nodes "xy" (metres) and "quads" of a gmsh mesh, as the file numbers them."""
    from phantomnode.geometry import gmsh_mesh, gmsh_reader

    file = recognised(content)
    if file.kind != "msh":
        raise GeometryError(
            f"this is a {WORDS[file.kind]} file; a background grid is read from a gmsh mesh (.msh)"
        )
    factor = metres(chosen(unit, None)[0])
    with gmsh_reader.damage_told():
        xy, cells = gmsh_mesh.quads(gmsh_reader.opened(file.content, ".msh"))
    return {"xy": (xy * factor).tolist(), "quads": cells.tolist()}


def _read(file: File, wanted: dict[str, Any], time_limit: float) -> Geometry:
    """What is in a file, by the reader of its kind."""
    unit = wanted["unit"]
    if file.kind == "dxf":
        from phantomnode.geometry.dxf import read_dxf

        return read_dxf(file.content, unit, time_limit, wanted["layers"], wanted["without_layers"])
    if file.kind == "svg":
        from phantomnode.geometry.svg import read_svg

        return read_svg(file.content, unit)
    if file.kind in ("wkt", "geojson"):
        from phantomnode.geometry.features import read_features

        return read_features(file.text, file.kind, unit)
    return _by_gmsh(file, wanted)


def _by_gmsh(file: File, wanted: dict[str, Any]) -> Geometry:
    """A file of the gmsh family; gmsh gives STEP and IGES in mm, all others in their own numbers."""
    from phantomnode.geometry.gmsh_reader import read_curves

    content = file.content
    own = None
    if file.kind == "geo":
        content = _vetted(file, wanted["trust_scripts"])
    elif file.kind == "step":
        own = step_unit(file.text)
    elif file.kind == "iges":
        own = iges_unit(file.text)
    name, said = chosen(wanted["unit"], own)
    factor = metres(name)
    if file.kind in ("step", "iges"):
        # gmsh gives these in millimetres, by the unit in the file (millimetres where it has none).
        factor = 1e-3 if name == own else 1e-3 * metres(name) / metres(own or "mm")
    trusted = wanted["trust_scripts"]
    found = read_curves(content, SUFFIXES[file.kind], factor, wanted["face"], wanted["section"], trusted)
    return replace(found, notes=(*said, *found.notes), unit=name)


def _vetted(file: File, trust_scripts: bool) -> bytes:
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
