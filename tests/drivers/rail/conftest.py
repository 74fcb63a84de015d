"""Bench of the rail: the driver, its process as a thread, and a scripted drive on a TCP port."""

import asyncio
import contextlib
import itertools
import math
import socket
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any
from unittest.mock import ANY

import pytest

from softarm.drivers.rail import dryve, pair
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.rail.dryve import ModbusRequest
from softarm.drivers.rail.master import Master
from softarm.drivers.rail.settings import Settings
from softarm.drivers.twin.dryve import DryveDevice, DryveServer
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail

Answer = Callable[[ModbusRequest], bytes]


def refused(request: ModbusRequest) -> bytes:
    return dryve.encode_abort(request.transaction, 0x08000022)


class Drive(DryveDevice):
    """Drive that records its requests; `script` may answer in its place, and `coasts` keeps its velocity."""

    def __init__(self, config: DryveRail) -> None:
        super().__init__(config)
        self.requests: list[tuple[ModbusRequest, DriveState]] = []
        self.links: list[list[ModbusRequest]] = []
        self.script: Callable[[bytes, Callable[[], bytes]], bytes] | None = None
        self.position_m = self.velocity_m_s = 0.0
        self.coasts = False

    def answer(self, telegram: bytes, now_ns: int) -> bytes:
        self.requests.append((dryve.decode_request(telegram), self.state))
        self.links[-1].append(self.requests[-1][0])
        if self.script is None:
            return super().answer(telegram, now_ns)
        return self.script(telegram, lambda: super(Drive, self).answer(telegram, now_ns))

    def move(self) -> None:
        self.velocity_m_s = self.velocity_m_s if self.coasts else self.target_velocity_m_s
        self.sense(self.position_m, self.velocity_m_s)

    def spoil(
        self, bad: Answer, *entries: dryve.Entry, data: Any = ANY, times: float = math.inf
    ) -> list[ModbusRequest]:
        """Answer the next requests badly and return the list of them: all, or those for some entries or data."""
        spoilt: list[ModbusRequest] = []
        places = [(entry.index, entry.sub) for entry in entries]

        def script(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
            request = dryve.decode_request(telegram)
            concerned = (not places or (request.index, request.sub) in places) and request.data == data
            if not concerned or len(spoilt) >= times:
                return answer()
            spoilt.append(request)
            return bad(request)

        self.script = script
        return spoilt

    def writes(self, entry: dryve.Entry, since: int = 0) -> list[int]:
        return [
            int.from_bytes(request.data, "little", signed=entry.signed)
            for request, _ in self.requests[since:]
            if request.data is not None and (request.index, request.sub) == (entry.index, entry.sub)
        ]


class Server(DryveServer):
    """Server that starts a new list of requests with each connection."""

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.device.links.append([])  # type: ignore[attr-defined]
        await super()._serve(reader, writer)


class ProcessThread(threading.Thread):
    """The rail's process as a thread, so that it shares the test's clock."""

    def __init__(self, settings: Settings, theirs: socket.socket, clock: Any) -> None:
        super().__init__(daemon=True)
        self._theirs = theirs.dup()
        self._settings, self._clock = settings, clock
        self.start()

    def run(self) -> None:
        with self._theirs:
            if packet := self._theirs.recv(pair.PACKET_MAX):
                Master(self._settings, self._theirs, pair.decode_begin(packet), self._clock).run()

    def poll(self) -> int | None:
        return None if self.is_alive() else 0

    def kill(self) -> None:
        """Do nothing: the thread ends when the pair closes."""


async def stop_while(step: Callable[[], None], axis: DryveRailAxis, until: Any) -> None:
    """Stop the driver while the drive moves on."""
    mover = asyncio.create_task(until(lambda: False, step))
    await axis.stop()
    mover.cancel()


class Bench:
    """Driver and drive with a manual clock; the drive's own watchdog never triggers."""

    def __init__(self, clock: Any, until: Any, config: DryveRail) -> None:
        self.clock, self._until = clock, until
        self.drive, self.faults = Drive(config), Faults(clock)
        self.server = Server("127.0.0.1", 0, self.drive, self.faults, lambda: 0)
        self.config = config
        self.axis: DryveRailAxis

    async def open(self) -> None:
        await self.server.open()
        self.config = self.config.model_copy(update={"port": self.server.port})
        self.axis = DryveRailAxis(self.config, 0, self.clock, lambda *start: ProcessThread(*start[:2], self.clock))

    def step(self) -> None:
        self.server.step()
        self.drive.move()

    async def stop(self) -> None:
        await stop_while(self.step, self.axis, self._until)

    async def write_until(self, condition: Any, enable: bool = False, velocity_m_s: float = 0.0) -> None:
        def each() -> None:
            self.axis.write(enable, velocity_m_s)
            self.step()

        await self._until(condition, each)

    async def pass_time(self, seconds: float, enable: bool, velocity_m_s: float) -> None:
        """Advance the clock and write a set-point every 30 ms."""
        for _ in range(math.ceil(seconds / 0.03)):
            self.clock.advance(0.03)
            self.axis.write(enable, velocity_m_s)
            number = self.axis._number
            await self.wait_until(lambda n=number: self.axis._report.received == n)

    async def wait_until(self, condition: Any) -> None:
        await self._until(condition, self.step)

    async def enable(self, velocity_m_s: float = 0.3) -> None:
        await self.write_until(lambda: self.axis.problem() is None and self.axis.read() is not None)
        await self.write_until(lambda: self.drive.velocity_m_s == velocity_m_s, True, velocity_m_s)
        await self.write_until(lambda: self.axis.read().velocity_m_s == velocity_m_s, True, velocity_m_s)


@pytest.fixture
def opened(clock: Any, until: Any, running: Any, monkeypatch: Any) -> Callable[..., Any]:
    """Context of a bench with given settings of the drive, after `prepare`."""
    monkeypatch.setattr("softarm.drivers.rail.master.RETRY_S", (0.005, 0.01))
    monkeypatch.setattr("softarm.drivers.rail.master.POLL_S", 0.005)

    @contextlib.asynccontextmanager
    async def opened(prepare: Any = lambda bench: None, **config: Any) -> AsyncIterator[Bench]:
        bench = Bench(clock, until, DryveRail(host="127.0.0.1", timeout_s=1.0).model_copy(update=config))
        prepare(bench)
        await bench.open()
        try:
            async with running(bench.axis):
                yield bench
                await bench.stop()
        finally:
            await bench.server.close()
        check_controlwords(bench.drive)

    return opened


@pytest.fixture
async def bench(opened: Any) -> AsyncIterator[Bench]:
    async with opened() as bench:
        yield bench


def check_controlwords(drive: Drive) -> None:
    """Check that no connection repeats a controlword, and that a drive in operation kept its bits or was shut down."""
    for link in drive.links:
        words = [r for r in link if (r.index, bool(r.data)) == (0x6040, True)]
        for earlier, later in itertools.pairwise(words):
            repeated = earlier.data == later.data and earlier.transaction == later.transaction
            assert not repeated
    for request, state in drive.requests:
        if (request.index, bool(request.data)) != (0x6040, True):
            continue
        value = int.from_bytes(request.data or b"", "little")
        assert state is not DriveState.OPERATION_ENABLED or value & 0x0F == 0x0F or value == 0x0006
