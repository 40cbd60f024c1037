"""Batches that are asked to end, variants in batches, and what a batch leaves in the process that drives it."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import psutil
import pytest
from numba import config
from test_batch_faults import SHORT, Batch, contents
from test_resume import cut_short, results

from phantomnode.pipeline import batch as batch_module
from phantomnode.pipeline import cli
from phantomnode.pipeline.batch import run_batch
from phantomnode.pipeline.case import resolved_toml
from phantomnode.pipeline.checkpoint import checkpoints
from phantomnode.pipeline.engine import Crew, client_of
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.one_case import DONE, INTERRUPTED, Order, Outcome, known, run_order
from phantomnode.pipeline.run import run_all
from phantomnode.pipeline.stopping import Stopping
from phantomnode.pipeline.sweep import load_study
from phantomnode.pipeline.underway import end_batch

LONGER = SHORT.replace('"time.end" = 6e-4', '"time.end" = 0.2').replace("20 }", "200 }")
LONGER = LONGER.replace("[-50.0, -100.0]", "[-50.0]")
"""Two cases of some seconds of steps."""

VARIED = """
base = "split_block_wave"
outputs = ["energy_error_max", "variant.lumped.energy_error_max"]
[set]
"body.block.grid.counts" = [8, 41]
"time.end" = 1e-6
"output.fields.count" = 2
"output.history.count" = 10
"output.profile.height.times" = [1e-6]
[axis.nu]
key = "material.pmma.nu"
values = [0.3, 0.35]
"""


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def wait_until_one_runs(batch: Batch, driver: subprocess.Popen[bytes]) -> None:
    """Until results.csv says so, and the run has taken a tenth of its steps."""
    deadline = time.monotonic() + 60.0
    while True:
        assert driver.poll() is None and time.monotonic() < deadline
        if (batch.out / "results.csv").exists():
            running = [row["folder"] for row in rows(batch.out) if row["status"] == "running"]
            files = [batch.out / folder / "history.csv" for folder in running]
            if any(file.exists() and file.read_bytes().count(b"\n") > 20 for file in files):
                return
        time.sleep(0.05)


@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, *(pytest.param(n, marks=pytest.mark.slow) for n in (signal.SIGTERM, signal.SIGHUP))],
)
def test_a_batch_that_is_asked_to_end_goes_on_from_the_checkpoints_it_writes(
    tmp_path: Path, number: int
) -> None:
    """The signal goes to all of its processes, as from a terminal."""
    batch = Batch(tmp_path / "batch", LONGER)
    driver = batch.start()
    wait_until_one_runs(batch, driver)
    os.killpg(driver.pid, number)
    began = time.monotonic()
    assert driver.wait(60) == 130 and time.monotonic() - began < 20.0
    assert batch.clean()
    ended = {row["folder"]: row["status"] for row in rows(batch.out)}
    cut = [folder for folder, status in ended.items() if status == INTERRUPTED]
    assert cut and {*ended.values()} <= {DONE, INTERRUPTED, "waiting"}
    assert any(checkpoints(batch.out / folder) for folder in cut)
    said = (tmp_path / "batch" / "log").read_text()
    assert f"a signal ({signal.Signals(number).name}) asked for the end; go on with" in said
    assert (
        "Traceback" not in said and "Warning" not in said
    )  # such as of Python's process for shared resources

    assert batch.start("--resume").wait(120) == 0 and batch.clean()
    resumed = [json.loads((batch.out / folder / "summary.json").read_text())["resumed_at"] for folder in cut]
    assert max(steps[0] for steps in resumed if steps) > 0
    first = load_study(tmp_path / "batch" / "sweep.toml").points[0]
    alone = tmp_path / "alone" / first.name
    assert run_order(Order(resolved_toml(first.case), str(alone), first.hash, "alone")).status == DONE
    found = contents(batch.out)
    for name, content in contents(tmp_path / "alone").items():
        assert found[name] == content, name


@pytest.mark.slow
def test_a_wall_limit_ends_the_cases_that_run(tmp_path: Path) -> None:
    batch = Batch(tmp_path / "batch", LONGER.replace("= 0.2", "= 8.0"))
    driver, began = batch.start("--wall-limit", "40 s"), time.monotonic()
    assert driver.wait(60) == 130 and time.monotonic() - began < 40.0 and batch.clean()
    cut = [row["folder"] for row in rows(batch.out) if row["status"] == INTERRUPTED]
    assert cut and all(checkpoints(batch.out / folder) for folder in cut)


def test_a_wall_limit_asks_a_batch_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def endless(client: object, orders: list[Order], stopping: Stopping) -> Iterator[None]:
        assert {order.checkpoint_every for order in orders} == {"1000 steps"}
        while not stopping.asked():
            yield None

    monkeypatch.setattr(batch_module, "outcomes", endless)
    monkeypatch.setattr(batch_module, "client_of", lambda hands, scratch: nullcontext())
    (tmp_path / "sweep.toml").write_text(SHORT)
    options = ("--wall-limit", "0.2 s", "--checkpoint-every", "1000 steps")
    with pytest.raises(SystemExit) as left:
        cli.app(["batch", str(tmp_path / "sweep.toml"), "--out", str(tmp_path / "out"), *options])
    said = capsys.readouterr().out
    assert left.value.code == 130 and "the wall limit of 0.2 s is near; go on with" in said


def test_a_case_writes_checkpoints_as_the_batch_says(tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(SHORT)
    point, out = load_study(tmp_path / "sweep.toml").points[0], tmp_path / "case"
    order = Order(resolved_toml(point.case), str(out), point.hash, "b", checkpoint_every="20 steps")
    assert run_order(order).status == DONE and len(checkpoints(out)) == 2


@pytest.mark.parametrize(
    "option", [{"wall_limit": "soon"}, {"checkpoint_every": "often"}], ids=["limit", "every"]
)
def test_options_that_are_no_times_are_refused(tmp_path: Path, option: dict[str, Any]) -> None:
    with pytest.raises(CaseError, match='--(wall-limit|checkpoint-every): "(soon|often)" is no'):
        run_batch("ring_impact", tmp_path / "out", **option)
    assert not (tmp_path / "out").exists()


def test_a_case_of_a_batch_that_ends_does_not_begin(tmp_path: Path) -> None:
    assert end_batch("over") == []
    assert run_order(Order("", str(tmp_path / "case"), "h", "over")).status == "waiting"
    assert not (tmp_path / "case").exists()


def test_nohup_is_respected() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Stopping() as stopping:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not stopping.asked()
            os.kill(os.getpid(), signal.SIGTERM)
            assert stopping.asked() and "SIGTERM" in stopping.reason()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_worker_that_is_replaced_leaves_no_trace_in_the_driver(tmp_path: Path) -> None:
    """Dask sets the variables of a worker in this process, also when it replaces one that died."""
    environment, threads = dict(os.environ), config.NUMBA_NUM_THREADS
    with client_of(Crew(1, 1, None), tmp_path) as client:
        before = client.run(os.getpid)
        psutil.Process(*before.values()).kill()
        deadline = time.monotonic() + 30.0
        while client.run(os.getpid, on_error="ignore") in (before, {}):
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert os.environ["NUMBA_NUM_THREADS"] == "1"
    config.reload_config()  # as numba does when it compiles
    assert dict(os.environ) == environment and threads == config.NUMBA_NUM_THREADS


@pytest.fixture
def varied(tmp_path: Path) -> Path:
    file = tmp_path / "sweep.toml"
    file.write_text(VARIED)
    return file


def test_a_case_of_a_batch_writes_what_run_writes_with_its_variants(
    varied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = lambda client, orders, stopping: ((k, run_order(order)) for k, order in enumerate(orders))  # noqa: E731
    monkeypatch.setattr(batch_module, "outcomes", here)
    monkeypatch.setattr(batch_module, "client_of", lambda hands, scratch: nullcontext())
    assert run_batch(varied, tmp_path / "out").status == DONE
    point = load_study(varied).points[0]
    run_all(point.case, tmp_path / "alone" / point.name)
    alone, found = contents(tmp_path / "alone"), contents(tmp_path / "out")
    assert sum(name.endswith("summary.json") for name in alone) == 5
    assert f"{point.name}/profile.height.png" in alone
    assert [name for name in alone if found[name] != alone[name]] == []
    row = rows(tmp_path / "out")[0]
    for name in ("consistent", "lumped"):
        figures = json.loads((tmp_path / "out" / point.name / f"variants/{name}/summary.json").read_text())
        assert float(row[f"variant.{name}.energy_error_max"]) == figures["energy_error_max"]


def test_variants_belong_to_the_hash_of_a_case_and_can_be_left_out(varied: Path) -> None:
    whole = [point.hash for point in load_study(varied).points]
    varied.write_text(VARIED.replace("[set]", '[set]\n"variant.lumped.xfem.mass" = "consistent"'))
    assert not {*whole} & {point.hash for point in load_study(varied).points}
    varied.write_text(
        VARIED.replace("[set]", '[set]\n"variant" = {}')
        .replace(', "variant.', ', "')
        .replace('"lumped.energy_error_max"', '"steps"')
    )
    study = load_study(varied)
    assert study.points[0].case.variant == {} and not [o for o in study.outputs if o.startswith("variant.")]


def test_a_case_goes_on_with_the_variant_it_was_at(
    varied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted in its second variant; what is finished stays, and the reason names the variant."""
    point, folder = load_study(varied).points[0], tmp_path / "case"
    order = Order(resolved_toml(point.case), str(folder), point.hash, "first")
    ended = 0

    def third(self: Any, ending: Any) -> None:
        nonlocal ended
        finish(self, ending)
        ended += 1
        if ended == 2:
            cut_short(monkeypatch, 1)

    from phantomnode.pipeline.tally import Tally

    finish = Tally.finish
    monkeypatch.setattr(Tally, "finish", third)
    cut = run_order(order)
    assert cut.status == INTERRUPTED and cut.reason.startswith("variant lumped: a signal")
    assert known(folder, point.hash) == Outcome(INTERRUPTED, cut.reason, {})
    first = (folder / "history.csv").stat().st_mtime_ns
    done = run_order(order._replace(batch="second"))
    assert done.status == DONE and (folder / "history.csv").stat().st_mtime_ns == first
    assert [len(done.figures["variant"][name]["resumed_at"]) for name in ("consistent", "lumped")] == [0, 1]
    run_all(point.case, tmp_path / "alone")
    for name in ("", *(f"variants/{name}" for name in point.case.variant)):
        assert results(folder / name) == results(tmp_path / "alone" / name), name


def test_what_is_wrong_with_a_variant_is_told_with_its_name(tmp_path: Path) -> None:
    study = tmp_path / "sweep.toml"
    study.write_text(VARIED.replace("[set]", '[set]\n"variant.lumped.time" = { step = 1.0 }'))
    point = load_study(study).points[0]
    failed = run_order(Order(resolved_toml(point.case), str(tmp_path / "case"), point.hash, "b"))
    assert failed.status == "failed" and failed.reason.startswith(
        "variant.lumped: time.step: 1 s is unstable"
    )


@pytest.mark.parametrize(
    ("module", "heavy"), [("engine", {"numba", "scipy", "shapely"}), ("batch", {"numba"})]
)
def test_what_is_loaded_before_a_case_is_there(module: str, heavy: set[str]) -> None:
    """Workers load the engine, the driver all of a batch; the compiler alone takes more than a second."""
    code = f"import sys, phantomnode.pipeline.{module}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not heavy & {*loaded.stdout.split()}
