"""The regulator board receives disarmed commands while a tool uses the drive."""

import time
from pathlib import Path
from typing import Any

from softarm.drivers.rail.commissioning.relay import Relay
from softarm.drivers.twin.faults import Faults
from softarm.drivers.twin.teensy import TeensyDevice, TeensyPort
from softarm.schemas.config import SerialRegulator
from tests.processes import until


class Served(TeensyPort):
    """Port that is opened and closed by coroutines."""

    async def open(self) -> None:  # type: ignore[override]
        super().open()

    async def close(self) -> None:  # type: ignore[override]
        super().close()


def test_a_held_relay_sends_disarmed_commands(tmp_path: Path, served: Any) -> None:
    device, config = TeensyDevice(), SerialRegulator(port=str(tmp_path / "regulator"))
    port = Served(Path(config.port), device, Faults(time.monotonic_ns), time.monotonic_ns, lambda: 0.0)
    with served(port), Relay(config) as relay:
        until(lambda: relay.hold() or (relay.problem() is None and device.accepted_sequence >= 5))
        assert not device.armed
        assert not device.faults


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
