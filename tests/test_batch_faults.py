"""A sweep whose processes are killed, at random: every case whole, to the bit, and nothing left behind.

One seed a round: what is killed when. All rounds: python -m pytest -m slow tests/test_batch_faults.py
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from uuid import uuid4

import numpy as np
import psutil
import pytest

from phantomnode.pipeline.case import resolved_toml
from phantomnode.pipeline.one_case import DONE, Order, run_order
from phantomnode.pipeline.sweep import load_study

SHORT = """
base = "ring_impact"
set = { "time.end" = 6e-4, "body.obstacle.grid.cell" = 0.1, "output.fields.count" = 2, "output.history.count" = 20 }
[axis.speed]
key = "body.ring.initial_velocity.1"
values = [-50.0, -100.0]
[axis.cell]
key = "body.ring.grid.cell"
values = [0.05, 0.04]
"""
LONG = """
base = "ring_impact"
zip = [["cell", "obstacle"]]
[set]
"time.end" = 3e-3
"output.fields.count" = 4
"output.history.count" = 100
"output.checkpoint.every" = "50 steps"
[axis.speed]
key = "body.ring.initial_velocity.1"
values = [-50.0, -100.0]
[axis.penalty]
key = "contact.ring_on_obstacle.penalty.times_E"
values = [10.0, 100.0, 1000.0]
[axis.cell]
key = "body.ring.grid.cell"
values = [0.05, 0.04, 0.025, 0.02]
[axis.obstacle]
key = "body.obstacle.grid.cell"
values = [0.1, 0.1, 0.05, 0.05]
"""
CLOCKS = {"wall_s", "step_loop_s", "element_updates_per_s", "provenance", "resumed_at"}
OTHERS = {"run.log", "summary.json"}
"""Files that hold times; in manifest.json so do their digests, and in checkpoints everything."""
VICTIMS = ("driver", "worker", "worker", "any")


class Batch:
    """A batch on the command line; every process of it can be found by a mark in its environment."""

    def __init__(self, folder: Path, sweep: str) -> None:
        self.out, self.temporary, self._mark = folder / "out", folder / "temporary", uuid4().hex
        self._file = folder / "sweep.toml"
        self.temporary.mkdir(parents=True)
        self._file.write_text(sweep)

    def start(self, *options: str) -> subprocess.Popen[bytes]:
        """Start the driver."""
        line = [
            sys.executable,
            "-m",
            "phantomnode",
            "batch",
            str(self._file),
            "--out",
            str(self.out),
            *options,
        ]
        environment = {**os.environ, "TMPDIR": str(self.temporary), "TEST_MARK": self._mark}
        log = open(self._file.with_name("log"), "ab")
        with log:
            return subprocess.Popen(line, env=environment, stdout=log, stderr=log, start_new_session=True)

    def processes(self) -> list[psutil.Process]:
        """All that run, orphans included."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.environ().get("TEST_MARK") == self._mark and process.status() != "zombie":
                    found.append(process)
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
        return found

    def victims(self, kind: str, driver: int) -> list[psutil.Process]:
        """What a kind of victim can be at the moment."""
        found = self.processes()
        if kind == "driver":
            return [process for process in found if process.pid == driver]
        return [p for p in found if kind == "any" or "spawn_main" in " ".join(_command_line(p))]

    def clean(self) -> bool:
        """Whether no process and no temporary file is left; a killed driver's processes get 10 s to end."""
        deadline = time.monotonic() + 10.0
        while self.processes() and time.monotonic() < deadline:
            time.sleep(0.1)
        return not self.processes() and not [*self.temporary.iterdir()] and not [*self.out.rglob(".*")]


def _command_line(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


def contents(out: Path) -> dict[str, object]:
    """Every file of every case, as it must come out again; times of clocks and attempts aside."""
    found: dict[str, object] = {}
    for file in sorted(out.glob("*/**/*")):
        name = str(file.relative_to(out))
        if file.name == "summary.json":
            figures = json.loads(file.read_text())
            found[name] = {key: value for key, value in figures.items() if key not in CLOCKS}
        elif file.name == "outcome.json":
            found[name] = json.loads(file.read_text())["status"]
        elif file.name == "manifest.json":
            files = json.loads(file.read_text())["files"]
            found[name] = {key: value for key, value in files.items() if key not in OTHERS}
        elif file.is_file() and file.name not in OTHERS and file.parent.name != "checkpoint":
            found[name] = file.read_bytes()
    return found


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """What the long sweep gives when nothing happens to it."""
    batch = Batch(tmp_path_factory.mktemp("undisturbed") / "batch", LONG)
    assert batch.start().wait(600) == 0 and batch.clean()
    return contents(batch.out)


def test_a_batch_whose_driver_is_killed_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    """The same as each case gives alone, in this process."""
    batch = Batch(tmp_path / "batch", SHORT)
    for point in load_study(tmp_path / "batch" / "sweep.toml").points:
        folder = str(tmp_path / "alone" / point.name)
        assert run_order(Order(resolved_toml(point.case), folder, point.hash, "alone")).status == DONE
    driver = batch.start()
    while not [*batch.out.glob("*/outcome.json")]:
        assert driver.poll() is None
        time.sleep(0.02)
    driver.kill()
    driver.wait()
    assert batch.start("--resume").wait(120) == 0
    assert contents(batch.out) == contents(tmp_path / "alone")
    assert batch.clean()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_batch_survives_random_kills_to_the_same_bits(tmp_path: Path, undisturbed, seed: int) -> None:
    """Until the batch is done: a random process of a random kind is killed every few seconds."""
    whole, kills = undisturbed, list[str]()
    random, batch = np.random.default_rng(seed), Batch(tmp_path / "batch", LONG)
    options: tuple[str, ...] = ()
    while True:
        driver, began = batch.start(*options), time.monotonic()
        while driver.poll() is None:
            pause = random.uniform(0.5, 8.0)
            try:
                driver.wait(pause)
            except subprocess.TimeoutExpired:
                kind = str(random.choice(VICTIMS))
                if victims := batch.victims(kind, driver.pid):
                    victim = victims[random.integers(len(victims))]
                    kills.append(f"{kind} after {time.monotonic() - began:.1f} s")
                    victim.kill()
            assert time.monotonic() - began < 300.0, f"seed {seed}: stuck after {kills}"
        if driver.returncode == 0:
            break
        options = ("--only-failed",) if driver.returncode == 4 else ("--resume",)
    print(f"seed {seed}: {len(kills)} kills: {', '.join(kills)}")
    found = contents(batch.out)
    assert found.keys() == whole.keys() and len([*batch.out.glob("*/outcome.json")]) == 24
    assert not [name for name in whole if found[name] != whole[name]]
    with (batch.out / "results.csv").open(newline="") as file:
        assert [row["status"] for row in csv.DictReader(file)] == [DONE] * 24
    assert batch.clean()
