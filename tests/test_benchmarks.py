"""The benchmarks run, each at a tiny size; what they measure is a matter of the machine."""

from __future__ import annotations

import ast
import io
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from benchmarks import measure, memory, runs, startup, table, versus_akantu
from benchmarks.__main__ import app
from benchmarks.blocks import mapped_block, uniform_block, waves
from benchmarks.measure import Figure, Plan, Process, Seconds, clocked
from benchmarks.registry import BENCHMARKS
from benchmarks.stepping import started

from phantomnode.pipeline import cli
from phantomnode.solver.explicit import frames

TINY = Plan(repeats=1, scale=1e-3)


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Child processes done here: each would import everything anew."""

    def python(*arguments: str) -> Process:
        output = io.StringIO()

        def run() -> None:
            if arguments[0] == "-c":
                monkeypatch.setattr("sys.argv", ["-c", *arguments[2:]])
                with redirect_stdout(output):
                    exec(arguments[1].replace("tests.benchmarks", "benchmarks"), {})
                return
            with pytest.raises(SystemExit) as ended:
                cli.app(arguments[2:])
            assert ended.value.code in (0, None)

        return Process(clocked(run), output.getvalue())

    for module in (memory, runs, startup):
        monkeypatch.setattr(module, "python", python)


@pytest.mark.parametrize("name", BENCHMARKS)
def test_each_benchmark_runs_in_small(name: str, in_process: None) -> None:
    figures = list(BENCHMARKS[name](TINY))
    assert figures
    for figure in figures:
        values = [value for value in (figure.cpu, figure.wall) if value is not None]
        assert figure.name and figure.unit and values and np.isfinite(values).all()


def test_blocks_are_strained_by_a_few_per_cent_and_keep_their_energy() -> None:
    """The waves are those of the note in blocks.py; the energy of a free block stays to 1 % at the usual step."""
    for prepared in (uniform_block(40), mapped_block(40)):
        assert len(prepared.model.elements.volume) == 40**2 and len(prepared.model.cut_elements.lame) == 0
        velocity = waves(prepared, 40)
        sequence = list(
            frames(prepared.model, velocity, prepared.dt, [0, 10, 20], prepared.motion, guard=0.01)
        )
        internal = [frame.energies.internal for frame in sequence]
        assert max(internal) > 0.3 * sequence[0].energies.kinetic
        assert 0.8 < min(frame.smallest_j for frame in sequence[1:]) < 0.99


def test_gradients_differ_from_cell_to_cell_in_the_mapped_block_only() -> None:
    uniform, mapped = (np.ptp(make(8).model.elements.volume) for make in (uniform_block, mapped_block))
    assert uniform < 1e-15 < 1e-4 < mapped


def test_thinned_models_lack_what_they_should() -> None:
    model = runs.prepare(runs.load_case("ring_impact")).model
    counts = [
        (len(m.contact.slave_weight), len(m.cut_elements.lame), len(m.elements.volume))
        for m in runs.thinned(model)
    ]
    contact, cut, uncut = counts[0]
    assert counts == [(contact, cut, uncut), (0, cut, uncut), (0, 0, uncut), (0, 0, 0)] and min(counts[0]) > 0


def test_a_loop_that_stops_early_is_no_measurement() -> None:
    prepared = uniform_block(4)
    with pytest.raises(RuntimeError, match="were not taken"):
        started(prepared, -100.0 * waves(prepared, 4)).take(100)


def test_python_runs_the_checkout_and_says_what_it_took() -> None:
    process = measure.python("-c", "import phantomnode; print(phantomnode.__path__)")
    assert str(measure.ROOT) in process.output
    assert process.seconds.wall > 0.0 and process.seconds.cpu > 0.0
    with pytest.raises(subprocess.CalledProcessError) as failure:
        measure.python("-c", "raise SystemExit('no')")
    assert failure.value.output == "no\n"


def test_peak_memory_is_that_of_the_process_itself() -> None:
    """Not of this one, which holds 200 MB more when it starts the child."""
    held = np.ones(25_000_000)
    script = "from tests.benchmarks.memory import own_peak; print(own_peak())"
    assert 2e7 < int(measure.python("-c", script).output) < memory.own_peak() - 0.5 * held.nbytes


def test_medians_and_spread_are_those_of_the_runs() -> None:
    times = [Seconds(1.0, 5.0), Seconds(3.0, 4.0), Seconds(2.0, 9.0)]
    assert measure.medians(times) == (2.0, 5.0) and measure.spread(times) == 1.0
    assert measure.rate("x", 10.0, "/s", times) == Figure("x", 5.0, 2.0, "/s", "", 1.0)


def test_two_tables_are_compared(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "before.json"
    figure = Figure("a row", 2.0, None, "s", "a note [a]", 0.25)
    table.write_json(file, [figure])
    before = table.read_json(file)
    assert before == {("a row", "s"): figure}
    rows = table.empty_table(compared=True)
    table.add_row(rows, Figure("a row", 1.0, None, "s"), before)
    table.add_row(rows, Figure("a new row", 1234.5, 6.78, "s"), before)
    cells = [list(column.cells) for column in rows.columns]
    assert cells[1] == ["1", "1234"] and cells[5] == ["2", ""] and cells[7] == ["0.50", ""]


def test_an_unknown_benchmark_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert app(["--only", "speed"], result_action="return_value") == 2
    assert "there is no benchmark speed; there are: ceilings, uniform" in capsys.readouterr().err


def test_akantus_side_needs_nothing_of_this_checkout() -> None:
    """It runs in an environment that holds Akantu, NumPy and no more."""
    imported = [
        name
        for node in ast.walk(ast.parse(versus_akantu.SCRIPT.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module])
    ]
    assert set(imported) == {"sys", "time", "akantu", "numpy"}


SLOW_PROGRAM = """
import sys, numpy
side, folder = int(sys.argv[1]), sys.argv[2]
assert numpy.load(folder + "/velocity.npy").shape == ((side + 1) ** 2, 2)
assert "finite_deformation = true" in open(folder + "/material.dat").read()
print("ready", flush=True)
for line in sys.stdin:
    print(int(line) * side**2 / 1000.0, 0.0, flush=True)
"""
"""Says that it updates 1000 elements a CPU second."""


def test_rates_are_those_that_either_side_reports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "slow.py").write_text(SLOW_PROGRAM)
    monkeypatch.setattr(versus_akantu, "SCRIPT", tmp_path / "slow.py")
    monkeypatch.setattr(versus_akantu, "UPDATES", 8000.0)
    theirs, ours, full = versus_akantu.rates(Path(sys.executable), 10, 3)
    assert theirs == pytest.approx(1000.0) and min(ours, full) > 1e4


def test_akantus_process_that_ends_early_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "empty.py").write_text("raise SystemExit(7)")
    monkeypatch.setattr(versus_akantu, "SCRIPT", tmp_path / "empty.py")
    with pytest.raises(RuntimeError, match="ended early, exit code 7"):
        versus_akantu.Worker(Path(sys.executable), 2, tmp_path, np.zeros((9, 2)))


def test_an_interpreter_without_akantus_wheel_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder whose Python runs but has no pip."""
    python = tmp_path / "bin" / "python"
    command = [sys.executable, "-m", "venv", "--without-pip", str(tmp_path)]
    subprocess.run(command, check=True)
    assert versus_akantu.compare([2], 1, tmp_path, python) == 2
    assert "a CPython for which it has a wheel" in capsys.readouterr().err
