"""CAD files for tests, made by gmsh, and how to read many of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from phantomnode.geometry import reading
from phantomnode.geometry.curves import Geometry
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.readers import TIME_LIMIT


def by_gmsh(folder: Path, body: str, *names: str) -> tuple[Path, ...]:
    """Files that gmsh writes of a model, in a process of its own."""
    lines = [
        "import gmsh, sys",
        "gmsh.initialize(interruptible=False)",
        "gmsh.option.setNumber('General.Terminal', 0)",
        "occ, geo, model, mesh = gmsh.model.occ, gmsh.model.geo, gmsh.model, gmsh.model.mesh",
        body,
        *(f"gmsh.write({str(folder / name)!r})" for name in names),
    ]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, capture_output=True, timeout=60)
    return tuple(folder / name for name in names)


def read_here(path: Path, unit: str | None = None, **options: Any) -> Geometry:
    """What ``read_geometry`` does in a process of its own, in this one: for many drawings, and patched limits."""
    wanted = {
        "layers": (),
        "without_layers": (),
        "trust_scripts": False,
        "face": None,
        "section": None,
        **options,
    }
    try:
        return reading.geometry(Path(path).read_bytes(), {"unit": unit, **wanted}, TIME_LIMIT)
    except GeometryError as error:
        raise GeometryError(f"{path}: {error}") from error
