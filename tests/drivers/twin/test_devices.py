"""Promises of the twin's drive and its faults, with a manual clock.

tests/firmware/test_side_by_side.py compares the simulated regulator with the firmware.
"""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState, decode_state
from softarm.drivers.twin.dryve import DryveDevice
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail

MS = 1_000_000


class Master:
    """Master's end of the drive's line."""

    def __init__(self, **config: Any) -> None:
        self.drive = DryveDevice(DryveRail(**config))
        self.now_ns = 0

    def ask(self, telegram: str) -> str:
        return self.drive.answer(bytes.fromhex(telegram), self.now_ns).hex()

    def read(self, entry: dryve.Entry) -> int:
        answer = self.drive.answer(dryve.encode_request(1, entry), self.now_ns)
        return dryve.decode_answer(answer, 1, entry, write=False)

    def write(self, entry: dryve.Entry, value: int) -> None:
        answer = self.drive.answer(dryve.encode_request(1, entry, value), self.now_ns)
        dryve.decode_answer(answer, 1, entry, write=True)

    def enable(self) -> None:
        self.write(dryve.MODE, 3)
        for word in (0x0006, 0x0007, 0x000F):
            self.write(dryve.CONTROLWORD, word)
        assert decode_state(self.read(dryve.STATUSWORD)) is DriveState.OPERATION_ENABLED


def test_with_di7_low_bit_9_is_clear_and_the_drive_cannot_be_enabled() -> None:
    master = Master()
    master.drive.remote = False
    assert master.ask("0f0f0000000d002b0d00000060410000000002") == "0f0f0000000f002b0d000000604100000000024004"
    for word in (0x0006, 0x0007, 0x000F):
        master.write(dryve.CONTROLWORD, word)
    assert master.drive.state is DriveState.SWITCH_ON_DISABLED


def test_only_an_enabled_drive_in_velocity_mode_moves() -> None:
    master = Master()
    master.write(dryve.TARGET_VELOCITY, 50_000)
    assert master.drive.target_velocity_m_s == 0.0
    master.enable()
    assert master.drive.target_velocity_m_s == 0.5
    master.write(dryve.CONTROLWORD, 0x010F)
    assert master.drive.target_velocity_m_s == 0.0
    master.write(dryve.CONTROLWORD, 0x000F)
    master.write(dryve.MODE, 1)
    assert master.drive.target_velocity_m_s == 0.0


def test_without_a_master_the_drive_brakes_and_is_disabled() -> None:
    master = Master()
    master.enable()
    master.write(dryve.TARGET_VELOCITY, 50_000)
    master.drive.sense(0.1, 0.5)
    master.drive.watch(master.now_ns + 100 * MS)
    assert master.drive.target_velocity_m_s == 0.5
    master.drive.watch(master.now_ns + 101 * MS)
    assert (master.drive.state, master.drive.target_velocity_m_s) == (DriveState.QUICK_STOP, 0.0)
    master.write(dryve.CONTROLWORD, 0x000F)
    assert master.drive.state is DriveState.QUICK_STOP
    master.drive.sense(0.12, 0.0)
    master.drive.watch(master.now_ns)
    assert master.drive.state is DriveState.SWITCH_ON_DISABLED


def test_a_drive_that_keeps_going_moves_without_its_master_until_stopped() -> None:
    master = Master()
    master.drive.keeps_going = True
    master.enable()
    master.write(dryve.TARGET_VELOCITY, 50_000)
    master.drive.watch(master.now_ns + 10_000 * MS)
    master.drive.lose_master()
    assert master.drive.target_velocity_m_s == 0.5
    assert (master.drive.moved_ns, master.drive.halted_ns) == (0, None)
    master.now_ns = 7 * MS
    master.write(dryve.TARGET_VELOCITY, 0)
    assert (master.drive.moved_ns, master.drive.halted_ns) == (0, 7 * MS)
    master.write(dryve.TARGET_VELOCITY, -1)
    assert (master.drive.moved_ns, master.drive.halted_ns) == (7 * MS, None)
    master.now_ns = 9 * MS
    master.write(dryve.CONTROLWORD, 0x010F)
    assert master.drive.halted_ns == 9 * MS


def test_read_backs_are_in_drive_units_from_the_homed_end() -> None:
    master = Master(units_per_m=1000, centre_m=0.25)
    master.drive.sense(-0.05, -0.125)
    assert master.read(dryve.POSITION) == 200
    assert master.read(dryve.VELOCITY) == -125


@given(st.lists(st.integers(0, 0xFFFF), max_size=30))
def test_operation_is_only_reached_through_switched_on(words: list[int]) -> None:
    master = Master()
    before = master.drive.state
    for word in words:
        master.write(dryve.CONTROLWORD, word)
        if master.drive.in_operation:
            assert before in (DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED)
            assert word & 0x0F == 0x0F
        before = master.drive.state


@given(st.binary(max_size=40))
def test_any_telegram_is_answered(telegram: bytes) -> None:
    assert len(Master().drive.answer(telegram, 0)) in (9, 17, 19, 20, 21, 23)


def test_faults_last_as_long_as_requested(clock: Any) -> None:
    faults = Faults(clock)
    faults.apply(b'{"fault": "mocap_drop_body", "body": "link3", "seconds": 0.5}')
    assert faults.active("mocap_drop_body")
    assert faults.lost_body == "link3"
    clock.advance(0.6)
    assert not faults.active("mocap_drop_body")
    faults.apply(b'{"fault": "rail_fault"}')
    assert faults.take("rail_fault")
    assert not faults.take("rail_fault")
    faults.apply(b'{"fault": "remote_low"}')
    clock.advance(1e6)
    assert faults.active("remote_low")
    faults.apply(b'{"fault": "clear"}')
    assert not faults.active("remote_low")


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (b"nonsense", "JSON object such as"),
        (b"[]", "JSON object such as"),
        (b"[" * 100_000, "JSON object such as"),
        (json.dumps({"fault": "earthquake"}).encode(), "unknown fault 'earthquake'; allowed: clear, mocap_drop_body"),
        (json.dumps({"fault": ["x"]}).encode(), "unknown fault"),
        (json.dumps({"fault": "mocap_freeze", "seconds": -1}).encode(), "use a positive number"),
        (json.dumps({"fault": "mocap_freeze", "second": 1}).encode(), "unexpected keyword argument 'second'"),
        (json.dumps({"fault": "mocap_drop_body", "body": "nose"}).encode(), "unknown body 'nose'; allowed: cart"),
    ],
)
def test_an_invalid_fault_is_rejected_with_the_allowed_values(clock: Any, message: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Faults(clock).apply(message)


@pytest.mark.parametrize("word", [0x000F, 0x010F, 0x011F, 0x0006])
def test_a_cancelled_search_does_not_resume_by_itself(word: int) -> None:
    master = Master()
    master.write(dryve.HOMING_SPEED, 5000)
    master.enable()
    master.write(dryve.MODE, dryve.HOMING)
    master.write(dryve.CONTROLWORD, 0x001F)
    assert master.drive.target_velocity_m_s == -0.05
    master.write(dryve.CONTROLWORD, word)
    master.drive.sense(0.0, 0.0)
    assert master.drive.target_velocity_m_s == 0.0
    for again in (0x0006, 0x0007, 0x000F):
        master.write(dryve.CONTROLWORD, again)
    assert master.drive.target_velocity_m_s == 0.0
