"""Compiled kernels are kept: they follow their callees, heal, and bear several processes at once."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from phantomnode import kernels

CALLEE = "from phantomnode.kernels import kernel\n\n@kernel\ndef factor(x):\n    return {} * x\n"
CALLER = """
from small.callee import factor
from phantomnode.kernels import kernel

@kernel(nogil=True)
def scaled(x):
    return factor(x) + 1.0

if __name__ == "__main__":
    print(scaled(2.0), scaled(3), [k.stats.cache_hits.total() for k in (scaled, factor)])
"""
COMPILED, LOADED = "[0, 0]", "[2, 0]"
"""Hits of the cache, of caller and callee; a caller that is loaded holds its callee."""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Two kernels in two files, one of which calls the other."""
    folder = tmp_path / "small"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "callee.py").write_text(CALLEE.format(10.0))
    (folder / "caller.py").write_text(CALLER)
    return folder


def start(package: Path, module: str = "small.caller", **environment: str) -> subprocess.Popen[str]:
    """A process that calls the kernels, with a cache beside the package unless told otherwise."""
    import phantomnode

    path = os.pathsep.join([str(package.parent), str(Path(phantomnode.__path__[0]).parent)])
    given = {"NUMBA_DISABLE_JIT": "0", "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(package.parent / "cache")}
    return subprocess.Popen(
        [sys.executable, "-m", module], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=os.environ | given | environment,
    )  # fmt: skip


def call(package: Path, module: str = "small.caller", **environment: str) -> str:
    output, errors = (process := start(package, module, **environment)).communicate(timeout=120)
    assert process.returncode == 0, errors
    return output.strip()


def files(package: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in (package.parent / "cache").rglob("*.kernel")}


def test_a_second_process_compiles_nothing(package: Path) -> None:
    assert call(package) == f"21.0 31.0 {COMPILED}"
    before = files(package)
    assert len(before) == 4  # caller and callee, of a float and of an integer
    assert call(package) == f"21.0 31.0 {LOADED}"
    assert files(package) == before
    assert not list(package.rglob("*.nbi"))


PARALLEL_CALLEE = """
import numpy as np
from numba import prange
from phantomnode.kernels import kernel

@kernel(parallel=True)
def by_threads(x):
    parts = np.zeros(4)
    for i in prange(4):
        parts[i] = x
    return parts.sum()

@kernel
def factor(x):
    return by_threads(x) if x > 2.5 else 4.0 * x
"""


def test_a_kept_caller_of_parallel_loops_finds_the_threads(package: Path) -> None:
    """Compiled with a callee that was loaded, a caller does not know of its loops: it ended the next process."""
    (package / "callee.py").write_text(PARALLEL_CALLEE)
    (package / "first.py").write_text("from small.callee import factor\nfactor(2.0), factor(3)\n")
    assert call(package, "small.first") == ""
    assert call(package).startswith("9.0 13.0")
    assert call(package) == f"9.0 13.0 {LOADED}"


def test_a_caller_is_compiled_anew_when_its_callee_changes(package: Path) -> None:
    call(package)
    (package / "callee.py").write_text(CALLEE.format(20.0))
    assert call(package) == f"41.0 61.0 {COMPILED}"
    (package / "callee.py").write_text(CALLEE.format(10.0))  # back again: the first ones are still there
    assert call(package) == f"21.0 31.0 {LOADED}"


def flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda content: content[: len(content) // 2], id="truncated"),
        pytest.param(lambda content: b"", id="empty"),
        pytest.param(lambda content: content[:10], id="less than the digest"),
        pytest.param(lambda content: b"\x80" * len(content), id="garbage"),
        pytest.param(flip, id="one bit"),
    ],
)
def test_a_broken_file_is_written_anew(package: Path, damage: Callable[[bytes], bytes]) -> None:
    call(package)
    before = files(package)
    for file, content in before.items():
        file.write_bytes(damage(content))
    assert call(package) == f"21.0 31.0 {COMPILED}"
    assert set(files(package)) == set(before)
    assert call(package) == f"21.0 31.0 {LOADED}"


def test_four_processes_fill_an_empty_cache_at_once(package: Path) -> None:
    processes = [start(package) for _ in range(4)]
    said = [process.communicate(timeout=120) for process in processes]
    assert [output.split(" [")[0] for output, _ in said] == ["21.0 31.0"] * 4, said
    assert call(package) == f"21.0 31.0 {LOADED}"
    assert not list((package.parent / "cache").rglob("*.part"))


def test_without_a_writable_folder_the_kernels_still_run(package: Path) -> None:
    """Even the superuser cannot make a folder under a file."""
    blocked = package.parent / "blocked"
    blocked.touch()
    output, errors = (process := start(package, NUMBA_CACHE_DIR=str(blocked))).communicate(timeout=120)
    assert process.returncode == 0 and output.startswith("21.0 31.0")
    assert errors.count("every start compiles them") == 1 and "NUMBA_CACHE_DIR" in errors


def test_without_the_compiler_functions_stay_as_they_are(package: Path) -> None:
    """The statistics, which only dispatchers have, are what fails."""
    output, errors = start(package, NUMBA_DISABLE_JIT="1").communicate(timeout=120)
    assert "'function' object has no attribute 'stats'" in errors
    assert not files(package)


def test_unused_folders_of_other_versions_are_removed(tmp_path: Path) -> None:
    names = ["0" * 16, "1" * 16, "2" * 16, "notes", "3" * 15]
    for name in names:
        (tmp_path / name).mkdir()
    old = (tmp_path / "1").parent.stat().st_mtime - kernels.UNUSED - 60.0
    for name in ("0" * 16, "1" * 16, "notes", "3" * 15):
        os.utime(tmp_path / name, (old, old))
    kernels.remove_unused(tmp_path / ("0" * 16))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(set(names) - {"1" * 16})


def test_the_folder_is_the_users_own_choice_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels.config, "CACHE_DIR", str(tmp_path))
    assert kernels.cache_folder() == tmp_path / "phantomnode"
    monkeypatch.setattr(kernels.config, "CACHE_DIR", "")
    if sys.platform.startswith("linux"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
        assert kernels.cache_folder() == tmp_path / "xdg" / "phantomnode"
        monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # to be ignored, says its specification
        monkeypatch.setenv("HOME", str(tmp_path))
        assert kernels.cache_folder() == tmp_path / ".cache" / "phantomnode"


def test_it_is_known_whether_kernels_were_compiled_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(kernels.config, "DISABLE_JIT", 0)
    assert not kernels.kept("phantomnode.solver")
    sources = Path(importlib.import_module("phantomnode.solver").__file__ or "").parent
    (tmp_path / "phantomnode" / kernels.package_key(sources)).mkdir(parents=True)
    assert kernels.kept("phantomnode.solver")


@pytest.mark.slow
def test_a_run_heals_its_cache(tmp_path: Path) -> None:
    """The starter case with every kernel, cut short, from a cache of which every file is broken."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_DISABLE_JIT": "0"}

    def phantomnode(*arguments: str) -> str:
        command = [sys.executable, "-m", "phantomnode", *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    phantomnode("new", "starter")
    runs = [("run", "starter", "--set", "time.end=1e-4", "--out", name) for name in ("first", "second")]
    assert "compiling the kernels" in phantomnode(*runs[0])
    for number, file in enumerate(sorted((tmp_path / "cache").rglob("*.kernel"))):
        content = file.read_bytes()
        file.write_bytes((content[:100], b"", flip(content))[number % 3])
    assert "compiling the kernels" not in phantomnode(*runs[1])
    first, second = (tmp_path / name / "history.csv" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()
