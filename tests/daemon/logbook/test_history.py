"""Event history: each change once, in order of importance, with its source."""

import logging
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from softarm.daemon.control.failsafe import TABLE, Event
from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs, Request, RequestResult
from softarm.daemon.logbook.history import KEPT, LISTED, LOST, Changes, History
from softarm.schemas.goals import Goal, GoalStatus

PERIOD_NS = 33_333_334


class Run:
    """Consecutive ticks of a daemon and their history entries."""

    def __init__(self):
        self.changes = Changes(lambda t_ns: datetime.fromtimestamp(1_800_000_000 + t_ns * 1e-9, UTC))
        self.outputs = Outputs(0, 0, 0, 0, 0, Mode.DISARMED, EStop.CLEAR)
        self.entries = []

    def tick(self, *requests, refused=(), events=(), **changes):
        """Make one tick and return its entries."""
        number = self.outputs.tick + 1
        results = tuple(RequestResult(request.number, not refused, refused) for request in requests)
        active = tuple(Event(name).active() for name in events)
        self.outputs = replace(
            self.outputs, t_ns=number * PERIOD_NS, tick=number, results=results, events=active, **changes
        )
        found = self.changes.take(Inputs(self.outputs.t_ns, requests=requests), self.outputs)
        self.entries += found
        return found

    def ticks(self, seconds, **changes):
        return [entry for _ in range(round(seconds * 30)) for entry in self.tick(**changes)]


@pytest.fixture
def run():
    made = Run()
    assert made.tick() == []
    return made


def texts(entries):
    return [entry.text for entry in entries]


def test_a_request_is_recorded_with_number_time_source_and_result(run):
    who = "the API (command token, 10.0.0.7)"
    (entry,) = run.tick(Request(4, "arm", who=who), refused=("the drive is off: switch it on",))
    assert entry.text == f"arm requested from {who}; refused: the drive is off: switch it on"
    assert (entry.kind, entry.what, entry.who, entry.accepted) == ("request", "arm", who, False)
    (entry,) = run.tick(Request(5, "goal", Goal("reach", -0.2, 0.6)))
    assert (entry.text, entry.who, entry.accepted) == ("goal reach y -0.2, z 0.6 m", None, True)
    assert texts(run.tick(Request(6, "policy", policy="pid"))) == ["policy pid"]
    assert [(entry.number, entry.tick) for entry in run.entries] == [(1, 2), (2, 3), (3, 4)]
    assert run.entries[0].t_ns == 2 * PERIOD_NS
    assert run.entries[0].time == datetime.fromtimestamp(1_800_000_000.066666668, UTC)


def test_a_tick_that_failed_answers_no_request(run):
    run.outputs = replace(run.outputs, tick=5)
    outputs = replace(run.outputs, t_ns=10**9, results=())
    (entry,) = run.changes.take(Inputs(10**9, requests=(Request(9, "arm"),)), outputs)
    assert (entry.accepted, entry.text) == (False, "arm; refused: the control loop has failed")


def test_a_flood_of_requests_is_counted_not_listed(run):
    for number in range(30):
        run.tick(*(Request(3 * number + i, "cancel_goal") for i in range(3)))
    run.ticks(1)
    assert len(run.entries) == LISTED + 1
    assert run.entries[-1].text == f"{90 - LISTED} more requests within a second"
    assert len(run.tick(Request(1000, "arm"))) == 1


def test_each_change_of_mode_is_recorded_and_a_stop_with_its_reason(run):
    run.tick(mode=Mode.ARMING)
    run.tick(mode=Mode.ARMED)
    run.tick(mode=Mode.STOPPING, last_stop="disarmed by request", last_stop_ns=1)
    run.tick(mode=Mode.DISARMED)
    run.tick(mode=Mode.ARMED)
    run.tick(mode=Mode.DISARMED, last_stop="a late camera", last_stop_ns=7 * PERIOD_NS)  # over at once
    assert texts(run.entries) == [
        "disarmed → arming",
        "arming → armed",
        "armed → stopping: disarmed by request",
        "stopping → disarmed",
        "disarmed → armed",
        "armed → disarmed: a late camera",
    ]
    assert {entry.kind for entry in run.entries} == {"mode"}


def test_an_emergency_stop_follows_its_request_and_names_the_source(run):
    run.tick(mode=Mode.ARMED)
    why = Event("stop_requested").text
    change = {"mode": Mode.STOPPED, "estop": EStop.ENGAGED, "last_stop": why}  # of this run, although without a time
    request, stop = run.tick(Request(1, "stop", who="the terminal"), events=["stop_requested"], **change)
    assert (request.kind, request.what) == ("request", "stop")
    assert (stop.kind, stop.what, stop.who) == ("stop", "stopped", "the terminal")
    assert stop.text == f"emergency stop: {why}"
    assert run.ticks(1) == []


def test_a_stop_of_an_earlier_run_is_recorded_as_such():
    run = Run()
    (stop,) = run.tick(mode=Mode.STOPPED, estop=EStop.LATCHED, last_stop="the drive reports a fault")
    assert stop.text == "emergency stop before this daemon started: the drive reports a fault"


def test_a_log_that_begins_in_the_middle_of_a_run_begins_with_no_change():
    run = Run()
    run.outputs = replace(run.outputs, tick=500, mode=Mode.ARMED)
    assert run.tick() == []


def test_the_end_of_a_goal_is_recorded_once(run):
    flown = GoalStatus(Goal("reach", -0.2, 0.6), "running", number=3)
    assert run.tick(goal=flown) == []
    (entry,) = run.tick(goal=replace(flown, state="failed", reason="the arm is not armed", time_s=1.24))
    assert (entry.kind, entry.what) == ("goal", "failed")
    assert entry.text == "goal 3 failed (the arm is not armed) after 1.2 s"
    assert run.ticks(1) == []


def test_a_device_is_lost_at_once_and_found_when_it_has_answered_for_a_second(run):
    (lost,) = run.tick(events=["rail_stale"])
    assert (lost.kind, lost.what) == ("lost", "rail")
    assert TABLE["rail_stale"].remedy in lost.text
    assert run.ticks(2, events=["rail_stale"]) == []
    (found,) = run.ticks(3)
    assert (found.kind, found.what, found.text) == ("found", "rail", "rail found after 2.0 s")


def test_an_intermittent_device_is_recorded_once(run):
    for _ in range(20):
        run.tick(events=["mocap_stale"])
        run.tick()
    assert texts(run.entries) == [f"mocap lost: {Event('mocap_stale').text}"]


def test_devices_that_appear_first_are_found_and_were_not_lost():
    run = Run()
    run.ticks(2, events=["mocap_missing", "rail_missing"])
    run.ticks(2)
    assert sorted(texts(run.entries)) == ["mocap found after 2.0 s", "rail found after 2.0 s"]


def test_every_event_is_recorded_at_its_start_and_again_after_a_long_absence(run):
    names = [name for name in TABLE if name not in LOST and name != "stop_requested"]
    assert [entry.what for entry in run.tick(events=names)] == names
    assert run.ticks(12, events=names) == []
    run.tick()
    assert run.tick(events=names) == []
    run.ticks(11)
    assert [entry.kind for entry in run.tick(events=names)] == ["event"] * len(names)


def test_a_problem_that_is_not_text_is_recorded(run):
    (entry,) = run.tick(Request(1, "policy", policy="\ud800"))
    assert entry.text == "policy ?"


OUTPUTS = Outputs(0, 1, 0, 0, 0, Mode.DISARMED, EStop.CLEAR)


def history():
    return History("abc", lambda: 1_000, lambda: 1_800_000_000_000_001_000)


def turned(made, times):
    """Take ticks whose mode changes every time."""
    for tick in range(1, times + 1):
        mode = Mode.ARMED if tick % 2 else Mode.DISARMED
        made.take(Inputs(tick), replace(OUTPUTS, t_ns=tick * 10**9, tick=tick, mode=mode))


def test_each_entry_is_one_log_line_and_a_stop_a_warning(caplog):
    made = history()
    with caplog.at_level(logging.INFO, "softarm.events"):
        turned(made, 2)
        stop = replace(OUTPUTS, t_ns=3, tick=3, mode=Mode.STOPPED, last_stop="a hand", last_stop_ns=3)
        made.take(Inputs(3), stop)
    assert [(record.levelname, record.message) for record in caplog.records] == [
        ("INFO", "disarmed → armed"),
        ("INFO", "armed → disarmed"),
        ("WARNING", "emergency stop: a hand"),
    ]


def test_a_thousand_entries_are_kept():
    made = history()
    turned(made, KEPT + 7)
    assert [made.entries[0].number, made.entries[-1].number] == [8, KEPT + 7]
    assert len(made.entries) == KEPT
