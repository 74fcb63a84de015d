"""Tests of `softarm events`."""

import json

from softarm.cli.shared.console import clock
from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs, TickTiming
from softarm.daemon.logbook.recorder import Recorder
from softarm.schemas.config import Config


def answer(run, *numbers):
    """Return an answer in the format of GET /api/events."""
    events = [
        {"number": n, "t_ns": n, "time": f"2026-11-22T12:00:{n:02}Z", "tick": n, "kind": "mode", "what": "armed"}
        | {"text": f"{run}: number {n}", "who": None, "accepted": None}
        for n in numbers
    ]
    newest = numbers[-1] + 1 if numbers else None  # recorded after these
    return {"run": run, "events": events, "oldest": newest and 1, "newest": newest}


def test_the_newest_events_are_shown_with_their_time(softarm, daemon):
    daemon.on("GET", "/api/events?limit=2", answer("a", 3, 4))
    result = softarm("events", "--limit", 2)
    assert result.exit_code == 0
    assert result.stdout == "".join(f"{clock(f'2026-11-22T12:00:0{n}Z')}  a: number {n}\n" for n in (3, 4))


def test_each_event_is_one_line_of_json(softarm, daemon):
    daemon.on("GET", "/api/events?limit=50", answer("a", 3))
    assert json.loads(softarm("events", "--json").stdout) == answer("a", 3)["events"][0]


def test_following_continues_after_a_restart_of_the_daemon(softarm, daemon, monkeypatch):
    monkeypatch.setattr("softarm.cli.recordings.events.POLL_S", 0)
    daemon.on("GET", "/api/events?limit=50", answer("a", 8, 9))
    daemon.on("GET", "/api/events?since=9&limit=1000", answer("a", 10))
    daemon.on("GET", "/api/events?since=10&limit=1000", answer("b"))
    daemon.on("GET", "/api/events?since=0&limit=1000", answer("b", 1, 2))
    daemon.on("GET", "/api/events?since=2&limit=1000", {"detail": "enough"}, code=503)
    result = softarm("events", "--follow")
    shown = [line.partition("  ")[2] for line in result.stdout.splitlines()]
    assert shown == ["a: number 8", "a: number 9", "a: number 10", "b: number 1", "b: number 2"]
    assert (result.exit_code, result.stderr) == (1, "enough\n")


def test_a_recording_shows_its_end_its_policies_and_its_events(softarm, tmp_path):
    recorder = Recorder(Config(recorder={"directory": tmp_path}))
    recorder.start()
    for tick, mode in ((1, Mode.DISARMED), (2, Mode.ARMED)):
        recorder.tick(Inputs(tick), Outputs(tick, tick, 0, 0, 0, mode, EStop.CLEAR), TickTiming(0, 0, 0, None))
    recorder.stop()
    event = json.loads(softarm("logs", "show", "--json", recorder.path).stdout)
    assert (event["tick"], event["text"]) == (2, "disarmed → armed")
    end, policies, shown = softarm("logs", "show", recorder.path).stdout.splitlines()
    assert end.startswith(f"{recorder.path}: finished, ")
    assert policies == "policies: none"
    assert shown.endswith("  disarmed → armed")
