"""Files that are either complete or not there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def write_atomically(path: Path, content: bytes | str) -> None:
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

    Raises
    ------
    OSError
        Where the folder is missing or not writable, or the disk is full.
    """
    data = content.encode() if isinstance(content, str) else content
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o666 & ~_umask())  # mkstemp makes it private
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _umask() -> int:
    """The permissions that new files are denied; reading them needs a write and a write back."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
