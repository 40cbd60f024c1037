"""Compiled kernels, kept between runs: ``@kernel`` in place of numba's ``@njit(cache=True)``.

Numba's own cache knows a kernel by its own file only, and so keeps it when a callee in another file changes; a
truncated file ends every later start; and two processes that fill it at once can take the same file for two
signatures. Here every compiled signature has a file of its own, named by all that it depends on::

    CACHE/phantomnode/KEY/MODULE.NAME.SIGNATURE.kernel

KEY stands for the sources of the kernel's whole package and the versions of Python, numba, llvmlite and numpy;
SIGNATURE for the types of the arguments and the processor. A file begins with the SHA-256 of the rest: a broken one
is known before it is used, and written anew. CACHE is ``NUMBA_CACHE_DIR``, or the user's folder for caches; never
the package itself, which may be read-only, shared, or about to be replaced.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, overload

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

Function = TypeVar("Function", bound=Callable[..., Any])

UNUSED = 7 * 24 * 3600.0
"""Folders of other versions that no process has used for so long are removed, s."""

PARALLEL = b"numba_parallel_for"
"""What a kernel with parallel loops calls, and one with a callee that has them. Numba knows the name once its threads
are started. It starts them where it compiles such a loop or loads one that it compiled; but not where it loads a
caller that was compiled with a callee from a file: that would end in a jump to nowhere."""

KEY = re.compile("[0-9a-f]{16}")


@overload
def kernel(function: Function, /) -> Function: ...
@overload
def kernel(**options: Any) -> Callable[[Function], Function]: ...
def kernel(function: Any = None, /, **options: Any) -> Any:
    """Compile a function without Python objects, with NumPy's rules of division, and keep the result.

    With ``NUMBA_DISABLE_JIT`` the function stays as it is.

    Parameters
    ----------
    function : callable
    **options
        Those of ``numba.njit``, such as ``inline`` and ``nogil``.
    """
    if function is None:
        return lambda function: kernel(function, **options)
    compiled = numba.njit(error_model="numpy", **options)(function)  # noqa: TID251
    if not config.DISABLE_JIT:
        compiled._cache = KernelCache(function)
    return compiled


class KernelCache(NullCache):  # type: ignore[misc]
    """The files of one kernel, as a dispatcher of numba asks for them."""

    def __init__(self, function: Callable[..., Any]) -> None:
        code = function.__code__
        self._package = Path(code.co_filename).parent
        self._name = f"{Path(code.co_filename).stem}.{function.__name__}"
        self._line = code.co_firstlineno

    @property
    def cache_path(self) -> str:
        """The folder of the files."""
        return str(self._folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel for the types of its arguments; None where it must be compiled."""
        target_context.refresh()
        _mark_used(self._folder)
        content = read_checked(self._file(sig, target_context.codegen()))
        if content is None:
            return None
        if PARALLEL in content:
            numba.get_num_threads()  # starts them
        return CompileResult._rebuild(target_context, *pickle.loads(content))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel; where that is impossible, say so and go on."""
        if data.library.has_dynamic_globals:
            raise TypeError(f"{self._name} cannot be kept: it uses a large global array or a pointer")
        try:
            if not self._folder.is_dir():
                self._folder.mkdir(parents=True, exist_ok=True)
                remove_unused(self._folder)
            write_checked(self._file(sig, data.codegen), dumps(data._reduce()))
        except OSError as error:
            _warn_not_kept(str(error))

    @property
    def _folder(self) -> Path:
        return cache_folder() / package_key(self._package)

    def _file(self, sig: Any, codegen: Any) -> Path:
        """The file for a signature on a processor."""
        what = repr((self._line, sig, codegen.magic_tuple())).encode()
        return self._folder / f"{self._name}.{hashlib.sha256(what).hexdigest()[:16]}.kernel"


def cache_folder() -> Path:
    """The folder of all compiled kernels, whether it is there or not."""
    home = Path(os.path.expanduser("~"))
    if config.CACHE_DIR:
        parent = Path(config.CACHE_DIR)
    elif sys.platform == "win32":
        parent = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        parent = home / "Library" / "Caches"
    else:
        given = Path(os.environ.get("XDG_CACHE_HOME") or "")
        parent = given if given.is_absolute() else home / ".cache"
    return parent / "phantomnode"


def kept(package: str) -> bool:
    """Whether kernels of a package, as it is now, were compiled before; they may be some of them only."""
    spec = find_spec(package)
    if config.DISABLE_JIT or spec is None or spec.origin is None:
        return True
    return (cache_folder() / package_key(Path(spec.origin).parent)).is_dir()


@lru_cache
def package_key(package: Path) -> str:
    """16 hexadecimal digits for the sources in a folder and for what compiles them."""
    versions = sys.version, numba.__version__, llvmlite.__version__, np.__version__
    digest = hashlib.sha256(repr(versions).encode())
    for source in sorted(package.glob("*.py")):
        content = source.read_bytes()
        digest.update(f"{source.name} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def write_checked(path: Path, content: bytes) -> None:
    """Write a file with its digest, in one step for readers; its folder must exist.

    It need not reach the disk at once: what a power cut leaves of it is known as broken.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(content).digest() + content)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def read_checked(path: Path) -> bytes | None:
    """What :func:`write_checked` wrote; None where there is no such file, or a broken or unreadable one."""
    try:
        whole = path.read_bytes()
    except OSError:  # whatever it is, writing the file anew will meet it again and tell
        return None
    digest, content = whole[:32], whole[32:]
    return content if hashlib.sha256(content).digest() == digest else None


def remove_unused(folder: Path) -> None:
    """Remove the folders beside this one that hold kernels of other versions and have long been unused.

    A process that still runs from one of them compiles again what it finds missing.
    """
    for other in folder.parent.iterdir():
        if KEY.fullmatch(other.name) and other != folder:
            with suppress(FileNotFoundError):  # another process was quicker
                if time.time() - other.stat().st_mtime > UNUSED:
                    shutil.rmtree(other, ignore_errors=True)


@lru_cache
def _warn_not_kept(error: str) -> None:
    """Say once what is wrong with the folder; numba makes Python forget that it has shown a warning."""
    warnings.warn(
        f"compiled kernels cannot be kept, so every start compiles them: {error}; name a writable folder in "
        "NUMBA_CACHE_DIR",
        RuntimeWarning,
        stacklevel=2,
    )


@lru_cache
def _mark_used(folder: Path) -> None:
    """Date a folder, once a process; one that is not there, or not ours, needs no date."""
    with suppress(OSError):
        os.utime(folder)
