"""What a process that reads a foreign file may use, where the system can hold it to that (POSIX)."""

from __future__ import annotations

import os

TIME_LIMIT = 30.0
"""Seconds after which reading a file is given up, unless told otherwise."""

LONGEST = 86400.0
"""Seconds that can be allowed."""

ADDRESS_SPACE = 4 << 30
"""Bytes of memory: a planar drawing needs a hundredth of it."""

FILE_SIZE = 1 << 30
"""Bytes of any file written."""


def bound(seconds: float) -> None:
    """Bound memory, processor time and the size of files written."""
    if os.name != "posix":
        return
    import resource

    _set(resource.RLIMIT_AS, ADDRESS_SPACE)
    _set(resource.RLIMIT_CPU, int(seconds) + 2)
    _set(resource.RLIMIT_CORE, 0)
    let_write()


def forbid() -> None:
    """Let nothing be written or started from here on; a second wall behind :mod:`phantomnode.geometry.scripts`."""
    if os.name != "posix":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))  # root is exempt


def let_write() -> None:
    """Let files be written again, of bounded size."""
    if os.name != "posix":
        return
    import resource

    _set(resource.RLIMIT_FSIZE, FILE_SIZE)


def _set(what: int, most: int) -> None:
    """Set a limit, no higher than it may be."""
    import resource

    hard = resource.getrlimit(what)[1]
    resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
