"""The whole twin in real time, with the daemon's drivers and without."""

import json
from pathlib import Path
from typing import Any

import pytest
import zenoh

from softarm.drivers.base import DeviceError
from softarm.drivers.bodies.independent import IndependentBody
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.drivers.mocap.driver import ZenohMocapSource
from softarm.drivers.mocap.zenoh_session import listener
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.regulator.driver import TeensyRegulator
from softarm.drivers.twin.cameras import FAULT_KEY, STATE_KEY
from softarm.drivers.twin.main import DeviceClock, EndStops, Twin
from softarm.schemas.config import Config, Drivers, DryveRail, Mocap, SerialRegulator
from tests.processes import free_port

pytestmark = pytest.mark.anyio


@pytest.fixture
def config(tmp_path: Path) -> Config:
    return Config(
        drivers=Drivers(
            mocap=Mocap(endpoint=f"tcp/127.0.0.1:{free_port()}"),
            # The longest time to live that the device accepts, because tests share a busy machine.
            regulator=SerialRegulator(port=str(tmp_path / "wires" / "teensy"), time_to_live_s=0.25),
            rail=DryveRail(host="127.0.0.1", port=free_port(), timeout_s=1.0),
        )
    )


class Hands:
    """The daemon's three drivers, and a loop that writes."""

    def __init__(self, config: Config, until: Any) -> None:
        self.mocap = ZenohMocapSource(config.drivers.mocap)
        self.regulator = TeensyRegulator(config.drivers.regulator)
        self.rail = DryveRailAxis(config.drivers.rail, 20)
        self.frames: list[Any] = []
        self._until = until

    def problems(self) -> list[str | None]:
        return [self.mocap.problem(), self.regulator.problem(), self.rail.problem()]

    async def write_until(self, condition: Any, armed: bool = False, command: tuple[float, float] = (0, 0)) -> None:
        def each() -> None:
            self.regulator.write(armed, command[1])
            self.rail.write(armed, command[0])
            self.frames += self.mocap.read(self.mocap.clock())

        await self._until(condition, each)

    async def arm(self) -> None:
        """Arm once all devices are healthy."""
        await self.write_until(lambda: self.problems() == [None] * 3 and self.regulator.read() and self.rail.read())

        def armed() -> bool:
            return self.rail.read().enabled and self.regulator.read().armed

        await self.write_until(armed, True)


@pytest.mark.realtime
@pytest.mark.parametrize("make", [pytest.param(SimulatedBody, marks=pytest.mark.slow), IndependentBody])
async def test_the_drivers_move_the_twin_and_their_silence_stops_it(
    config: Config, until: Any, running: Any, make: Any
) -> None:
    hands = Hands(config, until)
    async with running(hands.mocap, hands.regulator, hands.rail):
        await until(lambda: all(hands.problems()))
        async with Twin(config, body=make()) as twin:
            await hands.arm()
            await hands.write_until(lambda: hands.frames, True)
            start = hands.frames[-1].bodies
            await hands.write_until(lambda: twin.state.cart_velocity_m_s < -0.2, True, (-0.3, 15.0))
            await hands.write_until(lambda: hands.regulator.read().pressure_kpa > 5.0, True, (-0.3, 15.0))
            # The tip first swings out the other way.
            await hands.write_until(lambda: hands.frames[-1].bodies[5].y_m < start[5].y_m, True, (-0.3, 15.0))
            assert hands.frames[-1].bodies[0].y_m < start[0].y_m
            assert hands.rail.read().position_m == pytest.approx(twin.state.cart_position_m, abs=0.05)
            sequences = [frame.sequence for frame in hands.frames]
            assert sequences == sorted(set(sequences))
            # The loop dies: no further writes.
            await until(lambda: twin.state.vented and abs(twin.state.cart_velocity_m_s) < 0.05)
            assert twin.state.crashes == 0
            assert twin.state.vented_since_ns is not None


@pytest.mark.slow
async def test_faults_reach_the_drivers(config: Config, until: Any, running: Any) -> None:
    async with Twin(config) as twin:
        hands = Hands(config, until)
        async with running(hands.mocap, hands.regulator, hands.rail):
            await hands.write_until(lambda: hands.problems() == [None] * 3)
            twin.faults.start("mocap_drop_body", body="link3")
            await hands.write_until(lambda: not hands.frames[-1].bodies[3].tracked)
            assert [body.tracked for body in hands.frames[-1].bodies].count(False) == 1
            twin.faults.start("clear")
            twin.faults.start("mocap_garbage")
            await hands.write_until(lambda: hands.mocap.malformed == 1)
            twin.faults.start("mocap_stuck")
            await hands.write_until(lambda: hands.frames[-1].bodies == hands.frames[-2].bodies)
            twin.faults.start("clear")
            twin.faults.start("mocap_freeze")
            await hands.write_until(lambda: "no frame for" in (hands.mocap.problem() or ""))


def test_delays_of_the_twin_do_not_count_as_silence(clock: Any) -> None:
    device_clock = DeviceClock(clock)
    start_ns = device_clock()
    for _ in range(12):
        clock.advance(1 / 120)
        device_clock.step()
    assert device_clock() - start_ns == pytest.approx(0.1e9, rel=1e-6)
    clock.advance(5.0)
    device_clock.step()
    assert device_clock() - start_ns == pytest.approx(0.125e9, rel=1e-6)


async def test_a_second_twin_is_refused_and_the_first_keeps_its_ports(config: Config) -> None:
    async with Twin(config):
        there = Path(config.drivers.regulator.port).readlink()
        with pytest.raises(DeviceError, match=r"listen as the rail: .*set drivers\.rail\.host to 127\.0\.0\.1"):
            async with Twin(config):
                pass
        assert Path(config.drivers.regulator.port).readlink() == there


@pytest.mark.slow
async def test_the_twin_outlives_the_daemon_and_removes_its_link(
    config: Config, until: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    async with Twin(config):
        assert Path(config.drivers.regulator.port).is_symlink()
        for _ in range(2):
            await watch_and_break(config, until)
    assert "unknown fault 'nonsense'" in capsys.readouterr().out
    assert not Path(config.drivers.regulator.port).is_symlink()


async def watch_and_break(config: Config, until: Any) -> None:
    session = zenoh.open(listener(config.drivers.mocap.endpoint))
    try:
        states = session.declare_subscriber(STATE_KEY, zenoh.handlers.RingChannel(64))
        frames = session.declare_subscriber(config.drivers.mocap.key, zenoh.handlers.RingChannel(64))
        await until(states.try_recv)
        await until(frames.try_recv)
        session.put(FAULT_KEY, b'{"fault": "nonsense"}')
        newest: list[dict[str, Any]] = [{}]

        def look() -> None:
            while (sample := states.try_recv()) is not None:
                newest.append(json.loads(sample.payload.to_bytes()))

        session.put(FAULT_KEY, b'{"fault": "rail_fault"}')
        await until(lambda: newest[-1].get("drive") == "fault", look)
        assert newest[-1]["vented"] is True
        assert newest[-1]["crashes"] == 0
    finally:
        session.close()


@pytest.mark.parametrize("body", [SimulatedBody, IndependentBody])
def test_a_cart_that_stays_at_the_end_of_its_travel_has_crashed_once(body: Any) -> None:
    made = body()
    ends, struck = EndStops(made.travel_m), []
    for velocity_m_s in (*[1.0] * 120, *[-0.2] * 60, *[1.0] * 60):
        made.step(velocity_m_s, 0.0, 8_333_334)
        struck.append(ends.update(made.truth.cart_position_m))
    assert ends.crashes == struck.count(True) == 2
    assert 0.25 < struck.index(True) / 120 < 0.6
    assert made.truth.cart_velocity_m_s == pytest.approx(0.0, abs=1e-3)
    assert ends.cart_max_abs_m == made.travel_m
