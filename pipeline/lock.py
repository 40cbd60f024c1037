"""One run a folder: a lock that the death of its process releases."""

from __future__ import annotations

import errno
import json
import os
import platform
from pathlib import Path
from types import TracebackType
from typing import Any

from phantomnode.pipeline.errors import CaseError

try:
    import fcntl
except ImportError:  # Windows: the file alone is the lock
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
UNSUPPORTED = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL)
"""What a file system says that knows no locks."""


class FolderLock:
    """Holds a results folder while a run writes to it.

    The lock is that of the system (``flock``) on a file that names its owner: it ends with the process, however
    that ends, so that a file left by one that was killed on this machine stands in nobody's way. Of a process on
    another machine, or where the file system knows no locks, only the file can tell.

    Parameters
    ----------
    folder : Path
        It must exist.

    Raises
    ------
    CaseError
        Where another run holds the folder.
    OSError
        Where the lock cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        self.taken_over = False
        self._handle = -1
        while self._handle < 0:
            self._handle = self._take()

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._path.unlink(missing_ok=True)
        os.close(self._handle)

    def _take(self) -> int:
        """A handle on the locked file; -1 where its owner has just removed it."""
        handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _lock(handle, self._path) or not _is(handle, self._path):
                os.close(handle)
                return -1
            owner = _owner(os.read(handle, 4096))
            if owner and owner.get("machine") != platform.node():
                raise _held(self._path, owner)
            self.taken_over = bool(owner)
            os.ftruncate(handle, 0)
            os.lseek(handle, 0, os.SEEK_SET)
            os.write(handle, json.dumps({"machine": platform.node(), "process": os.getpid()}).encode())
        except BaseException:
            os.close(handle)
            raise
        return handle


def is_locked(folder: Path) -> bool:
    """Whether a run is at work in a folder, as far as can be told now."""
    try:
        handle = os.open(folder / LOCK, os.O_RDWR)
    except FileNotFoundError:
        return False
    try:
        owner = _owner(os.read(handle, 4096))
        return not _lock(handle, folder / LOCK) or (bool(owner) and owner.get("machine") != platform.node())
    except CaseError:
        return True
    finally:
        os.close(handle)


def _lock(handle: int, path: Path) -> bool:
    """Lock a file.

    Raises
    ------
    CaseError
        Where another process has it.
    """
    if fcntl is not None:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            raise _held(path, _owner(os.pread(handle, 4096, 0))) from None
        except OSError as error:
            if error.errno not in UNSUPPORTED:
                raise
    if owner := _owner(path.read_bytes()):
        raise _held(path, owner)
    return True


def _is(handle: int, path: Path) -> bool:
    """Whether a file has still its name: its owner may have removed it before this process got it."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


def _owner(content: bytes) -> dict[str, Any]:
    """Machine and process in a lock; empty where there is nothing or half of it."""
    try:
        owner = json.loads(content or b"{}")
    except ValueError:
        return {}
    return owner if isinstance(owner, dict) else {}


def _held(path: Path, owner: dict[str, Any]) -> CaseError:
    who = f"process {owner.get('process', '?')} on {owner.get('machine', '?')}"
    return CaseError(
        f"{path.parent}: another run is at work in this folder ({who}); wait for it, or take another --out. If "
        f"that process is gone for certain, remove {path}"
    )
