"""``phantomnode batch``: all cases of a sweep, those that are finished already left as they are."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from phantomnode.pipeline.batch_plots import draw_plots
from phantomnode.pipeline.batch_progress import progress_of
from phantomnode.pipeline.case import resolved_toml
from phantomnode.pipeline.engine import Crew, client_of, crew, outcomes, signals_interrupt
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.ledger import WAITING, Ledger
from phantomnode.pipeline.one_case import (
    DONE,
    FAILED,
    INTERRUPTED,
    OUTCOME,
    RUNNING,
    STOPPED,
    Order,
    held,
    is_of,
    outcome_in,
    read_record,
)
from phantomnode.pipeline.one_case import LOCK as CASE_LOCK
from phantomnode.pipeline.sweep import Study, load_study

if TYPE_CHECKING:
    from rich.console import Console

RESULTS = Path("results")
LOCK, SCRATCH = ".batch.lock", ".scratch-"


class Batch(NamedTuple):
    """What became of a batch.

    status: "done", "failed" (some cases failed, or were stopped by a guard) or "interrupted"; folder: of its
    results; ledger: the outcome of each case.
    """

    status: str
    folder: Path
    ledger: Ledger


def run_batch(
    source: str | Path,
    out: Path | str | None = None,
    *,
    workers: int | None = None,
    threads: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    only_failed: bool = False,
    console: Console | None = None,
    command: Sequence[str] = (),
) -> Batch:
    """Run the cases of a sweep on several processes.

    Every case is read and validated before the first one runs. Ctrl-C and SIGTERM leave a batch that can be
    resumed. A script that calls this needs ``if __name__ == "__main__":`` about it, because workers import it.

    Parameters
    ----------
    source : str or Path
        A sweep file, a folder that holds ``sweep.toml``, or the name of a bundled case that has one.
    out : Path or str, optional
        The folder of the results, a folder a case in it; ``results/NAME`` unless given.
    workers : int, optional
        Processes on this machine; as many as its cores allow unless given.
    threads : int
        Of each worker; workers by threads are never more than the cores.
    scheduler : str, optional
        Address of a running dask scheduler, whose workers are used in their place; they see the same folder.
    resume : bool
        Go on with a batch: cases that have ended, by the hash of the case and the version, are left as they are.
    only_failed : bool
        Go on with a batch, and run only the cases that failed or were stopped.
    console : rich Console, optional
        Where to show the progress and the table of all cases.
    command : sequence of str
        The command line, for summary.json of each case.

    Raises
    ------
    CaseError
        With everything that is wrong with the sweep, a case or an option.
    OSError
        Where results cannot be written.
    """
    study = load_study(source)
    folder = folder_of(study, out)
    if (folder / "results.csv").exists() and not (resume or only_failed):
        raise CaseError(
            f"{folder}: holds a batch already; add --resume to go on with it, or name another --out"
        )
    hands = crew(workers, threads, scheduler)
    with _alone_in(folder):
        ledger = ledger_of(study, folder)
        again = (STOPPED, FAILED) if only_failed else (WAITING.status,)
        places = [place for place, outcome in enumerate(ledger.outcomes) if outcome.status in again]
        ledger.write(folder)
        try:
            interrupted = bool(places) and _run(ledger, places, folder, hands, console, command)
        finally:
            ledger.write(folder)
        pictures = draw_plots(ledger, folder)
    if console is not None:
        _tell(ledger, folder, pictures, console)
    return Batch(_status(ledger, interrupted), folder, ledger)


def show_plan(source: str | Path, out: Path | str | None, console: Console) -> None:
    """Print the cases of a sweep, and which of them have ended in the folder; nothing is run or written.

    Raises
    ------
    CaseError
        With everything that is wrong with the sweep or a case.
    """
    study = load_study(source)
    ledger = ledger_of(study, folder_of(study, out))
    console.print(ledger.table())
    _tell_counts(ledger, console)


def folder_of(study: Study, out: Path | str | None) -> Path:
    """Where the results of a batch go."""
    return (RESULTS / study.name if out is None else Path(out)).resolve()


def ledger_of(study: Study, folder: Path) -> Ledger:
    """What is known of the cases of a sweep; a case is found by its hash, whatever its folder is called."""
    found = {}
    for file in sorted(folder.glob(f"*/{OUTCOME}")):
        record = read_record(file.parent)
        if "hash" in record and is_of(record, record["hash"]):
            found[record["hash"]] = file.parent
    taken = {found[point.hash].name.lower() for point in study.points if point.hash in found}
    folders, known = [], []
    for point in study.points:
        if point.hash in found:
            folders.append(found[point.hash].name)
            outcome = outcome_in(found[point.hash])
            known.append(WAITING if outcome.status in (RUNNING, INTERRUPTED) else outcome)
        else:
            folders.append(f"{point.name}~{point.hash[:6]}" if point.name.lower() in taken else point.name)
            known.append(WAITING)
    return Ledger(study, folders, known)


def _run(
    ledger: Ledger,
    places: Sequence[int],
    folder: Path,
    hands: Crew,
    console: Console | None,
    command: Sequence[str],
) -> bool:
    """Run some of the cases; whether the user or the system put an end to it."""
    batch, points = secrets.token_hex(8), ledger.study.points
    orders = []
    for place in places:
        text, target = resolved_toml(points[place].case), str(folder / ledger.folders[place])
        orders.append(Order(text, target, points[place].hash, batch, hands.threads, tuple(command)))
    hands = hands._replace(workers=min(hands.workers, len(places)))
    if console is not None:
        who = (
            f"workers of {hands.scheduler}" if hands.scheduler else f"{hands.workers} workers on this machine"
        )
        console.print(
            f"{len(places)} of {len(points)} cases to run, on {who}", highlight=False, soft_wrap=True
        )
    try:
        with (
            signals_interrupt(),
            TemporaryDirectory(prefix=SCRATCH, dir=folder) as scratch,
            client_of(hands, Path(scratch)) as client,
            progress_of(len(places), console) as progress,
        ):
            for place, outcome in outcomes(client, orders):
                ledger.enter(places[place], outcome)
                ledger.write(folder, now=False)
                progress.ended(points[places[place]].name, outcome)
    except KeyboardInterrupt:
        return True
    return False


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Make the folder of a batch, hold it against other batches, remove what a killed one left.

    Raises
    ------
    CaseError
        If another batch runs in it, or it is no folder.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise CaseError(f"{folder}: this is a file, or lies under one; choose another --out") from None
    with ExitStack() as lock:
        try:
            lock.enter_context(held(folder / LOCK, wait=False))
        except BlockingIOError:
            raise CaseError(f"{folder}: another batch runs in this folder; wait for it, or end it") from None
        for part in folder.glob(".*.part"):
            part.unlink()
        for scratch in folder.glob(f"{SCRATCH}*"):
            shutil.rmtree(scratch, ignore_errors=True)  # a worker of a killed batch may still be about to end
        for left in folder.glob(f"*/{CASE_LOCK}"):
            with suppress(BlockingIOError), held(left, wait=False):  # a worker of a scheduler may hold it
                pass
        yield


def _status(ledger: Ledger, interrupted: bool) -> str:
    """The status of a batch."""
    if interrupted:
        return INTERRUPTED
    return DONE if ledger.count()[DONE] == len(ledger.outcomes) else FAILED


def _tell(ledger: Ledger, folder: Path, pictures: Sequence[Path], console: Console) -> None:
    """Print the table of all cases, what failed and why, and where the results are."""
    console.print(ledger.table())
    for point, outcome in zip(ledger.study.points, ledger.outcomes, strict=True):
        if outcome.reason:
            console.print(f"{point.name}: {outcome.status}: {outcome.reason}", markup=False, soft_wrap=True)
    _tell_counts(ledger, console)
    console.print(f"results   {folder / 'results.csv'}", highlight=False, soft_wrap=True)
    for picture in pictures:
        console.print(f"picture   {picture}", highlight=False, soft_wrap=True)


def _tell_counts(ledger: Ledger, console: Console) -> None:
    """Print how many cases there are of each status."""
    counts = ", ".join(f"{count} {status}" for status, count in ledger.count().items())
    console.print(f"cases     {counts}", highlight=False, soft_wrap=True)
