"""The command line: exit codes, messages, where results go, and that it answers at once."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from phantomnode.geometry.errors import GeometryError
from phantomnode.pipeline import cli
from phantomnode.pipeline.case import CaseError, load_case

Line = Callable[..., int]
Calls = list[tuple[str, Path]]


@pytest.fixture
def line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Line:
    """The command line in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PHANTOMNODE_DEBUG", raising=False)

    def call(*tokens: str) -> int:
        with pytest.raises(SystemExit) as left:
            cli.app(list(tokens))
        code = left.value.code
        assert code is None or isinstance(code, int)
        return code or 0

    return call


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Stands in for the solver: notes each run and its folder, and leaves what a finished run leaves."""
    calls: Calls = []

    def run_all(
        case: Any, out: Path, *, console: object = None, command: tuple[str, ...] = (), **options: object
    ) -> list[SimpleNamespace]:
        calls.append((case.name, out))
        out.mkdir(parents=True, exist_ok=True)
        status = case.title if case.title in ("stopped", "interrupted") else "done"
        (out / "summary.json").write_text(json.dumps({"status": status}))
        return [SimpleNamespace(status="done"), SimpleNamespace(status=status)]

    def check(case: Any, out: Path, *, console: object = None) -> None:
        calls.append((f"check {case.name}", out))

    monkeypatch.setitem(
        sys.modules, "phantomnode.pipeline.run", SimpleNamespace(run_all=run_all, check=check)
    )
    return calls


def fail_with(error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every run raise an error."""

    def run(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setitem(sys.modules, "phantomnode.pipeline.run", SimpleNamespace(run_all=run, check=run))


def test_help_loads_nothing_heavy_and_shows_every_command() -> None:
    """It answers in a fifth of a second because it needs none of what computes, reads, draws or distributes."""
    command = [sys.executable, "-X", "importtime", "-m", "phantomnode", "--help"]
    shown = subprocess.run(command, capture_output=True, text=True)
    assert shown.returncode == 0
    loaded = {line.rpartition("|")[2].strip().partition(".")[0] for line in shown.stderr.splitlines()}
    assert "phantomnode" in loaded
    assert not loaded & {
        "numpy",
        "numba",
        "scipy",
        "matplotlib",
        "shapely",
        "ezdxf",
        "gmsh",
        "dask",
        "distributed",
    }
    for word in (
        "run",
        "check",
        "cases",
        "new",
        "report",
        "plot",
        "animate",
        "paraview",
        "schema",
        "--version",
        "Exit codes",
    ):
        assert word in shown.stdout


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import sys, phantomnode.pipeline.cli; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not {"numpy", "numba", "pydantic", "vtk", "vtkmodules", "ezdxf", "gmsh", "matplotlib"} & set(
        loaded
    )


def test_a_bad_case_ends_with_2_a_message_and_nothing_written(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "phantomnode", "run", "missing.toml", "--out", "results"]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert ended.returncode == 2
    assert (
        ended.stderr.startswith("error: missing.toml: there is no such file")
        and "Traceback" not in ended.stderr
    )
    assert ended.stdout == "" and not list(tmp_path.iterdir())


def test_version(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    assert line("--version") == 0
    assert capsys.readouterr().out[0].isdigit()


@pytest.mark.parametrize(
    "tokens",
    [
        ("rnu", "a"),
        ("run",),
        ("run", "a", "b"),
        ("run", "a", "--outt", "b"),
        ("run", "a", "--threads", "two"),
    ],
)
def test_a_wrong_command_line_ends_with_2(line: Line, tokens: tuple[str, ...]) -> None:
    assert line(*tokens) == 2


def test_new_writes_a_case_that_loads_and_never_overwrites(
    line: Line, capsys: pytest.CaptureFixture[str]
) -> None:
    assert line("new", "first case") == 0
    case = load_case("first case")
    assert case.name == "first_case" and case.path("disc.dxf").is_file()
    Path("first case/case.toml").write_text("mine")
    assert line("new", "first case") == 2
    assert "exists already" in capsys.readouterr().err and Path("first case/case.toml").read_text() == "mine"


def test_the_starter_drawing_holds_the_disc_in_millimetres(line: Line) -> None:
    import ezdxf

    assert line("new", "start") == 0
    drawing = ezdxf.readfile("start/disc.dxf")
    (circle,) = drawing.modelspace()
    assert (drawing.units, circle.dxf.radius, tuple(circle.dxf.center)[:2]) == (4, 25.0, (0.0, 25.5))


def test_cases_lists_the_bundled_ones(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    assert line("cases") == 0
    out = capsys.readouterr().out
    assert (
        "Ring impact on an obstacle (paper, 4.4)" in out and "Run one: phantomnode run block_contact" in out
    )


def test_schema_prints_json(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    assert line("schema") == 0
    assert "body" in json.loads(capsys.readouterr().out)["properties"]


def test_results_go_to_the_first_free_folder(line: Line, runs: Calls) -> None:
    assert line("new", "disc") == 0
    for _ in range(3):
        assert line("run", "disc") == 0
    Path("results/disc-2/summary.json").unlink()  # a run that never finished is not in the way
    assert line("run", "disc") == 0
    folders = [str(out) for _, out in runs]
    assert folders == ["results/disc", "results/disc-2", "results/disc-3", "results/disc-2"]


def test_resume_goes_to_the_last_run_that_has_not_ended(line: Line, runs: Calls) -> None:
    assert line("new", "disc") == 0
    assert line("run", "disc", "--resume") == 0  # nothing there yet: the first folder
    assert line("run", "disc") == 0
    assert line("run", "disc", "--set", "title=interrupted") == 130
    assert line("run", "disc", "--resume") == 0
    assert line("run", "disc", "--resume") == 0  # all have ended: the last one, which will say so
    folders = [str(out) for _, out in runs]
    assert folders == ["results/disc", "results/disc-2", "results/disc-3", "results/disc-3", "results/disc-3"]


def test_resume_takes_the_folder_of_a_run_for_its_case(line: Line, runs: Calls) -> None:
    assert line("new", "disc") == 0
    Path("disc/run.log").touch()
    assert line("run", "disc", "--resume") == 0
    assert line("run", "disc", "--resume", "--out", "other") == 0
    assert [str(out) for _, out in runs] == ["disc", "other"]


def test_a_run_that_can_go_on_is_not_written_over(
    line: Line, runs: Calls, capsys: pytest.CaptureFixture[str]
) -> None:
    assert line("new", "disc") == 0
    Path("mine/checkpoint").mkdir(parents=True)
    Path("mine/checkpoint/step_000000000100.checkpoint").touch()
    assert line("run", "disc", "--out", "mine") == 2
    assert "add --resume to go on with it" in capsys.readouterr().err
    assert line("run", "disc", "--out", "mine", "--resume", "--overwrite") == 2
    assert "take one" in capsys.readouterr().err and not runs


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--checkpoint-every=soon", '--checkpoint-every: "soon" is no interval'),
        ("--wall-limit=5", '--wall-limit: "5" is no wall time'),
        ("--set=output.checkpoint.every='5'", '"5" is no interval'),
    ],
)
def test_what_is_no_time_is_refused_with_examples(
    line: Line, capsys: pytest.CaptureFixture[str], option: str, message: str
) -> None:
    assert line("new", "disc") == 0
    assert line("run", "disc", option) == 2
    said = capsys.readouterr().err
    assert message in said and "min" in said and not Path("results").exists()


def test_a_finished_run_in_out_is_kept_unless_asked(
    line: Line, runs: Calls, capsys: pytest.CaptureFixture[str]
) -> None:
    assert line("new", "disc") == 0
    assert line("run", "disc", "--out", "mine") == 0
    assert line("run", "disc", "--out", "mine") == 2
    assert "add --overwrite" in capsys.readouterr().err
    assert line("run", "disc", "--out", "mine", "--overwrite") == 0
    assert len(runs) == 2


@pytest.mark.parametrize(
    ("out", "reason"), [("disc", "holds the case file itself"), ("disc/disc.dxf", "is a file")]
)
def test_results_never_replace_the_case(
    line: Line, runs: Calls, capsys: pytest.CaptureFixture[str], out: str, reason: str
) -> None:
    assert line("new", "disc") == 0
    assert line("run", "disc", "--out", out, "--overwrite") == 2
    assert reason in capsys.readouterr().err and not runs


@pytest.mark.parametrize(("status", "code"), [("done", 0), ("stopped", 3), ("interrupted", 130)])
def test_the_status_of_a_run_is_the_exit_code(line: Line, runs: Calls, status: str, code: int) -> None:
    assert line("new", "disc") == 0
    assert line("run", "disc", "--set", f"title={status}", "--set", "time.end=1e-4") == code


def test_check_takes_overrides_and_its_own_folder(line: Line, runs: Calls) -> None:
    assert line("new", "disc") == 0
    assert line("check", "disc", "--set", "name=other") == 0
    assert line("check", "disc", "--out", "here") == 0
    assert runs == [("check other", Path("results/other")), ("check disc", Path("here"))]


@pytest.mark.parametrize(
    ("threads", "message"),
    [("0", "must be at least 1"), ("-3", "at least 1"), ("100000", "NUMBA_NUM_THREADS")],
)
def test_a_number_of_threads_that_cannot_be_had_is_refused(
    line: Line, capsys: pytest.CaptureFixture[str], threads: str, message: str
) -> None:
    assert line("new", "disc") == 0
    assert line("run", "disc", f"--threads={threads}") == 2
    assert message in capsys.readouterr().err and not Path("results").exists()


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (CaseError(["one [bold]", "two"]), 2, "error: one [bold]\nerror: two\n"),
        (GeometryError("a.dxf: open contour"), 2, "error: a.dxf: open contour\n"),
        (PermissionError(13, "Permission denied", "out"), 2, "error: [Errno 13] Permission denied: 'out'\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
)
def test_faults_end_as_messages(
    line: Line,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    message: str,
) -> None:
    assert line("new", "disc") == 0
    fail_with(error, monkeypatch)
    assert line("run", "disc") == code
    assert capsys.readouterr().err == message


def test_debug_shows_the_traceback(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PHANTOMNODE_DEBUG", "1")
    with pytest.raises(CaseError):
        cli.app(["run", "nowhere"])


def test_a_fault_of_the_program_is_not_blamed_on_the_input(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert line("new", "disc") == 0
    fail_with(ZeroDivisionError(), monkeypatch)
    with pytest.raises(ZeroDivisionError):
        cli.app(["run", "disc"])
