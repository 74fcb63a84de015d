"""Driver of the regulator against the twin's device behind a real pseudo-terminal."""

import os
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from softarm.drivers.regulator.cobs import Deframer, frame
from softarm.drivers.regulator.driver import Conversation, TeensyRegulator
from softarm.drivers.regulator.teensy import Fault, Hello, RegulatorCommand, RegulatorState, Welcome, decode, encode
from softarm.drivers.twin.faults import Faults
from softarm.drivers.twin.teensy import TeensyDevice, TeensyPort
from softarm.schemas.config import SerialRegulator

pytestmark = pytest.mark.anyio
MEASURED_KPA = 3.25


class Device(TeensyDevice):
    """Device that records the received messages."""

    def __init__(self) -> None:
        self.received: list[Any] = []
        self._spy = Deframer()
        super().__init__()

    def receive(self, data: bytes, now_ns: int, pressure_kpa: float) -> bytes:
        self.received += [decode(body)[0] for body in self._spy.feed(data)]
        return super().receive(data, now_ns, pressure_kpa)

    def commands(self) -> list[RegulatorCommand]:
        return [message for message in self.received if isinstance(message, RegulatorCommand)]


class Bench:
    """Driver and device with a manual clock."""

    def __init__(self, path: Path, clock: Any, until: Any) -> None:
        self.clock, self.path, self._until = clock, path, until
        self.device, self.faults = Device(), Faults(clock)
        self.port = TeensyPort(path, self.device, self.faults, clock, lambda: MEASURED_KPA)
        self.regulator = TeensyRegulator(SerialRegulator(port=str(path)), clock)

    async def write_until(self, condition: Any, armed: bool = False, pressure_kpa: float = 0.0) -> None:
        def each() -> None:
            self.regulator.write(armed, pressure_kpa)
            self.port.step()

        await self._until(condition, each)

    async def arm(self, pressure_kpa: float = 10.0) -> None:
        def disarmed() -> bool:
            commands = self.device.commands()
            return self.regulator.read() is not None and bool(commands) and not commands[-1].armed

        await self.write_until(disarmed)
        await self.write_until(lambda: self.regulator.read().armed, True, pressure_kpa)


@pytest.fixture
async def bench(tmp_path: Path, clock: Any, until: Any, running: Any, monkeypatch: Any) -> AsyncIterator[Bench]:
    monkeypatch.setattr("softarm.drivers.regulator.driver.RETRY_S", (0.005, 0.01))
    monkeypatch.setattr("softarm.drivers.regulator.driver.HELLO_S", 0.005)
    bench = Bench(tmp_path / "teensy", clock, until)
    bench.port.open()
    try:
        async with running(bench.regulator):
            yield bench
    finally:
        bench.port.close()


async def test_set_points_reach_the_device_and_the_sensor_is_read(bench: Any) -> None:
    await bench.arm(12.5)
    await bench.write_until(lambda: bench.device.set_point_kpa == 12.5, True, 12.5)
    reading = bench.regulator.read()
    assert reading.pressure_kpa == MEASURED_KPA
    assert reading.t_receive_ns == bench.clock()
    assert reading.faults == ()
    assert bench.regulator.problem() is None
    assert bench.device.commands()[-1].time_to_live_s == 0.1


async def test_without_writes_the_device_vents_until_disarmed_and_armed_again(bench: Any, until: Any) -> None:
    await bench.arm()
    await until(lambda: bench.regulator.read().sequence == len(bench.device.commands()) + 1)
    count = len(bench.device.received)
    bench.clock.advance(0.101)
    bench.port.step()
    assert bench.device.set_point_kpa == 0.0
    assert len(bench.device.received) == count
    await bench.write_until(lambda: not bench.regulator.read().armed, True, 10.0)
    assert "commands stopped, so the muscle was vented: disarm, then arm again" in bench.regulator.problem()
    assert bench.regulator.read().faults == ()
    await bench.write_until(lambda: len(bench.device.received) > count + 5, True, 10.0)
    assert bench.device.set_point_kpa == 0.0
    await bench.write_until(lambda: bench.regulator.problem() is None)
    await bench.arm()
    assert bench.device.set_point_kpa == 10.0


async def test_the_newest_set_point_replaces_older_ones(bench: Any, until: Any) -> None:
    await bench.arm()
    await until(lambda: bench.regulator.read().sequence == len(bench.device.commands()) + 1)
    since = len(bench.device.commands())
    for kpa in range(11, 20):
        bench.regulator.write(True, float(kpa))
    await until(lambda: bench.device.commands()[-1].pressure_kpa == 19.0)
    sent = [command.pressure_kpa for command in bench.device.commands()[since:]]
    assert sent == sorted(sent)


async def test_stop_vents_and_frees_the_port(bench: Any, running: Any) -> None:
    await bench.arm()
    await bench.regulator.stop()
    await bench._until(lambda: not bench.device.armed)
    assert not bench.device.commands()[-1].armed
    again = TeensyRegulator(SerialRegulator(port=str(bench.path)), bench.clock)
    async with running(again):
        await bench._until(lambda: again.problem() is None)
    bench.regulator.write(True, 5.0)


@pytest.mark.parametrize("bad_kpa", [float("nan"), float("inf")])
async def test_nan_and_infinity_vent(bench: Any, bad_kpa: float) -> None:
    await bench.arm()
    await bench.write_until(lambda: not bench.regulator.read().armed, True, bad_kpa)
    assert bench.device.set_point_kpa == 0.0


async def test_a_set_point_out_of_range_is_rejected_and_reported(bench: Any) -> None:
    await bench.arm()
    await bench.write_until(lambda: bench.regulator.read().faults, True, 25.0)
    assert "out of range (allowed: -0.7 to 20.0 kPa" in bench.regulator.problem()
    assert bench.device.set_point_kpa == 10.0


async def test_garbled_answers_are_dropped_and_reported(bench: Any) -> None:
    await bench.arm()
    bench.faults.start("serial_garbage")
    before = bench.regulator.read()
    count = len(bench.device.received)
    await bench.write_until(lambda: len(bench.device.received) > count + 20, True, 10.0)
    bench.clock.advance(0.3)
    assert "no answer for 0.3 s" in bench.regulator.problem()
    assert "check the cable" in bench.regulator.problem()
    assert bench.regulator.read().sequence < len(bench.device.commands())
    bench.faults.start("clear")
    await bench.write_until(lambda: bench.regulator.problem() is None)
    assert bench.regulator.read().t_receive_ns > before.t_receive_ns


async def test_silence_reopens_the_port_and_greets_again(bench: Any) -> None:
    def tick() -> str:
        bench.clock.advance(0.05)
        return bench.regulator.problem() or ""

    await bench.arm()
    bench.faults.start("serial_silence")
    await bench.write_until(lambda: "no answer for 0." in tick(), True, 10.0)
    await bench.write_until(lambda: "no answer for 1 s" in tick(), True, 10.0)
    hellos = sum(isinstance(message, Hello) for message in bench.device.received)
    bench.faults.start("clear")
    await bench.write_until(lambda: bench.regulator.problem() is None)
    assert sum(isinstance(message, Hello) for message in bench.device.received) > hellos
    assert not bench.device.armed


async def test_a_port_that_vanishes_while_open_comes_back_disarmed(bench: Any) -> None:
    await bench.arm()
    bench.faults.start("serial_unplug")
    await bench.write_until(lambda: "No such file or directory" in (bench.regulator.problem() or ""), True, 10.0)
    assert "plug the Teensy in" in bench.regulator.problem()
    bench.faults.start("clear")
    count = len(bench.device.received)
    await bench.write_until(lambda: len(bench.device.received) > count + 5, True, 10.0)
    assert not bench.device.armed
    await bench.arm()


async def test_a_device_that_restarts_is_greeted_again(bench: Any) -> None:
    await bench.arm()
    bench.port.device = bench.device = Device()
    await bench.write_until(lambda: bench.regulator.read().faults == () and bench.device.accepted_sequence)
    await bench.arm()


async def test_a_port_that_cannot_be_opened_is_reported(tmp_path: Path, until: Any, running: Any) -> None:
    (tmp_path / "plain").write_text("no port")
    regulator = TeensyRegulator(SerialRegulator(port=str(tmp_path / "plain")))
    async with running(regulator):
        await until(lambda: "set drivers.regulator.port to a serial port" in (regulator.problem() or ""))
        assert f"{tmp_path / 'plain'}: open: " in (regulator.problem() or "")
        regulator.write(True, 5.0)
        assert regulator.read() is None


async def test_a_port_held_by_another_process_is_reported(bench: Bench, until: Any, running: Any) -> None:
    await bench.write_until(lambda: bench.regulator.problem() is None)
    rival = TeensyRegulator(SerialRegulator(port=str(bench.path)), bench.clock)
    async with running(rival):
        await until(lambda: "another process holds the port: stop it" in (rival.problem() or ""))


def test_an_echo_of_the_sent_bytes_is_reported(clock: Any) -> None:
    conversation = Conversation(0.1)
    conversation.receive(conversation.greeting(clock()))
    assert not conversation.known
    assert "echoes" in str(conversation.complaint)


def test_commands_wait_for_the_token(clock: Any) -> None:
    conversation = Conversation(0.1)
    assert conversation.command(True, 5.0, clock()) == b""
    conversation.receive(frame(encode(Welcome(77), 1, 1)))
    [body] = Deframer().feed(conversation.command(True, 5.0, clock()))
    assert decode(body)[0] == RegulatorCommand(77, 0.1, True, 5.0)
    conversation.receive(frame(encode(RegulatorState(0, False, Fault.TOKEN, 0.0), 2, 1)))
    assert conversation.command(True, 5.0, clock()) == b""


def receive(conversation: Conversation, message: Any, sequence: int) -> RegulatorState | None:
    return conversation.receive(frame(encode(message, sequence, 0)))


def test_a_repeated_state_is_not_a_new_reading(clock: Any) -> None:
    conversation = Conversation(0.1)
    receive(conversation, Welcome(77), 2**32 - 2)
    conversation.command(True, 5.0, clock())
    state = RegulatorState(1, True, Fault(0), 5.0)
    assert receive(conversation, state, 2**32 - 1) == state
    assert receive(conversation, state, 0) == state
    clock.advance(0.5)
    conversation.command(True, 5.0, clock())
    for old in (0, 0, 2**32 - 1):
        assert receive(conversation, state, old) is None
    assert "message 4294967295 is repeated or late" in str(conversation.complaint)
    assert conversation.dropped == 3
    assert conversation.unanswered_since_ns == clock()
    assert receive(conversation, state, 1) == state
    assert conversation.complaint is None


def test_an_answer_to_an_earlier_connection_is_not_a_reading() -> None:
    conversation = Conversation(0.1)
    assert receive(conversation, RegulatorState(1, True, Fault(0), 5.0), 9) is None
    receive(conversation, Welcome(77), 10)
    assert conversation.known


def test_an_old_welcome_does_not_change_the_token(clock: Any) -> None:
    conversation = Conversation(0.1)
    receive(conversation, Welcome(1), 5)
    receive(conversation, Welcome(2), 6)
    receive(conversation, Welcome(1), 5)
    [body] = Deframer().feed(conversation.command(True, 5.0, clock()))
    assert decode(body)[0] == RegulatorCommand(2, 0.1, True, 5.0)


async def test_a_thousand_other_descriptors_do_not_matter(bench: Any, many_descriptors: Any) -> None:
    bench.faults.start("serial_unplug")
    await bench.write_until(lambda: "plug the Teensy in" in (bench.regulator.problem() or ""))
    with many_descriptors():
        bench.faults.start("clear")
        await bench.arm()
        assert bench.regulator.problem() is None
        await bench.regulator.stop()
        assert not bench.device.commands()[-1].armed


def test_the_twin_does_not_replace_a_real_device(tmp_path: Path, clock: Any) -> None:
    path = tmp_path / "ttyACM0"
    path.write_text("the real thing")
    port = TeensyPort(path, TeensyDevice(), Faults(clock), clock, lambda: 0.0)
    with pytest.raises(Exception, match=r"another file exists there; set drivers\.regulator\.port"):
        port.open()
    assert path.read_text() == "the real thing"
    assert not os.path.islink(path)
