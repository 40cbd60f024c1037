"""run.log: what was run, what it became, what was said on the way, how it ended."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.preflight import text_report
from phantomnode.pipeline.prepare import Prepared
from phantomnode.pipeline.summary import Summary, verdict_lines

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame


class RunLog:
    """The log of a run; a run that goes on adds to it.

    Parameters
    ----------
    path : Path
    prepared : Prepared
    command : sequence of str
        The command line.
    notes : sequence of str
        What was said before the first step.
    resumed : Frame or None
        Where the run goes on.
    """

    def __init__(
        self,
        path: Path,
        prepared: Prepared,
        command: Sequence[str],
        notes: Sequence[str] = (),
        resumed: Frame | None = None,
    ) -> None:
        from phantomnode import __version__

        self._path = path
        begun = path.read_text(encoding="utf-8").splitlines() if resumed and path.is_file() else []
        said = [f"command: {shlex.join(command)}"] if command else []
        if begun:
            self._lines = [*begun, "", *said, *notes]
        else:
            self._lines = [
                f"phantomnode {__version__}",
                *said,
                f"case: {prepared.case.name}: {prepared.case.title}".rstrip(": "),
                "",
                *(line.rstrip() for line in text_report(prepared).splitlines()),
                *(f"{body.name}: {body.relocated} grid nodes relocated" for body in prepared.bodies),
                *notes,
                "",
            ]
        self._write()

    def add(self, line: str) -> None:
        """Add what is said on the way."""
        self._lines.append(line)
        self._write()

    def close(self, summary: Summary) -> None:
        """Add how the run ended."""
        self._lines += verdict_lines(summary)
        self._write()

    def _write(self) -> None:
        write_atomically(self._path, "\n".join(self._lines) + "\n")
