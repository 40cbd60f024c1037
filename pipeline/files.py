"""Files that are either complete or not there."""

from __future__ import annotations

import os
import secrets
from pathlib import Path


def write_atomically(path: Path, content: bytes | str, *, durable: bool = True) -> None:
    """Write a file so that no reader ever meets a part of it.

    The bytes go to a temporary name in the same folder, reach the disk, and take the final name in one step
    (POSIX ``rename``). Text is written as UTF-8. Where anything fails, the old file stays as it was, the
    temporary one is removed, and the error goes on to the caller.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    content : bytes or str
        Everything that it will hold.
    durable : bool
        Wait for the disk. Without that the file is whole for every reader, but a power cut may empty it until
        :func:`reach_disk`.

    Raises
    ------
    OSError
        Where the folder is missing or not writable, or the disk is full.
    """
    data = content.encode() if isinstance(content, str) else content
    part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    try:
        with open(part, "xb") as file:
            file.write(data)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def reach_disk(path: Path) -> None:
    """Wait until the disk holds what a file has in memory.

    Raises
    ------
    OSError
        Where the file is missing, or the disk cannot hold it.
    """
    with open(path, "rb+") as file:
        os.fsync(file.fileno())
