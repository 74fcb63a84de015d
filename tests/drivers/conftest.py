"""Benches of the drivers: manual clocks, and devices that can misbehave."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import pytest

from tests import processes

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
    return processes.free_port()


@pytest.fixture
def anyio_backend() -> str:
    """Run asynchronous tests and fixtures on asyncio."""
    return "asyncio"


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
