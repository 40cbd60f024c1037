"""``python -m tests.benchmarks``, and ``python -m tests.benchmarks akantu``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter
from cyclopts.types import ExistingFile
from cyclopts.validators import Number
from rich.console import Console
from rich.live import Live

from . import table, versus_akantu
from .measure import Figure, Plan
from .registry import BENCHMARKS

Repeats = Annotated[int, Parameter(validator=Number(gte=1))]

app = App(name="python -m tests.benchmarks", help=__doc__, version_flags=())


@app.default
def everything(
    *,
    only: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative=())] = (),
    repeats: Repeats = 5,
    json: Path | None = None,
    against: ExistingFile | None = None,
) -> int:
    """Print the table of the product's own speed.

    Parameters
    ----------
    only
        Some of the benchmarks, by name; the order is theirs.
    repeats
        Runs of which the median is taken; of whole processes at most 3.
    json
        Write the figures to this file, one by one.
    against
        Show beside them those of such a file.
    """
    unknown = sorted(set(only) - set(BENCHMARKS))
    if unknown:
        print(
            f"there is no benchmark {', '.join(unknown)}; there are: {', '.join(BENCHMARKS)}", file=sys.stderr
        )
        return 2
    before = table.read_json(against) if against else None
    rows, figures = table.empty_table(compared=before is not None), list[Figure]()
    with Live(rows, console=Console(width=None if sys.stdout.isatty() else 160), auto_refresh=False) as live:
        for name, function in BENCHMARKS.items():
            if only and name not in only:
                continue
            for figure in function(Plan(repeats)):
                figures.append(figure)
                table.add_row(rows, figure, before)
                live.refresh()
                if json:
                    table.write_json(json, figures)
    return 0


@app.command(name="akantu")
def against_akantu(
    *,
    side: Annotated[tuple[int, ...], Parameter(consume_multiple=True, negative=())] = (100, 500),
    repeats: Repeats = 5,
    folder: Path | None = None,
    interpreter: Path = Path(sys.executable),
) -> int:
    """Install Akantu in an environment of its own, time the same blocks in turns, print the ratios.

    Parameters
    ----------
    side
        Cells along the side of each block.
    repeats
        Turns of which the median is taken.
    folder
        Where the environment is made, or was made before; a temporary folder unless given.
    interpreter
        A CPython for which Akantu has a wheel.
    """
    return versus_akantu.compare(side, repeats, folder, interpreter)


if __name__ == "__main__":
    sys.exit(app())
