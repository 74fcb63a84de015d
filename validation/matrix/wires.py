"""Wires between daemon and devices that can be disturbed, with a TCP relay, a pty relay and a Zenoh relay.

They know the length of a frame and nothing else about the data. All run in one event loop; `spoil` and `mend` may be
called from any other thread.
"""

import asyncio
import contextlib
import json
import os
import random
import tty
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, Literal

import zenoh

from softarm.drivers.mocap.zenoh_session import client, listener
from softarm.drivers.regulator import cobs
from softarm.drivers.twin.cameras import STATE_KEY
from softarm.schemas.config import Config

SLOW_S = 0.06  # almost two ticks
RETRY_S = 0.05
CLOCK_JUMP_S = 10.0
KEY = Config().drivers.mocap.key
DEVICE_TIME = slice(6, 10)  # of a regulator frame's body: the sender's microseconds, docs/reference/wires.md

Direction = Literal["read", "write"]  # from the daemon's side


class Fault(StrEnum):
    """Disturbance of a wire."""

    TIME_OUT = "time-out"  # no data passes
    GARBAGE = "garbage"  # the same number of random bytes
    DISCONNECT = "disconnect"  # closes this and every new connection
    SLOW = "slow"  # data passes SLOW_S later
    HALF_FRAME = "half frame"  # only the first half of each piece passes
    REPLAY = "replay"  # data from before the fault is repeated
    CLOCK_JUMP = "clock jump"  # the device's clock is CLOCK_JUMP_S ahead


class Wire:
    """Current fault of one wire, and its effect on data."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._loop: asyncio.AbstractEventLoop
        self._fault: Fault | None = None
        self._directions: tuple[Direction, ...] = ()
        self._passed: dict[Direction, bytes] = {}

    async def run(self) -> None:
        """Connect both sides, and again after each disconnection, until this task is cancelled."""
        self._loop = asyncio.get_running_loop()
        try:
            await self._keep_connected()
        finally:
            self._disconnect()

    async def _keep_connected(self) -> None:
        """Connect while there is no connection and none is refused."""
        raise NotImplementedError

    def _disconnect(self) -> None:
        """Close the current connection, if there is one."""
        raise NotImplementedError

    def spoil(self, fault: Fault, *directions: Direction) -> None:
        """Apply a fault in the given directions until `mend`."""
        self._directions, self._fault = directions, fault
        if fault is Fault.DISCONNECT:
            self.hang_up()

    def mend(self) -> None:
        """Remove the fault from the wire."""
        self._fault = None

    def hang_up(self) -> None:
        """Close the current connection."""
        self._loop.call_soon_threadsafe(self._disconnect)

    @property
    def hung_up(self) -> bool:
        """Return whether connections are currently refused."""
        return self._fault is Fault.DISCONNECT

    def pass_on(self, data: bytes, direction: Direction, put: Callable[[bytes], None]) -> None:
        """Call `put` with the data that comes out at the other end, when it does."""
        slow = self._fault is Fault.SLOW and direction in self._directions
        self._loop.call_later(SLOW_S if slow else 0.0, put, self._through(data, direction))

    def _through(self, data: bytes, direction: Direction) -> bytes:
        fault = self._fault if direction in self._directions else None
        match fault:
            case None:
                self._passed[direction] = data
            case Fault.TIME_OUT:
                return b""
            case Fault.GARBAGE:
                return self._random.randbytes(len(data))
            case Fault.HALF_FRAME:
                return data[: len(data) // 2]
            case Fault.REPLAY:
                return self._passed.get(direction, b"")
            case Fault.CLOCK_JUMP:
                return self.jumped(data)
        return data

    def jumped(self, data: bytes) -> bytes:
        """Return data whose sender's clock is ahead; unchanged if the wire carries no clock."""
        return data


class RailWire(Wire):
    """TCP relay at the address where the daemon expects the drive."""

    def __init__(self, seed: int, port: int, device_port: int) -> None:
        super().__init__(seed)
        self._port, self._device_port = port, device_port
        self._open: set[asyncio.StreamWriter] = set()

    async def _keep_connected(self) -> None:
        async with await asyncio.start_server(self._serve, "127.0.0.1", self._port) as server:
            await server.serve_forever()

    def _disconnect(self) -> None:
        for writer in self._open:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.hung_up:
            writer.transport.abort()
            return
        with contextlib.suppress(OSError):
            device_reader, device_writer = await asyncio.open_connection("127.0.0.1", self._device_port)
            ends = {writer, device_writer}
            self._open |= ends
            pumps = [
                asyncio.create_task(self._pump(reader, device_writer, "write")),
                asyncio.create_task(self._pump(device_reader, writer, "read")),
            ]
            await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
            for end in ends:
                end.transport.abort()
            await asyncio.wait(pumps)
            self._open -= ends

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, direction: Direction) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(4096):
                self.pass_on(data, direction, lambda out: None if writer.is_closing() else writer.write(out))


class RegulatorWire(Wire):
    """Pty at the path of the serial port, joined to the device's own pty."""

    def __init__(self, seed: int, path: Path, device_path: Path) -> None:
        super().__init__(seed)
        self._path, self._device_path = path, device_path
        self._host: tuple[int, int] | None = None  # both ends of the pty
        self._device: int | None = None
        self._deframer = cobs.Deframer()

    def jumped(self, data: bytes) -> bytes:
        """Return a frame with its time set ahead and a correct CRC."""
        ahead = b""
        for body in self._deframer.feed(data):
            microseconds = int.from_bytes(body[DEVICE_TIME], "little") + int(CLOCK_JUMP_S * 1e6)
            later = (microseconds % 2**32).to_bytes(4, "little")
            ahead += cobs.frame(body[: DEVICE_TIME.start] + later + body[DEVICE_TIME.stop :])
        return ahead

    async def _keep_connected(self) -> None:
        while True:
            if self._host is None and not self.hung_up and self._device_path.exists():
                with contextlib.suppress(OSError):
                    self._plug()
            await asyncio.sleep(RETRY_S)

    def _plug(self) -> None:
        self._device = os.open(self._device_path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._device)
        self._host = os.openpty()
        for end in self._host:
            tty.setraw(end)
            os.set_blocking(end, False)
        self._path.unlink(missing_ok=True)
        self._path.symlink_to(os.ttyname(self._host[1]))
        self._loop.add_reader(self._device, self._pump, self._device, self._host[0], "read")
        self._loop.add_reader(self._host[0], self._pump, self._host[0], self._device, "write")

    def _disconnect(self) -> None:
        """Close the pty, as an unplugged cable does."""
        self._path.unlink(missing_ok=True)
        for end in (*(self._host or ()), self._device):
            if end is not None:
                self._loop.remove_reader(end)
                os.close(end)
        self._host = self._device = None

    def _pump(self, source: int, sink: int, direction: Direction) -> None:
        try:
            data = os.read(source, 4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._disconnect()
            return
        self.pass_on(data, direction, partial(self._put, sink))

    def _put(self, sink: int, data: bytes) -> None:
        if self._host is not None and sink in (self._host[0], self._device):
            with contextlib.suppress(OSError):
                os.write(sink, data)


class MocapWire(Wire):
    """Relay that receives frames on its own endpoint and passes them on to the daemon.

    The twin's own states arrive here as well; `report_state` receives each of them.
    """

    def __init__(
        self, seed: int, endpoint: str, camera_endpoint: str, report_state: Callable[[dict[str, Any]], None]
    ) -> None:
        super().__init__(seed)
        self._endpoint, self._camera_endpoint = endpoint, camera_endpoint
        self._report_state = report_state
        self._daemon: zenoh.Session | None = None

    def jumped(self, data: bytes) -> bytes:
        """Return a frame whose capture time is set ahead."""
        frame = json.loads(data)
        frame["t_capture_ns"] += int(CLOCK_JUMP_S * 1e9)
        return json.dumps(frame).encode()

    async def _keep_connected(self) -> None:
        with zenoh.open(listener(self._camera_endpoint)) as cameras:
            cameras.declare_subscriber(KEY, self._receive)
            cameras.declare_subscriber(STATE_KEY, self._receive_state)
            while True:
                if self._daemon is None and not self.hung_up:
                    with contextlib.suppress(zenoh.ZError):
                        self._daemon = await asyncio.to_thread(zenoh.open, client(self._endpoint))
                await asyncio.sleep(RETRY_S)

    def _disconnect(self) -> None:
        session, self._daemon = self._daemon, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _receive_state(self, sample: zenoh.Sample) -> None:
        self._report_state(json.loads(sample.payload.to_bytes()))

    def _receive(self, sample: zenoh.Sample) -> None:
        """Receive a frame on the thread of Zenoh."""
        put = partial(self._put, sample.encoding)
        self._loop.call_soon_threadsafe(self.pass_on, sample.payload.to_bytes(), "read", put)

    def _put(self, encoding: zenoh.Encoding, data: bytes) -> None:
        if data and self._daemon is not None:
            with contextlib.suppress(zenoh.ZError):
                drop = zenoh.CongestionControl.DROP
                self._daemon.put(KEY, data, encoding=encoding, congestion_control=drop)
