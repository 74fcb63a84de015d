"""Driver of the rail against a D1 on a TCP port: its requests, their times, and that none is repeated."""

import math
from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.rail.dryve import ModbusRequest
from softarm.schemas.config import DryveRail
from tests.drivers.rail.conftest import Answer

pytestmark = pytest.mark.anyio
ENABLE = [0x0100, 0x0006, 0x0007, 0x000F]


def missing(request: ModbusRequest) -> bytes:
    return dryve.encode_abort(request.transaction, 0x06020000)


async def test_the_drive_is_enabled_once_moves_and_is_read_back(bench: Any) -> None:
    bench.drive.position_m = 0.125
    await bench.enable(0.3)
    reading = bench.axis.read()
    assert reading.position_m == pytest.approx(0.125, abs=1e-5)
    assert (reading.velocity_m_s, reading.enabled, reading.remote, reading.faults) == (0.3, True, True, ())
    assert reading.t_receive_ns == bench.clock()
    assert bench.drive.writes(dryve.CONTROLWORD) == ENABLE
    assert bench.axis.problem() is None


async def test_mode_and_ramps_are_set_before_anything_moves(opened: Any) -> None:
    async with opened(acceleration_m_s2=4.0, quick_stop_m_s2=8.0) as bench:
        await bench.enable()
        assert bench.drive.writes(dryve.MODE) == [3]
        assert bench.drive.writes(dryve.ACCELERATION) == bench.drive.writes(dryve.DECELERATION) == [400_000]
        assert bench.drive.writes(dryve.QUICK_STOP) == [800_000]
        moving = [request.index == 0x60FF and request.data != bytes(4) for request, _ in bench.drive.requests]
        first_velocity = moving.index(True)
        assert {0x6060, 0x6083, 0x6084, 0x6085} <= {r.index for r, _ in bench.drive.requests[:first_velocity]}


async def test_a_ramp_that_does_not_read_back_keeps_the_drive_off(bench: Any) -> None:
    bench.drive.spoil(lambda request: dryve.encode_value(request, bytes(4)), dryve.ACCELERATION, data=None)
    await bench.write_until(lambda: bench.axis.read() is not None)
    await bench.write_until(lambda: len(bench.drive.requests) > 60, True, 0.3)
    assert "6083h:0 (profile acceleration) reads 0 after 600000 was written" in bench.axis.problem()
    assert "the drive is not enabled" in bench.axis.problem()
    assert bench.axis.read().faults == (bench.axis.problem(),)
    assert bench.drive.writes(dryve.CONTROLWORD) == [0x0100]


async def test_disabling_brakes_first_and_disables_the_drive_at_rest(bench: Any) -> None:
    await bench.enable()
    bench.drive.coasts = True
    await bench.write_until(lambda: bench.drive.writes(dryve.TARGET_VELOCITY)[-1] == 0)
    since = len(bench.drive.requests)
    await bench.write_until(lambda: len(bench.drive.requests) > since + 40)
    assert set(bench.drive.writes(dryve.TARGET_VELOCITY, since)) == {0}
    assert bench.drive.writes(dryve.CONTROLWORD, since) == []
    bench.drive.coasts = False
    await bench.write_until(lambda: not bench.axis.read().enabled)
    assert bench.drive.writes(dryve.CONTROLWORD, since) == [0x0006]
    assert bench.drive.state is DriveState.READY


async def test_braking_ends_after_a_second(bench: Any) -> None:
    await bench.enable()
    bench.drive.coasts = True
    since = len(bench.drive.requests)
    await bench.write_until(lambda: len(bench.drive.requests) > since + 20)
    bench.clock.advance(1.1)
    await bench.write_until(lambda: bench.drive.writes(dryve.CONTROLWORD, since) == [0x0006])


async def test_the_cart_brakes_when_a_set_point_expires_and_resumes_with_the_next(opened: Any) -> None:
    async with opened(hold_s=0.045) as bench:
        await bench.enable()
        since = len(bench.drive.requests)
        await bench.wait_until(lambda: len(bench.drive.requests) > since + 20)
        assert set(bench.drive.writes(dryve.TARGET_VELOCITY, since)) <= {30_000}
        bench.clock.advance(0.044)
        await bench.wait_until(lambda: len(bench.drive.requests) > since + 40)
        assert bench.drive.velocity_m_s == 0.3
        bench.clock.advance(0.002)
        await bench.wait_until(lambda: bench.drive.velocity_m_s == 0.0)
        assert bench.axis.read().enabled
        await bench.write_until(lambda: bench.drive.velocity_m_s == 0.2, True, 0.2)
        assert bench.axis.problem() is None


async def test_without_set_points_for_the_time_to_live_the_drive_is_disabled_until_armed_again(opened: Any) -> None:
    async with opened(time_to_live_s=0.15) as bench:
        await bench.enable()
        since = len(bench.drive.requests)
        bench.clock.advance(0.151)
        await bench.wait_until(lambda: bench.drive.state is DriveState.READY)
        await bench.wait_until(
            lambda: "no set-point for 0.15 s, so the drive is disabled" in (bench.axis.problem() or "")
        )
        count = len(bench.drive.requests)
        await bench.write_until(lambda: len(bench.drive.requests) > count + 40, True, 0.2)
        assert bench.drive.writes(dryve.CONTROLWORD, since) == [0x0006]
        assert bench.drive.velocity_m_s == 0.0
        await bench.write_until(lambda: len(bench.drive.requests) > count + 60)
        bench.clock.advance(2.1)
        await bench.enable()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
async def test_a_velocity_that_is_not_finite_is_zero(bench: Any, bad: float) -> None:
    await bench.enable()
    await bench.write_until(lambda: bench.drive.velocity_m_s == 0.0, True, bad)


async def test_a_dropped_connection_brakes_and_the_motion_does_not_resume(bench: Any) -> None:
    await bench.enable()
    since = len(bench.drive.requests)
    bench.faults.start("rail_drop_connection")
    await bench.write_until(lambda: bench.drive.state is DriveState.SWITCH_ON_DISABLED, True, 0.3)
    await bench.write_until(lambda: len(bench.drive.requests) > since + 60, True, 0.3)
    assert bench.drive.velocity_m_s == 0.0
    assert bench.drive.writes(dryve.CONTROLWORD, since) == [0x0100]
    assert "the connection was lost" in bench.axis.problem()
    assert "disarm, then arm" in bench.axis.problem()
    bench.clock.advance(2.1)
    await bench.write_until(lambda: len(bench.drive.requests) > since + 80)
    await bench.enable()


async def test_a_drive_found_in_operation_is_braked_before_anything_else(opened: Any) -> None:
    def in_operation(b: Any) -> None:
        b.drive.state = DriveState.OPERATION_ENABLED
        b.drive.coasts, b.drive.velocity_m_s = True, 0.5
        b.step()

    async with opened(prepare=in_operation) as bench:
        await bench.wait_until(lambda: len(bench.drive.requests) > 10)
        assert set(bench.drive.writes(dryve.TARGET_VELOCITY)) == {0}
        assert bench.drive.writes(dryve.CONTROLWORD) == [0x010F]
        assert bench.axis.read() is None
        bench.drive.coasts = False
        await bench.wait_until(lambda: bench.axis.read() is not None)
        assert bench.drive.writes(dryve.CONTROLWORD) == [0x010F, 0x0006]


async def test_a_missing_answer_ends_the_connection_and_nothing_is_repeated(opened: Any) -> None:
    async with opened(timeout_s=0.05) as bench:
        bench.drive.spoil(lambda _: b"", dryve.CONTROLWORD, data=b"\x07\x00", times=1)
        await bench.write_until(lambda: bench.axis.read() is not None)
        problems: list[str] = []
        await bench.write_until(
            lambda: problems.append(bench.axis.problem() or "") or "no answer within" in problems[-1], True, 0.3
        )
        since = len(bench.drive.requests)
        assert "write 6040h:0 (controlword): no answer within 0.05 s" in problems[-1]
        await bench.write_until(lambda: len(bench.drive.requests) > since + 40, True, 0.3)
        assert bench.drive.writes(dryve.CONTROLWORD) == [0x0100, 0x0006, 0x0007, 0x0100]
        assert bench.drive.velocity_m_s == 0.0


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (missing, "6041h:0 (statusword): the object does not exist"),
        (
            lambda request: request.transaction.to_bytes(2, "big") + bytes.fromhex("0000ffff"),
            "3 to 64 bytes are allowed, here 65535",
        ),
    ],
)
async def test_error_answers_are_reported(bench: Any, answer: Answer, words: str) -> None:
    bench.drive.spoil(answer)
    await bench.wait_until(lambda: words in (bench.axis.problem() or ""))
    assert bench.axis.problem().startswith(f"127.0.0.1:{bench.server.port}: ")
    assert "connecting again" in bench.axis.problem()


async def test_segmented_answers_are_joined(bench: Any) -> None:
    bench.faults.start("rail_segment")
    await bench.enable()


async def test_an_invalid_boot_state_is_reported_and_nothing_is_sent(bench: Any) -> None:
    bench.drive.spoil(lambda request: dryve.encode_value(request, b"\x04\x27"), dryve.STATUSWORD)
    await bench.write_until(lambda: bench.axis.read() is not None)
    await bench.write_until(lambda: len(bench.drive.requests) > 60, True, 0.3)
    assert bench.axis.read().faults == ("invalid boot state: power-cycle the drive (statusword 0x2704)",)
    assert bench.drive.writes(dryve.CONTROLWORD) == [0x0100]


async def test_the_hardware_e_stop_stops_the_cart_and_its_release_does_not_start_it(bench: Any) -> None:
    await bench.enable()
    bench.faults.start("remote_low")
    await bench.write_until(lambda: not bench.axis.read().remote, True, 0.3)
    await bench.write_until(lambda: bench.drive.velocity_m_s == 0.0, True, 0.3)
    assert "the enable input DI7 is low; release the hardware e-stop" in bench.axis.problem()
    bench.faults.start("clear")
    await bench.write_until(lambda: bench.axis.read().remote, True, 0.3)
    since = len(bench.drive.requests)
    await bench.write_until(lambda: len(bench.drive.requests) > since + 40, True, 0.3)
    assert bench.drive.velocity_m_s == 0.0
    assert bench.drive.writes(dryve.CONTROLWORD, since) == []
    await bench.write_until(lambda: len(bench.drive.requests) > since + 60)
    await bench.enable()


async def test_a_fault_is_reported_and_reset_only_on_request_while_disabled(bench: Any) -> None:
    await bench.enable()
    bench.faults.start("rail_fault")
    await bench.write_until(lambda: bench.axis.read().faults, True, 0.3)
    assert bench.axis.read().faults == ("E11 following error (0x8611)",)
    assert "the drive reports E11" in bench.axis.problem()
    since = len(bench.drive.requests)
    bench.axis.reset_fault()
    await bench.write_until(lambda: len(bench.drive.requests) > since + 40, True, 0.3)
    await bench.write_until(lambda: len(bench.drive.requests) > since + 80)
    assert bench.drive.writes(dryve.CONTROLWORD, since) == []
    bench.axis.reset_fault()
    await bench.write_until(lambda: not bench.axis.read().faults)
    assert bench.drive.writes(dryve.CONTROLWORD, since) == [0x0100, 0x0080, 0x0100]
    await bench.enable()


async def test_a_drive_that_cannot_be_enabled_is_reported(bench: Any) -> None:
    bench.drive.spoil(dryve.encode_acknowledgement, dryve.CONTROLWORD)
    await bench.write_until(lambda: bench.axis.read() is not None)
    await bench.write_until(lambda: 0x0006 in bench.drive.writes(dryve.CONTROLWORD), True, 0.3)
    await bench.pass_time(2.1, True, 0.3)
    await bench.write_until(lambda: "the drive stays in" in (bench.axis.problem() or ""), True, 0.3)
    assert "'switch-on disabled' (statusword 0x0640); check DI7" in bench.axis.problem()
    assert bench.drive.writes(dryve.CONTROLWORD) == [0x0100, 0x0006]


async def test_a_missing_drive_is_reported(free_port: int, until: Any, running: Any) -> None:
    axis = DryveRailAxis(DryveRail(host="127.0.0.1", port=free_port))
    async with running(axis):
        axis.write(True, 0.5)
        await until(lambda: "Connection refused" in (axis.problem() or ""))
        assert axis.problem().startswith(f"127.0.0.1:{free_port}: connect: ")
        assert "switch on 'Modbus TCP Gateway'" in axis.problem()
        assert axis.read() is None


@pytest.mark.parametrize("busy", [0, 1])
async def test_a_drive_that_is_not_homed_is_reported_and_never_enabled(bench: Any, busy: int) -> None:
    """Its status may miss one answer."""
    bench.drive.reference.homed = False
    bench.drive.spoil(lambda request: dryve.encode_exception(request.transaction, 6), dryve.HOMING_STATUS, times=busy)
    await bench.write_until(lambda: bench.axis.read() is not None and bench.axis.read().homed is False)
    await bench.pass_time(0.3, True, 0.3)
    assert 0x000F not in bench.drive.writes(dryve.CONTROLWORD)
    bench.drive.reference.homed = True
    await bench.write_until(lambda: bench.axis.read().homed is True)
    await bench.enable()


async def test_a_drive_that_loses_its_zero_with_its_supply_is_detected(bench: Any) -> None:
    await bench.enable()
    assert bench.axis.read().homed is True
    bench.drive.position_m, bench.drive.velocity_m_s = 0.1, 0.0
    bench.drive.move()
    bench.faults.start("rail_unreferenced")
    await bench.write_until(lambda: bench.axis.read().homed is False, True, 0.3)
    assert bench.axis.read().position_m == pytest.approx(-0.3)
    await bench.pass_time(0.3, False, 0.0)
    await bench.pass_time(0.3, True, 0.3)
    assert not bench.drive.in_operation


async def test_a_drive_that_loses_its_zero_in_a_fault_is_detected_after_the_reset(bench: Any) -> None:
    await bench.enable()
    bench.drive.trip(0x7305)
    bench.drive.reference.homed = False
    await bench.write_until(lambda: bench.axis.read().faults)
    assert bench.axis.read().homed is True
    bench.axis.reset_fault()
    await bench.write_until(lambda: bench.axis.read().homed is False)


@pytest.mark.parametrize(
    "answer",
    [missing, lambda request: dryve.encode_exception(request.transaction, 2), lambda _: b""],
    ids=["abort", "exception", "silence"],
)
async def test_a_drive_without_the_homing_status_can_fly(bench: Any, answer: Answer) -> None:
    bench.drive.spoil(answer, dryve.HOMING_STATUS)
    await bench.enable()
    assert bench.axis.read().homed is None
    assert len(bench.drive.links) == 1


async def test_a_reset_that_was_requested_without_a_connection_resets_no_later_fault(bench: Any, until: Any) -> None:
    await bench.write_until(lambda: bench.axis.read() is not None)
    await bench.server.close()
    await until(lambda: "connect" in (bench.axis.problem() or ""), lambda: bench.axis.write(False, 0.0))
    bench.axis.reset_fault()
    await bench.pass_time(0.1, False, 0.0)
    bench.drive.trip(0x8611)
    since = len(bench.drive.requests)
    await bench.server.open()
    await bench.write_until(lambda: bench.axis.read().faults)
    await bench.write_until(lambda: len(bench.drive.requests) > since + 40)
    assert 0x0080 not in bench.drive.writes(dryve.CONTROLWORD, since)


async def test_asks_homed_false_skips_the_homing_status(opened: Any) -> None:
    async with opened(asks_homed=False) as bench:
        bench.drive.reference.homed = False
        await bench.enable()
        assert bench.axis.read().homed is None
        assert not any(request.index == 0x2014 for request, _ in bench.drive.requests)


async def test_a_reversed_axis_is_read_and_driven_with_the_opposite_sign(opened: Any) -> None:
    async with opened(reversed=True) as bench:
        bench.drive.position_m = 0.1
        await bench.write_until(lambda: bench.axis.problem() is None and bench.axis.read() is not None)
        assert bench.axis.read().position_m == pytest.approx(-0.1)
        await bench.write_until(lambda: bench.drive.velocity_m_s == -0.3, True, 0.3)
        await bench.write_until(lambda: bench.axis.read().velocity_m_s == 0.3, True, 0.3)
        ramps = [
            w for entry in (dryve.ACCELERATION, dryve.DECELERATION, dryve.QUICK_STOP) for w in bench.drive.writes(entry)
        ]
        assert ramps == [600_000] * 3
