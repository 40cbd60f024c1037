"""Batches: results.csv, exit codes, resuming, workers that die, schedulers that run already."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import batch_workers
import pytest

from phantomnode import __version__ as VERSION
from phantomnode.pipeline import batch as batch_module
from phantomnode.pipeline.batch import ledger_of, run_batch
from phantomnode.pipeline.case import Case, resolved_toml
from phantomnode.pipeline.checkpoint import checkpoints
from phantomnode.pipeline.engine import Crew, client_of, crew, outcomes
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.one_case import (
    DONE,
    FAILED,
    OUTCOME,
    RETRIES,
    RUNNING,
    STOPPED,
    Order,
    Outcome,
    held,
    read_record,
    run_order,
)
from phantomnode.pipeline.stopping import Stopping
from phantomnode.pipeline.sweep import load_study
from phantomnode.pipeline.tally import Tally

SWEEP = """
base = "ring_impact"
outputs = ["peak_contact_force.ring_on_obstacle", "energy_error_max"]
set = { "time.end" = 6e-4, "body.obstacle.grid.cell" = 0.1, "output.fields.count" = 2, "output.history.count" = 20 }
[axis.speed]
key = "body.ring.initial_velocity.1"
values = [-50.0, -100.0]
[axis.cell]
key = "body.ring.grid.cell"
values = [0.05, 0.04]
[plot.force]
x = "speed"
y = "peak_contact_force.ring_on_obstacle"
"""


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """A sweep of four coarse and short cases."""
    file = tmp_path / "sweep.toml"
    file.write_text(SWEEP)
    return file


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch):
    """Cases run in this process, one after the other, and end as the test says."""
    endings: dict[str, tuple[str, str]] = {}
    ran: list[str] = []

    def outcomes(client: object, orders: list[Order], stopping: object):
        for place, order in enumerate(orders):
            name = Path(order.folder).name
            ran.append(name)
            yield place, Outcome(RUNNING, "", {})
            Path(order.folder).mkdir(exist_ok=True)
            status, reason = endings.get(name, (DONE, ""))
            text = {"status": status, "reason": reason, "hash": order.hash, "version": VERSION, "batch": "b"}
            (Path(order.folder) / OUTCOME).write_text(json.dumps(text | {"attempt": 1}))
            (Path(order.folder) / "summary.json").write_text('{"wall_s": 1.5, "energy_error_max": 1e-5}')
            yield place, Outcome(status, reason, {"wall_s": 1.5, "energy_error_max": 1e-5})

    monkeypatch.setattr(batch_module, "outcomes", outcomes)
    monkeypatch.setattr(batch_module, "client_of", lambda hands, scratch: Nobody())
    return endings, ran


class Nobody:
    """A client without workers."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def leftovers(folder: Path) -> list[Path]:
    """What only belongs to a batch that runs."""
    return [path for path in folder.rglob(".*")]


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "phantomnode", "batch", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, timeout=120)


def test_a_batch_from_the_command_line(sweep: Path, tmp_path: Path) -> None:
    """Four cases on two workers; then nothing is left to do, whatever the folders are called."""
    out = tmp_path / "out"
    done = command(sweep, "--out", out)
    assert done.returncode == 0, done.stderr
    assert (
        "4 of 4 cases to run, on " in done.stdout
        and "\n4 of 4  speed=" in done.stdout
        and "4 done" in done.stdout
    )
    found = rows(out)
    assert [(row["speed"], row["cell"]) for row in found] == [
        ("-50.0", "0.05"), ("-50.0", "0.04"), ("-100.0", "0.05"), ("-100.0", "0.04"),
    ]  # fmt: skip
    for row in found:
        figures = json.loads((out / row["folder"] / "summary.json").read_text())
        assert row["status"] == "done" and float(row["energy_error_max"]) == figures["energy_error_max"]
        force = figures["peak_contact_force"]["ring_on_obstacle"]
        assert float(row["peak_contact_force.ring_on_obstacle"]) == force > 0.0
    assert (out / "plot.force.png").stat().st_size > 5000 and not leftovers(out)

    (out / found[0]["folder"]).rename(out / "another name")
    again = command(sweep, "--out", out, "--resume")
    assert again.returncode == 0 and "to run" not in again.stdout
    assert rows(out)[0]["folder"] == "another name"
    refused = command(sweep, "--out", out)
    assert refused.returncode == 2 and "holds a batch already; add --resume" in refused.stderr


def test_a_dry_run_writes_nothing(sweep: Path, tmp_path: Path) -> None:
    done = command(sweep, "--out", tmp_path / "out", "--dry-run")
    assert done.returncode == 0 and done.stdout.count("waiting") == 5  # four cases and their count
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.toml"]


def test_bad_input_ends_with_2_before_anything_is_written(sweep: Path, tmp_path: Path) -> None:
    sweep.write_text(SWEEP.replace("body.ring.grid.cell", "body.ring.grid.cel"))
    done = command(sweep, "--out", tmp_path / "out")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "body.ring.grid.cel: unknown key (did you mean 'cell'?)" in done.stderr
    assert not (tmp_path / "out").exists()


def test_what_failed_is_told_and_runs_again_only_when_asked(sweep: Path, tmp_path: Path, here) -> None:
    endings, ran = here
    bad, stopped = "speed=-50_cell=0.04", "speed=-100_cell=0.05"
    endings |= {bad: (FAILED, "no reason"), stopped: (STOPPED, "energy")}
    first = run_batch(sweep, tmp_path / "out")
    assert first.status == "failed" and len(ran) == 4
    assert {row["case"]: (row["status"], row["reason"]) for row in rows(first.folder)} == {
        "speed=-50_cell=0.05": ("done", ""), bad: ("failed", "no reason"),
        stopped: ("stopped", "energy"), "speed=-100_cell=0.04": ("done", ""),
    }  # fmt: skip
    ran.clear()
    assert run_batch(sweep, tmp_path / "out", resume=True).status == "failed" and not ran
    endings.clear()
    assert run_batch(sweep, tmp_path / "out", only_failed=True).status == "done"
    assert ran == [bad, stopped]


def test_a_case_that_changed_runs_again_and_keeps_clear_of_the_others(
    sweep: Path, tmp_path: Path, here
) -> None:
    """The folder of a finished case is its own, even if its name is that of another case now."""
    _, ran = here
    run_batch(sweep, tmp_path / "out")
    ran.clear()
    sweep.write_text(
        SWEEP.replace("-100.0]", "-100.0, -75.0]").replace('"time.end" = 6e-4', '"time.end" = 7e-4')
    )
    (tmp_path / "out" / "speed=-50_cell=0.05").rename(tmp_path / "out" / "elsewhere")
    assert len(rows(run_batch(sweep, tmp_path / "out", resume=True).folder)) == 6 and len(ran) == 6
    ran.clear()
    sweep.write_text(SWEEP.replace("-100.0]", "-100.0, -75.0]"))
    shutil.rmtree(tmp_path / "out" / "speed=-75_cell=0.05")
    (tmp_path / "out" / "elsewhere").rename(tmp_path / "out" / "speed=-75_cell=0.05")
    again = run_batch(sweep, tmp_path / "out", resume=True)
    assert again.status == "done" and "speed=-50_cell=0.05" not in ran
    assert len({row["folder"] for row in rows(again.folder)}) == 6


def test_results_are_right_while_cases_run(sweep: Path, tmp_path: Path, here, monkeypatch) -> None:
    monkeypatch.setattr("phantomnode.pipeline.ledger.EVERY", 0.0)
    inner, seen = batch_module.outcomes, []

    def watched(client: object, orders: list[Order], stopping: object):
        for ended in inner(client, orders, stopping):
            yield ended
            seen.append([row["status"] for row in rows(tmp_path / "out")])

    monkeypatch.setattr(batch_module, "outcomes", watched)
    run_batch(sweep, tmp_path / "out")
    kinds = [(["done"] * n + [now] + ["waiting"] * (3 - n)) for n in range(4) for now in ("running", "done")]
    assert seen == kinds


def test_an_interrupted_batch_says_so_and_is_resumed(sweep: Path, tmp_path: Path, here, monkeypatch) -> None:
    _, ran = here
    inner = batch_module.outcomes

    def interrupted(client: object, orders: list[Order], stopping: object):
        ended = inner(client, orders, stopping)
        yield next(ended)
        yield next(ended)
        raise KeyboardInterrupt

    monkeypatch.setattr(batch_module, "outcomes", interrupted)
    assert run_batch(sweep, tmp_path / "out").status == "interrupted"
    assert [row["status"] for row in rows(tmp_path / "out")] == ["done"] + ["waiting"] * 3
    monkeypatch.setattr(batch_module, "outcomes", inner)
    assert run_batch(sweep, tmp_path / "out", resume=True).status == "done" and len(ran) == 4
    assert not leftovers(tmp_path / "out")


def test_two_batches_in_one_folder_are_refused(sweep: Path, tmp_path: Path, here) -> None:
    (tmp_path / "out").mkdir()
    with held(tmp_path / "out" / ".batch.lock"), pytest.raises(CaseError, match="another batch runs"):
        run_batch(sweep, tmp_path / "out")
    assert run_batch(sweep, tmp_path / "out").status == "done"


@pytest.mark.parametrize(
    ("hands", "message"),
    [
        ((10_000, 1, None), "10000 workers of 1 threads are more than the"),
        ((1, 10_000, None), "1 workers of 10000 threads are more than the"),
        ((0, 1, None), "must be at least 1"),
        ((None, 0, None), "must be at least 1"),
        ((2, 1, "tcp://127.0.0.1:1"), "leave --workers out"),
    ],
)
def test_workers_that_cannot_be(hands: tuple[int | None, int, str | None], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        crew(*hands)


def test_a_scheduler_that_does_not_answer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("phantomnode.pipeline.engine.CONNECT", 0.2)
    for address in ("tcp://127.0.0.1:1", "nonsense://"):
        with (
            pytest.raises(CaseError, match="no dask scheduler answers"),
            client_of(Crew(0, 1, address), tmp_path),
        ):
            pass


def test_a_fault_of_a_case_is_its_outcome(tmp_path: Path) -> None:
    """A case at fault says what is wrong; a fault of the program leaves its traceback too."""
    bad = run_order(Order("time = { end = 1.0 }", str(tmp_path / "bad"), "h", "b"))
    assert bad.status == FAILED and "material: is missing" in bad.reason
    worse = run_order(Order("not toml", str(tmp_path / "worse"), "h", "b"))
    assert worse.status == FAILED and worse.reason.startswith("TOMLDecodeError")
    assert "Traceback" in read_record(tmp_path / "worse")["traceback"]
    assert not leftovers(tmp_path)


def test_a_case_is_begun_three_times_in_a_batch_and_anew_in_the_next(tmp_path: Path, monkeypatch) -> None:
    attempts = []

    def dies(order: Order, goes_on: bool) -> None:
        attempts.append(read_record(tmp_path)["attempt"])
        (tmp_path / ".part.vtu.0.part").write_text("half")
        raise SystemExit  # past every handler, as a killed process

    monkeypatch.setattr("phantomnode.pipeline.one_case._attempt", dies)
    order = Order("", str(tmp_path), "h", "first")
    for _ in range(RETRIES + 1):
        with pytest.raises(SystemExit):
            run_order(order)
    assert read_record(tmp_path)["status"] == RUNNING and attempts == [1, 2, 3]
    assert run_order(order) == Outcome(FAILED, "its worker died 3 times", {})
    monkeypatch.setattr("phantomnode.pipeline.one_case._attempt", lambda order, goes_on: (DONE, "", ""))
    assert run_order(order._replace(batch="second")).status == DONE
    assert not leftovers(tmp_path) and run_order(order._replace(batch="third")).status == DONE
    assert read_record(tmp_path)["batch"] == "second"  # found finished


def test_a_case_goes_on_from_its_last_checkpoint_unless_it_changed(
    sweep: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, other = (point for point in load_study(sweep).points[:2])
    folder = tmp_path / "case"
    take = Tally.frame

    def frame(self: Tally, frame: Any) -> None:
        take(self, frame)
        if frame.step >= 60:
            monkeypatch.undo()
            os.kill(os.getpid(), signal.SIGINT)

    def interrupt() -> None:
        monkeypatch.setattr(Tally, "frame", frame)
        order = Order(resolved_toml(first.case), str(folder), first.hash, "first")
        assert run_order(order).status == "interrupted" and checkpoints(folder)

    interrupt()
    order = Order(resolved_toml(first.case), str(folder), first.hash, "second")
    done = run_order(order)
    assert done.status == DONE and len(done.figures["resumed_at"]) == 1

    (folder / OUTCOME).unlink()
    interrupt()
    anew = run_order(Order(resolved_toml(other.case), str(folder), other.hash, "second"))
    assert anew.status == DONE and not anew.figures["resumed_at"]


def test_a_checkpoint_that_is_refused_lets_a_case_begin_anew(
    sweep: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    point = load_study(sweep).points[0]
    order, asked = Order(resolved_toml(point.case), str(tmp_path), point.hash, "b"), list[bool]()
    assert run_order(order).status == DONE
    record = read_record(tmp_path) | {"status": RUNNING}
    (tmp_path / OUTCOME).write_text(json.dumps(record))

    def run(case: Case, folder: str, *, resume: bool, **_: object) -> list[SimpleNamespace]:
        asked.append(resume)
        if resume:
            raise CaseError("a checkpoint of another build")
        return [SimpleNamespace(status=DONE, figures={"reason": ""})]

    monkeypatch.setattr("phantomnode.pipeline.run.run_all", run)
    assert run_order(order).status == DONE and asked == [True, False]


def test_an_attempt_that_got_further_is_not_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three jobs end before a long case does, each behind another checkpoint; then it stays where it is."""
    steps = iter([10, 20, 30, 30, 30])

    def dies(order: Order, goes_on: bool) -> None:
        (tmp_path / "checkpoint").mkdir(exist_ok=True)
        (tmp_path / "checkpoint" / f"step_{next(steps):012d}.checkpoint").touch()
        raise SystemExit

    monkeypatch.setattr("phantomnode.pipeline.one_case._attempt", dies)
    order, counted = Order("", str(tmp_path), "h", "first"), []
    for _ in range(5):
        with pytest.raises(SystemExit):
            run_order(order)
        counted.append(read_record(tmp_path)["attempt"])
    assert counted == [1, 1, 1, 1, 2]


def test_a_worker_that_dies_takes_only_its_case_with_it(tmp_path: Path) -> None:
    """The bad case kills its worker three times; the others, which wait on the same workers, are done."""
    names = ("bad", "good", "better")
    orders = [Order("", str(tmp_path / name), name, "b") for name in names]
    with client_of(Crew(1, 1, None), tmp_path) as client:
        found = [news for news in outcomes(client, orders, Stopping(), batch_workers.deadly) if news]
    ended = {names[place]: outcome for place, outcome in found}  # the last one of each
    assert ended["bad"] == Outcome(FAILED, "its worker died 3 times", {})
    assert ended["good"].status == ended["better"].status == DONE


@pytest.mark.slow
def test_workers_that_dask_does_not_start_again_are_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker that dies while its nanny still starts it is not started again: the batch would wait for ever."""
    from distributed import Status

    monkeypatch.setattr("phantomnode.pipeline.engine.WORKERLESS", 1.0)
    orders = [Order("", str(tmp_path / name), name, "b") for name in ("bad", "good")]
    with client_of(Crew(1, 1, None), tmp_path) as client:
        found = []
        for news in outcomes(client, orders, Stopping(), batch_workers.deadly):
            if news and not found:  # the first worker runs the bad case
                for nanny in client.cluster.workers.values():
                    nanny.status = Status.starting
            found += [news] if news else []
    assert {place: outcome.status for place, outcome in found} == {0: FAILED, 1: DONE}


def test_a_scheduler_that_runs_already_serves_a_batch(sweep: Path, tmp_path: Path) -> None:
    """A scheduler and a worker, two processes started by hand."""
    from distributed import Client

    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    file = tmp_path / "scheduler.json"
    started = [
        subprocess.Popen([*dask, "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]),
        subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1",
             "--local-directory", str(tmp_path / "scratch"), "--no-dashboard"]
        ),
    ]  # fmt: skip
    try:
        with Client(scheduler_file=str(file), timeout=30) as client:
            client.wait_for_workers(1, timeout=30)
            address = client.scheduler.address
        done = command(sweep, "--out", tmp_path / "out", "--scheduler", address)
        assert done.returncode == 0, done.stderr
        assert [row["status"] for row in rows(tmp_path / "out")] == ["done"] * 4
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            process.wait(20)
    assert not leftovers(tmp_path / "out")


def test_the_plan_finds_ended_cases_by_their_hash(sweep: Path, tmp_path: Path) -> None:
    study = load_study(sweep)
    folder = tmp_path / "any name"
    folder.mkdir()
    record = {"status": DONE, "hash": study.points[2].hash, "version": VERSION, "batch": "b", "attempt": 1}
    (folder / OUTCOME).write_text(json.dumps(record))
    assert [o.status for o in ledger_of(study, tmp_path).outcomes] == [
        "waiting",
        "waiting",
        "done",
        "waiting",
    ]
    for wrong in ({"version": "0"}, {"hash": "0"}):
        (folder / OUTCOME).write_text(json.dumps(record | wrong))
        assert ledger_of(study, tmp_path).count() == {"waiting": 4}
    (folder / OUTCOME).write_text(json.dumps(record | {"status": RUNNING}))
    assert ledger_of(study, tmp_path).count() == {"waiting": 3, "interrupted": 1}
    with held(folder / ".case.lock"):
        assert ledger_of(study, tmp_path).count() == {"waiting": 3, "running": 1}
    (folder / OUTCOME).write_text("{ half")
    assert ledger_of(study, tmp_path).count() == {"waiting": 4}
