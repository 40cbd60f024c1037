"""The workers of a batch, by dask.distributed: on this machine, or those of a running scheduler."""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import queue
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.one_case import FAILED, RETRIES, RUNNING, Order, Outcome, run_order, warm_up
from phantomnode.pipeline.stopping import KINDS, Stopping
from phantomnode.pipeline.underway import end_batch

if TYPE_CHECKING:
    from distributed import Client, Future

BLAME = 10
"""Deaths of workers that hold a case before dask gives it up. Dask blames every case that a dead worker held, even if
it had not begun; run_order counts the attempts themselves."""
CONNECT = 10.0
"""How long to look for a scheduler, s."""
PULSE = 0.5
"""Between two looks for a signal while no case ends, s."""
WORKERLESS = 30.0
"""How long to wait for dask to start a worker again, s. It does not where one dies before it is all there: all are
then started anew."""
GRACE = 20.0
"""How long cases that are asked to end have for their checkpoints, s; queues that end a job wait for about 30 s."""


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
    with _settings(crew, scratch), _no_child_left():
        with _shielded():
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

    Dask puts the variables into this process's environment whenever a worker starts, also in the place of one that
    died, and leaves them there; so they are put back when there are no workers any more.
    """
    import dask

    tempfile.gettempdir()  # this process keeps its own
    variables = {"NUMBA_NUM_THREADS": str(crew.threads), "TMPDIR": str(scratch)}
    before = dict(os.environ)
    os.environ.update(variables)  # which go before dask's own settings
    settings: dict[str, Any] = {
        f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in variables.items()
    }
    settings["distributed.scheduler.allowed-failures"] = BLAME
    settings["temporary-directory"] = str(scratch)
    with dask.config.set(settings):
        try:
            yield
        finally:
            os.environ.clear()
            os.environ.update(before)
            if "numba" in sys.modules:  # it read its variables again if it compiled meanwhile
                sys.modules["numba"].config.reload_config()


@contextmanager
def _no_child_left() -> Iterator[None]:
    """End the processes that dask could not close: they do not hear the SIGTERM that Python sends at its exit."""
    before = {process.pid for process in multiprocessing.active_children()}
    try:
        yield
    finally:
        for process in multiprocessing.active_children():
            if process.pid not in before:
                process.kill()


@contextmanager
def _shielded() -> Iterator[None]:
    """Processes and threads that are started here do not hear signals that end all processes of a terminal or job.

    This process hears them, and ends the others in good order.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    kinds = {getattr(signal, kind) for kind in KINDS}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, kinds)
    try:
        resource_tracker.ensure_running()  # which lets this thread hear some of them again
        signal.pthread_sigmask(signal.SIG_BLOCK, kinds)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def outcomes(
    client: Client,
    orders: Sequence[Order],
    stopping: Stopping,
    run: Callable[[Order], Outcome] = run_order,
) -> Iterator[tuple[int, Outcome] | None]:
    """Run cases and tell how each ended, as they end; before, that it runs.

    When the batch is asked to end, cases that run get some seconds to write a checkpoint, and no other one begins.

    Parameters
    ----------
    client : Client
    orders : sequence of Order
    stopping : Stopping
        What asks the batch to end.
    run : callable
        What a worker does with an order.

    Yields
    ------
    int, Outcome
        The place of the case in ``orders``, and how it ended, or that it runs; None where nothing was heard for a
        while.

    Raises
    ------
    CaseError
        If the workers cannot run anything.
    """
    if _warmed_up(client, orders[0].batch, stopping):
        yield from _Round(client, orders, stopping, run).outcomes()


def _warmed_up(client: Client, batch: str, stopping: Stopping) -> bool:
    """Whether a worker has compiled the kernels before the batch was asked to end.

    Raises
    ------
    CaseError
        If the workers cannot run anything.
    """
    from distributed.scheduler import KilledWorker

    trial, staff = client.submit(warm_up, pure=False, key=f"warm-up-{batch}"), _Staff(client)
    while not stopping.asked():
        try:
            trial.result(timeout=PULSE)
            return True
        except TimeoutError:
            staff.look()
        except (KilledWorker, ImportError) as error:
            raise CaseError(f"the workers cannot run a small trial case: {error}") from error
    return False


class _Staff:
    """The workers of this machine, which are started anew where there has been none for a while."""

    def __init__(self, client: Client) -> None:
        self._client, self._seen = client, time.monotonic()

    def look(self) -> None:
        """Start them where that is wanted; those of a scheduler that runs by itself may come later."""
        cluster = self._client.cluster
        if cluster is None or self._client.nthreads():
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > WORKERLESS:
            count = len(cluster.worker_spec)
            cluster.scale(0)
            cluster.scale(count)
            self._seen = time.monotonic()


class _Round:
    """The cases of a batch that are underway."""

    def __init__(
        self,
        client: Client,
        orders: Sequence[Order],
        stopping: Stopping,
        run: Callable[[Order], Outcome],
    ) -> None:
        self._client, self._orders, self._stopping, self._run = client, orders, stopping, run
        self._events: queue.SimpleQueue[tuple[int, Future[Any] | None]] = queue.SimpleQueue()
        self._underway = dict[int, "Future[Any]"]()
        self._rounds = dict[int, int]()
        self._staff = _Staff(client)

    def outcomes(self) -> Iterator[tuple[int, Outcome] | None]:
        """Submit all and collect what becomes of them."""
        topic, deadline = _topic(self._orders[0].batch), math.inf
        self._client.subscribe_topic(topic, lambda event: self._events.put((event[1], None)))
        self._submit(range(len(self._orders)))
        while self._underway and time.monotonic() < deadline:
            if self._stopping.asked():
                deadline = min(deadline, time.monotonic() + GRACE)
                self._end()
            try:
                place, future = self._events.get(timeout=PULSE)
            except queue.Empty:
                self._staff.look()
                yield None
                continue
            if place in self._underway:
                yield from self._heard(place, future)
        self._client.unsubscribe_topic(topic)

    def _submit(self, places: Sequence[int]) -> None:
        keys = [f"case-{self._orders[p].batch}-{p}-{self._rounds.get(p, 0)}" for p in places]
        orders = [self._orders[place] for place in places]
        found = self._client.map(partial(_told, self._run), orders, places, key=keys, pure=False)
        for place, future in zip(places, found, strict=True):
            self._underway[place] = future
            future.add_done_callback(lambda done, place=place: self._events.put((place, done)))

    def _heard(self, place: int, future: Future[Any] | None) -> Iterator[tuple[int, Outcome]]:
        """A case has begun (no future) or ended."""
        from distributed.scheduler import KilledWorker

        if future is None:
            yield place, Outcome(RUNNING, "", {})
            return
        del self._underway[place]
        fault = future.exception()
        if isinstance(fault, KilledWorker) and self._rounds.get(place, 0) < RETRIES:
            self._rounds[place] = self._rounds.get(place, 0) + 1
            self._submit([place])
        elif fault is not None:
            yield place, Outcome(FAILED, f"{type(fault).__name__}: {fault}", {})
        else:
            yield place, future.result()

    def _end(self) -> None:
        """Ask the cases that run to end, and take the others back."""
        answers = self._client.run(end_batch, self._orders[0].batch, on_error="ignore")
        running = {folder for folders in answers.values() for folder in folders}
        for place, future in [*self._underway.items()]:
            if self._orders[place].folder not in running and not future.done():
                del self._underway[place]
                future.cancel()


def _told(run: Callable[[Order], Outcome], order: Order, place: int) -> Outcome:
    """Run a case in a worker, and tell the driver that it has begun."""
    from distributed import get_worker

    get_worker().log_event(_topic(order.batch), place)
    return run(order)


def _topic(batch: str) -> str:
    return f"phantomnode-{batch}"
