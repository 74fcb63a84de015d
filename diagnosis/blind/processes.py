"""Many cases on several cores, one core each."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, TypeVar

R = TypeVar("R")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def as_they_come(work: Callable[..., R], jobs: Sequence[tuple[Any, ...]], processes: int) -> Iterator[R]:
    """What `work` returns for the arguments of each job, the first to finish first; with one process, in this one.

    Whoever stops listening leaves no job behind that has not begun.
    """
    if processes == 1 or len(jobs) < 2:
        yield from (work(*job) for job in jobs)
        return
    # A new interpreter each: threads of this one do not survive a fork.
    with _one_thread(), ProcessPoolExecutor(min(processes, len(jobs)), get_context("spawn")) as pool:
        pending = [pool.submit(work, *job) for job in jobs]
        try:
            for future in as_completed(pending):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _one_thread() -> Iterator[None]:
    """For processes that begin meanwhile: numba and BLAS read these when they are first imported."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
