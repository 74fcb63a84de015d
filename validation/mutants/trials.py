"""Execution of mutants: one fork each, which imports the changed module before the tests.

For each module a fresh interpreter imports everything that its tests need and that does not import the module; a fork
of it starts within a tenth of a second. Tests run fastest first and stop at the first failure.
"""

import contextlib
import gc
import importlib
import importlib.util
import os
import resource
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from typing import Literal, NamedTuple

import pytest

from softarm.common.revision import CHECKOUT
from validation import apart
from validation.mutants.operators import Mutant, mutated
from validation.mutants.targets import Target

SLACK_S, SLACK = 5.0, 6.0  # time for a mutant: SLACK_S plus SLACK times that of the unchanged module
UNCHANGED_MAX_S = 600.0
MEMORY_BYTES = 2 << 30  # limit for a mutant that allocates without end
EXAMPLES = 40  # examples per property without its own number
_OPTIONS = "-x -q -p no:cacheprovider -m 'not realtime' -W ignore::pytest.PytestAssertRewriteWarning"
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


End = Literal["killed", "timed out", "survived"]


class FailsUnchanged(Exception):
    """Failure of the tests of an unchanged module, which makes its mutants meaningless."""


class _Run(NamedTuple):
    code: int
    failed: str  # name of the failing test and its output
    durations: dict[str, float]  # by test
    modules: list[str]  # imported at the end


def trials(target: Target, mutants: Sequence[Mutant], jobs: int) -> list[End]:
    """Return the end of each mutant. Raises FailsUnchanged if the tests fail without a change."""
    with ProcessPoolExecutor(1, get_context("spawn")) as fresh:  # forks need a process without threads
        return fresh.submit(_try_all, target, mutants, jobs).result()


def _try_all(target: Target, mutants: Sequence[Mutant], jobs: int) -> list[End]:
    """Run the trials in the fresh interpreter."""
    os.chdir(CHECKOUT)
    sys.path[:] = [str(CHECKOUT), *(path for path in sys.path if path)]
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    _settle_hypothesis()
    first = _unchanged(target, {})
    _preload(target, first.modules)
    start_s = time.monotonic()
    _unchanged(target, first.durations)  # under the conditions of a mutant
    limit_s = SLACK_S + SLACK * (time.monotonic() - start_s)

    def tried(mutant: Mutant) -> End:
        try:
            run: _Run = apart.call("fork", limit_s, _run, target, mutant, first.durations)
        except TimeoutError:
            return "timed out"
        except apart.ProcessDied:
            return "killed"
        return "killed" if run.code else "survived"

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(tried, mutants))


def _unchanged(target: Target, durations: Mapping[str, float]) -> _Run:
    run: _Run = apart.call("fork", UNCHANGED_MAX_S, _run, target, None, durations)
    if run.code:
        raise FailsUnchanged(f"{target.module}: its tests fail without a change; repair them first: {run.failed}")
    return run


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


def _preload(target: Target, modules: Sequence[str]) -> None:
    """Import the modules that the tests need, except those that import the mutated one."""
    sys.modules[target.name] = None  # type: ignore[assignment]
    for name in modules:
        if name.partition(".")[0] in ("tests", "conftest") or name in sys.modules:
            continue
        before = set(sys.modules)
        try:
            importlib.import_module(name)
        except ImportError:
            for begun in set(sys.modules) - before:
                if begun.partition(".")[0] == target.name.partition(".")[0]:
                    _forget(begun)
    del sys.modules[target.name]
    gc.freeze()  # a fork copies only the pages it changes


def _forget(name: str) -> None:
    parent, _, leaf = name.rpartition(".")
    sys.modules.pop(name, None)
    if parent in sys.modules and hasattr(sys.modules[parent], leaf):
        delattr(sys.modules[parent], leaf)


def _run(target: Target, mutant: Mutant | None, durations: Mapping[str, float]) -> _Run:
    """Run the tests on the mutant in a fork."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        for output in (1, 2):
            os.dup2(nowhere.fileno(), output)
    _import(target, mutant)
    watch = _Watch(durations)
    code = 1
    with contextlib.suppress(SystemExit):
        code = int(pytest.main([*shlex.split(_OPTIONS), f"--rootdir={CHECKOUT}", *target.tests], plugins=[watch]))
    modules = [name for name, module in list(sys.modules.items()) if getattr(module, "__spec__", None)]
    return _Run(code, watch.failed, watch.durations, modules)


def _import(target: Target, mutant: Mutant | None) -> None:
    """Import the module with a change, under its own name."""
    spec = importlib.util.find_spec(target.name)
    assert spec is not None
    module = sys.modules[target.name] = importlib.util.module_from_spec(spec)
    exec(compile(mutated(target.source, mutant), spec.origin or "", "exec"), module.__dict__)
    parent, _, leaf = target.name.rpartition(".")
    setattr(sys.modules[parent], leaf, module)


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
        if report.failed:
            self.failed = f"{report.nodeid}\n{report.longreprtext}"
