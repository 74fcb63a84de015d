"""Benches of the drivers: manual clocks, and devices that can misbehave."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import pytest

# Reached only on failure, or on a very busy machine.
PATIENCE_S = 20.0


class Clock:
    """Manual CLOCK_MONOTONIC, in nanoseconds."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000

    def __call__(self) -> int:
        return self.now_ns

    def advance(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def run() -> Callable[[Coroutine[Any, Any, Any]], Any]:
    """Run a coroutine to its end, or fail if it hangs."""

    async def bounded(work: Coroutine[Any, Any, Any]) -> Any:
        return await asyncio.wait_for(work, 2 * PATIENCE_S)

    return lambda work: asyncio.run(bounded(work))


@pytest.fixture
def until() -> Callable[..., Coroutine[Any, Any, None]]:
    """Wait for a condition; `each` is called before every check (a control loop's writes, a device's steps)."""

    async def wait(condition: Callable[[], Any], each: Callable[[], Any] = lambda: None) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE_S):
                while each() or not condition():
                    await asyncio.sleep(0.002)
                return
        pytest.fail(f"the condition was false for {PATIENCE_S} s")

    return wait


@contextlib.asynccontextmanager
async def running(*devices: Any) -> AsyncIterator[None]:
    """Start drivers, and stop them even on failure."""
    for device in devices:
        device.start()
    try:
        yield
    finally:
        for device in devices:
            await device.stop()


@pytest.fixture(name="running")
def _running() -> Any:
    return running


@pytest.fixture
def regulator_bench(run: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Return a function that runs scripts, each with a new bench: a `regulator` to be run, and a `port`."""
    monkeypatch.setattr("softarm.drivers.regulator.driver.RETRY_S", (0.005, 0.01))
    monkeypatch.setattr("softarm.drivers.regulator.driver.HELLO_S", 0.005)

    async def play(make: Callable[[], Any], script: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
        bench = make()
        bench.port.open()
        try:
            async with running(bench.regulator):
                await script(bench)
        finally:
            bench.port.close()

    return lambda make: lambda script: run(play(make, script))
