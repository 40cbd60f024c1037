"""Reads one file with gmsh, in a process of its own: ``python -m phantomnode.geometry.gmsh_child``.

gmsh runs scripts, crashes on damaged files and ends the process on a script's ``Exit``; nothing of that reaches
the program this way. Arguments: request (JSON: "read" is "curves", with "face" and "section", or
"quads"), file, file for the result, token, CPU seconds. The result is JSON followed by the token, which says that it
is whole and written here. Lengths are as gmsh gives them: millimetres for STEP and IGES (Geometry.OCCTargetUnit =
"M" is refused for an IGES file in a fresh process, and OCC's tolerance of 1e-7 is finer in millimetres), the numbers
of the file for all others.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from phantomnode.geometry import gmsh_cad, gmsh_mesh
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.gmsh_section import section

ADDRESS_SPACE = 4 << 30
"""Bytes of memory: a planar drawing needs a hundredth of it."""

FILE_SIZE = 1 << 30
"""Bytes of any file written."""


def main(arguments: list[str]) -> None:
    """Read the file and write the result or the reason why there is none."""
    request, source, target, token, seconds = arguments
    _limit(int(seconds))
    try:
        import gmsh
    except OSError as error:
        result: dict[str, Any] = {"missing": str(error)}
    else:
        try:
            result = _read(gmsh, json.loads(request), source)
        except GeometryError as error:
            result = {"error": str(error)}
    Path(target).write_text(json.dumps(result) + token, encoding="utf-8")


def _limit(seconds: int) -> None:
    """Bound memory, time and written bytes where the system can."""
    if os.name != "posix":
        return
    import resource

    for what, most in (
        (resource.RLIMIT_AS, ADDRESS_SPACE),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, FILE_SIZE),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _read(gmsh: Any, request: dict[str, Any], source: str) -> dict[str, Any]:
    """What the file holds, as plain data."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.logger.start()
    try:
        gmsh.open(source)
    except Exception as error:  # gmsh raises plain Exception, with its last error message
        raise GeometryError(
            f"gmsh cannot read it ({str(error).strip() or 'no reason given'}): the file is damaged"
        ) from error
    complaints = [line for line in gmsh.logger.get() if line.startswith("Error")]
    if complaints:
        raise GeometryError(f"gmsh cannot read it ({complaints[0]}): the file is damaged")
    if request["read"] == "quads":
        return gmsh_mesh.quads(gmsh)
    if request["section"]:
        return section(gmsh, *request["section"])
    if source.endswith(".msh") and gmsh.model.mesh.getNodes()[0].size:
        return gmsh_mesh.outline(gmsh, request["face"])
    return gmsh_cad.whole(gmsh) if request["face"] is None else gmsh_cad.face(gmsh, request["face"])


if __name__ == "__main__":
    main(sys.argv[1:])
