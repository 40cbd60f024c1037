"""The table of figures, and the file from which two of them are compared."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.table import Table

from .measure import Figure

FOOTNOTES = (
    "CPU: the value by the CPU clock of the process, all its threads; wall: by the wall clock. Medians; spread: "
    "(largest - smallest)/median of the CPU times.",
    "[a] CPU time of the same loop from the states at 10, 30, 50, 70 and 90 % of the run: with a step so short that "
    "nothing moves (the same forces in each step), then without contact, without cut elements, and without "
    'elements; the differences, over the time of the moving loop. "search, other" is what moving adds.',
)


def environment() -> dict[str, Any]:
    """What the figures depend on besides the code."""
    return {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "load": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        **{name: version(name) for name in ("phantomnode", "numba", "numpy")},
    }


def processor() -> str:
    """The name that Linux gives to the processor; elsewhere what Python knows."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def empty_table(compared: bool) -> Table:
    """The columns."""
    table = Table(title="phantomnode benchmarks", caption=caption(), caption_justify="left")
    table.add_column("benchmark", no_wrap=True)
    for name in ("CPU", "wall"):
        table.add_column(name, justify="right")
    table.add_column("unit", no_wrap=True)
    table.add_column("spread", justify="right")
    if compared:
        for name in ("CPU before", "wall before", "now/before"):
            table.add_column(name, justify="right")
    table.add_column("note")
    return table


def caption() -> str:
    """The footnotes below the machine."""
    machine = ", ".join(f"{name} {value}" for name, value in environment().items())
    return "\n".join((machine, *FOOTNOTES)).replace("[a]", r"\[a]")


def add_row(table: Table, figure: Figure, before: dict[tuple[str, str], Figure] | None) -> None:
    """One figure, beside that of an earlier run where there is one."""
    cells = [figure.name, number(figure.cpu), number(figure.wall), figure.unit]
    cells.append("" if figure.spread is None else f"{100.0 * figure.spread:.0f} %")
    if before is not None:
        old = before.get((figure.name, figure.unit))
        cells += [number(old.cpu), number(old.wall), ratio(figure, old)] if old else ["", "", ""]
    table.add_row(*cells, figure.note.replace("[a]", r"\[a]"))


def number(value: float | None) -> str:
    """Three digits that count, or nothing."""
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def ratio(now: Figure, before: Figure) -> str:
    """Now over before, by the CPU clock where there is one."""
    pairs = ((now.cpu, before.cpu), (now.wall, before.wall))
    return next((f"{new / old:.2f}" for new, old in pairs if new is not None and old), "")


def write_json(path: Path, figures: Iterable[Figure]) -> None:
    """The environment and all figures."""
    content = {"environment": environment(), "figures": [asdict(figure) for figure in figures]}
    path.write_text(json.dumps(content, indent=1) + "\n")


def read_json(path: Path) -> dict[tuple[str, str], Figure]:
    """The figures of an earlier run by name and unit."""
    figures = (Figure(**entry) for entry in json.loads(path.read_text())["figures"])
    return {(figure.name, figure.unit): figure for figure in figures}
