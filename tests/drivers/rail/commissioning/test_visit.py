"""Homing over real TCP: the twin's drive, and one that was written from docs/wires.md alone."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softarm.drivers.base import DeviceError
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState

START, HALT, OFF = 0x001F, 0x010F, 0x0006


def refused(transaction: bytes) -> bytes:
    return dryve.encode_abort(int.from_bytes(transaction[:2], "big"), 0x08000022)


def test_the_twins_drive_finds_its_zero_slowly_and_is_left_off(twin: Any) -> None:
    twin.put(0.05)
    twin.drive.power_cycle()
    with twin.visit() as visit:
        assert (visit.homed(), visit.method()) == (False, 17)
        assert visit.look().position_m == pytest.approx(-0.3)  # its zero is where it stood
        found = visit.home(0.05, 0.01)
        assert visit.look().state is DriveState.READY
    assert found.confirmed is True
    assert found.position_m == pytest.approx(twin.position_m, abs=2e-5)
    assert found.axis_m == pytest.approx(found.position_m + 0.3)
    assert -0.2855 < twin.position_m < -0.284
    assert {round(abs(speed), 6) for speed in twin.speeds_m_s} == {0.0, 0.05, 0.01}
    assert twin.words.count(START) == 1
    assert twin.words[-1] == OFF
    assert twin.drive._values[dryve.MODE] == dryve.PROFILE_VELOCITY


def test_a_drive_that_was_written_from_the_page_alone_finds_its_zero_by_its_own_method(outside: Any) -> None:
    with outside.visit() as visit:
        assert (visit.homed(), visit.method()) == (False, 18)
        assert visit.look().position_m == pytest.approx(-0.3, abs=1e-4)
        found = visit.home(0.05, 0.01)
        assert visit.look().at_ease
    assert found.confirmed is True
    assert found.position_m == pytest.approx(outside.position_m, abs=1e-3)
    assert outside.position_m == pytest.approx(0.29, abs=2e-3)
    assert max(map(abs, outside.speeds_m_s)) < 0.07
    assert outside.robot.crashes == 0
    assert outside.words.count(START) == 1


def test_ctrl_c_brakes_and_switches_off(twin: Any) -> None:
    twin.drive.power_cycle()
    with twin.visit() as visit, pytest.raises(DeviceError, match="broken off by a person"):
        visit.home(0.05, 0.01, stop=lambda: twin.position_m < -0.02)
    assert twin.words[-2:] == [HALT, OFF]
    assert twin.drive.state is DriveState.READY
    assert -0.025 < twin.position_m < -0.02
    assert not twin.drive.reference.homed


@pytest.mark.parametrize(
    ("happens", "says"),
    [
        (lambda w: w.drive.trip(0x8611), "E11 following error"),
        (lambda w: setattr(w.drive, "remote", False), "DI7 is low"),
        (lambda w: setattr(w, "held", True), "not moved for 3 s"),
        (lambda w: w.drive.quick_stop(), "fell back to 'quick stop active'"),
        (lambda w: w.put(-0.35), "E12 limit switch"),
    ],
)
def test_what_goes_wrong_on_the_way_is_a_sentence_and_the_drive_is_off(twin: Any, happens: Any, says: str) -> None:
    twin.drive.power_cycle()
    twin.at.append(lambda: twin.drive.reference.searching and twin.position_m < -0.01 and (happens(twin) or True))
    with twin.visit() as visit, pytest.raises(DeviceError, match=says):
        visit.home(0.05, 0.01)
    assert not twin.drive.in_operation
    assert set(twin.words[twin.words.index(START) + 1 :]) <= {HALT, OFF}


def test_a_drive_that_says_homing_failed(twin: Any) -> None:
    begin = twin.drive.reference.begin
    twin.drive.reference.begin = lambda speed: begin(0)
    with twin.visit() as visit, pytest.raises(DeviceError, match="homing failed"):
        visit.home(0.05, 0.01)
    assert twin.words[-2:] == [HALT, OFF]


def test_a_drive_that_ends_its_search_and_is_not_homed_is_not_believed(twin: Any) -> None:
    see = twin.drive.reference.see

    def forgetful(position_m: float) -> None:
        see(position_m)
        twin.drive.reference.homed = False

    twin.drive.reference.see = forgetful
    with twin.visit() as visit, pytest.raises(DeviceError, match="says that it is not homed"):
        visit.home(0.05, 0.01)


def test_a_drive_that_was_in_operation_is_found_out_and_left_off(twin: Any) -> None:
    twin.drive.state = DriveState.OPERATION_ENABLED
    with twin.visit() as visit:
        assert visit.found_in_operation
    assert twin.words == [HALT, OFF]


def test_a_speed_that_does_not_read_back_moves_nothing(twin: Any) -> None:
    def script(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        if telegram[12:15] == b"\x60\x99\x01" and not telegram[9]:
            return dryve.encode_value(dryve.decode_request(telegram), bytes(4))
        return answer()

    twin.script = script
    with (
        twin.visit() as visit,
        pytest.raises(DeviceError, match=r"6099h:1.*reads 0 after 5000 was written.*nothing moved"),
    ):
        visit.home(0.05, 0.01)
    assert twin.words == [0x0100]


def test_one_bad_answer_is_borne_and_two_brake_over_a_new_connection(twin: Any) -> None:
    for bad, says in ((1, None), (2, "switched off over a new one")):
        twin.put(0.0)
        twin.drive.power_cycle()
        twin.words.clear()
        left = [bad]

        def script(telegram: bytes, answer: Callable[[], bytes], left: list[int] = left) -> bytes:
            if twin.position_m < -0.01 and telegram[12:14] == b"\x60\x41" and left[0]:
                left[0] -= 1
                return refused(telegram)
            return answer()

        twin.script = script
        with twin.visit() as visit:
            if says is None:
                visit.home(0.05, 0.01)
                continue
            with pytest.raises(DeviceError, match=says):
                visit.home(0.05, 0.01)
        assert twin.words[twin.words.index(START) + 1 :] == [HALT, 0x0100]  # the drive itself had braked by then
        assert not twin.drive.in_operation


def test_a_drive_that_keeps_going_is_stopped_when_the_connection_breaks(twin: Any) -> None:
    twin.drive.keeps_going = True  # what nobody knows of the D1: it may search on without its master
    loop = twin.server._server.get_loop()
    broken: list[int] = []

    def break_it() -> bool:
        if twin.position_m < -0.02 and not broken:
            broken.append(1)
            loop.call_soon_threadsafe(twin.server._hang_up)
        return bool(broken)

    twin.at.append(break_it)
    with twin.visit() as visit, pytest.raises(DeviceError, match="connection failed while it homed"):
        visit.home(0.05, 0.01)
    assert not twin.drive.in_operation
    assert twin.words[-2:] == [HALT, OFF]
    assert twin.position_m > -0.05


def test_a_refused_start_is_not_said_again(twin: Any) -> None:
    def script(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        return refused(telegram) if telegram[12:14] == b"\x60\x40" and telegram[19:] == b"\x1f\x00" else answer()

    twin.script = script
    with twin.visit() as visit, pytest.raises(DeviceError, match="refused in the drive's present state"):
        visit.home(0.05, 0.01)
    assert twin.words.count(START) == 1
    assert not twin.drive.in_operation
    assert twin.position_m == 0.0


def test_old_drives_may_say_neither_method_nor_status(twin: Any) -> None:
    def script(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        return refused(telegram) if telegram[12:14] in (b"\x60\x98", b"\x20\x14") else answer()

    twin.script = script
    twin.drive.power_cycle()
    with twin.visit() as visit:
        assert (visit.method(), visit.homed()) == (None, None)
        assert visit.home(0.05, 0.01).confirmed is None


def test_a_fault_is_reset_when_asked_and_nothing_moves(twin: Any) -> None:
    twin.drive.trip(0x8611)
    with twin.visit() as visit:
        assert visit.look().faults()
        visit.reset_fault()
        assert visit.look().state is DriveState.SWITCH_ON_DISABLED
        visit.reset_fault()  # of what is in none: nothing
    assert twin.words == [0x0100, 0x0100, 0x0080, 0x0100]


def test_a_drive_that_counts_down_towards_y_is_homed_alike(twin: Any) -> None:
    twin.drive.power_cycle()
    with twin.visit(reversed=True) as visit:
        found = visit.home(0.05, 0.01)
    assert found.position_m == pytest.approx(-twin.position_m, abs=2e-5)  # to the twin, whose axis counts up, it lies
    assert found.axis_m == pytest.approx(twin.position_m + 0.3, abs=2e-5)


def test_nobody_there_is_a_sentence(free_port: int, twin: Any) -> None:
    with pytest.raises(DeviceError, match="Modbus TCP Gateway"), twin.visit(port=free_port):
        pass


def test_every_connection_begins_and_ends_with_a_stop(twin: Any) -> None:
    asked: list[bytes] = []

    def script(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        asked.append(telegram)
        return answer()

    twin.script = script
    with twin.visit() as visit:
        visit.home(0.05, 0.01)
    stop = (b"\x60\xff", bytes(4))
    assert [(each[12:14], each[19:]) for each in (asked[0], asked[-1])] == [stop, stop]


def test_a_homing_says_what_the_page_says_and_nothing_else(twin: Any) -> None:
    page = (Path(__file__).parents[4] / "docs" / "wires.md").read_text(encoding="utf-8")
    [table] = re.findall(r"^\| homing master \|.*\n\|[-|]+\n((?:\|.*\n)+)", page, re.MULTILINE)
    shown = [bytes.fromhex(line.split("`")[1]) for line in table.splitlines()]
    asked: list[bytes] = []

    def script(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        asked.append(telegram)
        return answer()

    twin.put(-0.283)
    twin.script = script
    with twin.visit() as visit:
        visit.home(0.05, 0.01)
    assert asked[:36] == shown[:36]
    assert {each[2:] for each in asked} == {each[2:] for each in shown}
