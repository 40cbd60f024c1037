"""``phantomnode report``: pages and pictures of a run, of a batch, of runs beside each other."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from phantomnode.pipeline.cases_page import (
    PAGE,
    Asked,
    asked_of,
    cases_page,
    compared_cases,
    compared_runs,
    table_of,
)
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.figures import draw_figures
from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.page_charts import overlay
from phantomnode.pipeline.profile import draw_profiles
from phantomnode.pipeline.results import no_results, open_results
from phantomnode.pipeline.run_files import VARIANTS
from phantomnode.pipeline.run_page import run_page

LOG = logging.getLogger(__name__)

COMPARISON = "comparison.html"


def write_report(folders: Sequence[Path], out: Path) -> list[Path]:
    """Write the page of a run or a batch with its figures, or one that compares runs, and profiles over each other.

    The variants of a run get pages in their own folders.

    Parameters
    ----------
    folders : sequence of Path
        Results folders.
    out : Path
        Where the page and pictures go; made where it is missing.

    Returns
    -------
    list of Path
        The page, those of the variants of a run, and the pictures.

    Raises
    ------
    CaseError
        Where a folder holds no results.
    """
    for folder in folders:
        if not folder.is_dir():
            raise CaseError(f"{folder}: there is no such folder; name the folder of a run, or of a batch")
    batches = [folder for folder in folders if _is_batch(folder)]
    if batches and len(folders) > 1:
        raise CaseError(f"{batches[0]}: holds a batch; a batch has a report of its own: name it alone")
    runs = {} if batches else runs_of(folders)
    out.mkdir(parents=True, exist_ok=True)
    if batches:
        figures = draw_figures(folders[0], out)
        text = cases_page(asked_of(folders[0]), compared_cases(folders[0]), folders[0], figures)
        return [_written(out / PAGE, text), *figures]
    profiles = draw_profiles(runs, out)
    if len(folders) > 1:
        text = cases_page(Asked("Runs beside each other"), compared_runs(runs), out, profiles)
        return [_written(out / COMPARISON, text), *profiles]
    (main, *variants) = runs.values()
    pictures = [*draw_figures(main, out), *profiles]
    pages = [_written(variant / PAGE, run_page(open_results(variant))) for variant in variants]
    table, laid = None, None
    if variants:
        table, laid = table_of(compared_runs(runs), main), overlay(runs)
    text = run_page(open_results(main), pictures, table, laid)
    return [_written(out / PAGE, text), *pages, *pictures]


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
        Where a folder holds no run, or none of them a profile.
    """
    runs = runs_of(folders)
    if not any(any(folder.glob("profile.*.csv")) for folder in runs.values()):
        raise CaseError("these runs wrote no profile; ask for one with [output.profile.NAME] in the case")
    out.mkdir(parents=True, exist_ok=True)
    return draw_profiles(runs, out)


def runs_of(folders: Sequence[Path]) -> dict[str, Path]:
    """The runs in some folders and their variants, by their names.

    Raises
    ------
    CaseError
        Where a folder holds no run.
    """
    runs: dict[str, Path] = {}
    known = set[Path]()
    for folder in folders:
        if not (folder / "history.csv").is_file():
            raise no_results(folder)
        for run in (folder, *sorted(p.parent for p in folder.glob(f"{VARIANTS}/*/history.csv"))):
            if run.resolve() in known:
                continue
            known.add(run.resolve())
            own, case = run.resolve().name, folder.resolve().name
            names = (own, f"{case}/{own}", str(run))
            runs[next((name for name in names if name not in runs), str(run))] = run
    return runs


def _is_batch(folder: Path) -> bool:
    return (folder / "results.csv").is_file() and not (folder / "history.csv").is_file()


def _written(path: Path, text: str) -> Path:
    """A page, in its file."""
    write_atomically(path, text)
    LOG.info("%s, %.1f MB", path, path.stat().st_size / 1e6)
    return path
