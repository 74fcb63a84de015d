"""The rail's driver against a D1 on a TCP port: what it sends, when, and never twice."""

import asyncio
import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.rail.dryve import ModbusRequest
from softarm.drivers.twin.dryve import DryveDevice, DryveServer
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail

WALK = [0x0100, 0x0006, 0x0007, 0x000F]


class Drive(DryveDevice):
    """Remembers what it was asked; `script` may answer in its place, `coasts` delays its motion, and `stubborn` keeps
    its set-point when its master is gone.
    """

    def __init__(self, config: DryveRail) -> None:
        super().__init__(config)
        self.heard: list[tuple[ModbusRequest, DriveState]] = []
        self.links: list[list[ModbusRequest]] = []  # the same by connection
        self.stubborn = False
        self.script: Callable[[bytes, Callable[[], bytes]], bytes] | None = None
        self.position_m = self.velocity_m_s = 0.0
        self.coasts = False

    def answer(self, telegram: bytes, now_ns: int) -> bytes:
        self.heard.append((dryve.decode_request(telegram), self.state))
        self.links[-1].append(self.heard[-1][0])
        if self.script is None:
            return super().answer(telegram, now_ns)
        return self.script(telegram, lambda: super(Drive, self).answer(telegram, now_ns))

    def move(self) -> None:
        self.velocity_m_s = self.velocity_m_s if self.coasts else self.target_velocity_m_s
        self.sense(self.position_m, self.velocity_m_s)

    def quick_stop(self) -> None:
        if not self.stubborn:
            super().quick_stop()

    def writes(self, entry: dryve.Entry, since: int = 0) -> list[int]:
        return [
            int.from_bytes(request.data, "little", signed=entry.signed)
            for request, _ in self.heard[since:]
            if request.data is not None and (request.index, request.sub) == (entry.index, entry.sub)
        ]


class Server(DryveServer):
    """Tells the drive of each connection."""

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.device.links.append([])  # type: ignore[attr-defined]
        await super()._serve(reader, writer)


class Bench:
    """Driver and drive; the driver's clock stands still until told, the drive's own watchdog never bites."""

    def __init__(self, clock: Any, until: Any, config: DryveRail) -> None:
        self.clock, self._until = clock, until
        self.drive, self.faults = Drive(config), Faults(clock)
        self.server = Server("127.0.0.1", 0, self.drive, self.faults, lambda: 0)
        self.config = config
        self.axis: DryveRailAxis

    async def open(self) -> None:
        await self.server.open()
        self.config = self.config.model_copy(update={"port": self.server.port})
        self.axis = DryveRailAxis(self.config, self.clock)

    def step(self) -> None:
        self.server.step()
        self.drive.move()

    async def stop(self) -> None:
        mover = asyncio.create_task(self._until(lambda: False, self.step))
        await self.axis.stop()
        mover.cancel()

    async def write_until(self, condition: Any, enable: bool = False, velocity_m_s: float = 0.0) -> None:
        def each() -> None:
            self.axis.write(enable, velocity_m_s)
            self.step()

        await self._until(condition, each)

    async def wait_until(self, condition: Any) -> None:
        await self._until(condition, self.step)

    async def enable(self, velocity_m_s: float = 0.3) -> None:
        await self.write_until(lambda: self.axis.problem() is None and self.axis.read() is not None)
        await self.write_until(lambda: self.drive.velocity_m_s == velocity_m_s, True, velocity_m_s)
        await self.write_until(lambda: self.axis.read().velocity_m_s == velocity_m_s, True, velocity_m_s)


@pytest.fixture
def bench(clock: Any, until: Any, run: Any, running: Any, monkeypatch: Any) -> Any:
    monkeypatch.setattr("softarm.drivers.rail.driver.RETRY_S", (0.005, 0.01))
    monkeypatch.setattr("softarm.drivers.rail.driver.POLL_S", 0.005)

    async def play(script: Any, config: DryveRail, prepare: Any) -> None:
        bench = Bench(clock, until, config)
        prepare(bench)
        await bench.open()
        try:
            async with running(bench.axis):
                await script(bench)
                await bench.stop()
        finally:
            await bench.server.close()
        no_word_was_sent_twice_and_operation_kept_its_bits(bench.drive)

    def start(script: Any, prepare: Any = lambda b: None, **config: Any) -> None:
        run(play(script, DryveRail(host="127.0.0.1", timeout_s=1.0).model_copy(update=config), prepare))

    return start


def no_word_was_sent_twice_and_operation_kept_its_bits(drive: Drive) -> None:
    words = [(r, state) for r, state in drive.heard if (r.index, bool(r.data)) == (0x6040, True)]
    for (earlier, _), (later, _) in itertools.pairwise(words):
        repeated = earlier.data == later.data and earlier.transaction == later.transaction
        assert not repeated
    for request, state in words:
        value = int.from_bytes(request.data or b"", "little")
        assert state is not DriveState.OPERATION_ENABLED or value & 0x0F == 0x0F or value == 0x0006


def test_walks_up_once_drives_and_reads_back(bench: Any) -> None:
    async def script(b: Bench) -> None:
        b.drive.position_m = 0.125
        await b.enable(0.3)
        reading = b.axis.read()
        assert reading.position_m == pytest.approx(0.125, abs=1e-5)
        assert (reading.velocity_m_s, reading.enabled, reading.remote, reading.faults) == (0.3, True, True, ())
        assert reading.t_receive_ns == b.clock()
        assert b.drive.writes(dryve.CONTROLWORD) == WALK
        assert b.axis.problem() is None

    bench(script)


def test_mode_and_ramps_are_set_before_anything_moves(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        assert b.drive.writes(dryve.MODE) == [3]
        assert b.drive.writes(dryve.ACCELERATION) == b.drive.writes(dryve.DECELERATION) == [400_000]
        assert b.drive.writes(dryve.QUICK_STOP) == [800_000]
        moving = [request.index == 0x60FF and request.data != bytes(4) for request, _ in b.drive.heard]
        first_velocity = moving.index(True)
        assert {0x6060, 0x6083, 0x6084, 0x6085} <= {r.index for r, _ in b.drive.heard[:first_velocity]}

    bench(script, acceleration_m_s2=4.0, quick_stop_m_s2=8.0)


def test_a_ramp_that_does_not_read_back_keeps_the_drive_off(bench: Any) -> None:
    def lie(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        wrong = telegram[9:14] == bytes.fromhex("0000006083")
        return telegram[:5] + b"\x11" + telegram[6:] + bytes(4) if wrong else answer()

    async def script(b: Bench) -> None:
        b.drive.script = lie
        await b.write_until(lambda: b.axis.read() is not None)
        await b.write_until(lambda: len(b.drive.heard) > 60, True, 0.3)
        assert "6083h:0 (profile acceleration) reads 0 after 600000 was written" in b.axis.problem()
        assert "it is not enabled" in b.axis.problem()
        assert b.axis.read().faults == (b.axis.problem(),)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100]

    bench(script)


def test_disabling_brakes_first_and_switches_off_at_rest(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        b.drive.coasts = True
        since = len(b.drive.heard)
        await b.write_until(lambda: len(b.drive.heard) > since + 40)
        assert set(b.drive.writes(dryve.TARGET_VELOCITY, since)) == {0}
        assert b.drive.writes(dryve.CONTROLWORD, since) == []
        b.drive.coasts = False
        await b.write_until(lambda: not b.axis.read().enabled)
        assert b.drive.writes(dryve.CONTROLWORD, since) == [0x0006]
        assert b.drive.state is DriveState.READY

    bench(script)


def test_a_brake_that_never_ends_is_cut_after_a_second(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        b.drive.coasts = True
        since = len(b.drive.heard)
        await b.write_until(lambda: len(b.drive.heard) > since + 20)
        b.clock.advance(1.1)
        await b.write_until(lambda: b.drive.writes(dryve.CONTROLWORD, since) == [0x0006])

    bench(script)


def test_without_writes_for_a_tenth_of_a_second_zero_is_sent(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        since = len(b.drive.heard)
        await b.wait_until(lambda: len(b.drive.heard) > since + 20)
        assert set(b.drive.writes(dryve.TARGET_VELOCITY, since)) <= {30_000}  # between writes nothing changes
        b.clock.advance(0.09)
        await b.wait_until(lambda: len(b.drive.heard) > since + 40)
        assert b.drive.velocity_m_s == 0.3
        b.clock.advance(0.02)
        await b.wait_until(lambda: b.drive.velocity_m_s == 0.0)
        assert "no set-point for 0.1 s, so zero was sent; see what keeps the control loop" in b.axis.problem()
        await b.write_until(lambda: b.drive.velocity_m_s == 0.2, True, 0.2)  # a late loop may go on

    bench(script)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_velocity_that_is_not_finite_is_zero(bench: Any, bad: float) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        await b.write_until(lambda: b.drive.velocity_m_s == 0.0, True, bad)

    bench(script)


def test_stop_brakes_switches_off_and_hangs_up(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        await b.stop()
        assert b.drive.state is DriveState.READY
        assert b.drive.writes(dryve.CONTROLWORD)[-1] == 0x0006
        assert b.drive.writes(dryve.TARGET_VELOCITY)[-1] == 0

    bench(script)


def test_a_dropped_connection_brakes_and_does_not_bring_the_motion_back(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        since = len(b.drive.heard)
        b.faults.rail_drop_connection()
        await b.write_until(lambda: b.drive.state is DriveState.SWITCH_ON_DISABLED, True, 0.3)
        await b.write_until(lambda: len(b.drive.heard) > since + 60, True, 0.3)
        assert b.drive.velocity_m_s == 0.0
        assert b.drive.writes(dryve.CONTROLWORD, since) == [0x0100]
        assert "the connection was lost" in b.axis.problem()
        assert "disarm, then arm" in b.axis.problem()
        b.clock.advance(2.1)
        await b.write_until(lambda: len(b.drive.heard) > since + 80)
        await b.enable()

    bench(script)


def test_a_drive_found_in_operation_is_braked_before_anything_else(bench: Any) -> None:
    def in_operation(b: Bench) -> None:
        b.drive.state = DriveState.OPERATION_ENABLED
        b.drive.coasts, b.drive.velocity_m_s = True, 0.5
        b.step()

    async def script(b: Bench) -> None:
        await b.wait_until(lambda: len(b.drive.heard) > 10)
        assert set(b.drive.writes(dryve.TARGET_VELOCITY)) == {0}
        assert b.drive.writes(dryve.CONTROLWORD) == [0x010F]
        assert b.axis.read() is None
        b.drive.coasts = False
        await b.wait_until(lambda: b.axis.read() is not None)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x010F, 0x0006]

    bench(script, prepare=in_operation)


def test_an_answer_that_never_comes_ends_the_connection_and_nothing_is_sent_again(bench: Any) -> None:
    lost: list[bytes] = []

    def lose_the_first_switch_on(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        if telegram[9:14].hex() == "0100006040" and telegram[19:21].hex() == "0700" and not lost:
            lost.append(telegram)
            return b""
        return answer()

    async def script(b: Bench) -> None:
        b.drive.script = lose_the_first_switch_on
        await b.write_until(lambda: b.axis.read() is not None)
        told: list[str] = []
        await b.write_until(lambda: told.append(b.axis.problem() or "") or "no answer within" in told[-1], True, 0.3)
        since = len(b.drive.heard)
        assert "write 6040h:0 (controlword): no answer within 0.05 s" in told[-1]
        await b.write_until(lambda: len(b.drive.heard) > since + 40, True, 0.3)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100, 0x0006, 0x0007, 0x0100]
        assert b.drive.velocity_m_s == 0.0

    bench(script, timeout_s=0.05)


def test_answers_to_other_requests_are_skipped(bench: Any) -> None:
    previous = [b""]

    def repeat(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        late, previous[0] = previous[0], answer()
        return late + previous[0]  # the last answer once more, then the right one

    async def script(b: Bench) -> None:
        b.drive.script = repeat
        await b.enable()
        assert b.axis.read().velocity_m_s == 0.3

    bench(script)


def test_a_wrong_transaction_id_is_never_believed(bench: Any) -> None:
    def wrong(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        return b"\x77\x77" + answer()[2:]

    async def script(b: Bench) -> None:
        b.drive.script = wrong
        await b.wait_until(lambda: "no answer within 0.05 s" in (b.axis.problem() or ""))
        assert "(2 answers to other requests)" in b.axis.problem()  # the first stop's, and this one's
        assert b.axis.read() is None

    bench(script, timeout_s=0.05)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda t: dryve.encode_abort(t, 0x06020000), "6041h:0 (statusword): the object does not exist"),
        (lambda t: dryve.encode_exception(t, 6), "6041h:0 (statusword): busy (Modbus exception 0x06)"),
        (lambda t: t.to_bytes(2, "big") + bytes.fromhex("0000ffff"), "3 to 64 bytes, here 65535"),
        (lambda t: t.to_bytes(2, "big") + bytes.fromhex("00000003002b0d"), "no answer to a request for 6041h"),
    ],
)
def test_error_answers_are_told(bench: Any, answer: Callable[[int], bytes], words: str) -> None:
    async def script(b: Bench) -> None:
        b.drive.script = lambda telegram, _: answer(int.from_bytes(telegram[:2], "big"))
        await b.wait_until(lambda: words in (b.axis.problem() or ""))
        assert b.axis.problem().startswith(f"127.0.0.1:{b.server.port}: ")
        assert "connecting again" in b.axis.problem()

    bench(script)


STOP = ("60ff", bytes(4))
BAD_ANSWERS = {
    "refused": lambda t: dryve.encode_abort(t, 0x08000022),
    "busy": lambda t: dryve.encode_exception(t, 6),
    "garbled": lambda t: bytes.fromhex("ffffffffffffffffff"),
    "another's": lambda t: (t ^ 0x5500).to_bytes(2, "big") + bytes.fromhex("00000003002b0d"),
    "cut short": lambda t: t.to_bytes(2, "big") + bytes.fromhex("00000003002b0d"),
    "none": lambda t: b"",
}


def ends(link: list[ModbusRequest]) -> tuple[Any, Any]:
    return tuple((f"{request.index:04x}", request.data) for request in (link[0], link[-1]))  # type: ignore[return-value]


@pytest.mark.parametrize("kind", BAD_ANSWERS)
def test_a_link_begins_and_ends_with_a_stop_whatever_is_answered(bench: Any, kind: str) -> None:
    async def script(b: Bench) -> None:
        b.drive.stubborn = True  # nothing but what is said stops it
        await b.enable()
        b.drive.script = lambda telegram, _: BAD_ANSWERS[kind](int.from_bytes(telegram[:2], "big"))
        await b.write_until(lambda: len(b.drive.links) > 3, True, 0.3)
        assert [ends(link) for link in b.drive.links[:3]] == [(STOP, STOP)] * 3

    bench(script, timeout_s=0.02)


def test_a_link_that_is_left_in_peace_begins_and_ends_with_a_stop_too(bench: Any, until: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        await b.stop()
        await until(lambda: ends(b.drive.links[0]) == (STOP, STOP))

    bench(script)


@pytest.mark.parametrize("kind", BAD_ANSWERS)
@pytest.mark.parametrize("index", [0x60FF, 0x6041, 0x6064, 0x606C])
def test_one_bad_answer_does_not_end_a_link_in_motion(bench: Any, kind: str, index: int) -> None:
    async def script(b: Bench) -> None:
        await b.enable(0.3)
        spoilt: list[int] = []

        def spoil(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
            if int.from_bytes(telegram[12:14], "big") == index and not spoilt:
                spoilt.append(index)
                return BAD_ANSWERS[kind](int.from_bytes(telegram[:2], "big"))
            return answer()

        b.drive.script = spoil
        await b.write_until(lambda: spoilt, True, 0.4)
        await b.write_until(lambda: b.axis.read().velocity_m_s == 0.4, True, 0.4)
        assert len(b.drive.links) == 1
        assert b.axis.read().enabled
        assert b.axis.problem() is None

    bench(script, timeout_s=0.05)


def test_a_set_point_that_was_refused_once_is_said_again_without_waiting_for_the_next(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable(0.3)
        refused: list[int] = []

        def refuse(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
            if telegram[12:14].hex() == "60ff" and telegram[9] and not refused:
                refused.append(1)
                return dryve.encode_abort(int.from_bytes(telegram[:2], "big"), 0x08000022)
            return answer()

        b.drive.script = refuse
        b.axis.write(True, 0.0)  # once
        await b.wait_until(lambda: refused and b.drive.velocity_m_s == 0.0)

    bench(script)


@pytest.mark.parametrize("storm", [3, 40, 150])  # telegrams; a link's end falls within the longer ones
def test_a_cart_in_motion_is_stopped_as_soon_as_refusals_end(
    bench: Any, storm: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softarm.drivers.rail.driver.RETRY_S", (0.005, 60.0))  # no pause may grow meanwhile

    async def script(b: Bench) -> None:
        b.drive.stubborn = True
        await b.enable(0.3)
        began = len(b.drive.heard)

        def refuse(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
            if len(b.drive.heard) <= began + storm:
                return dryve.encode_abort(int.from_bytes(telegram[:2], "big"), 0x08000022)
            return answer()

        b.drive.script = refuse
        await b.write_until(lambda: len(b.drive.heard) > began + storm, True, 0.3)
        await b.write_until(lambda: b.drive.velocity_m_s == 0.0, True, 0.3)
        after = [request for request, _ in b.drive.heard[began + storm :]]
        stops = [request.index == 0x60FF and request.data == bytes(4) for request in after]
        assert stops.index(True) <= 1

    bench(script)


def test_two_bytes_for_a_velocity_are_no_reading(bench: Any) -> None:
    def shorten(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        whole = answer()
        if telegram[9:14].hex() != "000000606c":
            return whole
        return whole[:5] + b"\x0f" + whole[6:18] + b"\x02" + whole[19:21]

    async def script(b: Bench) -> None:
        b.drive.script = shorten
        await b.wait_until(lambda: "2 bytes for 606Ch:0 (velocity actual)" in (b.axis.problem() or ""))
        assert b.axis.read() is None

    bench(script)


def test_segmented_answers_are_put_together(bench: Any) -> None:
    async def script(b: Bench) -> None:
        b.faults.rail_segment()
        await b.enable()

    bench(script)


def test_an_invalid_boot_state_is_told_and_left_alone(bench: Any) -> None:
    def invalid(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        whole = answer()
        return whole[:19] + b"\x04\x27" if telegram[9:14].hex() == "0000006041" else whole

    async def script(b: Bench) -> None:
        b.drive.script = invalid
        await b.write_until(lambda: b.axis.read() is not None)
        await b.write_until(lambda: len(b.drive.heard) > 60, True, 0.3)
        assert b.axis.read().faults == ("invalid boot state: power-cycle the drive (statusword 0x2704)",)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100]

    bench(script)


def test_the_hardware_e_stop_stops_and_its_release_does_not_start(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        b.faults.remote_low()
        await b.write_until(lambda: not b.axis.read().remote, True, 0.3)
        await b.write_until(lambda: b.drive.velocity_m_s == 0.0, True, 0.3)
        assert "the enable input DI7 is low; release the hardware e-stop" in b.axis.problem()
        b.faults.clear()
        await b.write_until(lambda: b.axis.read().remote, True, 0.3)
        since = len(b.drive.heard)
        await b.write_until(lambda: len(b.drive.heard) > since + 40, True, 0.3)
        assert b.drive.velocity_m_s == 0.0
        assert b.drive.writes(dryve.CONTROLWORD, since) == []
        await b.write_until(lambda: len(b.drive.heard) > since + 60)
        await b.enable()

    bench(script)


def test_a_fault_is_named_kept_while_nobody_acknowledges_and_reset_when_asked(bench: Any) -> None:
    async def script(b: Bench) -> None:
        await b.enable()
        b.faults.rail_fault()
        await b.write_until(lambda: b.axis.read().faults, True, 0.3)
        assert b.axis.read().faults == ("E11 following error (0x8611)",)
        assert "the drive reports E11" in b.axis.problem()
        since = len(b.drive.heard)
        b.axis.reset_fault()  # while enable is still wanted: ignored
        await b.write_until(lambda: len(b.drive.heard) > since + 40, True, 0.3)
        await b.write_until(lambda: len(b.drive.heard) > since + 80)
        assert b.drive.writes(dryve.CONTROLWORD, since) == []
        b.axis.reset_fault()
        await b.write_until(lambda: not b.axis.read().faults)
        assert b.drive.writes(dryve.CONTROLWORD, since) == [0x0100, 0x0080, 0x0100]
        await b.enable()

    bench(script)


def test_a_drive_that_will_not_walk_up_is_told(bench: Any) -> None:
    def refuse(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        if telegram[9:14].hex() == "0100006040":
            return dryve.encode_acknowledgement(dryve.decode_request(telegram))
        return answer()

    async def script(b: Bench) -> None:
        b.drive.script = refuse
        await b.write_until(lambda: b.axis.read() is not None)
        await b.write_until(lambda: 0x0006 in b.drive.writes(dryve.CONTROLWORD), True, 0.3)
        b.clock.advance(2.1)
        await b.write_until(lambda: "the drive stays in" in (b.axis.problem() or ""), True, 0.3)
        assert "'switch-on disabled' (statusword 0x0640); check DI7" in b.axis.problem()
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100, 0x0006]

    bench(script)


def test_an_absent_drive_is_told(free_port: int, run: Any, until: Any, running: Any) -> None:
    async def play() -> None:
        axis = DryveRailAxis(DryveRail(host="127.0.0.1", port=free_port))
        async with running(axis):
            axis.write(True, 0.5)
            await until(lambda: "Connect call failed" in (axis.problem() or ""))
            assert axis.problem().startswith(f"127.0.0.1:{free_port}: connect: ")
            assert "switch on 'Modbus TCP Gateway'" in axis.problem()
            assert axis.read() is None

    run(play())


def test_a_port_that_is_taken_is_told_by_the_twin(clock: Any, run: Any) -> None:
    async def play() -> None:
        config = DryveRail(host="127.0.0.1")
        first = DryveServer("127.0.0.1", 0, DryveDevice(config), Faults(clock), clock)
        await first.open()
        second = DryveServer("127.0.0.1", first.port, DryveDevice(config), Faults(clock), clock)
        with pytest.raises(Exception, match=r"listen as the rail: .*set drivers\.rail\.host to 127\.0\.0\.1"):
            await second.open()
        await first.close()

    run(play())
