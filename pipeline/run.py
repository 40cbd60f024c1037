"""Runs a case: prepare, step, let the observers look, say whether the result can be trusted."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.background import Background
from phantomnode.pipeline.checkpoint import identity, shown
from phantomnode.pipeline.durations import every_option
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.files import make_folder, write_atomically
from phantomnode.pipeline.folder import cannot_write, finished_run, go_on_with, write_manifest
from phantomnode.pipeline.keeper import Keeper
from phantomnode.pipeline.lock import FolderLock
from phantomnode.pipeline.observer import Ending, Observer, sample_steps
from phantomnode.pipeline.preflight import report, steps_of, text_report, threads_told, variant_row
from phantomnode.pipeline.profile import draw_profiles, profile_steps, stations
from phantomnode.pipeline.provenance import case_hash, provenance
from phantomnode.pipeline.run_files import VARIANTS
from phantomnode.pipeline.runlog import RunLog
from phantomnode.pipeline.start import Start, new_start, resumed_start
from phantomnode.pipeline.stopping import Stopping, WallLimit, wall_limit_from
from phantomnode.pipeline.summary import Clock, Summary, show, summarize

if TYPE_CHECKING:
    from rich.console import Console

    from phantomnode.pipeline.case import Case
    from phantomnode.pipeline.prepare import Prepared
    from phantomnode.solver.explicit import Frame

LOG = logging.getLogger(__name__)


def run(
    case: Case,
    out: Path | str,
    *,
    console: Console | None = None,
    command: Sequence[str] = (),
    threads: int = 1,
    resume: bool = False,
    checkpoint_every: str | None = None,
    wall_limit: str | WallLimit | None = None,
    ordered: Callable[[], bool] = lambda: False,
    main: Path | None = None,
) -> Summary:
    """Run a case into a folder.

    Nothing is written before the case is prepared, so a case at fault leaves no trace. Then every file is
    complete at any time, and a run that a guard stops or that is interrupted (Ctrl-C, SIGTERM, wall limit) leaves
    its last state, its history, a summary that says so, and a checkpoint. Also after a crash it goes on from its
    last checkpoint: history, fields and summary are those of a run without interruption, to the bit.

    Parameters
    ----------
    case : Case
    out : Path or str
        The results folder; made where it is missing. Results of an earlier run in it are removed.
    console : rich Console, optional
        Where to show the progress and the verdict; nothing is shown without one.
    command : sequence of str
        The command line, for run.log and summary.json.
    threads : int
        How many may take part in a step; small models keep to one. The results are the same, to the bit.
    resume : bool
        Go on from the last good checkpoint in the folder; from the start where there is none. A run that came to
        its end is left as it is.
    checkpoint_every : str, optional
        How often to write a checkpoint, as "0.5 ms", "1000 steps" or "10 min"; as the case says unless given.
    wall_limit : str or WallLimit, optional
        When to end with a checkpoint, as "23:50:00" or "2 h" from now.
    ordered : callable
        Asked a few times a second; where it says so, the run ends as on a signal.
    main : Path, optional
        The folder to name in the advice to go on; ``out`` unless given.

    Returns
    -------
    Summary
        With the status "done", "stopped" or "interrupted" and the content of summary.json.

    Raises
    ------
    CaseError, GeometryError
        Where the case, a geometry or the folder cannot be used, or a checkpoint is of another case or version.
    WriteError
        Where a result cannot be written: an OSError that says what to do.
    """
    from phantomnode.pipeline.prepare import prepare

    began, folder, notes = time.perf_counter(), Path(out), list[str]()
    _refuse_source_folder(case, folder)
    check_threads(threads)
    every = every_option(checkpoint_every or case.output.checkpoint.every)
    limit = wall_limit_from(wall_limit, began)
    if resume and (finished := finished_run(case, folder, notes)) is not None:
        _tell(console, [f"finished already: {folder}"])
        return finished
    _tell_of_compiling(console)
    prepared = prepare(case)
    LOG.info("prepared in %.2f s", time.perf_counter() - began)
    if LOG.isEnabledFor(logging.INFO):
        LOG.info("%s", text_report(prepared).strip())
    lines, digest = stations(prepared), case_hash(case)
    own = identity(digest, prepared.model)
    source: dict[str, Any] = {"case_hash": digest, "provenance": provenance(command, threads)}
    try:
        make_folder(folder)
        with FolderLock(folder) as lock, Stopping(limit, ordered) as stopping, ExitStack() as closing:
            if lock.taken_over:
                notes.append(f"{folder}: the run before was killed; its folder is taken over")
            start = (
                resumed_start(prepared, lines, folder, own, notes)
                if resume
                else new_start(prepared, lines, folder)
            )
            closing.callback(start.history.close)
            closing.callback(start.fields.close)
            _tell(console, notes)
            log = RunLog(folder / "run.log", prepared, command, notes, start.frame)
            background = Background([start.fields, *start.profiles.values()])
            closing.callback(background.close)
            keeper = Keeper(folder, own, every, start, background, stopping, began)
            observers: list[Observer] = [start.tally, start.history, background]
            observers += _progress(prepared, console, start, closing)

            def told(used: int) -> None:
                source["provenance"]["threads_used"] = used
                if used < threads:
                    log.add(threads_told(prepared, threads, used))
                    _tell(console, [threads_told(prepared, threads, used)])

            ending, stepping = march(prepared, observers, threads, start.frame, stopping, keeper, told)
            if ending.status == "interrupted":
                ending = ending._replace(advice=go_on_with(main or folder))
            for observer in observers:
                observer.finish(ending)
            wall = start.past.wall + time.perf_counter() - began
            clock = Clock(wall, start.past.steps + stepping)
            source["resumed_at"] = list(start.past.resumed_at)
            summary = summarize(prepared, start.tally, ending, clock, folder, source, start.fields.highest)
            _finish(prepared, start, summary, log)
            LOG.info("summary, picture and manifest are written; %.2f s in all", wall)
    except OSError as error:
        raise cannot_write(error, folder, main or folder) from error
    if console is not None:
        show(console, summary)
        if ending.status == "interrupted":
            _tell(console, [ending.advice])
    return summary


def run_all(
    case: Case,
    out: Path | str,
    *,
    console: Console | None = None,
    command: Sequence[str] = (),
    threads: int = 1,
    resume: bool = False,
    checkpoint_every: str | None = None,
    wall_limit: str | None = None,
    ordered: Callable[[], bool] = lambda: False,
) -> list[Summary]:
    """Run a case and its variants, and draw their profiles over each other, and the figures of the case.

    The variants go to ``variants/NAME`` in the results folder, the pictures, profile.NAME.png and figure.NAME.png,
    to the folder itself. A run that is interrupted is the last one. Parameters and errors are those of :func:`run`.

    Returns
    -------
    list of Summary
        Of the case, then of its variants.
    """
    from phantomnode.pipeline.case import variants
    from phantomnode.pipeline.figures import draw_figures
    from phantomnode.pipeline.prepare import prepare

    folder, limit = Path(out), wall_limit_from(wall_limit, time.perf_counter())
    cases = {"": (case, folder)}
    cases |= {name: (variant, folder / VARIANTS / name) for name, variant in variants(case).items()}
    if case.variant and not resume:  # what is wrong with any of them is told before the first step
        _refuse_source_folder(case, folder)
        check_threads(threads)
        _tell_of_compiling(console)
        for name, (one, _) in cases.items():
            with _told_of(name):
                stations(prepare(one))
    runs: dict[str, Path] = {}
    summaries: list[Summary] = []
    for name, (one, place) in cases.items():
        runs[name or _label(case)] = place
        with _told_of(name):
            summary = run(
                one, place, console=console, command=command, threads=threads, resume=resume,
                checkpoint_every=checkpoint_every, wall_limit=limit, ordered=ordered, main=folder,
            )  # fmt: skip
        summaries.append(summary)
        if summary.status == "interrupted":
            break
    pictures = draw_profiles(runs, folder)
    if case.figure and all(summary.status == "done" for summary in summaries):
        pictures += draw_figures(folder)
    _tell(console, [f"picture   {picture}" for picture in pictures])
    return summaries


def prepared_variants(case: Case) -> Iterator[tuple[str, Prepared]]:
    """The variants of a case by their names, one after the other.

    Raises
    ------
    CaseError, GeometryError
        Where one cannot be run, with its name.
    """
    from phantomnode.pipeline.case import variants
    from phantomnode.pipeline.prepare import prepare

    for name, variant in variants(case).items():
        with _told_of(name):
            prepared = prepare(variant)
            stations(prepared)  # a line that meets no body is told now
            yield name, prepared


def _label(case: Case) -> str:
    """The name of a case among its variants, for pictures."""
    return case.method if case.method not in case.variant else case.name


@contextmanager
def _told_of(variant: str) -> Iterator[None]:
    """What is wrong with a variant is told with its name."""
    from phantomnode.geometry.errors import GeometryError

    try:
        yield
    except CaseError as error:
        # The cause holds what is to be drawn of it.
        raise CaseError([_named(variant, message) for message in error.messages]) from (
            error.__cause__ or error
        )
    except GeometryError as error:
        raise GeometryError(_named(variant, str(error))) from error


def _named(variant: str, message: str) -> str:
    return f"variant.{variant}: {message}" if variant else message


def check(case: Case, out: Path | str, *, console: Console | None = None) -> Prepared:
    """Prepare a case, report what it became, and write preview.png and preview.vtu; no step is taken.

    Parameters
    ----------
    case : Case
    out : Path or str
        Where the previews go; made where it is missing.
    console : rich Console, optional
        Where to print the report.

    Raises
    ------
    CaseError, GeometryError
        Where the case, a geometry or the folder cannot be used.
    """
    from phantomnode.pipeline.cad_picture import drawn_where_refused
    from phantomnode.pipeline.check_picture import draw_preview
    from phantomnode.pipeline.prepare import prepare
    from phantomnode.pipeline.preview import preview_vtu

    folder = Path(out)
    _tell_of_compiling(console)
    with drawn_where_refused(folder):
        prepared = prepare(case)
        stations(prepared)  # a line that meets no body is told now
        others = [variant_row(name, variant) for name, variant in prepared_variants(case)]
    make_folder(folder)
    write_atomically(folder / "preview.vtu", preview_vtu(prepared))
    draw_preview(prepared, folder / "preview.png")
    if console is not None:
        console.print(report(prepared, others))
        console.print(f"pictures  {folder / 'preview.png'}, {folder / 'preview.vtu'}", soft_wrap=True)
    return prepared


def _tell_of_compiling(console: Console | None) -> None:
    """Why the first command after an installation takes longer."""
    from phantomnode.kernels import kept

    if not kept("phantomnode.solver"):
        _tell(console, ["compiling the kernels, which are kept: half a minute or so, this once"])


def check_threads(threads: int) -> None:
    """Refuse a number of threads that cannot be had.

    Raises
    ------
    CaseError
        Where it is below one, or above what numba was started with.
    """
    from numba import config

    if threads < 1:
        raise CaseError(f"--threads {threads}: must be at least 1")
    if threads > config.NUMBA_NUM_THREADS:
        raise CaseError(
            f"--threads {threads}: at most {config.NUMBA_NUM_THREADS} can take part here (the cores that this "
            "process may use, or NUMBA_NUM_THREADS where it is set)"
        )


def march(
    prepared: Prepared,
    observers: Sequence[Observer],
    threads: int = 1,
    resume: Frame | None = None,
    stopping: Stopping | None = None,
    keeper: Keeper | None = None,
    told: Callable[[int], None] = lambda used: None,
) -> tuple[Ending, float]:
    """Take all steps and show the observers the frames that they want; tell how many threads take part.

    Returns how it ended and the wall time of the steps alone, s.
    """
    from phantomnode.solver.explicit import RunStopped

    stopping = stopping or Stopping()
    steps, samples, last, stepping = steps_of(prepared), sampled(prepared), resume, 0.0
    stream = frames_of(prepared, np.array(sorted(samples)), threads, resume, stopping, told)
    try:
        while True:
            began = time.perf_counter()
            frame = next(stream, None)
            stepping += time.perf_counter() - began
            if frame is None:
                break
            if last is resume:
                LOG.info("the kernels are loaded, and the first frame is there, in %.2f s", stepping)
            last = frame
            stopping.moved()
            if frame.step in samples:
                view = shown(frame)
                for observer in observers:
                    if observer.due(frame.step):
                        observer.frame(view)
            if keeper is not None:
                keeper.look(frame, stepping)
    except RunStopped as stop:
        return Ending("stopped", stop.reason, stop.advice, stop.last_good), stepping
    except KeyboardInterrupt:  # a second signal
        return Ending("interrupted", stopping.reason(), "", last), stepping
    if last is not None and last.step == steps:
        return Ending("done", "", "", last), stepping
    if keeper is not None and last is not None:
        keeper.write(last, stepping)
    return Ending("interrupted", stopping.reason(), "", last), stepping


def frames_of(
    prepared: Prepared,
    at: NDArray[np.int64],
    threads: int,
    resume: Frame | None,
    stopping: Stopping,
    told: Callable[[int], None] = lambda used: None,
) -> Iterator[Frame]:
    """The frames of a run at the given steps, and those between from which it could go on."""
    from phantomnode.solver import explicit, xfem

    velocity, motion, guard = prepared.velocity, prepared.motion, prepared.case.guard.energy_error
    arguments = velocity, prepared.dt, at, motion, guard, resume
    if prepared.xfem is not None:
        told(1)
        return xfem.frames(prepared.model, prepared.xfem, *arguments, looks=True, ended=stopping.asked)
    return explicit.frames(prepared.model, *arguments, threads, looks=True, ended=stopping.asked, told=told)


def sampled(prepared: Prepared) -> frozenset[int]:
    """The steps that some output shows."""
    steps, output = steps_of(prepared), prepared.case.output
    samples = sample_steps(steps, output.history.count) | sample_steps(steps, output.fields.count)
    return samples | {
        step for profile in output.profile.values() for step in profile_steps(prepared, profile)
    }


def _finish(prepared: Prepared, start: Start, summary: Summary, log: RunLog) -> None:
    """Write what tells of the end of a run; the manifest last: then all of it is there."""
    folder = summary.path
    log.close(summary)
    if start.fields.peak is not None:
        from phantomnode.pipeline.preview import draw_result

        draw_result(prepared, start.fields.peak, folder / "peak.png")
    summary.write()
    write_manifest(folder, start.fields.digests())


def _progress(
    prepared: Prepared, console: Console | None, start: Start, closing: ExitStack
) -> list[Observer]:
    """The progress bar, where there is somebody to see it."""
    if console is None:
        return []
    from phantomnode.pipeline.progress import watcher

    progress = watcher(prepared, steps_of(prepared), console, start.frame)
    closing.callback(progress.close)
    return [progress]


def _tell(console: Console | None, lines: Sequence[str]) -> None:
    if console is not None:
        for line in lines:
            console.print(line, soft_wrap=True, highlight=False, markup=False)


def _refuse_source_folder(case: Case, folder: Path) -> None:
    """The resolved case must not overwrite the case file that it came from."""
    if folder.resolve() == case.folder.resolve():
        raise CaseError(f"{folder}: the results cannot go into the case's own folder; choose another one")
