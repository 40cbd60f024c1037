"""One case of a batch, as a worker runs it: once at a time, with its outcome in a file that is written last."""

from __future__ import annotations

import json
import os
import shutil
import time
import tomllib
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from phantomnode import __version__
from phantomnode.pipeline.checkpoint import checkpoints, remove_checkpoints
from phantomnode.pipeline.files import remove_parts, write_atomically
from phantomnode.pipeline.lock import LOCK as RUN_LOCK
from phantomnode.pipeline.lock import UNSUPPORTED, is_locked
from phantomnode.pipeline.run_files import MANIFEST, VARIANTS, runs_in, sweep
from phantomnode.pipeline.underway import is_ending, underway

OUTCOME = "outcome.json"
"""Of a case in its folder: status, reason, hash and version, and how often it was begun by which batch."""
RETRIES = 2
"""How often a case whose worker died is begun again, unless it got to another checkpoint."""
DONE, STOPPED, FAILED, RUNNING, INTERRUPTED = "done", "stopped", "failed", "running", "interrupted"
WAITING = "waiting"
UNFINISHED = (WAITING, RUNNING, INTERRUPTED)
"""Not begun, underway, begun: goes on from its last checkpoint."""
SEVERITY = {DONE: 0, STOPPED: 1, INTERRUPTED: 2}
"""Which of the ends of a case and its variants is told."""
LOCK = ".case.lock"
"""Beside the one of a run, which one on another machine may have left: this one the system gives back."""
WAIT = 0.2
"""Between two looks at a folder that another process holds, s."""


class Order(NamedTuple):
    """What a worker gets.

    case: resolved, as TOML; folder: of its results; hash: of the case; batch: names the batch that orders it, so
    that its attempts are counted, and not those of a batch before; threads: of a step; command: the command line;
    checkpoint_every: as the case says unless given.
    """

    case: str
    folder: str
    hash: str
    batch: str
    threads: int = 1
    command: tuple[str, ...] = ()
    checkpoint_every: str | None = None


class Outcome(NamedTuple):
    """How a case ended: its status, why it is not done, and what came out.

    figures: the content of summary.json, with those of the variants by name under ``variant``; empty where the case
    has not ended.
    """

    status: str
    reason: str
    figures: dict[str, Any]


NOT_BEGUN = Outcome(WAITING, "", {})


def run_order(order: Order) -> Outcome:
    """Run a case with its variants, unless it is found finished, and write how it ended.

    The same order may reach two workers, where one was taken for dead: the second waits for the first. A case that
    was begun goes on from its last checkpoint; of a batch that ends, none begins, and the one that runs writes a
    checkpoint. What a case does wrong is its outcome; only a folder that cannot be written raises (OSError).
    """
    if is_ending(order.batch):
        return NOT_BEGUN
    folder = Path(order.folder)
    folder.mkdir(parents=True, exist_ok=True)
    with held(folder / LOCK), underway(order.batch, order.folder):
        before = read_record(folder)
        same, own = is_of(before, order.hash), before.get("batch") == order.batch
        if same and (before["status"] == DONE or own and before["status"] != RUNNING):
            return outcome_in(folder)
        goes_on = same and before["status"] != STOPPED
        if not goes_on and not is_locked(folder):
            _forget(folder)
        here = _reached(folder)
        # An attempt that got to another checkpoint was not in vain: on a cluster, jobs end before long cases do.
        attempt = before["attempt"] + 1 if own and here == before.get("checkpoint") else 1
        if attempt > RETRIES + 1:
            return _end(order, attempt, FAILED, f"its worker died {RETRIES + 1} times")
        _record(order, attempt, RUNNING, checkpoint=here)
        remove_parts(folder)
        for place in runs_in(folder):
            with suppress(BlockingIOError), held(place / RUN_LOCK, wait=False):
                pass  # left by a run on another machine, where it cannot be told whether its process has ended
        return _end(order, attempt, *_attempt(order, goes_on))


def _reached(folder: Path) -> str:
    """How far a case with its variants has got: what is finished, and the last checkpoints."""
    marks = [
        MANIFEST if (place / MANIFEST).exists() else next((file.name for file in checkpoints(place)), "")
        for place in runs_in(folder)
    ]
    return " ".join(marks)


def _forget(folder: Path) -> None:
    """Take out what another case left to go on with."""
    (folder / "case.toml").unlink(missing_ok=True)
    (folder / MANIFEST).unlink(missing_ok=True)
    remove_checkpoints(folder)
    shutil.rmtree(folder / VARIANTS, ignore_errors=True)


def _attempt(order: Order, goes_on: bool) -> tuple[str, str, str]:
    """Run the case and its variants: the worst status, its reason, and the traceback of a fault of the program."""
    from phantomnode.geometry.errors import GeometryError
    from phantomnode.pipeline.case import case_from_table
    from phantomnode.pipeline.errors import CaseError
    from phantomnode.pipeline.run import run_all

    try:
        case = case_from_table(tomllib.loads(order.case))
        summaries = run_all(
            case, order.folder, command=order.command, threads=order.threads, resume=goes_on,
            checkpoint_every=order.checkpoint_every, ordered=lambda: is_ending(order.batch),
        )  # fmt: skip
    except (CaseError, GeometryError, OSError) as error:
        if goes_on and isinstance(
            error, CaseError
        ):  # a checkpoint of another build of the solver, most likely
            return _attempt(order, False)
        return FAILED, str(error), ""
    except Exception as error:  # the batch goes on; the table and the file say what happened
        return FAILED, f"{type(error).__name__}: {error}", traceback.format_exc()
    worst = max(range(len(summaries)), key=lambda run: SEVERITY[summaries[run].status])
    status, reason = summaries[worst].status, str(summaries[worst].figures["reason"])
    return status, f"variant {[*case.variant][worst - 1]}: {reason}" if worst and reason else reason, ""


def _end(order: Order, attempt: int, status: str, reason: str, trace: str = "") -> Outcome:
    """Write how a case ended."""
    _record(order, attempt, status, reason=reason, **({"traceback": trace} if trace else {}))
    return outcome_in(Path(order.folder))


def _record(order: Order, attempt: int, status: str, **more: str) -> None:
    """Write the file of the outcome."""
    table = {"status": status, **more, "hash": order.hash, "version": __version__}
    text = json.dumps({**table, "batch": order.batch, "attempt": attempt}, indent=2, ensure_ascii=False)
    write_atomically(Path(order.folder) / OUTCOME, text + "\n")


def read_record(folder: Path) -> dict[str, Any]:
    """The file of an outcome; empty where there is none, or none that can be read."""
    return _json(folder / OUTCOME)


def is_of(record: dict[str, Any], digest: str) -> bool:
    """Whether the file of an outcome is about the case of a hash, as this version runs it."""
    return bool(record.get("hash") == digest and record.get("version") == __version__)


def outcome_in(folder: Path) -> Outcome:
    """The outcome in a folder that has one."""
    record = read_record(folder)
    figures = _figures(folder) if record["status"] not in UNFINISHED else {}
    return Outcome(record["status"], record.get("reason", ""), figures)


def known(folder: Path, digest: str) -> Outcome:
    """What is known of a case now; one whose process was killed counts as interrupted."""
    record = read_record(folder)
    if not is_of(record, digest):
        return NOT_BEGUN
    outcome = outcome_in(folder)
    if outcome.status == RUNNING and not is_held(folder / LOCK):
        return Outcome(INTERRUPTED, "its process was killed", {})
    return outcome


def tidy(folder: Path) -> None:
    """Remove the temporary files and locks that a killed process left of a case, unless another runs it."""
    with suppress(BlockingIOError, FileNotFoundError), held(folder / LOCK, wait=False):
        for place in runs_in(folder):
            sweep(place)
            with suppress(BlockingIOError), held(place / RUN_LOCK, wait=False):
                pass


def _figures(folder: Path) -> dict[str, Any]:
    """The content of summary.json; under ``variant``, by name, those of the variants."""
    figures, variants = _json(folder / "summary.json"), runs_in(folder)[1:]
    if variants:
        figures["variant"] = {place.name: _json(place / "summary.json") for place in variants}
    return figures


def _json(file: Path) -> dict[str, Any]:
    """The table in a file; empty where there is no such file, or a damaged one."""
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return {}
    return table if isinstance(table, dict) else {}


@contextmanager
def held(path: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold a lock; the system gives it back when the process ends, however that happens.

    Parameters
    ----------
    path : Path
        The file that stands for it; removed in the end.
    wait : bool
        Wait for another process that holds it.

    Raises
    ------
    BlockingIOError
        Where another process holds it and ``wait`` is false.
    OSError
        Where the file cannot be made.
    """
    import fcntl

    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_still(path, handle):
                break
            os.close(handle)  # the one before removed it in between
        except BlockingIOError:
            os.close(handle)
            if not wait:
                raise
            time.sleep(WAIT)
        except OSError as error:
            os.close(handle)
            if error.errno in UNSUPPORTED:
                text = "this file system knows no locks (flock), which a batch needs; take another --out"
                raise OSError(error.errno, text, str(path.parent)) from error
            raise
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def is_held(path: Path) -> bool:
    """Whether a process holds a lock."""
    import fcntl

    try:
        handle = os.open(path, os.O_RDWR)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    except BlockingIOError:
        return True
    finally:
        os.close(handle)


def _is_still(path: Path, handle: int) -> bool:
    """Whether a path leads to the file that is open."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(handle))
    except FileNotFoundError:
        return False


WARM_UP = """
time = { end = 2e-5 }
output = { fields = { count = 1 }, history = { count = 2 } }
material.soft = { E = 1e9, nu = 0.3, rho = 1000.0 }
[body.disc]
geometry = { circle = { centre = [0.0, 0.1], radius = 0.099 } }
grid = { kind = "cartesian", cell = 0.04 }
material = "soft"
initial_velocity = [0.0, -50.0]
[body.floor]
geometry = { rectangle = { low = [-0.2, -0.1], high = [0.2, 0.0] } }
grid = { kind = "cartesian", cell = 0.05, aligned = true }
material = "soft"
[contact.landing]
slave = "disc.outer"
master = "floor.top"
[boundary.base]
on = "floor.bottom"
displacement = { x = 0.0, y = 0.0 }
"""
"""A few elements and steps: what compiles the kernels."""


def warm_up() -> None:
    """Compile the kernels, or find them compiled, so that the workers need not all do it at once."""
    import tempfile

    from phantomnode.pipeline.case import case_from_table
    from phantomnode.pipeline.run import run

    with tempfile.TemporaryDirectory(prefix="phantomnode-") as folder:
        run(case_from_table(tomllib.loads(WARM_UP)), Path(folder) / "results")
