"""Where the results of a run go, and where those of an unfinished one are."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phantomnode.pipeline.schema import Case

RESULTS = Path("results")


def results_folder(case: Case, out: Path | None, source: Path, overwrite: bool = False) -> Path:
    """Where the results of a run go, such that no finished run is lost.

    Parameters
    ----------
    case : Case
    out : Path or None
        The folder that was asked for; None for the first free one of results/NAME, results/NAME-2, ...
    source : Path
        The case file.
    overwrite : bool
        Whether a finished run in ``out`` may be written over.

    Raises
    ------
    CaseError
        If ``out`` holds a finished run, the case file itself, or is no folder.
    """
    from phantomnode.pipeline.errors import CaseError
    from phantomnode.pipeline.folder import holds_a_run, status_of

    if out is None:
        return next(folder for folder in _numbered(case) if not holds_a_run(folder))
    if out.exists() and not out.is_dir():
        raise CaseError(f"--out {out}: is a file; name a folder")
    if out.resolve() == source.resolve().parent:
        raise CaseError(
            f"--out {out}: holds the case file itself, which the results would replace; name another"
        )
    if holds_a_run(out) and not overwrite:
        if status_of(out) in ("done", "stopped"):
            raise CaseError(f"--out {out}: holds a finished run; name another folder, or add --overwrite")
        raise CaseError(
            f"--out {out}: holds a run that has not come to its end; add --resume to go on with it, "
            "--overwrite to start again, or name another folder"
        )
    return out


def folder_to_resume(case: Case, out: Path | None, source: Path) -> Path:
    """The folder of the run to go on with.

    Parameters
    ----------
    case : Case
    out : Path or None
        The folder that was asked for; None for that of the case file where it is one of a run, else for the last
        of results/NAME, NAME-2, ... in which a run has not come to its end.
    source : Path
        The case file.

    Raises
    ------
    CaseError
        If ``out`` is no folder.
    """
    from phantomnode.pipeline.errors import CaseError
    from phantomnode.pipeline.folder import status_of

    if out is not None:
        if out.exists() and not out.is_dir():
            raise CaseError(f"--out {out}: is a file; name a folder")
        return out
    if source.name == "case.toml" and (source.parent / "run.log").is_file():
        return source.parent
    there = list(takewhile(Path.is_dir, _numbered(case)))
    unfinished = [folder for folder in there if status_of(folder) not in ("done", "stopped")]
    return [RESULTS / case.name, *there, *unfinished][-1]


def _numbered(case: Case) -> Iterator[Path]:
    """results/NAME, results/NAME-2, ..."""
    return (RESULTS / (case.name if number == 1 else f"{case.name}-{number}") for number in count(1))
