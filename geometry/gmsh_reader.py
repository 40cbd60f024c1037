"""Files of the gmsh family, read in a child process that cannot harm this one."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from phantomnode.geometry.curves import Curve, Geometry, Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.loops import assemble, join, nest
from phantomnode.geometry.planes import Plane

GMSH_LIBRARIES = (
    "libglu1-mesa libxcursor1 libxft2 libxinerama1 libxrender1 "
    "libxfixes3 libgomp1 libgl1 libx11-6 libfontconfig1"
)
"""The Debian packages that gmsh's wheel needs and does not bring."""

MOST_LISTED = 12
"""Faces that a message lists, the largest first."""


def read_curves(
    content: bytes, suffix: str, factor: float, time_limit: float, *,
    face: str | int | None = None, section: tuple[str, float] | None = None,
) -> Geometry:  # fmt: skip
    """Regions and curves of a file that gmsh reads.

    Parameters
    ----------
    content : bytes
        What gmsh gets to read.
    suffix : str
        Tells gmsh the format, e.g. ".step".
    factor : float
        Metres in one unit of gmsh's coordinates.
    time_limit : float, s
    face : str or int, optional
        Name or number of the flat face to take.
    section : (str, float), optional
        "x", "y" or "z", and where on that axis (metres) to cut solids.

    Raises
    ------
    GeometryError
        For anything that gmsh, or the geometry of the file, does not allow.
    """
    at = (section[0], section[1] / factor) if section else None
    data = run_child({"read": "curves", "face": face, "section": at}, content, suffix, time_limit)
    if "missed" in data:
        low, high = (factor * end + 0.0 for end in data["missed"])
        raise GeometryError(
            f"the section {section[0]} = {section[1]:g} m misses the part, "  # type: ignore[index]
            f"which reaches from {low:.6g} to {high:.6g} m"
        )
    if "solid" in data:
        raise GeometryError(_solid(data, factor))
    plane = Plane(np.array(data["plane"][0]), data["plane"][1])
    notes = list(data["notes"])
    if plane.frame[2, 2] != 1.0 and section is None:
        notes.append(f"the outline lies in {plane.words(factor)}; its x and y are {plane.coordinates()}")
    return _assembled(data, factor, notes)


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
        return Geometry(loose.regions, loose.curves, (*notes, *loose.notes))
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


def run_child(request: dict[str, Any], content: bytes, suffix: str, time_limit: float) -> dict[str, Any]:
    """What :mod:`phantomnode.geometry.gmsh_child` says about a file, in an empty directory of its own."""
    token = secrets.token_hex(16)
    with tempfile.TemporaryDirectory(prefix="phantomnode-", ignore_cleanup_errors=True) as folder:
        source, target = Path(folder, "input" + suffix), Path(folder, "result.json")
        source.write_bytes(content)
        seconds = str(int(np.ceil(time_limit)) + 1)
        status, said = _finish(
            [json.dumps(request), source.name, target.name, token, seconds], folder, time_limit
        )
        text = target.read_text(encoding="utf-8") if target.exists() else ""
    if not text.endswith(token):
        raise GeometryError(_what_happened(status, said))
    result: dict[str, Any] = json.loads(text.removesuffix(token))
    if "missing" in result:
        raise GeometryError(
            f"gmsh cannot be loaded ({result['missing']}). It needs system libraries; on Debian and Ubuntu: "
            f"apt-get install {GMSH_LIBRARIES}"
        )
    if "error" in result:
        raise GeometryError(result["error"])
    return result


def _finish(arguments: list[str], folder: str, time_limit: float) -> tuple[int, str]:
    """Run the child to its end or to the time limit: its exit status and the end of what it said."""
    # -P: nothing in the directory of the file can stand in for a module.
    command = [sys.executable, "-P", "-m", "phantomnode.geometry.gmsh_child", *arguments]
    environment = {**os.environ, "HOME": folder, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    try:
        said = process.communicate(timeout=time_limit)[1]
    except subprocess.TimeoutExpired:
        raise GeometryError(
            f"reading it took more than {time_limit:g} s (a looping script, a damaged file, or a very large part); "
            "simplify it or give a larger time_limit"
        ) from None
    finally:
        _kill(process)
    return process.returncode, said.decode(errors="replace").strip()[-300:]


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End the child, and on POSIX whatever it started."""
    if process.poll() is None:
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()


def _what_happened(status: int, said: str) -> str:
    """Why a child ended without a result, in words."""
    if status == 0:
        return "gmsh ended while reading it without a result (a script that calls Exit?)"
    reason = signal.Signals(-status).name if status < 0 else f"exit code {status}"
    return f"gmsh broke down ({reason}): the file is damaged, or needs too much memory. {said}".strip()


def _pieces(data: list[dict[str, Any]], factor: float) -> list[Curve]:
    """The pieces of the child's answer, in metres."""
    return [
        Curve(
            np.array(item["points"]) * factor, np.array(item["bulges"]), (item["name"],) * len(item["bulges"])
        )
        for item in data
    ]
