"""Thinning of a log: few ticks of a disarmed arm at rest, every other tick."""

from dataclasses import replace
from itertools import pairwise

import pytest

from softarm.daemon.control.records import ActiveEvent, EStop, Inputs, Mode, Outputs, Problems, Request, TickTiming
from softarm.daemon.logbook.thinning import Thinning
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.messages import Command, MocapFrame, Pose, PressureReading, RailReading

PERIOD_NS = 33_333_334  # thirty are a little more than a second
TIMING = TickTiming(1, 2, 3, None)


def tick(number: int, **changes):
    """Return a tick of an arm at rest with every reading."""
    now = number * PERIOD_NS
    bodies = changes.pop("bodies", (Pose(0.1, 0.2, 0.3),) * 6)
    inputs = Inputs(
        now,
        mocap=tuple(MocapFrame(4 * number + i, now, now, bodies) for i in range(4)),
        pressure=PressureReading(now, changes.pop("kpa", 0.0), False),
        rail=RailReading(now, changes.pop("cart_m", 0.0), 0.0, False),
        requests=changes.pop("requests", ()),
        missed=changes.pop("missed", 0),
        problems=changes.pop("problems", Problems()),
    )
    return inputs, replace(Outputs(now, number, 0, 0, 0, Mode.DISARMED, EStop.CLEAR), **changes), TIMING


def numbers(ticks) -> list[int]:
    return [outputs.tick for _, outputs, _ in ticks]


@pytest.fixture
def still():
    """Return a thinning of one tick a second after 400 ticks at rest."""
    thinning = Thinning(1.0, 1.0)
    thinning.kept = [number for n in range(1, 401) for number in numbers(thinning.take(tick(n)))]
    return thinning


def test_a_still_arm_is_written_once_per_interval_and_whole_at_the_start(still):
    assert still.kept[:30] == list(range(1, 31))
    seldom = still.kept[30:]
    assert len(seldom) == 11
    assert all(30 <= later - earlier <= 31 for earlier, later in pairwise(seldom))


@pytest.mark.parametrize(
    "change",
    [
        {"requests": (Request(1, "arm"),)},
        {"mode": Mode.ARMING},
        {"mode": Mode.STOPPED, "estop": EStop.ENGAGED},
        {"events": (ActiveEvent("mocap_stale", "soft_stop", "120 ms old"),)},
        {"bodies": (*(Pose(0.1, 0.2, 0.3),) * 5, Pose(0.106, 0.2, 0.3))},
        {"bodies": (*(Pose(0.1, 0.2, 0.3),) * 5, Pose(0.1, 0.2, 0.3, tracked=False))},
        {"kpa": 0.6},
        {"cart_m": 0.006},
        {"missed": 1},
        {"policy": "pid"},
        {"goal": GoalStatus(Goal("hold"), "cancelled")},
        {"problems": Problems(rail="rail 10.0.0.9:502: refused")},
        {"sent": Command(True, 0.0, 0.0)},
    ],
    ids=str,
)
def test_ticks_around_a_change_are_all_kept(still, change):
    kept = numbers(still.take(tick(401, **change)))
    assert kept == list(range(371, 402))
    change.pop("requests", None)
    for n in range(402, 431):
        kept += numbers(still.take(tick(n, **change)))
    assert kept == list(range(371, 431))


@pytest.mark.parametrize(
    "state",
    [
        {"mode": Mode.ARMED, "sent": Command(True, 0.0, 0.0)},
        {"events": (ActiveEvent("mocap_settling", "warn", "12 of 1000 frames"),)},
    ],
    ids=["flight", "motion capture settles"],
)
def test_every_tick_of_a_flight_and_before_arming_is_kept(still, state):
    kept = [number for n in range(401, 601) for number in numbers(still.take(tick(n, **state)))]
    assert kept[-200:] == list(range(401, 601))


def test_a_counter_in_a_text_is_not_a_change(still):
    def stale(n: int):
        return tick(n, events=(ActiveEvent("mocap_stale", "soft_stop", f"{n} ms old"),), arming_refusals=(f"{n} ms",))

    kept = [number for n in range(401, 1401) for number in numbers(still.take(stale(n)))]
    assert kept.count(401) == 1
    assert len([number for number in kept if number > 440]) < 35


def test_ticks_come_once_in_order_and_the_rest_at_the_end(still):
    kept = list(still.kept)
    for n in range(401, 2401):
        kept += numbers(still.take(tick(n, kpa=0.6 if n % 700 == 0 else 0.0)))
    kept += numbers(still.rest())
    assert kept == sorted(set(kept))
    assert kept[-30:] == list(range(2371, 2401))
    assert still.rest() == []


def test_an_interval_of_none_keeps_every_tick():
    thinning = Thinning(0.0, 1.0)
    assert [number for n in range(1, 500) for number in numbers(thinning.take(tick(n)))] == list(range(1, 500))


def test_a_new_file_begins_with_the_waiting_and_all_first_ticks(still):
    still.begin()
    assert numbers(still.take(tick(401))) == list(range(371, 402))
    assert numbers(still.take(tick(402))) == [402]
