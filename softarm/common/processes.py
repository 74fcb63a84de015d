"""Process pool and progress bar."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import timedelta
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

J = TypeVar("J")
R = TypeVar("R")
# Without a terminal: time before the first line of progress, and between two lines.
FIRST_LINE_S, LINE_S = 2.0, 10.0
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerDied(Exception):
    """A worker process was killed from outside."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def as_they_come(work: Callable[[J], R], jobs: Sequence[J], processes: int, threads: int = 1) -> Generator[tuple[J, R]]:
    """Yield each job with the result of `work`, in order of completion; jobs begin in their order.

    With one process or one job, the work runs in this process. Otherwise work, jobs and results are pickled, and numba
    and BLAS use `threads` threads per worker. Workers end with this process, and immediately on Ctrl-C. Closing the
    iterator, or an error of a job, cancels all jobs that have not begun. Errors of `work` are passed on.

    Raises:
        WorkerDied: A worker was killed.
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
            "a worker process was killed, most likely because the memory is full; start again with fewer processes"
        ) from None
    except KeyboardInterrupt:
        for worker in set(active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """Prepare a worker before its first job."""
    # Ctrl-C also reaches workers and must not print a traceback in each.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    """End this worker with its parent; it would otherwise wait forever or write to files of the next run."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Set the number of threads of numba and BLAS for processes that start in this block."""
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


class WorkClock:
    """Clock of progress bars, s, without the time of compiling, which says nothing about the speed of the work."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._left_out_s = clock, 0.0
        self._began_s: list[float] = []

    def __call__(self) -> float:
        """Return the time without what was left out."""
        return self._clock() - self._left_out_s

    def begin_leaving_out(self) -> None:
        """Leave out the time from now on; calls may be nested."""
        self._began_s.append(self._clock())

    def end_leaving_out(self) -> None:
        """Count the time again once every begin has its end."""
        began_s = self._began_s.pop()
        if not self._began_s:
            self._left_out_s += self._clock() - began_s


work_clock = WorkClock()


def left_s(elapsed_s: float, share: float) -> float:
    """Return the remaining time of work whose completed share has grown evenly.

    The newest speed alone would keep its estimate while a long step reports nothing.
    """
    return elapsed_s * (1.0 / min(share, 1.0) - 1.0)


@contextmanager
def later(seconds: float, call: Callable[[], object]) -> Iterator[None]:
    """Call a function after a time, unless the block has ended before."""
    timer = threading.Timer(seconds, call)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class _Lines:
    """Progress as lines: the first after FIRST_LINE_S, then at most one every LINE_S, with the remaining time."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._write, self._clock = write, clock
        self._begun_s = clock()
        self._due_s = self._begun_s + FIRST_LINE_S
        self._newest: tuple[str, float | None] = ("", None)
        self._lock = threading.Lock()

    def first_line(self) -> AbstractContextManager[None]:
        """Print the first line in time even if the work does not report progress."""
        return later(FIRST_LINE_S, lambda: self.update(*self._newest))

    def update(self, text: str, share: float | None, begun: float = 0.0) -> None:
        """Print a line if one is due.

        Args:
            text: Current work.
            share: Completed share of the work; None if unknown.
            begun: Completed share when the bar began.
        """
        with self._lock:
            self._newest = text, share
            now_s = self._clock()
            if now_s < self._due_s:
                return
            self._due_s = now_s + LINE_S
        if not share or share <= begun:
            self._write(f"{text} ...")
            return
        remaining_s = left_s(now_s - self._begun_s, (share - begun) / (1.0 - begun))
        self._write(f"{text} ({100 * share:.0f} %, about {remaining_s:.0f} s left)")


class Bar:
    """Progress of a piece of work."""

    def __init__(self, progress: "Progress", task: "TaskID", begun: float, lines: "_Lines | None" = None) -> None:
        self._progress, self._task, self._begun, self._lines = progress, task, begun, lines

    def advance(self, by: float = 1, text: str | None = None) -> None:
        """Advance the bar; `text` names the current work."""
        self._progress.update(self._task, advance=by, description=text)
        self._print()

    def show(self, done: float | None = None, total: float | None = None, text: str | None = None) -> None:
        """Show these values from now on."""
        self._progress.update(self._task, completed=done, total=total, description=text)
        self._print()

    def _print(self) -> None:
        if self._lines is not None:
            task = self._progress.tasks[0]
            share, begun = (task.completed / task.total, self._begun / task.total) if task.total else (None, 0.0)
            self._lines.update(task.description, share, begun)

    def report(self, text: str, share: float) -> None:
        """Show the current work and its share of a total of 1.0, as a callback of long work."""
        self.show(share, text=text)

    def count(self, text: str, done: int, of: int) -> None:
        """Show the current work and its count of a total."""
        self.show(done, of, text)


@contextmanager
def bar(text: str, total: float | None = 1.0, *, done: float = 0, stay: bool = False) -> Iterator[Bar]:
    """Show a progress bar on standard error during the block, or a line every LINE_S if it is no terminal.

    Args:
        text: Description of the work.
        total: A whole number shows a count (3/12), another number shows percent, None shows a count without total.
        done: Progress at the start.
        stay: Whether the bar stays on the terminal at the end.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.text import Text

    class Remaining(ProgressColumn):
        def render(self, task: Task) -> Text:
            gained = (task.completed - done) / (task.total - done) if task.total and task.total > done else 0.0
            seconds = round(left_s(task.elapsed or 0.0, gained)) if gained > 0 else None
            return Text("-:--:--" if seconds is None else str(timedelta(seconds=seconds)), style="progress.remaining")

    console = Console(stderr=True)
    figure = TaskProgressColumn() if isinstance(total, float) else MofNCompleteColumn()
    columns = (TextColumn("{task.description}"), BarColumn(), figure, TimeElapsedColumn(), Remaining())
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=not stay, disable=hidden, get_time=work_clock) as progress:
        lines = _Lines(partial(print, file=sys.stderr, flush=True), work_clock)
        shown = Bar(progress, progress.add_task(text, total=total), done, lines if progress.disable else None)
        shown.advance(done)
        with lines.first_line() if progress.disable else nullcontext():
            yield shown
