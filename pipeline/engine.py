"""The workers of a batch, by dask.distributed: on this machine, or those of a running scheduler."""

from __future__ import annotations

import logging
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.one_case import FAILED, RETRIES, Order, Outcome, run_order, warm_up

if TYPE_CHECKING:
    from distributed import Client, Future

BLAME = 10
"""Deaths of workers that hold a case before dask gives it up. Dask blames every case that a dead worker held, even if
it had not begun; run_order counts the attempts themselves."""
CONNECT = 10.0
"""How long to look for a scheduler, s."""
PULSE = 0.5
"""Between two looks for a signal while no case ends, s."""


class Crew(NamedTuple):
    """Who runs the cases.

    workers: processes on this machine; threads: of each; scheduler: the address of one that runs already, whose
    workers are used in their place, or None.
    """

    workers: int
    threads: int
    scheduler: str | None


def crew(workers: int | None, threads: int, scheduler: str | None) -> Crew:
    """Who is asked for, never more threads in all than there are cores.

    Raises
    ------
    CaseError
        Where more is asked for than this machine has, or workers where a scheduler has its own.
    """
    from dask.system import CPU_COUNT

    if scheduler is not None:
        if workers is not None:
            raise CaseError("--scheduler: it has its workers already; leave --workers out")
        return Crew(0, threads, scheduler)
    wanted = max(CPU_COUNT // max(threads, 1), 1) if workers is None else workers
    if wanted < 1 or threads < 1:
        raise CaseError("--workers and --threads must be at least 1")
    if wanted * threads > CPU_COUNT:
        raise CaseError(
            f"{wanted} workers of {threads} threads are more than the {CPU_COUNT} cores that this process may use"
        )
    return Crew(wanted, threads, None)


@contextmanager
def client_of(crew: Crew, scratch: Path) -> Iterator[Client]:
    """Connect to the workers; those on this machine start here, and end with the block and with this process.

    Parameters
    ----------
    crew : Crew
    scratch : Path
        A folder for temporary files of workers on this machine; the caller removes it.

    Raises
    ------
    CaseError
        If no scheduler answers at the address.
    """
    from distributed import Client, LocalCluster

    if crew.scheduler is not None:
        with ExitStack() as closing:
            try:
                client = closing.enter_context(Client(crew.scheduler, timeout=CONNECT))
            except (OSError, ValueError, TypeError) as error:
                raise CaseError(
                    f"--scheduler {crew.scheduler}: no dask scheduler answers ({error})"
                ) from error
            yield client
        return
    with _settings(crew, scratch), _shielded():
        cluster = LocalCluster(
            n_workers=crew.workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",  # dask listens there in any case; any free port
            memory_limit=0,
            silence_logs=logging.CRITICAL,
            local_directory=str(scratch),
        )
    with cluster, Client(cluster) as client:
        yield client


@contextmanager
def _settings(crew: Crew, scratch: Path) -> Iterator[None]:
    """What workers are started with: threads of kernels, a folder for temporary files, patience of the scheduler.

    Dask leaves the variables in this process's environment, where they are put back in the end.
    """
    import dask

    variables = {"NUMBA_NUM_THREADS": str(crew.threads), "TMPDIR": str(scratch)}
    before = dict(os.environ)
    os.environ.update(variables)  # which go before dask's own settings
    settings: dict[str, Any] = {
        f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in variables.items()
    }
    settings["distributed.scheduler.allowed-failures"] = BLAME
    with dask.config.set(settings):
        try:
            yield
        finally:
            os.environ.clear()
            os.environ.update(before)
            if "numba" in sys.modules:  # it reads its variables again whenever it compiles
                sys.modules["numba"].config.reload_config()


@contextmanager
def _shielded() -> Iterator[None]:
    """Processes and threads that are started here do not hear Ctrl-C: this process ends them in good order."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # a thread that starts it hears signals again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def signals_interrupt() -> Iterator[None]:
    """SIGTERM, and a terminal that closes, interrupt like Ctrl-C; signals reach the main thread only."""

    def interrupt(number: int, frame: Any) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    kinds = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    before = {kind: signal.signal(kind, interrupt) for kind in kinds}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


def outcomes(
    client: Client, orders: Sequence[Order], run: Callable[[Order], Outcome] = run_order
) -> Iterator[tuple[int, Outcome]]:
    """Run cases and tell how each ended, as they end.

    Parameters
    ----------
    client : Client
    orders : sequence of Order
    run : callable
        What a worker does with an order.

    Yields
    ------
    int, Outcome
        The place of the case in ``orders``, and how it ended.

    Raises
    ------
    CaseError
        If the workers cannot run anything.
    """
    from distributed.scheduler import KilledWorker

    try:
        client.submit(warm_up, pure=False, key=f"warm-up-{orders[0].batch}").result()
    except (KilledWorker, ImportError) as error:
        raise CaseError(f"the workers cannot run a small trial case: {error}") from error
    ended: queue.SimpleQueue[tuple[int, Future[Any]]] = queue.SimpleQueue()
    underway = dict[int, "Future[Any]"]()
    rounds = dict[int, int]()

    def submit(places: Sequence[int]) -> None:
        keys = [f"case-{orders[p].batch}-{p}-{rounds.get(p, 0)}" for p in places]
        found = client.map(run, [orders[p] for p in places], key=keys, pure=False)
        for place, future in zip(places, found, strict=True):
            underway[place] = future
            future.add_done_callback(lambda done, place=place: ended.put((place, done)))

    submit(range(len(orders)))
    while underway:
        try:
            place, future = ended.get(timeout=PULSE)
        except queue.Empty:
            continue
        del underway[place]
        fault = future.exception()
        if isinstance(fault, KilledWorker) and rounds.get(place, 0) < RETRIES:
            rounds[place] = rounds.get(place, 0) + 1
            submit([place])
        elif fault is not None:
            yield place, Outcome(FAILED, f"{type(fault).__name__}: {fault}", {})
        else:
            yield place, future.result()
