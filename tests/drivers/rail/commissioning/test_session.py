"""Homing over real TCP: the twin's drive, and one written from docs/reference/wires.md alone."""

from typing import Any

import pytest

from softarm.drivers.base import DeviceError
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState
from tests.drivers.rail.conftest import refused
from tests.drivers.wires_page import vectors

START, HALT, OFF = 0x001F, 0x010F, 0x0006


def test_the_simulated_drive_is_homed_slowly_and_left_disabled(twin: Any) -> None:
    twin.put(0.05)
    twin.drive.power_cycle()
    with twin.session() as session:
        assert (session.homed(), session.method()) == (False, 17)
        assert session.poll().position_m == pytest.approx(-0.3)
        found = session.home(0.05, 0.01)
        assert session.poll().state is DriveState.READY
    assert found.confirmed is True
    assert found.position_m == pytest.approx(twin.position_m, abs=2e-5)
    assert found.axis_m == pytest.approx(found.position_m + 0.3)
    assert -0.2855 < twin.position_m < -0.284
    assert {round(abs(speed), 6) for speed in twin.speeds_m_s} == {0.0, 0.05, 0.01}
    assert twin.words.count(START) == 1
    assert twin.words[-1] == OFF
    assert twin.drive._values[dryve.MODE] == dryve.PROFILE_VELOCITY


def test_the_independent_drive_is_homed_by_its_own_method(outside: Any) -> None:
    with outside.session() as session:
        assert (session.homed(), session.method()) == (False, 18)
        assert session.poll().position_m == pytest.approx(-0.3, abs=1e-4)
        found = session.home(0.05, 0.01)
        assert session.poll().out_of_operation
    assert found.confirmed is True
    assert found.position_m == pytest.approx(outside.position_m, abs=1e-3)
    assert outside.position_m == pytest.approx(0.29, abs=2e-3)
    assert max(map(abs, outside.speeds_m_s)) < 0.07
    assert outside.robot.crashes == 0
    assert outside.words.count(START) == 1


def test_a_failure_is_reported_and_the_drive_is_disabled(twin: Any) -> None:
    twin.drive.power_cycle()
    twin.at.append(lambda: twin.position_m < -0.01 and (twin.drive.trip(0x8611) or True))
    with twin.session() as session, pytest.raises(DeviceError, match="E11 following error"):
        session.home(0.05, 0.01)
    assert not twin.drive.in_operation
    assert set(twin.words[twin.words.index(START) + 1 :]) <= {HALT, OFF}


def test_a_drive_that_is_not_homed_after_its_search_is_an_error(twin: Any) -> None:
    update = twin.drive.reference.update

    def forgetful(position_m: float) -> None:
        update(position_m)
        twin.drive.reference.homed = False

    twin.drive.reference.update = forgetful
    with twin.session() as session, pytest.raises(DeviceError, match="reports that it is not homed"):
        session.home(0.05, 0.01)


def test_a_drive_in_operation_is_reported_and_disabled(twin: Any) -> None:
    twin.drive.state = DriveState.OPERATION_ENABLED
    with twin.session() as session:
        assert session.was_operating
    assert twin.words == [HALT, OFF]


def test_a_speed_that_the_drive_does_not_accept_moves_nothing(twin: Any) -> None:
    twin.drive.spoil(lambda request: dryve.encode_value(request, bytes(4)), dryve.HOMING_SPEED, data=None)
    with (
        twin.session() as session,
        pytest.raises(DeviceError, match=r"6099h:1.*reads 0 after 5000 was written.*nothing moved"),
    ):
        session.home(0.05, 0.01)
    assert twin.words == [0x0100]


def test_one_bad_answer_is_tolerated_and_two_brake_on_a_new_connection(twin: Any) -> None:
    for bad, says in ((1, None), (2, "a new connection disabled the drive")):
        twin.put(0.0)
        twin.drive.power_cycle()
        since = len(twin.words)

        def spoil(times: int = bad) -> bool:
            moves = twin.position_m < -0.01
            if moves:
                twin.drive.spoil(refused, dryve.STATUSWORD, times=times)
            return bool(moves)

        twin.at.append(spoil)
        with twin.session() as session:
            if says is None:
                session.home(0.05, 0.01)
                continue
            with pytest.raises(DeviceError, match=says):
                session.home(0.05, 0.01)
        # By then the drive itself had braked.
        words = twin.words[since:]
        assert words[words.index(START) + 1 :] == [HALT, 0x0100]
        assert not twin.drive.in_operation


def test_a_drive_that_keeps_moving_is_stopped_when_the_connection_breaks(twin: Any) -> None:
    # The D1 may continue its search without its master; its manual does not say.
    twin.drive.keeps_going = True
    loop = twin.server._server.get_loop()
    broken: list[int] = []

    def break_it() -> bool:
        if twin.position_m < -0.02 and not broken:
            broken.append(1)
            loop.call_soon_threadsafe(twin.server._disconnect)
        return bool(broken)

    twin.at.append(break_it)
    with twin.session() as session, pytest.raises(DeviceError, match="connection failed during homing"):
        session.home(0.05, 0.01)
    assert not twin.drive.in_operation
    assert twin.words[-2:] == [HALT, OFF]
    assert twin.position_m > -0.05


def test_a_refused_start_is_not_repeated(twin: Any) -> None:
    twin.drive.spoil(refused, dryve.CONTROLWORD, data=b"\x1f\x00")
    with twin.session() as session, pytest.raises(DeviceError, match="refused in the drive's present state"):
        session.home(0.05, 0.01)
    assert twin.words.count(START) == 1
    assert not twin.drive.in_operation
    assert twin.position_m == 0.0


def test_a_drive_may_report_neither_method_nor_status(twin: Any) -> None:
    twin.drive.spoil(refused, dryve.HOMING_METHOD, dryve.HOMING_STATUS)
    twin.drive.power_cycle()
    with twin.session() as session:
        assert (session.method(), session.homed()) == (None, None)
        assert session.home(0.05, 0.01).confirmed is None


def test_a_fault_is_reset_on_request_and_nothing_moves(twin: Any) -> None:
    twin.drive.trip(0x8611)
    with twin.session() as session:
        assert session.poll().faults()
        session.reset_fault()
        assert session.poll().state is DriveState.SWITCH_ON_DISABLED
        session.reset_fault()
    assert twin.words == [0x0100, 0x0100, 0x0080, 0x0100]


def test_a_reversed_axis_is_homed(twin: Any) -> None:
    twin.drive.power_cycle()
    with twin.session(reversed=True) as session:
        found = session.home(0.05, 0.01)
    assert found.position_m == pytest.approx(-twin.position_m, abs=2e-5)
    assert found.axis_m == pytest.approx(twin.position_m + 0.3, abs=2e-5)


def test_a_homing_sends_the_telegrams_of_the_page_and_no_others(twin: Any) -> None:
    shown = [dryve.decode_request(bytes.fromhex(telegram)) for _, telegram, *_ in vectors("homing.csv")]
    twin.put(-0.283)
    with twin.session() as session:
        session.home(0.05, 0.01)
    sent = [request for request, _ in twin.drive.requests]
    assert sent[:36] == shown[:36]
    assert {each[1:] for each in sent} == {each[1:] for each in shown}
    # Every connection begins and ends with a stop.
    for stop in (sent[0], sent[-1]):
        assert (stop.index, stop.data) == (dryve.TARGET_VELOCITY.index, bytes(4))
