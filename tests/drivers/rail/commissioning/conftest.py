"""Two drives on real TCP ports, in worlds whose time passes when the tool waits."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.commissioning.session import DriveSession
from softarm.drivers.rail.settings import Settings, settings_of
from softarm.drivers.twin.dryve import LIMIT_SWITCH
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail
from softarm.schemas.robot import RAIL_TRAVEL_M
from tests.drivers.rail.conftest import Drive as RecordingDrive
from tests.drivers.rail.conftest import Server
from validation.outside.body import Body
from validation.outside.drive import Drive, Port
from validation.outside.robot import STEP_S, Robot

FINE_S = 0.001


class World:
    """Clock and cart of a test; the tool waits by `pause`. A subclass has `position_m` and `move(seconds)`.

    The functions in `at` are called as time passes, until they return True.
    """

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000
        self.port = 0
        self.at: list[Callable[[], bool]] = []
        self.speeds_m_s: list[float] = []

    def clock(self) -> int:
        return self.now_ns

    def pause(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / FINE_S))):
            self.now_ns += round(FINE_S * 1e9)
            self.move(FINE_S)
            self.at = [each for each in self.at if not each()]

    def settings(self, **changes: Any) -> Settings:
        return settings_of(DryveRail(host="127.0.0.1", port=self.port, timeout_s=1.0))._replace(**changes)

    def session(self, **changes: Any) -> DriveSession:
        return DriveSession(self.settings(**changes), self.clock, self.pause)


class TwinWorld(World):
    """World of the twin's drive, with a cart that follows exactly."""

    def __init__(self) -> None:
        super().__init__()
        self.drive = RecordingDrive(DryveRail())
        self.server = Server("127.0.0.1", 0, self.drive, Faults(self.clock), self.clock)
        self.position_m = 0.0

    @property
    def words(self) -> list[int]:
        """Return all controlwords."""
        return self.drive.writes(dryve.CONTROLWORD)

    def put(self, position_m: float) -> None:
        self.position_m = position_m
        self.drive.sense(position_m, 0.0)

    def move(self, seconds: float) -> None:
        speed_m_s = self.drive.target_velocity_m_s
        self.speeds_m_s.append(speed_m_s)
        self.position_m += speed_m_s * seconds
        if abs(self.position_m) > RAIL_TRAVEL_M and self.drive.state is not DriveState.FAULT:
            self.drive.trip(LIMIT_SWITCH)
        self.drive.sense(self.position_m, speed_m_s)


class OutsideWorld(World):
    """World of the robot that is built from docs/reference/wires.md alone, with inertia."""

    def __init__(self, start_m: float) -> None:
        super().__init__()
        self.drive = Drive(0.02, keep=True, friction_n=3.0, unreferenced_at_m=start_m)
        self.robot = Robot(Body(cart_m=start_m), self.drive, bound_m=0.3)
        self.words: list[int] = []
        self._answer = self.drive.answer
        self.drive.answer = self.answer  # type: ignore[method-assign]

    def answer(self, telegram: bytes, now: float) -> bytes:
        request = dryve.decode_request(telegram)
        if request.data is not None and request.index == dryve.CONTROLWORD.index:
            self.words.append(int.from_bytes(request.data, "little"))
        return self._answer(telegram, self.now_ns * 1e-9)

    @property
    def position_m(self) -> float:
        return self.robot.body.cart_m

    def move(self, seconds: float) -> None:
        assert seconds == STEP_S
        self.robot.step(self.now_ns * 1e-9)
        self.speeds_m_s.append(self.robot.body.cart_m_s)


@pytest.fixture
def twin(served: Any) -> Iterator[TwinWorld]:
    world = TwinWorld()
    with served(world.server):
        world.port = world.server.port
        yield world


@pytest.fixture
def outside(free_port: int) -> Iterator[OutsideWorld]:
    world, ended = OutsideWorld(0.25), threading.Event()
    world.port = free_port
    world.pause(0.01)
    port = Port(world.drive, "127.0.0.1", free_port)

    def serve() -> None:
        while not ended.is_set():
            port.serve(world.now_ns * 1e-9)
            ended.wait(0.0002)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    with contextlib.ExitStack() as undo:
        undo.callback(port.close)
        undo.callback(thread.join, 20)
        undo.callback(ended.set)
        yield world
