"""Where a result comes from: the hash of its case, what ran it, and a copy of all that it was made from."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phantomnode.pipeline.files import write_atomically

if TYPE_CHECKING:
    from phantomnode.pipeline.schema import Case

GEOMETRY = "geometry"
"""Folder, within the results, of copies of the files that the case names."""

PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "shapely", "gmsh", "ezdxf", "meshio", "pydantic")


def case_hash(case: Case) -> str:
    """SHA-256 of all that decides the outcome of a case, as 64 hexadecimal digits.

    That is the resolved case with the content of the files that it names, and without what only labels it:
    title, name, where files lie, checkpoints, variants.

    Raises
    ------
    OSError
        Where a file cannot be read.
    """
    return hashlib.sha256(json.dumps(resolved_content(case)).encode()).hexdigest()


def family_hash(case: Case) -> str:
    """SHA-256 of a case with its variants, by their names; that of the case alone where it has none.

    Raises
    ------
    OSError
        Where a file cannot be read.
    """
    from phantomnode.pipeline.case import variants

    own = case_hash(case)
    if not case.variant:
        return own
    theirs = {name: case_hash(variant) for name, variant in variants(case).items()}
    return hashlib.sha256(json.dumps([own, theirs]).encode()).hexdigest()


def resolved_content(case: Case) -> dict[str, Any]:
    """The resolved case with, in place of the name of each file, its ending and the SHA-256 of its content."""
    table = case.model_dump(
        mode="json", exclude_none=True, exclude={"title", "name", "folder", "variant", "figure"}
    )
    table["output"].pop("checkpoint", None)
    content: dict[str, Any] = _with_files(table, lambda file: _content(case.path(file)))
    return content


def _content(path: Path) -> str:
    return f"{hashlib.sha256(path.read_bytes()).hexdigest()}{path.suffix.lower()}"


def _with_files(table: Any, replaced: Callable[[str], str]) -> Any:
    """A table in which the name of each file is replaced."""
    if isinstance(table, list):
        return [_with_files(item, replaced) for item in table]
    if not isinstance(table, dict):
        return table
    return {
        key: replaced(value) if key == "file" and isinstance(value, str) else _with_files(value, replaced)
        for key, value in table.items()
    }


def write_case(case: Case, folder: Path) -> None:
    """Write case.toml, resolved, and beside it in ``geometry/`` the files that it names: the run again.

    Raises
    ------
    OSError
        Where something cannot be read or written.
    """
    from phantomnode.pipeline.case import toml_of

    copies: dict[Path, str] = {}

    def copied(base: Path) -> Callable[[str], str]:
        def name_of(file: str) -> str:
            source = (base / Path(file).expanduser()).resolve()
            if not source.is_file():  # of a variant that will say so when its turn comes
                return str(source)
            if source not in copies:
                copies[source] = _free_name(source, set(copies.values()))
            return copies[source]

        return name_of

    table = case.model_dump(mode="json", exclude_none=True)
    variants = table.pop("variant")
    table = _with_files(table, copied(case.folder))
    table["folder"] = GEOMETRY
    table["variant"] = {
        name: {
            key: value
            for key, value in _with_files(changes, copied(case.folder / changes.get("folder", ""))).items()
            if key != "folder"
        }
        for name, changes in variants.items()
    }
    if copies:
        (folder / GEOMETRY).mkdir(exist_ok=True)
    for source, name in copies.items():
        write_atomically(folder / GEOMETRY / name, source.read_bytes())
    for left in (folder / GEOMETRY).glob("*"):
        if left.name not in copies.values() and left.is_file():
            left.unlink()
    write_atomically(folder / "case.toml", toml_of(table))


def _free_name(source: Path, taken: set[str]) -> str:
    """The name of a file, numbered where another one has it."""
    name, number = source.name, 2
    while name in taken:
        name, number = f"{source.stem}-{number}{source.suffix}", number + 1
    return name


def provenance(command: Sequence[str], threads: int) -> dict[str, Any]:
    """The machine, the versions of what computes, the command line."""
    return {
        "command": list(command),
        "threads": threads,
        "machine": {
            "name": platform.node(),
            "system": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count(),
        },
        "python": platform.python_version(),
        "packages": {name: found for name in PACKAGES if (found := _version(name))},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    """The model of the processor, as Linux tells it; elsewhere its kind."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
