"""Jobs on a Ray cluster, whose nodes need the same softarm but no shared file system.

Files with a relative path travel with a job, and its results return to the driver. Where the driver's current folder is
visible, a job works in it instead, so that an interrupted job continues there.
"""

import logging
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from softarm.common import files
from softarm.common.batch import Failure, Work, isolated
from softarm.common.processes import cores
from softarm.common.revision import code_version

J = TypeVar("J")
R = TypeVar("R")
LOCAL = "local"
AHEAD = 2  # jobs submitted for each core of the cluster; more would fill the driver's memory


class ClusterError(Exception):
    """Unusable cluster; the text names the problem and the remedy."""


class Parcel(NamedTuple):
    """Surroundings of a job on another computer."""

    folder: str  # current folder of the driver
    mark: str  # name of a file in it, which exists where the folder is visible
    code: str
    files: dict[str, bytes]  # by path, relative to the folder
    writes: tuple[str, ...]


def on_ray(work: Work[J, R], jobs: list[tuple[str, J]], address: str) -> Iterator[tuple[tuple[str, J], R | Failure]]:
    """Yield each job with its result, in order of completion; `local` starts a cluster here.

    Raises ClusterError. Needs the extra `ray`.
    """
    ray = _connected(address)
    try:
        with tempfile.NamedTemporaryFile(prefix=".softarm-", dir=Path.cwd()) as mark:
            remote = ray.remote(max_retries=0)(_on_node)
            waiting: dict[Any, tuple[str, J]] = {}
            todo = iter(jobs)
            while True:
                cpus = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
                while len(waiting) < AHEAD * max(1, sum(cpus)) and (keyed := next(todo, None)) is not None:
                    # Ray hides cards that were not requested, and waits forever for more cores than a node has.
                    needs = {"num_cpus": min(work.threads, max([1, *cpus])), "num_gpus": work.cards(keyed[1])}
                    task = remote.options(**needs)
                    waiting[task.remote(work.run, keyed, _parcel(work, keyed[1], Path(mark.name).name))] = keyed
                if not waiting:
                    return
                (ready, *_), _ = ray.wait(list(waiting), num_returns=1)
                keyed = waiting.pop(ready)
                yield keyed, _received(ray, ready)
    finally:
        ray.shutdown()


def _connected(address: str) -> Any:
    """Return the module ray, connected to a cluster."""
    try:
        import ray
    except ModuleNotFoundError:
        raise ClusterError("a cluster needs the package 'ray': pip install 'softarm[ray]'") from None
    own: dict[str, Any] = {"num_cpus": cores(), "include_dashboard": False} if address == LOCAL else {}
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **own)
    except Exception as error:
        text = str(error).partition("\n")[0]
        raise ClusterError(
            f"no Ray cluster at '{address}': {text}; give its address, or 'local' for one here"
        ) from error
    return ray


def _parcel(work: Work[J, R], job: J, mark: str) -> Parcel:
    inputs = packed(path for path in work.reads(job) if not path.is_absolute())
    return Parcel(str(Path.cwd()), mark, code_version(), inputs, tuple(map(str, work.writes(job))))


def _received(ray: Any, task: Any) -> Any:
    """Return the result of a job after writing its files; a worker that died is a failure."""
    try:
        result, written = ray.get(task)
    except Exception as error:
        # `cause` is the exception of the job; Ray's text holds the whole traceback of the worker.
        return Failure.of(getattr(error, "cause", None) or error)
    unpack(written)
    return result


def _on_node(function: Callable[[J], R], keyed: tuple[str, J], parcel: Parcel) -> tuple[R | Failure, dict[str, bytes]]:
    """Run a job in a Ray worker, which ends with the driver's cluster."""
    _watch(os.getppid())
    if parcel.code != code_version():
        raise ClusterError(f"this node has softarm {code_version()}; install that of the driver, {parcel.code}")
    with _surroundings(parcel) as is_shared:
        result = isolated(function, keyed)
        return result, {} if is_shared else packed(map(Path, parcel.writes))


@contextmanager
def _surroundings(parcel: Parcel) -> Iterator[bool]:
    """Work in the driver's folder, or in a copy of its needed files; return whether it is the driver's own."""
    before = Path.cwd()
    try:
        if Path(parcel.folder, parcel.mark).exists():
            os.chdir(parcel.folder)
            yield True
            return
        with tempfile.TemporaryDirectory(prefix="softarm-") as root:
            # As deep as the driver's folder, so that `..` in a path works.
            place = Path(root, *Path(parcel.folder).parts[1:])
            place.mkdir(parents=True)
            os.chdir(place)
            unpack(parcel.files)
            yield False
            os.chdir(before)
    finally:
        os.chdir(before)


def packed(paths: Iterable[Path]) -> dict[str, bytes]:
    """Return the content of files and of all files in folders by path, in the order in which they were written."""
    found = [file for path in paths for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
    there = sorted((file for file in found if file.is_file()), key=lambda file: file.stat().st_mtime_ns)
    return {str(file): file.read_bytes() for file in there}


def unpack(content: dict[str, bytes]) -> None:
    """Write files by path."""
    for name, each in content.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        files.write_bytes(name, each)


@lru_cache
def _watch(parent: int) -> None:
    """Watch the worker's parent from a thread, which is the same for all jobs of the worker."""
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End the worker with its parent, so that no job writes to the files of the next batch."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)
