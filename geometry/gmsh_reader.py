"""Files of the gmsh family; in the child process of :mod:`phantomnode.geometry.readers`.

gmsh runs scripts, crashes on damaged files and ends the process on a script's ``Exit``. It gives millimetres for STEP
and IGES (Geometry.OCCTargetUnit = "M" is refused for an IGES file in a fresh process, and OCC's tolerance of 1e-7 is
finer in millimetres), the numbers of the file for all others.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phantomnode.geometry import gmsh_cad, gmsh_mesh, gmsh_section
from phantomnode.geometry.curves import Curve, Geometry, Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.limits import forbid
from phantomnode.geometry.loops import assemble, join
from phantomnode.geometry.nesting import nest
from phantomnode.geometry.planes import Plane

GMSH_LIBRARIES = (
    "libglu1-mesa libxcursor1 libxft2 libxinerama1 libxrender1 "
    "libxfixes3 libgomp1 libgl1 libx11-6 libfontconfig1"
)
"""The Debian packages that gmsh's wheel needs and does not bring."""

MOST_LISTED = 12
"""Faces that a message lists, the largest first."""


def read_curves(
    content: bytes,
    suffix: str,
    factor: float,
    face: str | int | None,
    section: tuple[str, float] | None,
    trusted: bool,
) -> Geometry:
    """Regions and curves of a file that gmsh reads.

    Parameters
    ----------
    content : bytes
        What gmsh gets to read.
    suffix : str
        Tells gmsh the format, e.g. ".step".
    factor : float
        Metres in one unit of gmsh's coordinates.
    face : str or int or None
        Name or number of the flat face to take.
    section : (str, float) or None
        "x", "y" or "z", and where on that axis (metres) to cut solids.
    trusted : bool
        Whether a script may write files and start programs.

    Raises
    ------
    GeometryError
        For anything that gmsh, or the geometry of the file, does not allow.
    """
    with damage_told():
        gmsh = opened(content, suffix, trusted)
        data = _found(gmsh, suffix, face, section and (section[0], section[1] / factor))
    if "missed" in data:
        low, high = (factor * end + 0.0 for end in data["missed"])
        raise GeometryError(
            f"the section misses the part, which reaches from {low:.6g} to {high:.6g} m on its axis"
        )
    if "solid" in data:
        raise GeometryError(_solid(data, factor))
    plane = Plane(np.array(data["plane"][0]), data["plane"][1])
    notes = list(data["notes"])
    if plane.frame[2, 2] != 1.0 and section is None:
        notes.append(f"the outline lies in {plane.words(factor)}; its x and y are {plane.coordinates()}")
    return _assembled(data, factor, notes)


@contextmanager
def damage_told() -> Iterator[None]:
    """Say of gmsh's own errors that the file is damaged: what was asked for is not in what it read."""
    try:
        yield
    except UnicodeDecodeError as error:  # of gmsh's module, which takes all texts for UTF-8
        raise GeometryError(
            "a name or word in it is not UTF-8: the file is damaged, or save it as UTF-8"
        ) from error
    except Exception as error:
        if type(error) is not Exception:  # gmsh raises no other
            raise
        said = str(error).strip()  # nothing where memory ran out
        why = f" ({said}): the file is damaged" if said else ": the file is damaged, or needs too much memory"
        raise GeometryError(f"gmsh cannot read it{why}") from error


def opened(content: bytes, suffix: str, trusted: bool = False) -> Any:
    """The module gmsh, which holds what is in a file."""
    try:
        import gmsh
    except OSError as error:
        raise GeometryError(
            f"gmsh cannot be loaded ({error}). It needs system libraries; on Debian and Ubuntu: "
            f"apt-get install {GMSH_LIBRARIES}"
        ) from error
    source = Path("input" + suffix)
    # gmsh takes a mesh that does not begin with its mark for a script.
    source.write_bytes(content.removeprefix(b"\xef\xbb\xbf").lstrip() if suffix == ".msh" else content)
    if not trusted:
        forbid()
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.logger.start()
    with damage_told():
        gmsh.open(str(source))
    complaints = [line for line in gmsh.logger.get() if line.startswith("Error")]
    if complaints:
        raise GeometryError(f"gmsh cannot read it ({complaints[0]}): the file is damaged")
    return gmsh


def _found(
    gmsh: Any, suffix: str, face: str | int | None, section: tuple[str, float] | None
) -> dict[str, Any]:
    """What is wanted of the model that gmsh holds, or what there is to choose from."""
    if section is not None:
        return gmsh_section.section(gmsh, *section)
    if suffix == ".msh" and gmsh.model.mesh.getNodes()[0].size:
        return gmsh_mesh.outline(gmsh, face)
    return gmsh_cad.whole(gmsh) if face is None else gmsh_cad.face(gmsh, face)


def _assembled(data: dict[str, Any], factor: float, notes: list[str]) -> Geometry:
    """The outlines of faces as regions, all other curves joined."""
    regions: list[Region] = []
    for group in data["groups"]:
        chains = join(_pieces(group["pieces"], factor))
        if chains.open:
            x, y = chains.open[0].points[0]
            raise GeometryError(
                f"the outline of a face is not closed at ({x:g}, {y:g}) m: the file is damaged"
            )
        regions += nest(chains.closed, group["name"])
        notes += chains.notes
    free = _pieces(data["free"], factor)
    if not data["groups"]:
        loose = assemble(free)
        return replace(loose, notes=(*notes, *loose.notes))
    chains = join(free)
    return Geometry(tuple(regions), chains.closed + chains.open, (*notes, *chains.notes))


def _solid(data: dict[str, Any], factor: float) -> str:
    """Why a 3D model cannot be taken as it is, and what of it can."""
    solid = data["solid"]
    what = f"this is a 3D part (solids: {solid['volumes']}, faces: {solid['faces']}), and a plane problem needs a "
    what += "planar outline"
    if "no_face" in data:
        what = f"no face is {data['no_face']!r} among the {solid['faces']} faces"
    faces = sorted(solid["flat"], key=lambda f: -f["size"][0] * f["size"][1])
    listed = []
    for flat in faces[:MOST_LISTED]:
        plane, (width, height) = Plane(np.array(flat["plane"][0]), flat["plane"][1]), flat["size"]
        name = f" {flat['name']!r}" if flat["name"] else ""
        listed.append(
            f"{flat['number']}{name} ({plane.words(factor)}, {factor * width:.3g} x {factor * height:.3g} m)"
        )
    more = f", and {len(faces) - MOST_LISTED} smaller ones" if len(faces) > MOST_LISTED else ""
    ways = [f"take a flat face by its number or name, face = {faces[0]['number']}"] if faces else []
    if solid["faces"]:
        axis = solid["extruded"] or "xyz"[int(np.argmin(np.ptp(solid["box"], axis=0)))]
        middle = factor * float(np.mean(solid["box"], axis=0)["xyz".index(axis)]) + 0.0
        through = f" (the middle of what is extruded along {axis})" if solid["extruded"] else ""
        ways.append(f'cut a section, section = {{ axis = "{axis}", at = {middle:.6g} }}{through}')
    todo = ", or ".join(ways) or "draw the section in one plane"
    return f"{what}: {todo}" + (f". Flat faces: {', '.join(listed)}{more}" if listed else "")


def _pieces(data: list[dict[str, Any]], factor: float) -> list[Curve]:
    """The pieces of the child's answer, in metres."""
    return [
        Curve(
            np.array(item["points"]) * factor, np.array(item["bulges"]), (item["name"],) * len(item["bulges"])
        )
        for item in data
    ]
