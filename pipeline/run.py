"""Runs a case: prepare, step, let the observers look, say whether the result can be trusted."""

from __future__ import annotations

import shlex
import signal
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from phantomnode.pipeline.background import Background
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.fields import Fields
from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.history import History
from phantomnode.pipeline.observer import Ending, Observer, sample_steps
from phantomnode.pipeline.preflight import report, steps_of, text_report
from phantomnode.pipeline.profile import ProfileWriter, Stations, draw_profiles, profile_steps, stations
from phantomnode.pipeline.provenance import GEOMETRY, case_hash, provenance, write_case
from phantomnode.pipeline.summary import Clock, Summary, highlights, summarize, verdict
from phantomnode.pipeline.tally import Tally

if TYPE_CHECKING:
    from rich.console import Console

    from phantomnode.pipeline.case import Case
    from phantomnode.pipeline.prepare import Prepared
    from phantomnode.solver.explicit import Frame

RESULTS = ("summary.json", "history.csv", "fields.pvd", "contact.pvd", "run.log", "peak.png")
FRAMES = ("fields/fields_*.vtu", "contact/contact_*.vtu", "profile.*", f"{GEOMETRY}/*")
VARIANTS = "variants"
"""Folder, within the results of a case, of the results of its variants."""


def run(
    case: Case,
    out: Path | str,
    *,
    console: Console | None = None,
    command: Sequence[str] = (),
    threads: int = 1,
) -> Summary:
    """Run a case into a folder.

    Nothing is written before the case is prepared, so a case at fault leaves no trace. Then every file is
    complete at any time, and a run that a guard stops or that is interrupted (Ctrl-C, SIGTERM) leaves its
    last state, its history and a summary that says so.

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

    Returns
    -------
    Summary
        With the status "done", "stopped" or "interrupted" and the content of summary.json.

    Raises
    ------
    CaseError, GeometryError
        Where the case, a geometry or the folder cannot be used.
    OSError
        Where a result cannot be written.
    """
    from phantomnode.pipeline.prepare import prepare

    began, folder = time.perf_counter(), Path(out)
    _refuse_source_folder(case, folder)
    check_threads(threads)
    prepared = prepare(case)
    lines, digest = stations(prepared), case_hash(case)
    _make_folder(case, folder)
    log = RunLog(folder / "run.log", prepared, command)
    with ExitStack() as closing:
        fields, observers, tally = _observers(prepared, lines, folder, console, closing)
        ending, stepping = march(prepared, observers, threads)
        for observer in observers:
            observer.finish(ending)
    clock = Clock(time.perf_counter() - began, stepping)
    source = {"case_hash": digest, "provenance": provenance(command, threads)}
    summary = summarize(prepared, tally, ending, clock, folder, source)
    summary.write()
    log.close(summary)
    if fields.peak is not None:
        from phantomnode.pipeline.preview import draw_result

        draw_result(prepared, fields.peak, folder / "peak.png")
    if console is not None:
        console.print(verdict(summary))
    return summary


def run_all(
    case: Case,
    out: Path | str,
    *,
    console: Console | None = None,
    command: Sequence[str] = (),
    threads: int = 1,
) -> list[Summary]:
    """Run a case and its variants, and draw their profiles over each other.

    The variants go to ``variants/NAME`` in the results folder, the pictures, profile.NAME.png, to the folder
    itself. A run that is interrupted is the last one. Parameters and errors are those of :func:`run`.

    Returns
    -------
    list of Summary
        Of the case, then of its variants.
    """
    from phantomnode.pipeline.case import variants

    folder = Path(out)
    label = case.method if case.method not in case.variant else case.name
    runs: dict[str, Path] = {label: folder}
    summaries = [run(case, folder, console=console, command=command, threads=threads)]
    for name, variant in variants(case).items():
        if summaries[-1].status == "interrupted":
            break
        runs[name] = folder / VARIANTS / name
        summaries.append(run(variant, runs[name], console=console, command=command, threads=threads))
    for picture in draw_profiles(runs, folder):
        if console is not None:
            console.print(f"picture   {picture}", soft_wrap=True, highlight=False)
    return summaries


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
    from phantomnode.pipeline.prepare import prepare
    from phantomnode.pipeline.preview import draw_preview, preview_vtu

    prepared, folder = prepare(case), Path(out)
    stations(prepared)  # a line that meets no body is told now
    _mkdir(folder)
    write_atomically(folder / "preview.vtu", preview_vtu(prepared))
    draw_preview(prepared, folder / "preview.png")
    if console is not None:
        console.print(report(prepared))
        console.print(f"pictures  {folder / 'preview.png'}, {folder / 'preview.vtu'}", soft_wrap=True)
    return prepared


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


def march(prepared: Prepared, observers: Sequence[Observer], threads: int = 1) -> tuple[Ending, float]:
    """Take all steps and show the observers the frames that they want.

    Returns how it ended and the wall time of the steps alone, s.
    """
    from phantomnode.solver import explicit, xfem

    case, steps = prepared.case, steps_of(prepared)
    output = case.output
    samples = sample_steps(steps, output.history.count) | sample_steps(steps, output.fields.count)
    samples |= {step for profile in output.profile.values() for step in profile_steps(prepared, profile)}
    guard, at = case.guard.energy_error, np.array(sorted(samples), dtype=np.int64)
    arguments = prepared.velocity, prepared.dt, at, prepared.motion, guard
    if prepared.xfem is None:
        stream = explicit.frames(prepared.model, *arguments, threads=threads)
    else:
        stream = xfem.frames(prepared.model, prepared.xfem, *arguments)
    last: Frame | None = None
    stepping = 0.0
    with Interruption() as interruption:
        try:
            while True:
                began = time.perf_counter()
                frame = next(stream, None)
                stepping += time.perf_counter() - began
                if frame is None:
                    return Ending("done", "", "", last), stepping
                last = frame
                for observer in observers:
                    if observer.due(frame.step):
                        observer.frame(frame)
                if interruption.asked and frame.step < steps:
                    return _interrupted(last), stepping
        except explicit.RunStopped as stop:
            return Ending("stopped", stop.reason, stop.advice, stop.last_good), stepping
        except KeyboardInterrupt:
            return _interrupted(last), stepping


class Interruption:
    """Ctrl-C and SIGTERM end a run between two frames, with its files complete; a second one at once.

    Python takes signals in the main thread only; in another one this does nothing.
    """

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            self._before = {
                number: signal.signal(number, self._ask) for number in (signal.SIGINT, signal.SIGTERM)
            }
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


class RunLog:
    """run.log: what was run, what it became, what was said on the way, how it ended."""

    def __init__(self, path: Path, prepared: Prepared, command: Sequence[str]) -> None:
        from phantomnode import __version__

        self._path = path
        relocated = [f"{body.name}: {body.relocated} grid nodes relocated" for body in prepared.bodies]
        self._lines = [
            f"phantomnode {__version__}",
            *([f"command: {shlex.join(command)}"] if command else []),
            f"case: {prepared.case.name}: {prepared.case.title}".rstrip(": "),
            "",
            *(line.rstrip() for line in text_report(prepared).splitlines()),
            *relocated,
            "",
        ]
        self._write()

    def close(self, summary: Summary) -> None:
        """Add how the run ended."""
        figures = summary.figures
        self._lines.append(f"status: {summary.status}")
        self._lines += [text for text in (figures["reason"], figures["advice"]) if text]
        for item in summary.checks:
            word = "PASS" if item.passed else f"WARN ({item.advice})"
            self._lines.append(f"{item.name}: {item.value:.3g} (limit {item.limit:g}) {word}")
        self._lines += highlights(figures)
        self._write()

    def _write(self) -> None:
        write_atomically(self._path, "\n".join(self._lines) + "\n")


def _observers(
    prepared: Prepared,
    lines: Mapping[str, Stations],
    folder: Path,
    console: Console | None,
    closing: ExitStack,
) -> tuple[Fields, list[Observer], Tally]:
    """Everything that looks at the run; the tally first, so that it is complete whatever follows."""
    steps, output = steps_of(prepared), prepared.case.output
    tally = Tally(prepared)
    fields = Fields(prepared, folder, sample_steps(steps, output.fields.count))
    history = History(prepared, folder / "history.csv", sample_steps(steps, output.history.count))
    profiles = [ProfileWriter(prepared, name, line, folder) for name, line in lines.items()]
    writing = Background([fields, *profiles])
    closing.callback(writing.close)
    observers: list[Observer] = [tally, history, writing]
    if console is not None:
        from phantomnode.pipeline.progress import watcher

        progress = watcher(prepared, steps, console)
        closing.callback(progress.close)
        observers.append(progress)
    return fields, observers, tally


def _interrupted(last: Frame | None) -> Ending:
    """The ending of a run that the user or the system cut short."""
    return Ending("interrupted", "a signal asked the run to end", "the state so far is written", last)


def _refuse_source_folder(case: Case, folder: Path) -> None:
    """The resolved case must not overwrite the case file that it came from."""
    if folder.resolve() == case.folder.resolve():
        raise CaseError(f"{folder}: the results cannot go into the case's own folder; choose another one")


def _make_folder(case: Case, folder: Path) -> None:
    """An empty results folder with the resolved case in it."""
    _mkdir(folder)
    for name in RESULTS:
        (folder / name).unlink(missing_ok=True)
    for pattern in FRAMES:
        for frame in folder.glob(pattern):
            frame.unlink()
    write_case(case, folder)


def _mkdir(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise CaseError(
            f"{folder}: this is a file, or lies under one; choose another results folder"
        ) from None
