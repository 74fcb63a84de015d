"""Wires between daemon and devices that can be made bad: a TCP relay, a pty relay, a Zenoh relay.

They know how long a frame is and nothing else of what passes. All live in one thread with a loop of its own; `spoil`
and `mend` may be called from any other.
"""

import asyncio
import contextlib
import json
import os
import random
import threading
import tty
from collections.abc import Callable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal, Self

import zenoh

from softarm.drivers.mocap.zenoh_session import client, listener
from softarm.drivers.regulator import cobs
from softarm.drivers.twin.cameras import STATE_KEY

SLOW_S = 0.06  # nearly two ticks
RETRY_S = 0.05
CLOCK_JUMP_S = 10.0
DEVICE_TIME = slice(6, 10)  # of a regulator frame's body: the sender's microseconds, docs/wires.md

Direction = Literal["read", "write"]  # as the daemon sees it


class Fault(StrEnum):
    """What a wire can be made to do."""

    TIME_OUT = "time-out"  # nothing passes
    GARBAGE = "garbage"  # as many bytes, but any
    DISCONNECT = "disconnect"  # hangs up, and does so again with whoever comes
    SLOW = "slow"  # everything passes, SLOW_S later
    HALF_FRAME = "half frame"  # the first half of each piece
    REPLAY = "replay"  # what passed before the fault, again and again
    CLOCK_JUMP = "clock jump"  # the device's clock is CLOCK_JUMP_S ahead


class Wire:
    """What is wrong with one wire now, and what that does to a piece of data."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._fault: Fault | None = None
        self._directions: tuple[Direction, ...] = ()
        self._passed: dict[Direction, bytes] = {}

    def spoil(self, fault: Fault, *directions: Direction) -> None:
        """Be bad that way, in these directions, until `mend`."""
        self._directions, self._fault = directions, fault
        if fault is Fault.DISCONNECT:
            self.hang_up()

    def mend(self) -> None:
        """Be good."""
        self._fault = None

    def hang_up(self) -> None:
        """End the connection that there is."""
        raise NotImplementedError

    @property
    def hung_up(self) -> bool:
        """Whether nobody gets a connection now."""
        return self._fault is Fault.DISCONNECT

    def delay_s(self, direction: Direction) -> float:
        """How much later a piece passes."""
        return SLOW_S if self._fault is Fault.SLOW and direction in self._directions else 0.0

    def through(self, data: bytes, direction: Direction) -> bytes:
        """What of a piece comes out at the other end."""
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
        """A piece whose sender's clock is ahead; unchanged where the wire carries no clock."""
        return data


class RailWire(Wire):
    """Listens where the daemon thinks the drive is."""

    def __init__(self, seed: int, port: int, device_port: int) -> None:
        super().__init__(seed)
        self._port, self._device_port = port, device_port
        self._open: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    async def open(self) -> None:
        """Listen."""
        self._loop = asyncio.get_running_loop()
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self._port)

    async def close(self) -> None:
        """Stop listening."""
        self._abort()
        if self._server is not None:
            self._server.close()

    def hang_up(self) -> None:
        """See `Wire.hang_up`."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._abort)

    def _abort(self) -> None:
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
            for pump in pumps:
                pump.cancel()
            await asyncio.gather(*pumps, return_exceptions=True)
            for end in ends:
                end.transport.abort()
            self._open -= ends

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, direction: Direction) -> None:
        loop = asyncio.get_running_loop()
        with contextlib.suppress(OSError):
            while data := await reader.read(4096):
                loop.call_later(self.delay_s(direction), _write, writer, self.through(data, direction))


def _write(writer: asyncio.StreamWriter, data: bytes) -> None:
    if not writer.is_closing():
        writer.write(data)


class RegulatorWire(Wire):
    """A pty where the daemon looks for the serial port, joined with the device's own."""

    def __init__(self, seed: int, path: Path, device_path: Path) -> None:
        super().__init__(seed)
        self._path, self._device_path = path, device_path
        self._loop: asyncio.AbstractEventLoop | None = None
        self._host: tuple[int, int] | None = None  # the pty's two ends
        self._device: int | None = None
        self._task: asyncio.Task[None] | None = None
        self._deframer = cobs.Deframer()

    async def open(self) -> None:
        """Plug in, and again after each hang-up."""
        self._loop = asyncio.get_running_loop()
        self._task = asyncio.create_task(self._keep_plugged())

    async def close(self) -> None:
        """Unplug."""
        if self._task is not None:
            self._task.cancel()
        self._unplug()

    def hang_up(self) -> None:
        """See `Wire.hang_up`."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._unplug)

    def jumped(self, data: bytes) -> bytes:
        """See `Wire.jumped`: the body's time is set ahead, its CRC made good."""
        ahead = b""
        for body in self._deframer.feed(data):
            microseconds = int.from_bytes(body[DEVICE_TIME], "little") + int(CLOCK_JUMP_S * 1e6)
            later = (microseconds % 2**32).to_bytes(4, "little")
            ahead += cobs.frame(body[: DEVICE_TIME.start] + later + body[DEVICE_TIME.stop :])
        return ahead

    async def _keep_plugged(self) -> None:
        while True:
            if self._host is None and not self.hung_up and self._device_path.exists():
                with contextlib.suppress(OSError):
                    self._plug()
            await asyncio.sleep(RETRY_S)

    def _plug(self) -> None:
        assert self._loop is not None
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

    def _unplug(self) -> None:
        self._path.unlink(missing_ok=True)
        for end in (*(self._host or ()), self._device):
            if end is not None:
                if self._loop is not None:
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
            self._unplug()
            return
        assert self._loop is not None
        self._loop.call_later(self.delay_s(direction), self._put, sink, self.through(data, direction))

    def _put(self, sink: int, data: bytes) -> None:
        if self._host is not None and sink in (self._host[0], self._device):
            with contextlib.suppress(OSError):
                os.write(sink, data)


class MocapWire(Wire):
    """A bridge: hears the cameras on its own endpoint and passes their frames on to the daemon's.

    What the twin says of itself comes by here as well: `tell` is called with each of its states.
    """

    def __init__(
        self, seed: int, key: str, endpoint: str, camera_endpoint: str, tell: Callable[[dict[str, Any]], None]
    ) -> None:
        super().__init__(seed)
        self._key, self._endpoint, self._camera_endpoint, self._tell = key, endpoint, camera_endpoint, tell
        self._loop: asyncio.AbstractEventLoop | None = None
        self._cameras: zenoh.Session | None = None
        self._daemon: zenoh.Session | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Listen for the cameras; look for the daemon until it is there."""
        self._loop = asyncio.get_running_loop()
        self._cameras = zenoh.open(listener(self._camera_endpoint))
        self._cameras.declare_subscriber(self._key, self._hear)
        self._cameras.declare_subscriber(STATE_KEY, lambda sample: self._tell(json.loads(sample.payload.to_bytes())))
        self._task = asyncio.create_task(self._keep_connected())

    async def close(self) -> None:
        """Close both sessions."""
        if self._task is not None:
            self._task.cancel()
        self._leave()
        if self._cameras is not None:
            self._cameras.close()  # type: ignore[no-untyped-call]

    def hang_up(self) -> None:
        """See `Wire.hang_up`."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._leave)

    def jumped(self, data: bytes) -> bytes:
        """See `Wire.jumped`."""
        frame = json.loads(data)
        frame["t_capture_ns"] += int(CLOCK_JUMP_S * 1e9)
        return json.dumps(frame).encode()

    async def _keep_connected(self) -> None:
        while True:
            if self._daemon is None and not self.hung_up:
                with contextlib.suppress(zenoh.ZError):
                    self._daemon = await asyncio.to_thread(zenoh.open, client(self._endpoint))
            await asyncio.sleep(RETRY_S)

    def _leave(self) -> None:
        session, self._daemon = self._daemon, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _hear(self, sample: zenoh.Sample) -> None:
        """Zenoh's thread calls this for each frame."""
        if self._loop is not None:
            data, encoding = sample.payload.to_bytes(), sample.encoding
            self._loop.call_soon_threadsafe(self._pass_on, data, encoding)

    def _pass_on(self, data: bytes, encoding: zenoh.Encoding) -> None:
        assert self._loop is not None
        through = self.through(data, "read")
        if through:
            self._loop.call_later(self.delay_s("read"), self._put, through, encoding)

    def _put(self, data: bytes, encoding: zenoh.Encoding) -> None:
        if self._daemon is not None:
            with contextlib.suppress(zenoh.ZError):
                drop = zenoh.CongestionControl.DROP
                self._daemon.put(self._key, data, encoding=encoding, congestion_control=drop)


class Wires:
    """A context: inside it the three wires are there, in a thread of their own."""

    def __init__(self, rail: RailWire, regulator: RegulatorWire, mocap: MocapWire) -> None:
        self.rail, self.regulator, self.mocap = rail, regulator, mocap
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="wires", daemon=True)

    def __iter__(self) -> Iterator[RailWire | RegulatorWire | MocapWire]:
        yield from (self.rail, self.regulator, self.mocap)

    def __enter__(self) -> Self:
        self._thread.start()
        for wire in self:
            asyncio.run_coroutine_threadsafe(wire.open(), self._loop).result(10)
        return self

    def __exit__(self, *_: object) -> None:
        for wire in self:
            asyncio.run_coroutine_threadsafe(wire.close(), self._loop).result(10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)
        self._loop.close()
