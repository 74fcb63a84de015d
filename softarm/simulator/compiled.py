"""numba's `njit`, with a cache on disk that checks every source file of a function.

Before numba loads a compiled function it checks only that function's own file. A function that was inlined from
another file may have changed since, and the old code would run. Here a function's name on disk also holds a stamp: a
hash of all source files and of the compiler's versions. Functions with another stamp are not found and are deleted.
Any number of processes may start at once; they save one after the other. Two environments that share one checkout
compile again at each change between them.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, allow-subclassing-any
import fcntl
import functools
import hashlib
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache

VERSIONS = (sys.version, numba.__version__, llvmlite.__version__, np.__version__)
COMPILING = "compiling the simulator for this machine: once, for about half a minute ..."
_log = logging.getLogger(__name__)
# Each message once a process.
_warn_once, _inform_once = functools.cache(_log.warning), functools.cache(_log.info)


def compiler(*sources: Path) -> Any:
    """Return a decorator like `numba.njit` for functions that depend on these files, including their own.

    Call it before the other files are imported, so that a later edit is noticed. Raises OSError for a file that cannot
    be read.
    """
    stamp = _stamp(sources)

    class Files(CompileResultCacheImpl):
        def get_filename_base(self, fullname, abiflags):
            return f"{super().get_filename_base(fullname, abiflags)}.{stamp}"

    class Cache(FunctionCache):
        _impl_class = Files

        def load_overload(self, sig, target_context):
            if (found := super().load_overload(sig, target_context)) is None:
                _inform_once(COMPILING)
            return found

        def save_overload(self, sig, data):
            # A process that started before an edit does not save the old code.
            if _stamp(sources) == stamp:
                with _alone(Path(self.cache_path)):
                    super().save_overload(sig, data)

    def compiled(function=None, **options):
        if function is None:
            return functools.partial(compiled, **options)
        dispatcher = numba.njit(**options)(function)
        try:
            cache = Cache(function)
        except RuntimeError:  # numba finds no folder that it may write
            _warn_once("no folder for compiled functions; each start compiles again: set NUMBA_CACHE_DIR")
            return dispatcher
        dispatcher._cache = cache  # as njit(cache=True) does, with its own class
        file = Path(function.__code__.co_filename)
        _delete_stale(Path(cache.cache_path), file, stamp)
        return dispatcher

    return compiled


def _stamp(sources: tuple[Path, ...]) -> str:
    digest = hashlib.sha256("\0".join(VERSIONS).encode())
    for path in sources:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Lock the cache: numba reads its index, changes and writes it, and numbers files by it."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "softarm.lock").open("w") as lock:
        with suppress(OSError):  # a network file system may not support locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield
        finally:
            with suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_UN)  # closing is not enough if a fork also has it open


@functools.cache
def _delete_stale(folder: Path, file: Path, stamp: str) -> None:
    """Delete this Python's compiled functions of a file with another stamp; warn if the cache is elsewhere."""
    python = f".py{sys.version_info.major}{sys.version_info.minor}"
    mine = [path for path in folder.glob(f"{file.stem}.*.nb[ic]") if python in path.name]
    kept = [path for path in mine if f".{stamp}." in path.name]
    for path in set(mine).difference(kept):
        path.unlink(missing_ok=True)
    if not kept and not numba.config.CACHE_DIR and folder != file.parent / "__pycache__":
        _warn_once(f"{file.parent} cannot be written; its compiled functions are kept in {folder}")
