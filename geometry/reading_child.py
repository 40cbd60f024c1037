"""Reads one file in a process of its own: ``python -m phantomnode.geometry.reading_child``.

Arguments: request (JSON: what to "read" and what is "wanted" of it), file, file for the answer,
token, seconds. The answer is JSON followed by the token, which says that it is whole and written here.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from phantomnode.geometry import reading, wire
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.limits import ADDRESS_SPACE, bound, let_write


def main(arguments: list[str]) -> None:
    """Read the file and write the result, or the reason why there is none."""
    request, source, target, token, seconds = json.loads(arguments[0]), *arguments[1:4], float(arguments[4])
    content = Path(source).read_bytes()
    bound(seconds)
    try:
        answer = {"result": _read(request, content, seconds)}
    except GeometryError as error:
        answer = {"error": str(error), "kind": type(error).__name__}
    except MemoryError:
        answer = {"error": f"reading it needs more than {ADDRESS_SPACE >> 30} GB of memory; simplify it"}
    let_write()
    Path(target).write_text(json.dumps(answer) + token, encoding="utf-8")


def _read(request: dict[str, Any], content: bytes, seconds: float) -> Any:
    """What is asked for, as JSON takes it."""
    if request["read"] == "quads":
        return reading.quads(content, request["wanted"]["unit"])
    # A reader that watches its time can say what takes it before the one that asks gives up.
    return wire.encoded(reading.geometry(content, request["wanted"], 0.7 * seconds))


if __name__ == "__main__":
    main(sys.argv[1:])
