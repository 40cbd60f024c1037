"""Case files: found, read, overridden, validated, written back with every default spelled out."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from phantomnode.pipeline.crosscheck import cross_check
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.merging import merged
from phantomnode.pipeline.messages import describe, listed, suggestion
from phantomnode.pipeline.overrides import apply_overrides
from phantomnode.pipeline.schema import Case

__all__ = [
    "CASE_FILE",
    "SWEEP_FILE",
    "Case",
    "CaseError",
    "bundled_cases",
    "case_from_table",
    "default_name",
    "find_case",
    "json_schema",
    "load_case",
    "read_toml",
    "resolved_toml",
    "schema_text",
    "toml_of",
    "variants",
]

CASE_FILE, SWEEP_FILE = "case.toml", "sweep.toml"

COMMA = re.compile(r"=\s*[-+]?\d+,\d+\s*(#.*)?$", re.MULTILINE)
"""A number as it is written where a comma parts off the decimals."""


def load_case(source: str | Path, overrides: Sequence[str] = ()) -> Case:
    """Read and validate a case.

    Parameters
    ----------
    source : str or Path
        A case file, a folder that holds ``case.toml``, or the name of a bundled case ("ring_impact", or
        "ring_impact/polar" for a variant).
    overrides : sequence of str
        Each ``key.path=value``, as ``"body.ring.initial_velocity=[0, -100]"``; the value is TOML.

    Returns
    -------
    Case
        Validated, in SI; its ``folder`` is absolute.

    Raises
    ------
    CaseError
        With everything that is wrong, each message naming the file and the key.
    """
    file = find_case(source)
    table = read_toml(file)
    try:
        apply_overrides(table, overrides)
        return case_from_table(table, file.parent, default_name(file))
    except CaseError as error:
        raise CaseError([m if m.startswith("--set") else f"{file}: {m}" for m in error.messages]) from error


def case_from_table(table: Mapping[str, Any], folder: Path = Path("."), name: str = "case") -> Case:
    """Validate a case that is given as a table (what TOML reads).

    Parameters
    ----------
    table : mapping
        The case.
    folder : Path
        Where relative files are taken from, unless the case says it.
    name : str
        The name of the case, unless the case says it.

    Raises
    ------
    CaseError
        With everything that is wrong; each message starts with the key.
    """
    filled = {"name": name, **table}
    try:
        case = Case.model_validate(filled)
    except ValidationError as error:
        raise CaseError(describe(error, filled)) from error
    # A folder in the file is relative to the file; "/" keeps an absolute one.
    case = case.model_copy(update={"folder": (folder / case.folder).resolve()})
    if faults := cross_check(case):
        raise CaseError(faults)
    variants(case)  # what is wrong with them is told before anything runs
    return case


def variants(case: Case) -> dict[str, Case]:
    """The variants of a case by name: its own keys, with those of the variant in their places.

    Raises
    ------
    CaseError
        With everything that is wrong with a variant.
    """
    base = case.model_dump(mode="json", exclude_none=True, exclude={"variant", "figure"})
    found = {}
    for name, changes in case.variant.items():
        try:
            if "variant" in changes:
                raise CaseError("variant: a variant has none of its own")
            found[name] = case_from_table(
                merged(base, {"title": f"{case.title or case.name}: {name}", **changes})
            )
        except CaseError as error:
            raise CaseError([f"variant.{name}: {message}" for message in error.messages]) from error
    return found


def resolved_toml(case: Case) -> str:
    """The case as TOML with every default spelled out; it loads back to an equal case from anywhere."""
    return toml_of(case.model_dump(mode="json", exclude_none=True))


def toml_of(table: Mapping[str, Any]) -> str:
    """A resolved case, as a table, as TOML."""
    text = tomli_w.dumps(table)
    # tomli_w gives every number of a list its own line; a vector reads better on one.
    return re.sub(r"\[\n(?:\s+[-+0-9.e]+,\n)+\s*\]", _on_one_line, text)


def _on_one_line(numbers: re.Match[str]) -> str:
    """A list of numbers, written over several lines, on one."""
    return f"[{' '.join(numbers[0].strip('[]').split()).rstrip(',')}]"


def json_schema() -> dict[str, Any]:
    """The JSON schema of a case file, for editors that complete and check TOML."""
    schema = Case.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "phantomnode case"}


def schema_text() -> str:
    """The schema as the content of a file that editors read."""
    return json.dumps(json_schema(), indent=2) + "\n"


def bundled_cases() -> dict[str, Path]:
    """Bundled cases by name: "folder" for its case.toml, "folder/variant" for another TOML file in it.

    A sweep.toml is no case: ``phantomnode batch`` finds it by the name of its folder.
    """
    # By name, not by import: cases are data (see the import contracts in pyproject.toml).
    root = Path(str(resources.files("phantomnode.cases")))
    found = {}
    for file in sorted(root.glob("*/*.toml"), key=lambda f: (f.parent.name, f.name != CASE_FILE, f.name)):
        folder = file.parent.name
        if file.name == SWEEP_FILE:
            continue
        found[folder if file.name == CASE_FILE else f"{folder}/{file.stem}"] = file
    return found


def find_case(source: str | Path) -> Path:
    """The file of a case.

    Raises
    ------
    CaseError
        If there is no such file, folder or bundled case.
    """
    path = Path(source).expanduser()
    if path.is_file():
        return path
    if (path / CASE_FILE).is_file():
        return path / CASE_FILE
    bundled = bundled_cases()
    if str(source) in bundled:
        return bundled[str(source)]
    if path.is_dir():
        raise CaseError(f"{path}: this folder holds no {CASE_FILE}; name the case file itself, or write one")
    beside = [str(folder.parent) for folder in path.parent.glob(f"*/{CASE_FILE}")]
    raise CaseError(
        f"{source}: there is no such file, folder or bundled case{suggestion(str(source), [*beside, *bundled])}; "
        f"bundled cases are {listed(bundled)}"
    )


def read_toml(file: Path) -> dict[str, Any]:
    """The table in a TOML file.

    Raises
    ------
    CaseError
        If it cannot be read, or is no TOML.
    """
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise CaseError(f"{file}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise CaseError(f"{file}: is not a text file in UTF-8, as TOML is") from error
    except tomllib.TOMLDecodeError as error:
        hint = (
            "; a number has a decimal point: 0.2, not 0,2"
            if COMMA.search(file.read_text("utf-8-sig"))
            else ""
        )
        raise CaseError(f"{file}: is not valid TOML: {error}{hint}") from error


def default_name(file: Path) -> str:
    """The folder's name for a case.toml or sweep.toml, else the file's, with what no name may hold replaced."""
    folder = file.resolve().parent.name
    raw = {CASE_FILE: folder, SWEEP_FILE: f"{folder}_sweep"}.get(file.name, file.stem)
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in raw)
    return name if name[:1].isalpha() or name[:1] == "_" else f"case_{name}"
