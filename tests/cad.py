"""CAD files for tests, made by gmsh."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


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
