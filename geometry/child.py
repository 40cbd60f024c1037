"""Asks a child process to read a file, and waits no longer than agreed."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from phantomnode.geometry.errors import GeometryError, NoUnitError


def ask(request: dict[str, Any], content: bytes, time_limit: float) -> Any:
    """What :mod:`phantomnode.geometry.reading_child` answers about the content of a file.

    It runs in an empty directory of its own, within limits of memory and time.

    Raises
    ------
    GeometryError
        With its reason, or with what became of it.
    """
    token = secrets.token_hex(16)
    with tempfile.TemporaryDirectory(prefix="phantomnode-", ignore_cleanup_errors=True) as folder:
        source, target = Path(folder, "content"), Path(folder, "answer.json")
        source.write_bytes(content)
        arguments = [json.dumps(request), source.name, target.name, token, f"{time_limit!r}"]
        status, said = _finish(arguments, folder, time_limit)
        text = target.read_text(encoding="utf-8") if target.exists() else ""
    if not text.endswith(token):
        raise GeometryError(_what_happened(status, said))
    answer: dict[str, Any] = json.loads(text.removesuffix(token))
    if "error" in answer:
        kind = NoUnitError if answer.get("kind") == NoUnitError.__name__ else GeometryError
        raise kind(answer["error"])
    return answer["result"]


def _finish(arguments: list[str], folder: str, time_limit: float) -> tuple[int, str]:
    """Run the child to its end or to the time limit: its exit status and the end of what it said."""
    # -P: nothing in the directory of the file can stand in for a module.
    command = [sys.executable, "-P", "-m", "phantomnode.geometry.reading_child", *arguments]
    environment = {**os.environ, "HOME": folder, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    try:
        said = process.communicate(timeout=time_limit)[1]
    except subprocess.TimeoutExpired:
        raise GeometryError(
            f"reading it took more than {time_limit:g} s (a looping script, a damaged file, or a very large part); "
            "simplify it or give a larger time_limit"
        ) from None
    finally:
        _kill(process)
    return process.returncode, said.decode(errors="replace").strip()[-300:]


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End the child, and on POSIX whatever it started."""
    if process.poll() is None:
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()


def _what_happened(status: int, said: str) -> str:
    """Why a child ended without a result, in words."""
    if status == 0:
        return "the reader ended while reading it without a result (a script that calls Exit?)"
    reason = signal.Signals(-status).name if status < 0 else f"exit code {status}"
    return f"the reader broke down ({reason}): the file is damaged, or needs too much memory. {said}".strip()
