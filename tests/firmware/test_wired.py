"""The relay between board and drive, with the real drivers and the drive's master in its process."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.regulator.driver import TeensyRegulator
from softarm.drivers.twin.dryve import DryveDevice, DryveServer
from softarm.drivers.twin.faults import Faults
from softarm.drivers.twin.teensy import TeensyPort
from softarm.schemas.config import DryveRail, SerialRegulator

pytestmark = pytest.mark.anyio
TICK_S = 0.033
MEASURED_KPA = 3.25


class Bench:
    """Bench whose board's clock advances by a tick with each answered command, so that its second passes fast."""

    def __init__(self, path: Path, board: Any, clock: Any, until: Any) -> None:
        self.board, self.clock, self._until = board, clock, until
        faults = Faults(clock)
        self.port = TeensyPort(path, board, faults, clock, lambda: MEASURED_KPA)
        self.drive = DryveDevice(DryveRail())
        self.drive.sense(0.0, 0.0)
        self.server = DryveServer("127.0.0.1", 0, self.drive, faults, clock)
        self.regulator = TeensyRegulator(SerialRegulator(port=str(path)), clock)
        self.rail: Any = None

    async def write_until(self, condition: Any, armed: bool, speak: bool = True) -> None:
        """Write as a control loop does; `speak` includes the board."""
        answered = self.regulator.read()

        def each() -> None:
            nonlocal answered
            if not speak or self.regulator.read() is not answered:
                answered = self.regulator.read()
                self.clock.advance(TICK_S)
            if speak:
                self.regulator.write(armed, 10.0)
            self.rail.write(armed, 0.0)
            self.port.step()
            self.server.step()
            self.drive.remote = self.board.relay_closed
            self.drive.watch(self.clock())

        await self._until(condition, each)

    async def armed(self) -> None:
        """Arm as the daemon does: both devices healthy and disarmed with DI7 high, then both armed."""
        await self.write_until(lambda: (reading := self.rail.read()) and reading.remote and not self.board.armed, False)
        await self.write_until(lambda: self.board.armed and self.rail.read().enabled, True)
        assert (self.board.set_point_kpa, self.regulator.read().pressure_kpa) == (10.0, MEASURED_KPA)


@pytest.fixture
async def bench(
    tmp_path: Path, make_board: Any, clock: Any, until: Any, running: Any, monkeypatch: Any
) -> AsyncIterator[Bench]:
    monkeypatch.setattr("softarm.drivers.regulator.driver.HELLO_S", 0.005)
    # The twin's drive has the board's clock.
    monkeypatch.setattr("softarm.drivers.twin.dryve.SILENCE_MAX_S", float("inf"))
    bench = Bench(tmp_path / "teensy", make_board(), clock, until)
    await bench.server.open()
    bench.port.open()
    bench.rail = DryveRailAxis(DryveRail(host="127.0.0.1", port=bench.server.port, timeout_s=1.0), 20)
    try:
        async with running(bench.regulator, bench.rail):
            yield bench
    finally:
        bench.port.close()
        await bench.server.close()


@pytest.mark.slow
async def test_the_drive_is_armed_over_the_relay_and_stopped_by_a_board_without_commands(bench: Any) -> None:
    await bench.armed()
    await bench.write_until(lambda: not bench.rail.read().remote, False)
    assert "enable input DI7 is low" in bench.rail.problem()
    await bench.armed()
    await bench.write_until(lambda: not bench.rail.read().enabled, True, speak=False)
    assert not bench.drive.in_operation
    assert (bench.board.armed, bench.board.set_point_kpa, bench.board.relay_closed) == (False, 0.0, False)
    await bench.write_until(lambda: "commands stopped" in (bench.regulator.problem() or ""), True)
    assert not bench.rail.read().enabled
    await bench.armed()
    await bench.regulator.stop()
    assert (bench.board.armed, bench.board.relay_closed) == (False, False)
