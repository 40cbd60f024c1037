"""Pictures that compare runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.profile import draw_profiles
from phantomnode.pipeline.run import VARIANTS


def report_runs(folders: Sequence[Path], out: Path) -> list[Path]:
    """Draw the profiles of some runs, and of their variants, over each other.

    Parameters
    ----------
    folders : sequence of Path
        Results folders; a curve has the name of its folder.
    out : Path
        Where the pictures go; made where it is missing.

    Raises
    ------
    CaseError
        Where a folder holds no finished run, or none of them a profile.
    """
    runs: dict[str, Path] = {}
    for folder in folders:
        if not (folder / "summary.json").is_file():
            raise CaseError(f"{folder}: holds no results of a run (no summary.json)")
        for run in (folder, *sorted(p.parent for p in folder.glob(f"{VARIANTS}/*/summary.json"))):
            name = run.resolve().name
            runs[name if name not in runs else str(run)] = run
    if not any(any(folder.glob("profile.*.csv")) for folder in runs.values()):
        raise CaseError("these runs wrote no profile; ask for one with [output.profile.NAME] in the case")
    out.mkdir(parents=True, exist_ok=True)
    return draw_profiles(runs, out)
