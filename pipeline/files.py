"""Files that are either complete or not there."""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
from pathlib import Path

from phantomnode.pipeline.errors import CaseError

AS_IT_IS = getattr(os, "O_BINARY", 0)
"""Windows would change ends of lines."""


class WriteError(OSError):
    """A result cannot be written; the text says which, why, and what to do."""

    def __init__(self, error: OSError, advice: str = "") -> None:
        super().__init__(error.errno, error.strerror or str(error), error.filename)
        self.advice = advice

    def __str__(self) -> str:
        where = f"{self.filename}: " if self.filename else ""
        return f"{where}{self.strerror}{f'; {self.advice}' if self.advice else ''}"


def write_atomically(path: Path, content: bytes | memoryview | str, *, durable: bool = True) -> None:
    """Write a file so that no reader ever meets a part of it.

    The bytes go to a temporary name in the same folder, reach the disk, and take the final name in one step
    (POSIX ``rename``). Text is written as UTF-8. Where anything fails, the old file stays as it was, the
    temporary one is removed, and the error goes on to the caller.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    content : bytes, memoryview or str
        Everything that it will hold.
    durable : bool
        Wait for the disk. Without that the file is whole for every reader, but a power cut may empty it until
        :func:`reach_disk`.

    Raises
    ------
    OSError
        Where the folder is missing or not writable, or the disk is full; it names the file.
    """
    data = content.encode() if isinstance(content, str) else content
    part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    try:
        handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | AS_IT_IS, 0o666)
        try:
            write_all(handle, data)
            if durable:
                os.fsync(handle)
        finally:
            os.close(handle)
        os.replace(part, path)
        if durable:
            _folder_reaches_disk(path.parent)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise _about(error, path) from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_all(handle: int, data: bytes | memoryview) -> None:
    """Write all bytes to a file; a disk that takes a part of them only is full."""
    left = memoryview(data)
    while left:
        taken = os.write(handle, left)
        if taken == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        left = left[taken:]


def reach_disk(path: Path) -> None:
    """Wait until the disk holds what a file has in memory, and its name.

    Raises
    ------
    OSError
        Where the file is missing, or the disk cannot hold it.
    """
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        raise _about(error, path) from error
    finally:
        os.close(handle)
    _folder_reaches_disk(path.parent)


def _folder_reaches_disk(folder: Path) -> None:
    """The names in a folder survive a power cut, where the system knows that (POSIX)."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _about(error: OSError, path: Path) -> OSError:
    """The same error, of the file as its reader knows it."""
    return type(error)(error.errno, error.strerror, str(path))


class GrowingFile:
    """A file to which whole pieces are added: after a failure it ends with the last whole one.

    Parameters
    ----------
    path : Path
    content : bytes
        What it begins with.
    there : bool
        The file is there and begins so: go on behind that, and drop what follows.

    Attributes
    ----------
    size : int
        Bytes so far.
    """

    def __init__(self, path: Path, content: bytes, *, there: bool = False) -> None:
        self.path, self.size = path, len(content)
        self._digest = hashlib.sha256(content)
        if not there:
            write_atomically(path, content)
        self._handle = os.open(path, os.O_RDWR | AS_IT_IS)
        os.ftruncate(self._handle, self.size)
        os.lseek(self._handle, self.size, os.SEEK_SET)

    @property
    def sha256(self) -> str:
        """SHA-256 of the bytes so far, as hexadecimal digits."""
        return self._digest.hexdigest()

    def add(self, piece: bytes) -> None:
        """Write a piece; readers see it at once."""
        try:
            write_all(self._handle, piece)
        except BaseException as error:
            os.ftruncate(self._handle, self.size)
            os.lseek(self._handle, self.size, os.SEEK_SET)
            if isinstance(error, OSError):
                raise _about(error, self.path) from error
            raise
        self.size += len(piece)
        self._digest.update(piece)

    def reach_disk(self) -> None:
        """Wait until the disk holds what was written."""
        try:
            os.fsync(self._handle)
        except OSError as error:
            raise _about(error, self.path) from error

    def close(self) -> None:
        """Give the file back; closing twice is fine."""
        if self._handle >= 0:
            os.close(self._handle)
        self._handle = -1


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove_parts(folder: Path) -> None:
    """Remove the temporary files that a killed process left in a folder."""
    for part in folder.glob(".*.part"):
        part.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make a folder, with its parents, unless it is there.

    Raises
    ------
    CaseError
        If a file is in the way.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise CaseError(
            f"{folder}: this is a file, or lies under one; choose another results folder"
        ) from None
