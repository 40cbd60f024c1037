"""``phantomnode batch``: all cases of a sweep, those that are finished already left as they are."""

from __future__ import annotations

import secrets
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from phantomnode.pipeline.batch_plots import draw_plots
from phantomnode.pipeline.batch_progress import progress_of
from phantomnode.pipeline.case import resolved_toml, toml_of
from phantomnode.pipeline.durations import every_option
from phantomnode.pipeline.engine import GRACE, Crew, client_of, crew, outcomes
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.figures import draw_figures
from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.ledger import Ledger
from phantomnode.pipeline.one_case import (
    DONE,
    FAILED,
    INTERRUPTED,
    NOT_BEGUN,
    OUTCOME,
    RUNNING,
    STOPPED,
    UNFINISHED,
    Order,
    held,
    is_of,
    known,
    read_record,
    tidy,
)
from phantomnode.pipeline.one_case import LOCK as CASE_LOCK
from phantomnode.pipeline.stopping import FINISHING, Stopping, wall_limit_from
from phantomnode.pipeline.sweep import COPY, Study, load_study

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
    checkpoint_every: str | None = None,
    wall_limit: str | None = None,
    console: Console | None = None,
    command: Sequence[str] = (),
) -> Batch:
    """Run the cases of a sweep on several processes.

    Every case is read and validated before the first one runs. On Ctrl-C, SIGTERM and near the wall limit, the cases
    that run write a checkpoint, and the batch can be resumed. A script that calls this needs
    ``if __name__ == "__main__":`` about it, because workers import it.

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
    checkpoint_every : str, optional
        How often a case writes a checkpoint, as "0.5 ms", "1000 steps" or "10 min"; as the case says unless given.
    wall_limit : str, optional
        When to end, as "23:50:00" or "2 h" from now.
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
    limit = wall_limit_from(wall_limit, time.perf_counter())
    if checkpoint_every is not None:
        every_option(checkpoint_every)
    study = load_study(source)
    folder = folder_of(study, out)
    if (folder / "results.csv").exists() and not (resume or only_failed):
        raise CaseError(
            f"{folder}: holds a batch already; add --resume to go on with it, or name another --out"
        )
    hands = crew(workers, threads, scheduler)
    with _alone_in(folder):
        ledger = ledger_of(study, folder)
        again = (STOPPED, FAILED) if only_failed else UNFINISHED
        places = [place for place, outcome in enumerate(ledger.outcomes) if outcome.status in again]
        orders = _orders(ledger, places, folder, hands.threads, command, checkpoint_every)
        ledger.write(folder)
        write_atomically(folder / COPY, toml_of(study.copy()))
        reason = ""
        try:
            if orders:
                stopping = Stopping(limit, kept=GRACE + FINISHING)
                reason = _run(
                    ledger, dict(zip(places, orders, strict=True)), folder, hands, stopping, console
                )
        finally:
            ledger.look_again(folder)
            ledger.write(folder)
        pictures = [*draw_plots(ledger, folder), *draw_figures(folder)]
    if console is not None:
        _tell(ledger, folder, pictures, console)
        if reason:
            told = f"{reason}; go on with: the same command and --resume"
            console.print(told, highlight=False, soft_wrap=True)
    return Batch(_status(ledger, bool(reason)), folder, ledger)


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
    folders, outcomes = [], []
    for point in study.points:
        if point.hash in found:
            folders.append(found[point.hash].name)
            outcomes.append(known(found[point.hash], point.hash))
        else:
            folders.append(f"{point.name}~{point.hash[:6]}" if point.name.lower() in taken else point.name)
            outcomes.append(NOT_BEGUN)
    return Ledger(study, folders, outcomes)


def _orders(
    ledger: Ledger,
    places: Sequence[int],
    folder: Path,
    threads: int,
    command: Sequence[str],
    checkpoint_every: str | None,
) -> list[Order]:
    """What workers get for some of the cases."""
    batch, points = secrets.token_hex(8), ledger.study.points
    orders = []
    for place in places:
        text, target = resolved_toml(points[place].case), str(folder / ledger.folders[place])
        orders.append(
            Order(text, target, points[place].hash, batch, threads, tuple(command), checkpoint_every)
        )
    return orders


def _run(
    ledger: Ledger,
    orders: Mapping[int, Order],
    folder: Path,
    hands: Crew,
    stopping: Stopping,
    console: Console | None,
) -> str:
    """Run the cases at some places of the ledger; why it ended before they did, nothing where it did not."""
    places, points = list(orders), ledger.study.points
    hands = hands._replace(workers=min(hands.workers, len(places)))
    if console is not None:
        _tell_who(len(places), len(points), hands, console)
    stopping.moved()
    try:
        with (
            stopping,
            TemporaryDirectory(prefix=SCRATCH, dir=folder) as scratch,
            client_of(hands, Path(scratch)) as client,
            progress_of(len(places), console) as progress,
        ):
            for news in outcomes(client, list(orders.values()), stopping):
                if news is not None:
                    place, outcome = places[news[0]], news[1]
                    ledger.enter(place, outcome)
                    if outcome.status != RUNNING:
                        progress.ended(points[place].name, outcome)
                ledger.write(folder, now=False)
    except KeyboardInterrupt:  # a second signal
        pass
    if all(ledger.outcomes[place].status not in UNFINISHED for place in places):
        return ""
    for order in orders.values():
        tidy(Path(order.folder))
    return stopping.reason()


def _tell_who(count: int, total: int, hands: Crew, console: Console) -> None:
    """Print how many cases run, and who runs them."""
    own = f"{hands.workers} workers on this machine"
    who = f"workers of {hands.scheduler}" if hands.scheduler else own
    console.print(f"{count} of {total} cases to run, on {who}", highlight=False, soft_wrap=True)


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
