"""The same block in Akantu and in phantomnode, in turns, in one session.

Akantu (https://akantu.ch) is a finite element library in C++; from PyPI it comes compiled, for some versions
of CPython. Both sides: finite strain, plane strain, explicit central differences, lumped mass, as many bilinear
quadrilaterals. Akantu has 2 x 2 points in each and the St. Venant-Kirchhoff law; so phantomnode runs twice: as it
does by default, with one point and hourglass control, and with 2 x 2 points.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from .blocks import MATERIAL, uniform_block, waves
from .measure import Seconds, clocked, medians
from .stepping import started
from .table import number

SCRIPT = Path(__file__).with_name("akantu_block.py")

UPDATES, THEIRS = 60e6, 2e6
"""Element updates in one turn, of phantomnode and of Akantu: about a second each."""


def compare(sides: Sequence[int], repeats: int, folder: Path | None, interpreter: Path) -> int:
    """Print the table; 2 where Akantu cannot be installed."""
    table = Table(title="element updates per CPU second, phantomnode over Akantu")
    for name in ("cells", "Akantu, M/s", "phantomnode, M/s", "ratio", "2 x 2 points, M/s", "ratio"):
        table.add_column(name, justify="right")
    with ExitStack() as stack:
        where = folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        try:
            python, version = installed(where, interpreter)
        except subprocess.CalledProcessError as error:
            print(error.stderr, f"Akantu cannot be installed with {interpreter}", file=sys.stderr)
            print("give --interpreter, a CPython for which it has a wheel on PyPI", file=sys.stderr)
            return 2
        for side in sides:
            theirs, ours, full = rates(python, side, repeats)
            cells = [number(1e-6 * value) for value in (theirs, ours, full)]
            table.add_row(
                f"{side} x {side}",
                cells[0],
                cells[1],
                f"{ours / theirs:.0f}",
                cells[2],
                f"{full / theirs:.0f}",
            )
    table.caption = f"Akantu {version}; medians of {repeats} turns"
    Console().print(table)
    return 0


def installed(folder: Path, interpreter: Path) -> tuple[Path, str]:
    """Python of an environment with Akantu, made where it is not there yet, and Akantu's version.

    Raises
    ------
    subprocess.CalledProcessError
        Where pip finds no wheel, or nothing at all.
    """
    python = folder / "bin" / "python"

    def call(*command: str | Path) -> str:
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    if not python.exists():
        call(interpreter, "-I", "-m", "venv", folder)
        call(python, "-I", "-m", "pip", "install", "--only-binary", "akantu", "akantu")
    version = "import importlib.metadata as m; print(m.version('akantu'))"
    return python, call(python, "-I", "-c", version).strip()


def rates(python: Path, side: int, repeats: int) -> tuple[float, float, float]:
    """Element updates per CPU second: Akantu's, ours, ours with 2 x 2 points."""
    default = uniform_block(side)
    velocity = waves(default, side)
    ours = started(default, velocity)
    full = started(uniform_block(side, integration={"uncut": "full"}), velocity)
    steps, few = max(20, round(UPDATES / side**2)), max(2, round(THEIRS / side**2))
    turns: list[tuple[Seconds, Seconds, Seconds]] = []
    with tempfile.TemporaryDirectory() as folder, Worker(python, side, Path(folder), velocity) as theirs:
        for turn in range(repeats + 1):
            taken = (
                theirs.take(few),
                clocked(lambda: ours.take(steps)),
                clocked(lambda: full.take(steps // 4)),
            )
            turns += [taken] if turn else []  # the first one warms up
    work = np.array([few, steps, steps // 4]) * side**2
    first, second, third = (medians(column).cpu for column in zip(*turns, strict=True))
    return float(work[0] / first), float(work[1] / second), float(work[2] / third)


class Worker:
    """Akantu's process, which takes steps when told."""

    def __init__(self, python: Path, side: int, folder: Path, velocity: np.ndarray) -> None:
        law = "".join(f"  {name} = {value}\n" for name, value in MATERIAL.items())
        text = f"material elastic [\n  name = soft\n{law}  finite_deformation = true\n]\n"
        (folder / "material.dat").write_text(text)
        np.save(folder / "velocity.npy", velocity)
        command = [str(python), "-I", str(SCRIPT), str(side), str(folder)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if self._answer() != "ready":
            raise RuntimeError("Akantu's process said something else than that it is ready")

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.communicate()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"Akantu's process ended early, exit code {self._process.wait()}")
        return line.strip()

    def take(self, steps: int) -> Seconds:
        """Take steps; what they took."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{steps}\n")
        self._process.stdin.flush()
        cpu, wall = self._answer().split()
        return Seconds(float(cpu), float(wall))
