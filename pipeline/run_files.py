"""Names of what lies in the folder of a run, for those that look into many folders without what makes a run."""

from __future__ import annotations

from pathlib import Path

from phantomnode.pipeline.files import remove_parts
from phantomnode.pipeline.provenance import GEOMETRY

VARIANTS = "variants"
"""Folder, within the results of a case, of the results of its variants."""

MANIFEST = "manifest.json"
"""Size and SHA-256 of every file of a run that has ended; written last."""


def sweep(folder: Path) -> None:
    """Remove the temporary files of a killed process from the folder of a run."""
    for place in (folder, *(folder / name for name in ("fields", "contact", "checkpoint", GEOMETRY))):
        remove_parts(place)


def runs_in(folder: Path) -> list[Path]:
    """The folders of a case and of its variants that have begun."""
    try:
        variants = sorted(place for place in (folder / VARIANTS).iterdir() if place.is_dir())
    except FileNotFoundError:
        return [folder]
    return [folder, *variants]
