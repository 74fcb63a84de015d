"""Fixtures that tests of several packages use."""

import asyncio
import contextlib
import gc
import os
import resource
import sys
import textwrap
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

import softarm  # noqa: F401  selects the BLAS kernels before a test imports numpy
from tools import chromium

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Processes of `make test` share two cores, where more threads only wait. Numba's number counts for OpenMP too: with two
# threads, boosted trees took three times the processor time.
for _threads in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

# The same examples in every run and no time limit, since a machine may be slow. Mutation testing sets its own profile.
settings.register_profile("tests", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
if settings.get_current_profile_name() == "default":
    settings.load_profile("tests")

REAL_DATA = Path(os.environ.get("SOFTARM_DATA") or Path(__file__).parents[2] / "shared" / "data")


def pytest_report_header() -> str:
    """Report whether the real recordings are available in this run."""
    found = "diagnosed from" if REAL_DATA.is_dir() else "NOT DIAGNOSED, there is no"
    return f"real recordings: {found} {REAL_DATA}"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Exempt imported modules and collected tests, which stay, from garbage collection; it took 4 s of each process."""
    gc.disable()
    found = yield
    gc.freeze()
    gc.enable()
    return found


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start with the files that have slow tests, so that no process is left alone with one at the end.

    In the order of their names, files that wait for a browser or a daemon alternate with files that compute.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (item.path not in slow, item.path.name))


def pytest_runtest_setup() -> None:
    """No test begins with the real-time priority that an earlier one's daemon has left to this thread.

    What is started from it has it too; a whole browser above everything else stops the machine.
    """
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real data: what SOFTARM_DATA names, else ../shared/data beside the checkout."""
    if REAL_DATA.is_dir():
        return REAL_DATA
    if "SOFTARM_DATA" in os.environ:  # asked for: no reason to go on without
        pytest.fail(f"SOFTARM_DATA names {REAL_DATA}, which is no folder; correct it, or leave it out")
    pytest.skip(f"{REAL_DATA} holds no real data (SOFTARM_DATA may name another folder): none is loaded or diagnosed")


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """A real browser, one for all tests of a file; without Playwright or Chromium its tests are skipped, and say so."""
    pytest.importorskip("playwright.sync_api")
    if chromium.found() is None:
        pytest.skip(f"no page is tried: {chromium.MISSING}")
    with chromium.opened() as opened:
        yield opened


@contextlib.contextmanager
def _many_descriptors() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2048:
        pytest.skip("this machine allows fewer than 2048 open files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2048), hard))
    try:
        with contextlib.ExitStack() as files:
            while files.enter_context(open(os.devnull)).fileno() < 1024:
                pass
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.fixture
def many_descriptors() -> Callable[[], AbstractContextManager[None]]:
    """A context with as many open files as make every new one's number too large for select."""
    return _many_descriptors


@contextlib.contextmanager
def _served(server: Any) -> Iterator[None]:
    ready, ended, loop = threading.Event(), asyncio.Event(), asyncio.new_event_loop()

    async def serve() -> None:
        await server.open()
        ready.set()
        await ended.wait()
        await server.close()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    assert ready.wait(20)
    try:
        yield
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(20)
        loop.close()


@pytest.fixture
def served() -> Callable[[Any], AbstractContextManager[None]]:
    """A context in which a server (`open` and `close` are coroutines) serves from a thread of its own."""
    return _served


@pytest.fixture
def ordinary_scheduling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the priority of the test process, in which some tests run the daemon."""
    monkeypatch.setattr("softarm.common.realtime._set", lambda priority: None)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Install a distribution with plugins, as pip would: a module and an entry point on the path."""

    def write(module: str, source: str, group: str = "softarm.policies", **points: str) -> None:
        (tmp_path / f"{module}.py").write_text(textwrap.dedent(source))
        info = tmp_path / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        lines = [f"{name} = {module}:{attribute}" for name, attribute in points.items()]
        (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
        monkeypatch.delitem(sys.modules, module, raising=False)
        monkeypatch.syspath_prepend(str(tmp_path))

    return write
