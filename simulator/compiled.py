"""numba's `njit`, with a cache on disk that knows every file of which a function is made.

Before numba loads a compiled function it looks at that function's own file alone; what was inlined from other files
may have changed since, and the old numbers would come back to every digit. Here a function's name on disk also holds
a stamp: a hash over all of its files and over the versions of what compiles them. Another stamp is another name: what
was made of other text is not found, wherever numba keeps it, and is deleted. Any number of processes may start at
once; they save one after the other. Who keeps two environments beside one checkout compiles at each change of them.
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
_say, _tell = functools.cache(_log.warning), functools.cache(_log.info)  # once a process


def compiler(*sources: Path) -> Any:
    """Return a decorator like `numba.njit` for functions that are made of these files, their own among them.

    To be called before the others are imported: a file that is edited after that is noticed. Raises OSError for one
    that cannot be read.
    """
    stamp = _stamp(sources)

    class Files(CompileResultCacheImpl):
        def get_filename_base(self, fullname, abiflags):
            return f"{super().get_filename_base(fullname, abiflags)}.{stamp}"

    class Cache(FunctionCache):
        _impl_class = Files

        def load_overload(self, sig, target_context):
            if (found := super().load_overload(sig, target_context)) is None:
                _tell(COMPILING)
            return found

        def save_overload(self, sig, data):
            # A process that outlives an edit keeps to itself what it makes of the text before.
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
            _say("no folder to keep compiled functions in; each start compiles anew: set NUMBA_CACHE_DIR")
            return dispatcher
        dispatcher._cache = cache  # as njit(cache=True) does, with its own class
        file = Path(function.__code__.co_filename)
        _make_room(Path(cache.cache_path), file, stamp)
        return dispatcher

    return compiled


def _stamp(sources: tuple[Path, ...]) -> str:
    digest = hashlib.sha256("\0".join(VERSIONS).encode())
    for path in sources:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold other processes back from saving: numba reads its index, changes and writes it, and numbers files by it."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "softarm.lock").open("w") as lock:
        with suppress(OSError):  # a network's file system may know no locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield
        finally:
            with suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_UN)  # closing it is not enough where a fork has it too


@functools.cache
def _make_room(folder: Path, file: Path, stamp: str) -> None:
    """Delete what this Python once compiled of a file's functions under another stamp; say where they lie if afar."""
    python = f".py{sys.version_info.major}{sys.version_info.minor}"
    mine = [path for path in folder.glob(f"{file.stem}.*.nb[ic]") if python in path.name]
    kept = [path for path in mine if f".{stamp}." in path.name]
    for path in set(mine).difference(kept):
        path.unlink(missing_ok=True)
    if not kept and not numba.config.CACHE_DIR and folder != file.parent / "__pycache__":
        _say(f"{file.parent} cannot be written; its compiled functions are kept in {folder}")
