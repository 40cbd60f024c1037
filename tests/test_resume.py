"""A run that is cut short and goes on ends with the bits of one that was not."""

from __future__ import annotations

import errno
import io
import json
import os
import platform
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import config
from rich.console import Console

from phantomnode.pipeline import checkpoint, lock
from phantomnode.pipeline.case import Case, bundled_cases, load_case, variants
from phantomnode.pipeline.checkpoint import Damaged, checkpoints, packed, unpacked
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.folder import differences
from phantomnode.pipeline.lock import LOCK, FolderLock, is_locked
from phantomnode.pipeline.preflight import steps_of
from phantomnode.pipeline.prepare import prepare
from phantomnode.pipeline.run import run, run_all
from phantomnode.pipeline.starter import write_starter
from phantomnode.pipeline.tally import Tally
from phantomnode.solver import layout

RING = (
    "body.ring.grid.cell=0.05", "body.obstacle.grid.cell=0.1", "time.end=1.5e-3", "output.fields.count=6",
    "output.history.count=40", "contact.ring_on_obstacle.friction=0.3",
    "body.ring.initial_velocity=[8.0, -50.0]",
)  # fmt: skip
BUNDLED = {
    "block_contact": (
        "time.end=0.006", "output.fields.count=5", "output.history.count=30", "contact.halves.friction=0.2",
    ),
    "curved_bodies": (
        "time.end=0.008", "output.fields.count=5", "output.history.count=30", "contact.crowns.friction=0.2",
    ),
    "ring_impact": RING,
    "ring_impact/polar": ("time.end=6e-4", "output.fields.count=5", "output.history.count=30"),
    "split_block_wave": (
        "body.block.grid.counts=[8, 41]", "time.end=3e-6", "output.fields.count=6", "output.history.count=25",
        "output.profile.height.times=[1e-6, 2.5e-6]",
    ),
    "wavy_block": (
        "body.block.grid.counts=[20, 10]", "time.end=0.004", "time.step='auto'", "output.fields.count=5",
        "output.history.count=30", "contact.sliding.friction=0.2",
    ),
}  # fmt: skip
TIMES = {"wall_s", "step_loop_s", "element_updates_per_s", "provenance", "resumed_at"}
"""What of summary.json differs from run to run."""


def cut_short(monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    """A signal at the first frame from this step on."""
    take = Tally.frame

    def frame(self: Tally, frame: Any) -> None:
        take(self, frame)
        if frame.step >= step:
            monkeypatch.undo()
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Tally, "frame", frame)


def results(folder: Path) -> dict[str, Any]:
    """All files of a run by name; of summary.json what is physics."""
    names = ("history.csv", "*.pvd", "fields/*", "contact/*", "profile.*.csv", "peak.png", "case.toml")
    files = sorted(file for name in names for file in folder.glob(name))
    found: dict[str, Any] = {str(file.relative_to(folder)): file.read_bytes() for file in files}
    figures = json.loads((folder / "summary.json").read_text())
    return found | {key: value for key, value in figures.items() if key not in TIMES}


def leftovers(folder: Path) -> list[Path]:
    """Temporary files and locks."""
    return [*folder.rglob("*.part"), *folder.rglob(LOCK)]


def assert_same(one: Path, other: Path) -> None:
    a, b = results(one), results(other)
    assert [key for key in {**a, **b} if a.get(key) != b.get(key)] == []
    assert not leftovers(one) and differences(one) == []


def every_case() -> list[tuple[str, str]]:
    return [(name, variant) for name in BUNDLED for variant in ("", *load_case(name).variant)]


def coarse(name: str, variant: str) -> Case:
    case = load_case(name, BUNDLED[name])
    return variants(case)[variant] if variant else case


@pytest.mark.parametrize(("name", "variant"), every_case())
def test_every_bundled_case_goes_on_to_the_same_bits(
    name: str, variant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut at a third, on one thread; again at two thirds, on two; against one run on one."""
    monkeypatch.setattr(layout, "STRIP_ELEMENTS", 8)  # so that two threads take part in a small model
    case, whole, parts = coarse(name, variant), tmp_path / "whole", tmp_path / "parts"
    steps = run(case, whole).figures["steps"]
    two = min(2, config.NUMBA_NUM_THREADS)  # one core has one
    for part, threads in ((3, 1), (1.5, two)):
        cut_short(monkeypatch, int(steps / part))
        summary = run(case, parts, resume=True, threads=threads)
        monkeypatch.setattr(layout, "STRIP_ELEMENTS", 8)
        assert summary.status == "interrupted" and "--resume" in summary.figures["advice"]
        assert 0 < summary.figures["steps"] < steps
    summary = run(case, parts, resume=True, threads=two)
    assert summary.status == "done" and len(summary.figures["resumed_at"]) == 2
    assert_same(parts, whole)
    assert summary.figures["step_loop_s"] > 0.0


def test_no_bundled_case_is_missing_here() -> None:
    assert {*BUNDLED} == {*bundled_cases()}


@pytest.mark.parametrize("name", BUNDLED)
def test_two_threads_take_part_in_these_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layout, "STRIP_ELEMENTS", 8)
    assert layout.prepare_layout(prepare(coarse(name, "")).model, 2).threads == 2


def test_contact_and_friction_are_active_in_these_runs(tmp_path: Path) -> None:
    summary = run(load_case("ring_impact", RING), tmp_path / "out")
    assert summary.figures["peak_contact_force"]["ring_on_obstacle"] > 0.0
    assert summary.figures["energies"]["friction"] > 0.0


@pytest.fixture
def starter(tmp_path: Path) -> Case:
    """A case of some hundred steps with contact."""
    few = (
        "time.end=8e-4",
        "output.fields.count=3",
        "output.history.count=12",
        "contact.disc_on_block.friction=0.2",
    )
    return load_case(write_starter(tmp_path / "disc"), few)


def interrupted(case: Case, out: Path, monkeypatch: pytest.MonkeyPatch, **options: Any) -> None:
    """Leave a run that was cut short at three quarters, with two checkpoints."""
    with monkeypatch.context() as inner:
        cut_short(inner, 3 * steps_of_case(case) // 4)
        assert run(case, out, checkpoint_every="0.1 ms", **options).status == "interrupted"
    assert len(checkpoints(out)) == 2


def steps_of_case(case: Case) -> int:
    return steps_of(prepare(case))


@pytest.mark.parametrize("damage", ["cut", "changed", "empty"])
def test_a_damaged_checkpoint_is_skipped_for_the_one_before(
    starter: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    run(starter, tmp_path / "whole")
    out = tmp_path / "out"
    interrupted(starter, out, monkeypatch)
    last, before = checkpoints(out)
    content = bytearray(last.read_bytes())
    content[len(content) // 2] ^= 1
    last.write_bytes({"cut": content[:-100], "changed": content, "empty": b""}[damage])
    summary = run(starter, out, resume=True)
    assert summary.figures["resumed_at"] == [int(before.stem.split("_")[1])]
    assert "damaged or cut short; the checkpoint before it is taken" in (out / "run.log").read_text()
    assert_same(out, tmp_path / "whole")


@pytest.mark.parametrize("file", ["history.csv", "fields/fields_00001.vtu", "contact/contact_00000.vtu"])
def test_results_that_a_checkpoint_misses_are_made_again(
    starter: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    run(starter, tmp_path / "whole")
    out = tmp_path / "out"
    interrupted(starter, out, monkeypatch)
    content = (out / file).read_bytes()
    (out / file).write_bytes(content[: len(content) // 3])
    assert run(starter, out, resume=True).figures["resumed_at"] == []
    log = (out / "run.log").read_text()
    assert file in log and "begins at its start" in log
    assert_same(out, tmp_path / "whole")


def test_a_checkpoint_of_another_case_or_version_is_refused(
    starter: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    interrupted(starter, out, monkeypatch)
    other = load_case(tmp_path / "disc", ["body.disc.initial_velocity=[0.0, -1.0]", "time.end=8e-4"])
    with pytest.raises(CaseError, match="another case: body.disc.initial_velocity is .* there and .* here"):
        run(other, out, resume=True)
    (out / "case.toml").unlink()
    with pytest.raises(CaseError, match="another case .hash"):
        run(other, out, resume=True)
    monkeypatch.setattr("phantomnode.__version__", "0.0.1")
    with pytest.raises(CaseError, match=r"written by phantomnode .* now 0\.0\.1"):
        run(starter, out, resume=True)
    monkeypatch.undo()
    monkeypatch.setattr(checkpoint, "_digest", lambda model: "other")
    with pytest.raises(CaseError, match="another model of the same case"):
        run(starter, out, resume=True)
    assert len(checkpoints(out)) == 2 and not leftovers(out)


def test_the_drawing_belongs_to_the_case(
    starter: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, drawing = tmp_path / "out", tmp_path / "disc" / "disc.dxf"
    interrupted(starter, out, monkeypatch)
    drawing.write_text(drawing.read_text() + "\n")
    with pytest.raises(CaseError, match="body.disc.geometry.file is a file of content"):
        run(starter, out, resume=True)
    # The folder of the run has a copy of its own, and goes on.
    assert run(load_case(out), out, resume=True).status == "done"


def test_a_finished_run_is_left_alone_and_a_spoilt_one_is_not(starter: Case, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run(starter, out, checkpoint_every="100 steps")
    before = {file: file.stat().st_mtime_ns for file in out.rglob("*")}
    again = run(starter, out, resume=True)
    assert (again.status, again.checks) == (first.status, first.checks)
    assert {file: file.stat().st_mtime_ns for file in out.rglob("*")} == before
    whole = results(out)
    (out / "peak.png").write_bytes(b"half a picture")
    assert run(starter, out, resume=True).figures["resumed_at"] != []
    assert results(out) == whole and differences(out) == []


def test_a_stopped_run_stops_again_where_it_stopped(
    starter: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guard ends both at the same step with the same last good state."""
    wild = starter.model_copy(
        update={"time": starter.time.model_copy(update={"step": 8e-6, "force": True, "end": 4e-3})}
    )
    whole = run(wild, tmp_path / "whole")
    assert whole.status == "stopped"
    with monkeypatch.context() as inner:
        cut_short(inner, whole.figures["steps"] // 2)
        assert run(wild, tmp_path / "parts").status == "interrupted"
    assert run(wild, tmp_path / "parts", resume=True).status == "stopped"
    assert_same(tmp_path / "parts", tmp_path / "whole")


def test_variants_go_on_too_and_what_is_done_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = load_case("split_block_wave", BUNDLED["split_block_wave"])
    run_all(case, tmp_path / "whole")
    ends, frame = 0, Tally.frame

    def third(self: Tally, at: Any) -> None:  # half of the third run
        nonlocal ends
        frame(self, at)
        ends += at.step == 0
        if ends == 3 and at.step > 20:
            monkeypatch.undo()
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(Tally, "frame", third)
    assert [s.status for s in run_all(case, tmp_path / "parts")] == ["done", "done", "interrupted"]
    done = (tmp_path / "parts" / "history.csv").stat().st_mtime_ns
    again = run_all(load_case(tmp_path / "parts"), tmp_path / "parts", resume=True)
    assert [s.status for s in again] == ["done"] * 5
    assert (tmp_path / "parts" / "history.csv").stat().st_mtime_ns == done
    for name in ("", *(f"variants/{name}" for name in case.variant)):
        one, other = results(tmp_path / "parts" / name), results(tmp_path / "whole" / name)
        assert [key for key in one if key not in ("case.toml", "title") and one[key] != other[key]] == []


def test_a_wall_limit_ends_a_run_in_time_and_resumed_runs_come_to_an_end(tmp_path: Path) -> None:
    few = ("time.end=8e-4", "output.fields.count=3", "output.history.count=3")
    case = load_case(write_starter(tmp_path / "disc"), few)
    run(case, tmp_path / "whole")
    out, runs = tmp_path / "out", 1
    while (summary := run(case, out, resume=True, wall_limit="0.001 s")).status == "interrupted":
        assert "wall limit of 0.001 s" in summary.figures["reason"]
        runs += 1
    assert runs == 4  # one frame further each time, of 4
    assert_same(out, tmp_path / "whole")


def test_two_runs_in_one_folder_are_refused(starter: Case, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with FolderLock(out):
        assert is_locked(out)
        with pytest.raises(
            CaseError, match=f"another run is at work in this folder .process {os.getpid()} on"
        ):
            run(starter, out)
        assert sorted(path.name for path in out.iterdir()) == [LOCK]
    assert not is_locked(out) and not list(out.iterdir())


def test_the_lock_of_a_dead_process_is_taken_over_and_one_of_another_machine_is_not(
    starter: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    code = (
        "import os, sys; from pathlib import Path; from phantomnode.pipeline.lock import FolderLock\n"
        "FolderLock(Path(sys.argv[1])).__enter__(); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(out)]).returncode == -9
    assert (out / LOCK).exists() and not is_locked(out)
    assert run(starter, out).status == "done"
    assert "killed; its folder is taken over" in (out / "run.log").read_text()
    left = '{"machine": "elsewhere", "process": 1}'
    (out / LOCK).write_text(left)
    monkeypatch.setattr(lock, "file_system", lambda path: ("lustre", {"rw"}))
    assert is_locked(out)
    with pytest.raises(
        CaseError, match="process 1 on elsewhere .* kind lustre .* ps -p 1. .* rm .*/.lock and"
    ):
        run(starter, out)
    assert (out / LOCK).read_text() == left
    monkeypatch.undo()  # on the file system of this machine, a container of another name may have left it
    with FolderLock(out) as held:
        assert held.taken_over


@pytest.mark.parametrize(
    ("kind", "options", "seen"),
    [
        ("ext4", "rw", True),
        ("nfs4", "rw,vers=4.2,local_lock=none", True),
        ("nfs", "rw,vers=3,nolock", False),
        ("nfs4", "rw,local_lock=flock", False),
        ("nfs", "rw,local_lock=all", False),
        ("lustre", "rw,flock", False),
        ("", "", False),
    ],
)
def test_whose_locks_a_file_system_shows(kind: str, options: str, seen: bool) -> None:
    assert lock._all_see(kind, {*options.split(",")}) is seen


def test_the_file_system_of_a_folder_is_that_of_the_innermost_mount(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (
        "1 0 8:1 / / rw shared:1 - ext4 /dev/a rw\n"
        "2 1 0:4 / /data\\040of\\040all rw - nfs4 server:/data rw,local_lock=none\n"
        "3 2 0:5 / /data\\040of\\040all/fast rw,noatime - tmpfs tmpfs rw,size=2048k\n"
    )
    monkeypatch.setattr(Path, "read_text", lambda self, **_: text)
    assert lock.file_system(Path("/data of all/study")) == ("nfs4", {"rw", "local_lock=none"})
    assert lock.file_system(Path("/data of all/fast/a"))[0] == "tmpfs"
    assert lock.file_system(Path("/data"))[0] == "ext4"


def test_where_there_are_no_locks_a_dead_process_holds_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(lock.fcntl, "flock", unsupported)
    with FolderLock(tmp_path), pytest.raises(CaseError, match="another run is at work"):
        FolderLock(tmp_path)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (tmp_path / LOCK).write_text(json.dumps({"machine": platform.node(), "process": dead.pid}))
    with FolderLock(tmp_path) as held:
        assert held.taken_over


def test_threads_that_take_no_part_are_told(
    starter: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In run.log, for the user and in summary.json; nothing where all take part."""
    case, said = coarse("split_block_wave", "consistent"), Console(file=io.StringIO(), width=200)
    two = min(2, config.NUMBA_NUM_THREADS)
    for one, why in ((case, "classic X-FEM runs on one"), (starter, "each needs 4,096 uncut elements, of ")):
        out = tmp_path / one.method
        summary = run(one, out, threads=two, console=said)
        assert summary.figures["provenance"]["threads_used"] == 1
        for text in ((out / "run.log").read_text(), said.file.getvalue()):
            assert (f"threads   1 of {two}: {why}" in text) == (two > 1)
    monkeypatch.setattr(layout, "STRIP_ELEMENTS", 8)
    summary = run(starter, tmp_path / "all", threads=two)
    assert summary.figures["provenance"]["threads_used"] == two
    assert f"of {two}:" not in (tmp_path / "all" / "run.log").read_text()


def test_trees_come_back_to_the_bit() -> None:
    tree = {
        "number": 0.1 + 0.2, "inf": np.inf, "list": [1.0 / 3.0, 2], "none": None, "text": "é/x",
        "f": np.asfortranarray(np.random.default_rng(1).normal(size=(5, 2))), "empty": np.zeros((0, 2)),
        "in": {"ints": np.arange(3), "deep": {}},
    }  # fmt: skip
    found = unpacked(packed(tree))
    assert found["f"].flags.f_contiguous and (found["f"] == tree["f"]).all()
    assert found["empty"].shape == (0, 2) and found["in"]["ints"].dtype == np.int64
    plain = ("number", "inf", "list", "none", "text")
    assert all(found[key] == tree[key] for key in plain) and found["in"]["deep"] == {}
    with pytest.raises(Damaged):
        unpacked(packed(tree)[:-1])


COMMAND = (sys.executable, "-m", "phantomnode", "run")


def start(case: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    """The command line in a process of its own."""
    line = (*COMMAND, str(case), "--out", str(out), "--checkpoint-every", "200 steps", *more)
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def longer(tmp_path: Path) -> Path:
    """The folder of a case whose steps take about a second."""
    folder = write_starter(tmp_path / "disc")
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace("end = 0.002", "end = 0.02"))
    assert load_case(folder).time.end == 0.02
    return folder


def wait_for(condition: Any, process: subprocess.Popen[str]) -> None:
    began = time.monotonic()
    while not condition() and process.poll() is None:
        assert time.monotonic() < began + 120.0
        time.sleep(0.002)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_command_with_130_and_resume_ends_it(
    longer: Path, tmp_path: Path, number: int
) -> None:
    out = tmp_path / "out"
    process = start(longer, out)
    wait_for(lambda: (out / "history.csv").exists(), process)
    process.send_signal(number)
    said, wrong = process.communicate(timeout=60)
    assert process.returncode == 130, wrong
    assert len(checkpoints(out)) >= 1 and f"phantomnode run {out} --resume" in said
    process = start(longer, out, "--resume")
    said, wrong = process.communicate(timeout=120)
    assert process.returncode == 0 and "goes on at t = " in said, wrong


def kill_at_random(longer: Path, tmp_path: Path, moments: int) -> None:
    whole, seed = tmp_path / "whole", random.Random(20261122)
    assert start(longer, whole).wait(120) == 0
    for moment in range(moments):
        out, kills = tmp_path / "out", 0
        shutil.rmtree(out, ignore_errors=True)
        while True:
            process = start(longer, out, "--resume")
            if kills < 2:
                wait_for(lambda: (out / LOCK).exists(), process)  # noqa: B023
                time.sleep(seed.uniform(0.0, 1.0))
                process.kill()
                kills += 1
            process.communicate(timeout=120)
            if process.returncode == 0:
                break
            assert process.returncode == -signal.SIGKILL, moment
        assert_same(out, whole)


def test_a_run_that_is_killed_twice_ends_with_the_same_bits(longer: Path, tmp_path: Path) -> None:
    kill_at_random(longer, tmp_path, 1)


@pytest.mark.slow
def test_runs_that_are_killed_at_many_moments_end_with_the_same_bits(longer: Path, tmp_path: Path) -> None:
    kill_at_random(longer, tmp_path, 15)
