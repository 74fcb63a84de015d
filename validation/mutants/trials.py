"""Execution of mutants: one fork each, in which the module is replaced before any test imports it.

For each module a fresh interpreter imports everything that its tests need and that does not import the module; a fork
of it starts within a tenth of a second. Tests run fastest first and stop at the first failure.
"""

import ast
import contextlib
import gc
import importlib
import importlib.abc
import importlib.util
import os
import resource
import shlex
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.machinery import ModuleSpec
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, Literal, NamedTuple

import pytest

from validation.mutants.operators import Mutant, mutated
from validation.mutants.targets import Target

SLACK_S, SLACK = 5.0, 6.0  # time for a mutant: SLACK_S plus SLACK times that of the unchanged module
MEMORY_BYTES = 2 << 30  # limit for a mutant that allocates without end
EXAMPLES = 40  # examples per property without its own number
_PRELOADED = "ignore::pytest.PytestAssertRewriteWarning"
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class FailsUnchanged(Exception):
    """Failure of the tests of an unchanged module, which makes its mutants meaningless."""


class Trial(NamedTuple):
    """Result of one mutant."""

    mutant: Mutant
    end: Literal["killed", "timed out", "survived"]
    by: str  # name of the failing test; empty if none failed
    seconds: float


class _Run(NamedTuple):
    code: int
    failed: str
    durations: dict[str, float]  # by test
    modules: tuple[str, ...]  # imported at the end
    output: str  # the end of the output of pytest


def trials(target: Target, mutants: Sequence[Mutant], jobs: int, slack_s: float = SLACK_S) -> Iterator[Trial]:
    """Yield each mutant with its result in the order of completion.

    Raises:
        FailsUnchanged: The tests fail without a change.
    """
    context = get_context("spawn")  # forks need a process without threads
    ours, theirs = context.Pipe(duplex=False)
    server = context.Process(target=_serve, args=(target, mutants, jobs, slack_s, theirs))
    server.start()
    theirs.close()
    try:
        while True:
            try:
                got = ours.recv()
            except EOFError:
                raise FailsUnchanged(f"{target.module}: the process that tries its mutants died") from None
            if got is None:
                return
            if isinstance(got, str):
                raise FailsUnchanged(f"{target.module}: {got}")
            yield got
    finally:
        server.terminate()
        server.join()


def _serve(target: Target, mutants: Sequence[Mutant], jobs: int, slack_s: float, results: Connection) -> None:
    """Run the trials in the fresh interpreter."""
    os.chdir(target.root)
    sys.path[:] = [str(target.root), *(path for path in sys.path if path)]
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    signal.signal(signal.SIGTERM, _end)
    _settle_hypothesis()
    first = _one(target, None, {})
    if first.code == 0:
        _prepare(target, first.modules)
        start_s = time.monotonic()
        second = _one(target, None, first.durations)  # under the conditions of a mutant
        limit_s = slack_s + SLACK * (time.monotonic() - start_s)
        if second.code == 0:
            for trial in _try_all(target, mutants, jobs, first.durations, limit_s):
                results.send(trial)
            results.send(None)
            return
        first = second
    results.send(f"its tests fail without a change; repair them first: {first.failed}\n{first.output}")


def _end(*_: object) -> None:
    for process in tuple(_running):
        _kill(process)
    os._exit(1)


_running: set[BaseProcess] = set()


def _settle_hypothesis() -> None:
    """Use the same few examples for every mutant, without shrinking."""
    from hypothesis import HealthCheck, Phase, settings

    settings.register_profile(
        "mutants",
        derandomize=True,
        max_examples=EXAMPLES,
        database=None,
        deadline=None,
        phases=(Phase.explicit, Phase.generate),
        suppress_health_check=list(HealthCheck),
    )
    settings.load_profile("mutants")


def _prepare(target: Target, modules: Sequence[str]) -> None:
    """Import the modules that the tests need, except those that import the mutated one."""
    sys.modules[target.name] = None  # type: ignore[assignment]
    package = target.name.partition(".")[0]
    for name in modules:
        if name.partition(".")[0] in ("tests", "conftest") or name in sys.modules:
            continue
        before = set(sys.modules)
        try:
            importlib.import_module(name)
        except ImportError:
            for begun in set(sys.modules) - before:
                if begun.partition(".")[0] == package:
                    _forget(begun)
    del sys.modules[target.name]
    gc.freeze()  # a fork copies only the pages it changes


def _forget(name: str) -> None:
    parent, _, leaf = name.rpartition(".")
    sys.modules.pop(name, None)
    if parent in sys.modules and hasattr(sys.modules[parent], leaf):
        delattr(sys.modules[parent], leaf)


def _try_all(
    target: Target, mutants: Sequence[Mutant], jobs: int, durations: Mapping[str, float], limit_s: float
) -> Iterator[Trial]:
    waiting = list(reversed(mutants))
    running: dict[Connection, tuple[BaseProcess, Mutant, float]] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            process, ours = _fork(target, mutant, durations)
            running[ours] = process, mutant, time.monotonic()
        oldest_s = min(start_s for _, _, start_s in running.values())
        ready = wait(list(running), max(0.0, oldest_s + limit_s - time.monotonic()))
        now_s = time.monotonic()
        for ours, (process, mutant, start_s) in list(running.items()):
            if ours not in ready and now_s - start_s < limit_s:
                continue
            del running[ours]
            yield _ended(process, ours if ours in ready else None, mutant, now_s - start_s)


def _ended(process: BaseProcess, ours: Connection | None, mutant: Mutant, seconds: float) -> Trial:
    got: _Run | None = None
    if ours is not None:
        with contextlib.suppress(EOFError):
            got = ours.recv()
    _kill(process)
    if ours is None:
        return Trial(mutant, "timed out", "", seconds)
    if got is None:
        return Trial(mutant, "killed", "(the process died)", seconds)
    return Trial(mutant, "killed" if got.code else "survived", got.failed, seconds)


def _one(target: Target, mutant: Mutant | None, durations: Mapping[str, float]) -> _Run:
    process, ours = _fork(target, mutant, durations)
    try:
        got: _Run = ours.recv()
    except EOFError:
        got = _Run(-1, "", {}, (), "the process died")
    _kill(process)
    return got


def _fork(target: Target, mutant: Mutant | None, durations: Mapping[str, float]) -> tuple[BaseProcess, Connection]:
    context = get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(target, mutant, durations, theirs))
    process.start()
    _running.add(process)
    theirs.close()
    return process, ours


def _kill(process: BaseProcess) -> None:
    """Kill a process and its children."""
    _running.discard(process)
    if process.pid is not None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()


def _child(target: Target, mutant: Mutant | None, durations: Mapping[str, float], results: Connection) -> None:
    """Run the tests on the mutant in the fork, report the result and end every thread."""
    os.setsid()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    with open(os.memfd_create("said"), "w+", encoding="utf-8", errors="replace") as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        sys.meta_path.insert(0, _Finder(target, mutated(target.source, mutant)))
        watch = _Watch(durations)
        options = [*shlex.split("-x -q -p no:cacheprovider -m 'not realtime'"), f"--rootdir={target.root}"]
        try:
            code = int(pytest.main([*options, "-W", _PRELOADED, *target.tests], plugins=[watch]))
        except BaseException as error:
            code, watch.failed = 1, f"({type(error).__name__}: {error})"
        sys.stdout.flush()
        said.seek(0)
        modules = tuple(name for name, module in sys.modules.items() if getattr(module, "__spec__", None))
        failed = watch.failed or ("(import)" if code else "")
        results.send(_Run(code, failed, watch.durations, modules, said.read()[-2000:] if code else ""))
    os._exit(0)


class _Watch:
    """Pytest plug-in that runs the fastest tests first and records the failing test and all durations."""

    def __init__(self, order: Mapping[str, float]) -> None:
        self._order = order
        self.durations: dict[str, float] = {}
        self.failed = ""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self._order.get(item.nodeid, 0.0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.durations[report.nodeid] = self.durations.get(report.nodeid, 0.0) + report.duration
        if report.failed and not self.failed:
            self.failed = report.nodeid


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Import finder that creates one module from a given tree."""

    def __init__(self, target: Target, tree: ast.Module) -> None:
        self._name = target.name
        self._file = str(target.root / target.name.replace(".", "/")) + ".py"
        self._tree = tree

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != self._name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=self._file)

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self._file
        exec(compile(self._tree, self._file, "exec"), module.__dict__)
