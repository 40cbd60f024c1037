"""Disks that are full, folders that vanish or may not be written: a message, an exit code, nothing that looks whole
and is not, and a run that goes on once there is space."""

from __future__ import annotations

import csv
import errno
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import pytest
from test_resume import assert_same, leftovers, results

from phantomnode.pipeline import cli, files, vtu
from phantomnode.pipeline import prepare as prepare_module
from phantomnode.pipeline.case import load_case
from phantomnode.pipeline.folder import differences
from phantomnode.pipeline.run import run
from phantomnode.pipeline.starter import write_starter

WRITES = ("open", "write", "fsync", "replace", "ftruncate")
"""What the house's functions that write files ask of the system."""

FEW = (
    "time.end=4e-4",
    "output.fields.count=2",
    "output.history.count=4",
    "output.checkpoint.every='100 steps'",
)


class Disk:
    """Stands between the functions that write files and the system; the n-th request fails.

    Parameters
    ----------
    fails : callable
        Whether the request of this number fails.
    """

    def __init__(self, fails: Callable[[int], bool]) -> None:
        self.requests, self.fails = 0, fails

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        return self._asking(name, real) if name in WRITES else real

    def _asking(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def ask(*given: Any) -> Any:
            if name == "ftruncate":  # what is there can be cut on a full disk, too
                return real(*given)
            self.requests += 1
            if self.fails(self.requests):
                if name == "write":  # a full disk takes a part
                    real(given[0], bytes(given[1])[: len(given[1]) // 2])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return None if name == "fsync" else real(*given)  # nobody cuts the power here: it need not wait

        return ask


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A short run with output and checkpoints, prepared once; its picture is a line of text."""
    loaded = load_case(write_starter(tmp_path / "disc"), FEW)
    prepared = prepare_module.prepare(loaded)
    monkeypatch.setattr(prepare_module, "prepare", lambda case: prepared)
    monkeypatch.setattr(vtu, "monotonic", lambda: 0.0)  # as many requests in every run
    monkeypatch.setattr(
        "phantomnode.pipeline.preview.draw_result",
        lambda prepared, frame, path: files.write_atomically(path, f"peak at {frame.time!r}"),
    )
    return loaded


def assert_nothing_is_wrong(folder: Path, whole: dict[str, Any]) -> None:
    """What can be read is a part of the whole: frames, lines of the history, entries of the series."""
    for file in folder.rglob("*"):
        name = str(file.relative_to(folder))
        if name == "history.csv":
            assert whole[name].startswith(file.read_bytes()) and file.read_bytes().endswith(b"\n")
        elif name in whole and not name.endswith(".pvd"):
            assert file.read_bytes() == whole[name], name
        elif name.endswith(".pvd"):
            lines = file.read_text().splitlines()
            assert lines[-1] == "</VTKFile>"
            for line in lines[3:-2]:
                assert line in whole[name].decode() and (folder / line.split('file="')[1][:-3]).is_file()
    assert not leftovers(folder)
    if (folder / "manifest.json").exists():
        assert differences(folder) == []


@pytest.mark.parametrize(
    ("kind", "stride"),
    [
        ("one", 4),
        ("all that follow", 7),
        pytest.param("one", 1, marks=pytest.mark.slow),
        pytest.param("all that follow", 1, marks=pytest.mark.slow),
    ],
)
def test_any_write_may_fail(
    case: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, stride: int
) -> None:
    """Every (stride-th) request of a run in turn, alone or with all behind it: see the head of this file."""
    whole, out = tmp_path / "whole", tmp_path / "out"
    counting = Disk(lambda number: False)
    with monkeypatch.context() as inner:
        inner.setattr(files, "os", counting)
        run(case, whole)
    complete, total, resumed = results(whole), counting.requests, 0
    assert total > 100
    for n in range(1, total + 1, stride):
        shutil.rmtree(out, ignore_errors=True)
        disk = Disk((lambda k: k == n) if kind == "one" else (lambda k: k >= n))  # noqa: B023
        with monkeypatch.context() as inner:
            inner.setattr(files, "os", disk)
            with pytest.raises(
                files.WriteError, match="No space left on device; make space on the disk, then"
            ):
                run(case, out)
        assert_nothing_is_wrong(out, complete)
        with monkeypatch.context() as inner:
            inner.setattr(files, "os", counting)
            resumed += run(case, out, resume=True).figures["resumed_at"] != []
        assert_same(out, whole)
    assert resumed > 0.25 * total / stride  # many of them went on from a checkpoint


def code_of(*tokens: str) -> int:
    with pytest.raises(SystemExit) as left:
        cli.app(list(tokens))
    return int(left.value.code or 0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "make space on the disk, then run the case again"),
        (errno.EROFS, "cannot be written there; change that, or take another --out"),
        (errno.EIO, "run the case again"),
    ],
)
def test_the_message_says_what_to_do(
    case: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: int,
    advice: str,
) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(files.os, "fsync", fail)
    assert code_of("run", str(tmp_path / "disc"), "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {tmp_path / 'out'}") and os.strerror(number) in said and advice in said


def test_a_folder_that_vanishes_ends_the_run(
    case: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from phantomnode.pipeline.fields import Fields

    out, take = tmp_path / "out", Fields.take

    def vanish(self: Fields, frame: Any) -> None:
        take(self, frame)
        if frame.step > 0:
            self.reach_disk()  # nothing is written while the folder goes
            shutil.rmtree(out)

    monkeypatch.setattr(Fields, "take", vanish)
    with pytest.raises(files.WriteError, match="the folder, or a part of it, is gone; run the case again"):
        run(case, out)
    assert not out.exists()


def test_a_folder_that_may_not_be_written_is_told(case: Any, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine").chmod(0o500)
    if os.access(tmp_path / "mine", os.W_OK):
        pytest.skip("the superuser may write everywhere")
    with pytest.raises(files.WriteError, match="Permission denied; results cannot be written there"):
        run(case, tmp_path / "mine" / "out")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB in memory."""
    place = tmp_path / "disk"
    place.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)], capture_output=True, text=True
    )
    if made.returncode != 0:
        pytest.skip(f"no file system can be mounted: {made.stderr.strip()}")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_disk_of_two_megabytes_fills_up(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if shutil.which("mount") is None:
        pytest.skip("there is no mount")
    disk: Path = request.getfixturevalue("small_disk")
    case = load_case(
        write_starter(tmp_path / "disc"),
        ["time.end=4e-4", "output.fields.count=6", "output.checkpoint.every='100 steps'"],
    )
    ballast, out = disk / "ballast", disk / "out"
    run(case, tmp_path / "whole")
    complete = results(tmp_path / "whole")
    for size in (1_900_000, 1_700_000, 1_500_000, 1_300_000):
        shutil.rmtree(out, ignore_errors=True)
        ballast.write_bytes(bytes(size))
        with pytest.raises(files.WriteError, match="No space left on device; make space"):
            run(case, out)
        assert_nothing_is_wrong(out, complete)
        ballast.unlink()
        run(case, out, resume=True)
        assert_same(out, tmp_path / "whole")


def test_a_history_is_cut_back_to_whole_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = files.GrowingFile(tmp_path / "a.csv", b"a,b\n")
    file.add(b"1,2\n")

    def half(handle: int, data: bytes) -> int:
        if len(data) < 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return os.pwrite(handle, bytes(data)[:2], os.lseek(handle, 0, os.SEEK_CUR)) or 2

    monkeypatch.setattr(files, "os", SimpleNamespace(**{**vars(os), "write": half}))
    with pytest.raises(OSError, match="No space left"):
        file.add(b"3,4\n")
    monkeypatch.undo()
    file.add(b"5,6\n")
    file.close()
    with (tmp_path / "a.csv").open() as text:
        assert list(csv.reader(text)) == [["a", "b"], ["1", "2"], ["5", "6"]]
    assert file.sha256 == files.sha256_of(tmp_path / "a.csv")


def test_frames_of_an_interrupted_disk_are_read(case: Any, tmp_path: Path) -> None:
    run(case, tmp_path / "out")
    assert all(meshio.read(frame).points.size for frame in (tmp_path / "out").glob("fields/*.vtu"))
