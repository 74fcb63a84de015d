"""Work on several cores, and how far it is: the one pool of processes, the one bar on the terminal."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

J = TypeVar("J")
R = TypeVar("R")
PATIENCE_S, LINE_S = 2.0, 10.0  # before the first, and between two lines of a bar that is no terminal's
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerDied(Exception):
    """A process of the pool was killed by somebody else."""


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0))


def as_they_come(work: Callable[[J], R], jobs: Sequence[J], processes: int, threads: int = 1) -> Iterator[tuple[J, R]]:
    """Each job and what `work` returned for it, the first to finish first; jobs begin in their order.

    With one process, or one job, in this process: no other is started. Else work, jobs and results are pickled, and a
    worker's numba and BLAS run on so many threads. Workers end with this process, and at once on Ctrl-C. Whoever
    stops listening, or hears an error, leaves no job behind that has not begun.

    Raises what `work` raises, and WorkerDied.
    """
    if processes == 1 or len(jobs) < 2:
        yield from ((job, work(job)) for job in jobs)
        return
    others = set(active_children())
    # A new interpreter each: threads of this one do not survive a fork.
    pool = ProcessPoolExecutor(min(processes, len(jobs)), get_context("spawn"), _begin)
    try:
        with _threads(threads):
            waiting = {pool.submit(work, job): job for job in jobs}
        for future in as_completed(waiting):
            yield waiting[future], future.result()
    except BrokenProcessPool:
        raise WorkerDied(
            "a worker process was killed, which is what a machine does that runs out of memory; "
            "start again with fewer processes"
        ) from None
    except KeyboardInterrupt:
        for worker in set(active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """In a worker, before its first job."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C reaches workers too: no traceback from each
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    """A worker whose pool was killed would wait for jobs for ever, or write where the next start writes too."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """For processes that begin meanwhile: numba and BLAS read these when they are first imported."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, str(count)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class _Lines:
    """What a bar shows, as lines: one after PATIENCE_S, then one in LINE_S at most, with the time that is left."""

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._say, self._clock = say, clock
        self._begun_s = clock()
        self._due_s = self._begun_s + PATIENCE_S
        self._newest: tuple[str, float | None] = ("", None)
        self._lock = threading.Lock()

    @contextmanager
    def patience(self) -> Iterator[None]:
        """Say the first line in time also where the work does not call back meanwhile."""
        first = threading.Timer(PATIENCE_S, lambda: self.say(*self._newest))
        first.daemon = True
        first.start()
        try:
            yield
        finally:
            first.cancel()

    def say(self, text: str, share: float | None) -> None:
        """share: of the whole work; None: not known."""
        with self._lock:
            self._newest = text, share
            now_s = self._clock()
            if now_s < self._due_s:
                return
            self._due_s = now_s + LINE_S
        if not share:
            self._say(f"{text} ...")
            return
        left_s = (now_s - self._begun_s) * (1.0 / min(share, 1.0) - 1.0)
        self._say(f"{text} ({100 * share:.0f} %, about {left_s:.0f} s left)")


class Bar:
    """How far a piece of work is."""

    def __init__(self, progress: "Progress", task: "TaskID", lines: "_Lines | None" = None) -> None:
        self._progress, self._task, self._lines = progress, task, lines

    def advance(self, by: float = 1, text: str | None = None) -> None:
        """So much more is done; text: what is being done."""
        self._progress.update(self._task, advance=by, description=text)
        self._say()

    def show(self, done: float | None = None, total: float | None = None, text: str | None = None) -> None:
        """What is given is shown from now on."""
        self._progress.update(self._task, completed=done, total=total, description=text)
        self._say()

    def _say(self) -> None:
        if self._lines is not None:
            task = self._progress.tasks[0]
            self._lines.say(task.description, task.completed / task.total if task.total else None)

    def tell(self, text: str, share: float) -> None:
        """What is being done, and how much of it all is: a bar of total 1.0 as long work calls it back."""
        self.show(share, text=text)

    def count(self, text: str, done: int, of: int) -> None:
        """The same for work that counts."""
        self.show(done, of, text)


@contextmanager
def bar(text: str, total: float | None = 1.0, *, done: float = 0, stay: bool = False) -> Iterator[Bar]:
    """A bar on standard error while this lasts; where that is no terminal a line after PATIENCE_S, and now and then.

    total: a whole number is counted (3/12), any other shown in percent; None: not known yet, to be counted. stay: leave
    the bar on the terminal at the end.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    figure = TaskProgressColumn() if isinstance(total, float) else MofNCompleteColumn()
    columns = (TextColumn("{task.description}"), BarColumn(), figure, TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=not stay, disable=not console.is_terminal) as progress:
        lines = _Lines(partial(print, file=sys.stderr, flush=True), time.monotonic)
        shown = Bar(progress, progress.add_task(text, total=total), lines if progress.disable else None)
        shown.advance(done)
        with lines.patience() if progress.disable else nullcontext():
            yield shown
