"""One run a folder: a lock that the death of its process releases."""

from __future__ import annotations

import errno
import json
import os
import platform
import re
import shlex
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
ONE_MACHINE = frozenset(
    {"bcachefs", "btrfs", "ext2", "ext3", "ext4", "f2fs", "jfs", "overlay", "ramfs", "tmpfs", "xfs", "zfs"}
)
"""File systems of one kernel: who else sees them, as a container of another name does, sees their locks."""
NETWORK = frozenset({"nfs", "nfs4"})
"""File systems whose server keeps the locks of all machines, unless mounted otherwise."""


class FolderLock:
    """Holds a results folder while a run writes to it.

    The lock is that of the system (``flock``) on a file that names its owner: it ends with the process, however
    that ends, so that a file left by one that was killed stands in nobody's way. Only where the file system is not
    known to show the locks of other machines, or knows none, a file of another machine is believed.

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
            if _unseen(owner, self._path):
                raise _left(self._path, owner)
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
        return not _lock(handle, folder / LOCK) or _unseen(owner, folder / LOCK)
    except CaseError:
        return True
    finally:
        os.close(handle)


def _lock(handle: int, path: Path) -> bool:
    """Lock a file; where the file system knows no locks, look whether its owner lives.

    Raises
    ------
    CaseError
        Where another process has it, or may have it.
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
    owner = _owner(path.read_bytes())
    if owner.get("machine") == platform.node() and _lives(owner):
        raise _held(path, owner)
    if owner and owner.get("machine") != platform.node():
        raise _left(path, owner)
    return True


def _lives(owner: dict[str, Any]) -> bool:
    """Whether there is a process of that number on this machine."""
    try:
        os.kill(int(owner.get("process", 0)), 0)
    except (ProcessLookupError, ValueError):
        return False
    except PermissionError:
        pass
    return True


def _unseen(owner: dict[str, Any], path: Path) -> bool:
    """Whether a lock may be held by a process on another machine, although this one was given it."""
    return bool(owner) and owner.get("machine") != platform.node() and not _all_see(*file_system(path))


def _all_see(kind: str, options: set[str]) -> bool:
    """Whether all machines that see a file system see its locks."""
    own = {"nolock", "local_lock=flock", "local_lock=all"}
    return kind in ONE_MACHINE or (kind in NETWORK and not options & own)


def file_system(path: Path) -> tuple[str, set[str]]:
    """The kind of file system that a file is on, as "nfs4", and how it is mounted; nothing outside Linux."""
    try:
        lines = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return "", set()
    found, longest, place = ("", set[str]()), -1, path.resolve()
    for (
        line
    ) in lines:  # 36 35 98:0 / /home rw,noatime shared:1 - nfs4 server:/home rw,vers=4.2,local_lock=none
        mount, source = (part.split() for part in line.split(" - ", 1))
        at = Path(re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), mount[4]))
        if (
            place.is_relative_to(at) and len(at.parts) >= longest
        ):  # of two at one place, the later one is on top
            found, longest = (source[0], {*mount[5].split(","), *source[-1].split(",")}), len(at.parts)
    return found


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
        f"{path.parent}: another run is at work in this folder ({who}); wait for it, or take another --out"
    )


def _left(path: Path, owner: dict[str, Any]) -> CaseError:
    """The lock of another machine, of which it cannot be told whether it holds."""
    process, machine, kind = owner.get("process", "?"), owner.get("machine", "?"), file_system(path)[0]
    on = f"a file system of kind {kind}" if kind else "this file system"
    return CaseError(
        f"{path.parent}: process {process} on {machine} runs in this folder, or was killed in it; on {on} that "
        f"cannot be seen from here. Look on {machine}: ps -p {process}. If the process is there, wait for it, "
        f"or take another --out; if it is not, rm {shlex.quote(str(path))} and start again"
    )
