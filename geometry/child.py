"""A child process that reads one file, and is waited for no longer than agreed."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from phantomnode.geometry.errors import GeometryError, NoUnitError


class Child:
    """:mod:`phantomnode.geometry.reading_child` at work on the content of a file.

    It runs in an empty directory of its own, within limits of memory and time. ``end`` must be called.
    """

    def __init__(self, request: dict[str, Any], content: bytes, time_limit: float) -> None:
        self._token, self._time_limit = secrets.token_hex(16), time_limit
        self._folder = tempfile.TemporaryDirectory(prefix="phantomnode-", ignore_cleanup_errors=True)
        self._answer = Path(self._folder.name, "answer.json")
        source = Path(self._folder.name, "content")
        arguments = [json.dumps(request), source.name, self._answer.name, self._token, f"{time_limit!r}"]
        try:
            source.write_bytes(content)
            self._process = _started(arguments, self._folder.name)
        except OSError:
            self._folder.cleanup()
            raise

    def answer(self) -> Any:
        """What it answers, within the time limit from now on.

        Raises
        ------
        GeometryError
            With its reason, or with what became of it.
        """
        try:
            said = self._process.communicate(timeout=self._time_limit)[1]
        except subprocess.TimeoutExpired:
            raise GeometryError(
                f"reading it took more than {self._time_limit:g} s (a looping script, a damaged file, or a very "
                "large part); simplify it or allow it more (time_limit, --time-limit)"
            ) from None
        text = self._answer.read_text(encoding="utf-8") if self._answer.exists() else ""
        if not text.endswith(self._token):
            raise GeometryError(_what_happened(self._process.returncode, said.decode(errors="replace")))
        answer: dict[str, Any] = json.loads(text.removesuffix(self._token))
        if "error" in answer:
            kind = NoUnitError if answer.get("kind") == NoUnitError.__name__ else GeometryError
            raise kind(answer["error"])
        return answer["result"]

    def end(self) -> None:
        """End it where it still runs, on POSIX with whatever it started, and remove its directory."""
        if self._process.poll() is None:
            with suppress(ProcessLookupError, PermissionError):  # where it has ended meanwhile
                _kill(self._process)
        self._process.wait()
        if self._process.stderr is not None:
            self._process.stderr.close()
        self._folder.cleanup()


def _kill(process: subprocess.Popen[bytes]) -> None:
    if os.name == "posix":
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()


def _started(arguments: list[str], folder: str) -> subprocess.Popen[bytes]:
    """The child, in its directory."""
    # -P: nothing in the directory of the file can stand in for a module.
    command = [sys.executable, "-P", "-m", "phantomnode.geometry.reading_child", *arguments]
    environment = {**os.environ, "HOME": folder, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def _what_happened(status: int, said: str) -> str:
    """Why a child ended without a result, in words."""
    if status == 0:
        return "the reader ended while reading it without a result (a script that calls Exit?)"
    reason = signal.Signals(-status).name if status < 0 else f"exit code {status}"
    said = said.strip()[-300:]
    return f"the reader broke down ({reason}): the file is damaged, or needs too much memory. {said}".strip()
