"""Driver of the rail against a D1 on a TCP port: its requests, their times, and that none is repeated."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.twin.dryve import DryveDevice, DryveServer
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail

ENABLE = [0x0100, 0x0006, 0x0007, 0x000F]


def test_the_drive_is_enabled_once_moves_and_is_read_back(bench: Any) -> None:
    async def script(b: Any) -> None:
        b.drive.position_m = 0.125
        await b.enable(0.3)
        reading = b.axis.read()
        assert reading.position_m == pytest.approx(0.125, abs=1e-5)
        assert (reading.velocity_m_s, reading.enabled, reading.remote, reading.faults) == (0.3, True, True, ())
        assert reading.t_receive_ns == b.clock()
        assert b.drive.writes(dryve.CONTROLWORD) == ENABLE
        assert b.axis.problem() is None

    bench(script)


def test_mode_and_ramps_are_set_before_anything_moves(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        assert b.drive.writes(dryve.MODE) == [3]
        assert b.drive.writes(dryve.ACCELERATION) == b.drive.writes(dryve.DECELERATION) == [400_000]
        assert b.drive.writes(dryve.QUICK_STOP) == [800_000]
        moving = [request.index == 0x60FF and request.data != bytes(4) for request, _ in b.drive.requests]
        first_velocity = moving.index(True)
        assert {0x6060, 0x6083, 0x6084, 0x6085} <= {r.index for r, _ in b.drive.requests[:first_velocity]}

    bench(script, acceleration_m_s2=4.0, quick_stop_m_s2=8.0)


def test_a_ramp_that_does_not_read_back_keeps_the_drive_off(bench: Any) -> None:
    def lie(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        wrong = telegram[9:14] == bytes.fromhex("0000006083")
        return telegram[:5] + b"\x11" + telegram[6:] + bytes(4) if wrong else answer()

    async def script(b: Any) -> None:
        b.drive.script = lie
        await b.write_until(lambda: b.axis.read() is not None)
        await b.write_until(lambda: len(b.drive.requests) > 60, True, 0.3)
        assert "6083h:0 (profile acceleration) reads 0 after 600000 was written" in b.axis.problem()
        assert "the drive is not enabled" in b.axis.problem()
        assert b.axis.read().faults == (b.axis.problem(),)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100]

    bench(script)


def test_disabling_brakes_first_and_disables_the_drive_at_rest(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        b.drive.coasts = True
        await b.write_until(lambda: b.drive.writes(dryve.TARGET_VELOCITY)[-1] == 0)
        since = len(b.drive.requests)
        await b.write_until(lambda: len(b.drive.requests) > since + 40)
        assert set(b.drive.writes(dryve.TARGET_VELOCITY, since)) == {0}
        assert b.drive.writes(dryve.CONTROLWORD, since) == []
        b.drive.coasts = False
        await b.write_until(lambda: not b.axis.read().enabled)
        assert b.drive.writes(dryve.CONTROLWORD, since) == [0x0006]
        assert b.drive.state is DriveState.READY

    bench(script)


def test_braking_ends_after_a_second(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        b.drive.coasts = True
        since = len(b.drive.requests)
        await b.write_until(lambda: len(b.drive.requests) > since + 20)
        b.clock.advance(1.1)
        await b.write_until(lambda: b.drive.writes(dryve.CONTROLWORD, since) == [0x0006])

    bench(script)


def test_the_cart_brakes_when_a_set_point_expires_and_resumes_with_the_next(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        since = len(b.drive.requests)
        await b.wait_until(lambda: len(b.drive.requests) > since + 20)
        assert set(b.drive.writes(dryve.TARGET_VELOCITY, since)) <= {30_000}
        b.clock.advance(0.044)
        await b.wait_until(lambda: len(b.drive.requests) > since + 40)
        assert b.drive.velocity_m_s == 0.3
        b.clock.advance(0.002)
        await b.wait_until(lambda: b.drive.velocity_m_s == 0.0)
        assert b.axis.read().enabled
        await b.write_until(lambda: b.drive.velocity_m_s == 0.2, True, 0.2)
        assert b.axis.problem() is None

    bench(script, hold_s=0.045)


def test_without_set_points_for_the_time_to_live_the_drive_is_disabled_until_armed_again(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        since = len(b.drive.requests)
        b.clock.advance(0.151)
        await b.wait_until(lambda: b.drive.state is DriveState.READY)
        await b.wait_until(lambda: "no set-point for 0.15 s, so the drive is disabled" in (b.axis.problem() or ""))
        count = len(b.drive.requests)
        await b.write_until(lambda: len(b.drive.requests) > count + 40, True, 0.2)
        assert b.drive.writes(dryve.CONTROLWORD, since) == [0x0006]
        assert b.drive.velocity_m_s == 0.0
        await b.write_until(lambda: len(b.drive.requests) > count + 60)
        b.clock.advance(2.1)
        await b.enable()

    bench(script, time_to_live_s=0.15)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_velocity_that_is_not_finite_is_zero(bench: Any, bad: float) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        await b.write_until(lambda: b.drive.velocity_m_s == 0.0, True, bad)

    bench(script)


def test_stop_brakes_and_disables_the_drive(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        await b.stop()
        assert b.drive.state is DriveState.READY
        assert b.drive.writes(dryve.CONTROLWORD)[-1] == 0x0006
        assert b.drive.writes(dryve.TARGET_VELOCITY)[-1] == 0

    bench(script)


def test_a_dropped_connection_brakes_and_the_motion_does_not_resume(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        since = len(b.drive.requests)
        b.faults.start("rail_drop_connection")
        await b.write_until(lambda: b.drive.state is DriveState.SWITCH_ON_DISABLED, True, 0.3)
        await b.write_until(lambda: len(b.drive.requests) > since + 60, True, 0.3)
        assert b.drive.velocity_m_s == 0.0
        assert b.drive.writes(dryve.CONTROLWORD, since) == [0x0100]
        assert "the connection was lost" in b.axis.problem()
        assert "disarm, then arm" in b.axis.problem()
        b.clock.advance(2.1)
        await b.write_until(lambda: len(b.drive.requests) > since + 80)
        await b.enable()

    bench(script)


def test_a_drive_found_in_operation_is_braked_before_anything_else(bench: Any) -> None:
    def in_operation(b: Any) -> None:
        b.drive.state = DriveState.OPERATION_ENABLED
        b.drive.coasts, b.drive.velocity_m_s = True, 0.5
        b.step()

    async def script(b: Any) -> None:
        await b.wait_until(lambda: len(b.drive.requests) > 10)
        assert set(b.drive.writes(dryve.TARGET_VELOCITY)) == {0}
        assert b.drive.writes(dryve.CONTROLWORD) == [0x010F]
        assert b.axis.read() is None
        b.drive.coasts = False
        await b.wait_until(lambda: b.axis.read() is not None)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x010F, 0x0006]

    bench(script, prepare=in_operation)


def test_a_missing_answer_ends_the_connection_and_nothing_is_repeated(bench: Any) -> None:
    lost: list[bytes] = []

    def lose_the_first_switch_on(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        if telegram[9:14].hex() == "0100006040" and telegram[19:21].hex() == "0700" and not lost:
            lost.append(telegram)
            return b""
        return answer()

    async def script(b: Any) -> None:
        b.drive.script = lose_the_first_switch_on
        await b.write_until(lambda: b.axis.read() is not None)
        problems: list[str] = []

        def keep_problem() -> bool:
            problems.append(b.axis.problem() or "")
            return True

        await b.write_until(
            lambda: problems.append(b.axis.problem() or "") or "no answer within" in problems[-1], True, 0.3
        )
        since = len(b.drive.requests)
        assert "write 6040h:0 (controlword): no answer within 0.05 s" in problems[-1]
        await b.write_until(lambda: len(b.drive.requests) > since + 40, True, 0.3)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100, 0x0006, 0x0007, 0x0100]
        assert b.drive.velocity_m_s == 0.0

    bench(script, timeout_s=0.05)


def test_answers_to_other_requests_are_skipped(bench: Any) -> None:
    previous = [b""]

    def repeat(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        late, previous[0] = previous[0], answer()
        return late + previous[0]

    async def script(b: Any) -> None:
        b.drive.script = repeat
        await b.enable()
        assert b.axis.read().velocity_m_s == 0.3

    bench(script)


def test_an_answer_with_a_wrong_transaction_id_is_ignored(bench: Any) -> None:
    def wrong(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        return b"\x77\x77" + answer()[2:]

    async def script(b: Any) -> None:
        b.drive.script = wrong
        await b.wait_until(lambda: "no answer within 0.02" in (b.axis.problem() or ""))
        assert "(2 answers to other requests)" in b.axis.problem()
        assert b.axis.read() is None

    bench(script, timeout_s=0.05)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda t: dryve.encode_abort(t, 0x06020000), "6041h:0 (statusword): the object does not exist"),
        (lambda t: dryve.encode_exception(t, 6), "6041h:0 (statusword): busy (Modbus exception 0x06)"),
        (lambda t: t.to_bytes(2, "big") + bytes.fromhex("0000ffff"), "3 to 64 bytes are allowed, here 65535"),
        (lambda t: t.to_bytes(2, "big") + bytes.fromhex("00000003002b0d"), "not an answer to a request for 6041h"),
    ],
)
def test_error_answers_are_reported(bench: Any, answer: Callable[[int], bytes], words: str) -> None:
    async def script(b: Any) -> None:
        b.drive.script = lambda telegram, _: answer(int.from_bytes(telegram[:2], "big"))
        await b.wait_until(lambda: words in (b.axis.problem() or ""))
        assert b.axis.problem().startswith(f"127.0.0.1:{b.server.port}: ")
        assert "connecting again" in b.axis.problem()

    bench(script)


def test_a_velocity_of_two_bytes_is_rejected(bench: Any) -> None:
    def shorten(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        whole = answer()
        if telegram[9:14].hex() != "000000606c":
            return whole
        return whole[:5] + b"\x0f" + whole[6:18] + b"\x02" + whole[19:21]

    async def script(b: Any) -> None:
        b.drive.script = shorten
        await b.wait_until(lambda: "2 bytes for 606Ch:0 (velocity actual)" in (b.axis.problem() or ""))
        assert b.axis.read() is None

    bench(script)


def test_segmented_answers_are_joined(bench: Any) -> None:
    async def script(b: Any) -> None:
        b.faults.start("rail_segment")
        await b.enable()

    bench(script)


def test_an_invalid_boot_state_is_reported_and_nothing_is_sent(bench: Any) -> None:
    def invalid(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        whole = answer()
        return whole[:19] + b"\x04\x27" if telegram[9:14].hex() == "0000006041" else whole

    async def script(b: Any) -> None:
        b.drive.script = invalid
        await b.write_until(lambda: b.axis.read() is not None)
        await b.write_until(lambda: len(b.drive.requests) > 60, True, 0.3)
        assert b.axis.read().faults == ("invalid boot state: power-cycle the drive (statusword 0x2704)",)
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100]

    bench(script)


def test_the_hardware_e_stop_stops_the_cart_and_its_release_does_not_start_it(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        b.faults.start("remote_low")
        await b.write_until(lambda: not b.axis.read().remote, True, 0.3)
        await b.write_until(lambda: b.drive.velocity_m_s == 0.0, True, 0.3)
        assert "the enable input DI7 is low; release the hardware e-stop" in b.axis.problem()
        b.faults.start("clear")
        await b.write_until(lambda: b.axis.read().remote, True, 0.3)
        since = len(b.drive.requests)
        await b.write_until(lambda: len(b.drive.requests) > since + 40, True, 0.3)
        assert b.drive.velocity_m_s == 0.0
        assert b.drive.writes(dryve.CONTROLWORD, since) == []
        await b.write_until(lambda: len(b.drive.requests) > since + 60)
        await b.enable()

    bench(script)


def test_a_fault_is_reported_and_reset_only_on_request_while_disabled(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        b.faults.start("rail_fault")
        await b.write_until(lambda: b.axis.read().faults, True, 0.3)
        assert b.axis.read().faults == ("E11 following error (0x8611)",)
        assert "the drive reports E11" in b.axis.problem()
        since = len(b.drive.requests)
        b.axis.reset_fault()
        await b.write_until(lambda: len(b.drive.requests) > since + 40, True, 0.3)
        await b.write_until(lambda: len(b.drive.requests) > since + 80)
        assert b.drive.writes(dryve.CONTROLWORD, since) == []
        b.axis.reset_fault()
        await b.write_until(lambda: not b.axis.read().faults)
        assert b.drive.writes(dryve.CONTROLWORD, since) == [0x0100, 0x0080, 0x0100]
        await b.enable()

    bench(script)


def test_a_drive_that_cannot_be_enabled_is_reported(bench: Any) -> None:
    def refuse(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        if telegram[9:14].hex() == "0100006040":
            return dryve.encode_acknowledgement(dryve.decode_request(telegram))
        return answer()

    async def script(b: Any) -> None:
        b.drive.script = refuse
        await b.write_until(lambda: b.axis.read() is not None)
        await b.write_until(lambda: 0x0006 in b.drive.writes(dryve.CONTROLWORD), True, 0.3)
        await b.pass_time(2.1, True, 0.3)
        await b.write_until(lambda: "the drive stays in" in (b.axis.problem() or ""), True, 0.3)
        assert "'switch-on disabled' (statusword 0x0640); check DI7" in b.axis.problem()
        assert b.drive.writes(dryve.CONTROLWORD) == [0x0100, 0x0006]

    bench(script)


def test_a_missing_drive_is_reported(free_port: int, run: Any, until: Any, running: Any) -> None:
    async def play() -> None:
        axis = DryveRailAxis(DryveRail(host="127.0.0.1", port=free_port))
        async with running(axis):
            axis.write(True, 0.5)
            await until(lambda: "Connection refused" in (axis.problem() or ""))
            assert axis.problem().startswith(f"127.0.0.1:{free_port}: connect: ")
            assert "switch on 'Modbus TCP Gateway'" in axis.problem()
            assert axis.read() is None

    run(play())


def test_the_twin_reports_a_port_in_use(clock: Any, run: Any) -> None:
    async def play() -> None:
        config = DryveRail(host="127.0.0.1")
        first = DryveServer("127.0.0.1", 0, DryveDevice(config), Faults(clock), clock)
        await first.open()
        second = DryveServer("127.0.0.1", first.port, DryveDevice(config), Faults(clock), clock)
        with pytest.raises(Exception, match=r"listen as the rail: .*set drivers\.rail\.host to 127\.0\.0\.1"):
            await second.open()
        await first.close()

    run(play())


def test_a_drive_that_is_not_homed_is_reported_and_never_enabled(bench: Any) -> None:
    async def script(b: Any) -> None:
        b.drive.reference.homed = False
        await b.write_until(lambda: b.axis.read() is not None)
        assert b.axis.read().homed is False
        await b.pass_time(0.3, True, 0.3)
        assert 0x000F not in b.drive.writes(dryve.CONTROLWORD)
        b.drive.reference.homed = True
        await b.write_until(lambda: b.axis.read().homed is True)
        await b.enable()

    bench(script)


def test_a_drive_that_loses_its_zero_with_its_supply_is_detected(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        assert b.axis.read().homed is True
        b.drive.position_m, b.drive.velocity_m_s = 0.1, 0.0
        b.drive.move()
        b.faults.start("rail_unreferenced")
        await b.write_until(lambda: b.axis.read().homed is False, True, 0.3)
        assert b.axis.read().position_m == pytest.approx(-0.3)
        await b.pass_time(0.3, False, 0.0)
        await b.pass_time(0.3, True, 0.3)
        assert not b.drive.in_operation

    bench(script)


def test_a_drive_that_loses_its_zero_in_a_fault_is_detected_after_the_reset(bench: Any) -> None:
    async def script(b: Any) -> None:
        await b.enable()
        b.drive.trip(0x7305)
        b.drive.reference.homed = False
        await b.write_until(lambda: b.axis.read().faults)
        assert b.axis.read().homed is True
        b.axis.reset_fault()
        await b.write_until(lambda: b.axis.read().homed is False)

    bench(script)


@pytest.mark.parametrize(
    "answer",
    [lambda t: dryve.encode_abort(t, 0x06020000), lambda t: dryve.encode_exception(t, 2), lambda _: b""],
    ids=["abort", "exception", "silence"],
)
def test_a_drive_without_the_homing_status_can_fly(bench: Any, answer: Callable[[int], bytes]) -> None:
    def without(telegram: bytes, regular: Callable[[], bytes]) -> bytes:
        return answer(int.from_bytes(telegram[:2], "big")) if telegram[12:14] == b"\x20\x14" else regular()

    async def script(b: Any) -> None:
        b.drive.script = without
        await b.enable()
        assert b.axis.read().homed is None
        assert len(b.drive.links) == 1

    bench(script)


def test_asks_homed_false_skips_the_homing_status(bench: Any) -> None:
    async def script(b: Any) -> None:
        b.drive.reference.homed = False
        await b.enable()
        assert b.axis.read().homed is None
        assert not any(request.index == 0x2014 for request, _ in b.drive.requests)

    bench(script, asks_homed=False)


def test_a_reversed_axis_is_read_and_driven_with_the_opposite_sign(bench: Any) -> None:
    async def script(b: Any) -> None:
        b.drive.position_m = 0.1
        await b.write_until(lambda: b.axis.problem() is None and b.axis.read() is not None)
        assert b.axis.read().position_m == pytest.approx(-0.1)
        await b.write_until(lambda: b.drive.velocity_m_s == -0.3, True, 0.3)
        await b.write_until(lambda: b.axis.read().velocity_m_s == 0.3, True, 0.3)
        ramps = [
            w for entry in (dryve.ACCELERATION, dryve.DECELERATION, dryve.QUICK_STOP) for w in b.drive.writes(entry)
        ]
        assert ramps == [600_000] * 3

    bench(script, reversed=True)
