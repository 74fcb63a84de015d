"""The last minutes as columns: equal to the ticks, in bounded memory, cheap to read."""

import json
import math
import threading
from dataclasses import replace

import pytest

from softarm.daemon.control.records import EStop, Mode, Observed, Outputs
from softarm.daemon.logbook import recent as module
from softarm.daemon.logbook.recent import BLOCK, KEPT, NAMES, SPARE, Recent
from softarm.schemas.messages import BODY_NAMES, Command, MocapFrame, Pose
from softarm.schemas.policy import Observation
from softarm.schemas.rest import RecentAnswer

STEP_NS = 33_333_333
SEEN = Observed(Observation(0.9, 0.9, -0.20001, 0.65, 0, 0, 0, 12.3456), 7, 5_000_000, 6_000_000, 7_000_000)
FLOWN = Outputs(
    STEP_NS,
    1,
    123_456,
    0,
    0,
    Mode.ARMED,
    EStop.CLEAR,
    sent=Command(True, 0.25, 12.0),
    action=(0.5, 13.0),
    policy_ns=345_678,
    observed=SEEN,
    rail_position_m=0.1,
    rail_velocity_m_s=-0.3,
)
UNOBSERVED = Outputs(STEP_NS, 1, 0, 0, 0, Mode.DISARMED, EStop.CLEAR, sent=Command(False, 0.0, math.nan))


def filled(ticks: int, outputs: Outputs = FLOWN) -> Recent:
    recent = Recent(lambda: 0, lambda: 1_000_000_000_000)
    for number in range(1, ticks + 1):
        recent.take(replace(outputs, tick=number, t_ns=number * STEP_NS))
    return recent


def test_every_column_has_the_ticks_value():
    said = json.loads(filled(1).json(60))
    assert said == {
        "tick": [1],
        "time": [1000.033],
        "tip_y_m": [-0.2],
        "tip_z_m": [0.65],
        "cart_m": [0.1],
        "cart_velocity_m_s": [-0.3],
        "action_velocity_m_s": [0.5],
        "sent_velocity_m_s": [0.25],
        "pressure_kpa": [12.346],
        "action_pressure_kpa": [13.0],
        "sent_pressure_kpa": [12.0],
        "late_ms": [0.123],
        "policy_ms": [0.346],
        "mocap_age_ms": [5.0],
        "pressure_age_ms": [6.0],
        "rail_age_ms": [7.0],
        "bodies": [[None] * len(BODY_NAMES)],
        "mode": ["armed"],
    }
    assert list(said) == list(NAMES) == list(RecentAnswer.model_fields)


def test_an_unknown_value_or_nan_is_null():
    said = json.loads(filled(1, UNOBSERVED).json(60))
    known = {"tick", "time", "sent_velocity_m_s", "late_ms", "policy_ms", "bodies", "mode"}
    assert {name for name, column in said.items() if column != [None]} == known


def test_the_bodies_are_those_of_the_newest_frame():
    recent = Recent(lambda: 0, lambda: 0)
    poses = [Pose(0.1 * k, 0.9 - 0.1 * k, 0.0, tracked=k != 2) for k in range(len(BODY_NAMES))]
    frame = MocapFrame(1, 0, 0, tuple(poses))
    older = replace(frame, bodies=tuple(reversed(poses)))
    recent.take(replace(FLOWN, tick=1))
    recent.take(replace(FLOWN, tick=2), (older, frame))
    recent.take(replace(FLOWN, tick=3))  # without a frame of its own
    seen = [[0.0, 0.9], [0.1, 0.8], None, [0.3, 0.6], [0.4, 0.5], [0.5, 0.4]]
    assert json.loads(recent.json(60))["bodies"] == [[None] * len(BODY_NAMES), seen, seen]


@pytest.mark.parametrize("ticks", [1, 29, 30, 31, 2000])
@pytest.mark.parametrize("seconds", [1, 60, 600])
def test_the_newest_seconds_are_returned_without_a_gap(ticks, seconds):
    said = json.loads(filled(ticks).json(seconds))
    assert {len(column) for column in said.values()} == {len(said["tick"])}
    assert said["tick"] == list(range(said["tick"][0], ticks + 1))
    assert min(ticks, 30 * seconds) <= len(said["tick"]) <= 30 * seconds + 2 * BLOCK


def test_memory_is_bounded_and_the_oldest_are_dropped(monkeypatch):
    assert KEPT == 600 * BLOCK
    kept = 40 * BLOCK
    monkeypatch.setattr(module, "KEPT", kept)
    recent = filled(kept + SPARE + 100)
    said = json.loads(recent.json(600))
    assert kept - BLOCK <= len(said["tick"]) <= kept
    assert said["tick"] == list(range(said["tick"][0], kept + SPARE + 101))
    for number in range(kept + SPARE + 101, kept + SPARE + 2000):
        recent.take(replace(FLOWN, tick=number, t_ns=number * STEP_NS))
    assert json.loads(recent.json(600))["tick"][-1] == kept + SPARE + 1999
    assert len(recent._texts) <= kept // BLOCK + 1


def test_cached_text_stays_correct():
    recent = filled(95)
    before = json.loads(recent.json(60))
    recent.take(replace(FLOWN, tick=96, t_ns=96 * STEP_NS))
    after = json.loads(recent.json(60))
    assert {name: column[:95] for name, column in after.items()} == before
    assert after["tick"][95:] == [96]


def test_a_concurrent_reader_gets_complete_rows_only():
    recent, over = Recent(lambda: 0, lambda: 0), threading.Event()

    def write():
        number = 0
        while not over.is_set():
            number += 1
            values = SEEN.values._replace(tip_y_m=number % 1000 / 1e4)
            recent.take(replace(FLOWN, tick=number, t_ns=number * STEP_NS, observed=replace(SEEN, values=values)))

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(10):
            said = json.loads(recent.json(20))
            assert [tick % 1000 / 1e4 for tick in said["tick"]] == said["tip_y_m"]
            first = said["tick"][0] if said["tick"] else 0
            assert said["tick"] == list(range(first, first + len(said["tick"])))
    finally:
        over.set()
        writer.join()
