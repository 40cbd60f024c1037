"""The folder of a run: what is in it, what may be replaced, what of it is complete."""

from __future__ import annotations

import errno
import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phantomnode.pipeline.checkpoint import checkpoints, remove_checkpoints
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.files import WriteError, sha256_of, write_atomically
from phantomnode.pipeline.lock import is_locked
from phantomnode.pipeline.provenance import GEOMETRY, case_hash, resolved_content, write_case
from phantomnode.pipeline.run_files import MANIFEST, sweep
from phantomnode.pipeline.summary import Check, Summary

if TYPE_CHECKING:
    from phantomnode.pipeline.case import Case

ENDED = (MANIFEST, "summary.json", "peak.png")
"""What is written when a run has ended."""

RESULTS = ("history.csv", "fields.pvd", "contact.pvd", "run.log")
FRAMES = ("fields/fields_*.vtu", "contact/contact_*.vtu", "profile.*")
OURS = ("case.toml", f"{GEOMETRY}/*", *RESULTS, *FRAMES[:2], "profile.*.csv", *ENDED[1:])
"""The files of a run that are complete when it has ended."""


def empty_folder(case: Case, folder: Path) -> None:
    """Take what another run left out of a results folder, and write the resolved case into it."""
    for name in (*ENDED, *RESULTS):
        (folder / name).unlink(missing_ok=True)
    for pattern in FRAMES:
        for frame in folder.glob(pattern):
            frame.unlink()
    remove_checkpoints(folder)
    sweep(folder)
    write_case(case, folder)


def reopen_folder(folder: Path) -> None:
    """Take out what says that the run has ended, and what a killed process left."""
    for name in ENDED:
        (folder / name).unlink(missing_ok=True)
    sweep(folder)


def write_manifest(folder: Path, known: dict[Path, str]) -> None:
    """Write manifest.json: size and SHA-256 of every file of a run that has ended.

    Parameters
    ----------
    folder : Path
    known : dict of Path to str
        Files whose SHA-256 is known already.
    """
    files = sorted(file for pattern in OURS for file in folder.glob(pattern) if file.is_file())
    listed = {
        file.relative_to(folder).as_posix(): {
            "bytes": file.stat().st_size,
            "sha256": known.get(file) or sha256_of(file),
        }
        for file in files
    }
    write_atomically(folder / MANIFEST, json.dumps({"files": listed}, indent=1) + "\n")


def differences(folder: Path) -> list[str]:
    """What of a folder is not what its manifest says; empty where all is.

    Raises
    ------
    FileNotFoundError
        Where there is no manifest: the run has not ended.
    """
    listed = _json(folder / MANIFEST).get("files")
    if not isinstance(listed, dict):
        return [MANIFEST]
    return [
        name
        for name, entry in listed.items()
        if not (folder / name).is_file() or sha256_of(folder / name) != entry.get("sha256")
    ]


def status_of(folder: Path) -> str | None:
    """How the run in a folder ended: "done", "stopped" or "interrupted"; None where it has not."""
    try:
        status = _json(folder / "summary.json").get("status")
    except FileNotFoundError:
        return None
    return status if isinstance(status, str) else None


def holds_a_run(folder: Path) -> bool:
    """Whether a folder holds what a new run must not replace: one that ended, that can go on, or is at work."""
    return (folder / "summary.json").exists() or bool(checkpoints(folder)) or is_locked(folder)


def finished_run(case: Case, folder: Path, notes: list[str]) -> Summary | None:
    """The summary of a run of this case and version that came to its end, where all of its files are whole.

    Raises
    ------
    CaseError
        Where the folder holds the run of another case.
    """
    from phantomnode import __version__

    refuse_other_case(case, folder)
    if status_of(folder) not in ("done", "stopped"):
        return None
    figures = _json(folder / "summary.json")
    if (figures.get("case_hash"), figures.get("version")) != (case_hash(case), __version__):
        return None
    try:
        spoilt = differences(folder)
    except FileNotFoundError:
        spoilt = [MANIFEST]
    if spoilt:
        notes.append(f"{folder / spoilt[0]} is missing or not what it was")
        return None
    checks = tuple(Check(**check) for check in figures.get("checks", ()))
    return Summary(figures["status"], folder, figures, checks)


def refuse_other_case(case: Case, folder: Path) -> None:
    """Refuse to go on in the folder of another case.

    Raises
    ------
    CaseError
        Naming the keys that differ.
    """
    from phantomnode.pipeline.case import load_case

    if not (folder / "case.toml").is_file():
        return
    try:
        there = resolved_content(load_case(folder / "case.toml"))
    except (CaseError, OSError):
        return  # half a folder: its checkpoints say themselves of which case they are
    found, wanted = _flat(there), _flat(resolved_content(case))
    differ = [key for key in {**found, **wanted} if found.get(key) != wanted.get(key)]
    if differ:
        told = ", ".join(f"{k} is {_told(found, k)} there and {_told(wanted, k)} here" for k in differ[:3])
        more = f" (and {len(differ) - 3} more)" if len(differ) > 3 else ""
        raise CaseError(
            f"{folder}: holds a run of another case: {told}{more}. Take another --out or --overwrite; "
            f"for that case, {go_on_with(folder)}"
        )


def go_on_with(folder: Path) -> str:
    """The command that goes on with a run."""
    return f"go on with: phantomnode run {shlex.quote(str(folder))} --resume"


def cannot_write(error: OSError, folder: Path, main: Path) -> WriteError:
    """An error of the disk, with what to do about it; ``main`` is the folder to be resumed."""
    resumable = bool(checkpoints(folder))
    then = go_on_with(main) if resumable else "run the case again"
    if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)):
        advice = f"make space on the disk, then {then}"
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        advice = "results cannot be written there; change that, or take another --out" + (
            f"; then {then}" if resumable else ""
        )
    elif error.errno == errno.ENOENT:
        advice = f"the folder, or a part of it, is gone; {then}"
    else:
        advice = then
    return WriteError(error, advice)


def _flat(value: Any, place: str = "") -> dict[str, Any]:
    """The values of a table by their full keys."""
    if not isinstance(value, dict):
        return {place: value}
    return {k: v for key, item in value.items() for k, v in _flat(item, f"{place}.{key}".lstrip(".")).items()}


def _told(values: dict[str, Any], key: str) -> str:
    """A value for a message; a hash in short."""
    if key not in values:
        return "not given"
    return f"a file of content {values[key][:8]}..." if key.endswith(".file") else str(values[key])


def _json(path: Path) -> dict[str, Any]:
    """A table in a JSON file; empty where it is damaged."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return {}
    return table if isinstance(table, dict) else {}
