"""Batches of jobs on processes of this computer or on a Ray cluster: restartable, with one progress bar.

A job is a key and an argument. The function of all jobs is pickled, so it is importable by name (or a partial of such a
function). Results have the order of the jobs, wherever and in which order they finished.
"""

import json
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import click

from softarm.common import files
from softarm.common.processes import as_they_come, bar, cores

J = TypeVar("J")
R = TypeVar("R")


class JobsFailed(Exception):
    """Failed jobs of a batch, each with its key and its error; the other jobs have finished."""


class Workers(NamedTuple):
    """Place that jobs run at."""

    processes: int = cores()  # on this computer
    ray: str | None = None  # address of a Ray cluster, or `local` for one that starts here; None: processes


@dataclass(frozen=True)
class Work(Generic[J, R]):
    """Function of all jobs of a batch, and what it needs on another computer."""

    run: Callable[[J], R]
    reads: Callable[[J], Iterable[Path]] = lambda job: ()  # files and folders that go to the job
    writes: Callable[[J], Iterable[Path]] = lambda job: ()  # files and folders that come back from the job
    threads: int = 1  # of numba and BLAS
    cards: Callable[[J], int] = lambda job: 0  # graphics cards


class Failure(NamedTuple):
    """Error of a job."""

    kind: str  # class of the exception
    message: str  # its first line
    trace: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.message}"

    @classmethod
    def of(cls, error: BaseException) -> "Failure":
        """Return the failure that an exception is."""
        first, _, _ = str(error).strip().partition("\n")
        return cls(type(error).__name__, first, "".join(traceback.format_exception(error)))


@dataclass(frozen=True)
class Batch(Generic[R]):
    """Results and failures by key, in the order of the jobs."""

    results: dict[str, R]
    failures: dict[str, Failure]

    def complete(self, remedy: str = "") -> dict[str, R]:
        """Return the results of all jobs. Raises JobsFailed with each failed key, its error and the remedy."""
        if not self.failures:
            return self.results
        count, lines = len(self.failures), [f"{key}: {each}" for key, each in self.failures.items()]
        failed = JobsFailed("\n".join([f"{count} of {count + len(self.results)} jobs failed:", *lines, remedy]).strip())
        for each in self.failures.values():
            failed.add_note(each.trace)
        raise failed


@dataclass(frozen=True)
class Kept:
    """Results that stay in files, so that a restart runs only the missing jobs.

    A result is a dictionary of plain values. Its file also holds what the result depends on (code, data, settings). A
    result that depends on something else is missing.
    """

    file: Callable[[str], Path]  # of a key
    depends_on: Callable[[str], Mapping[str, Any]]

    def read(self, key: str) -> dict[str, Any] | None:
        """Return the result of a job, or None if it is missing or damaged."""
        try:
            found = json.loads(self.file(key).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        now = _plain(self.depends_on(key))
        same = isinstance(found, dict) and all(name in found and found[name] == value for name, value in now.items())
        return found if same else None

    def write(self, key: str, result: Mapping[str, Any]) -> dict[str, Any]:
        """Write a result and return it as `read` does."""
        file = self.file(key)
        file.parent.mkdir(parents=True, exist_ok=True)
        whole = _plain({**self.depends_on(key), **result})
        files.write_text(file, json.dumps(whole, indent=1) + "\n")
        return whole


def run(
    text: str,
    work: Work[J, R] | Callable[[J], R],
    jobs: Mapping[str, J],
    workers: Workers | None = None,
    *,
    kept: Kept | None = None,
    cost: Callable[[J], int] = lambda job: 1,
    on_result: Callable[[str, R], None] = lambda key, result: None,
) -> Batch[R]:
    """Run jobs, show their progress, and return their results; a failed job does not stop the others.

    Args:
        text: Description of the work, for the progress bar.
        work: Function of all jobs.
        jobs: Argument of each job by its key; jobs begin in this order.
        workers: Place that jobs run at; by default a process for each core.
        kept: Store of finished results. Without one, a restart runs every job again.
        cost: Size of a job, from which the bar estimates the remaining time.
        on_result: Called with each new result as soon as it is kept.

    Raises:
        WorkerDied: A process on this computer was killed. Finished results are kept.
        ClusterError: The cluster cannot be used.
    """
    own = work if isinstance(work, Work) else Work(work)
    results: dict[str, Any] = {}
    if kept is not None:
        results = {key: found for key in jobs if (found := kept.read(key)) is not None}
    todo = [(key, job) for key, job in jobs.items() if key not in results]
    failures: dict[str, Failure] = {}
    done = sum(cost(job) for key, job in jobs.items() if key in results)
    with bar(text, done + sum(cost(job) for _, job in todo), done=done) as shown:
        for (key, job), result in _finished(own, todo, workers or Workers()):
            if isinstance(result, Failure):
                failures[key] = result
            else:
                results[key] = result if kept is None else kept.write(key, result)  # type: ignore[arg-type]
                on_result(key, results[key])
            shown.advance(cost(job))
    ordered = {key: results[key] for key in jobs if key in results}
    return Batch(ordered, {key: failures[key] for key in jobs if key in failures})


def _finished(
    work: Work[J, R], todo: list[tuple[str, J]], workers: Workers
) -> Iterator[tuple[tuple[str, J], R | Failure]]:
    if workers.ray is None:
        return as_they_come(partial(isolated, work.run), todo, workers.processes, work.threads)
    from softarm.common.cluster import on_ray

    return on_ray(work, todo, workers.ray)


def isolated(function: Callable[[J], R], keyed: tuple[str, J]) -> R | Failure:
    """Return the result of a job, or its failure."""
    try:
        return function(keyed[1])
    except Exception as error:
        return Failure.of(error)


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values as a file gives them back, so that kept and new results are equal."""
    plain: dict[str, Any] = json.loads(json.dumps(values))
    return plain


def workers_options(about: str = "") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the options --workers and --ray of a verb that runs many jobs; it receives `workers`, a `Workers`."""
    count = click.option(
        "--workers",
        "processes",
        type=click.IntRange(min=1),
        help=f"{about}parallel jobs here.  [default: one per core]",
    )
    address = click.option("--ray", help=f"{about}run on the Ray cluster at this address; 'local' starts one here.")

    def decorate(verb: Callable[..., Any]) -> Callable[..., Any]:
        @count
        @address
        @wraps(verb)
        def with_workers(*args: Any, processes: int | None, ray: str | None, **options: Any) -> Any:
            return verb(*args, workers=Workers(processes or cores(), ray), **options)

        return with_workers

    return decorate
