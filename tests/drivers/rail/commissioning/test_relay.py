"""The regulator board receives disarmed commands while a tool uses the drive."""

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from softarm.drivers.rail.commissioning.relay import Relay
from softarm.drivers.twin.faults import Faults
from softarm.drivers.twin.teensy import TeensyDevice, TeensyPort
from softarm.schemas.config import SerialRegulator

PATIENCE_S = 20.0


class Board(TeensyDevice):
    """Board that records its answers."""

    def __init__(self) -> None:
        super().__init__()
        self.states: list[bytes] = []

    def receive(self, data: bytes, now_ns: int, pressure_kpa: float) -> bytes:
        answer = super().receive(data, now_ns, pressure_kpa)
        self.states.append(answer)
        return answer


@pytest.fixture
def board(tmp_path: Path) -> Iterator[tuple[Board, SerialRegulator]]:
    board, ready, ended = Board(), threading.Event(), asyncio.Event()
    config = SerialRegulator(port=str(tmp_path / "regulator"))
    loop = asyncio.new_event_loop()

    async def serve() -> None:
        port = TeensyPort(Path(config.port), board, Faults(time.monotonic_ns), time.monotonic_ns, lambda: 0.0)
        port.open()
        ready.set()
        await ended.wait()
        port.close()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    assert ready.wait(PATIENCE_S)
    yield board, config
    loop.call_soon_threadsafe(ended.set)
    thread.join(PATIENCE_S)
    loop.close()


def test_a_held_relay_sends_disarmed_commands(board: tuple[Board, SerialRegulator]) -> None:
    device, config = board
    until_s = time.monotonic() + PATIENCE_S
    with Relay(config) as relay:
        while (relay.problem() is not None or len(device.states) < 5) and time.monotonic() < until_s:
            relay.hold()
            threading.Event().wait(0.002)
        assert relay.problem() is None
        assert not device.armed
        assert not device.faults
    assert len(device.states) >= 5


def test_commands_are_sent_at_most_every_20_ms(tmp_path: Path) -> None:
    now_s = [0.0]
    sent: list[tuple[bool, float]] = []
    with Relay(SerialRegulator(port=str(tmp_path / "none")), lambda: now_s[0]) as relay:
        relay._regulator.write = lambda *command: sent.append(command)  # type: ignore[method-assign]
        for _ in range(1000):
            relay.hold()
            now_s[0] += 0.001
    assert set(sent) == {(False, 0.0)}
    assert 45 <= len(sent) <= 51
