"""GET /api/events and the source of a request, over real sockets and the real recorder."""

import logging

import httpx
import pytest

from softarm.daemon.assembly import Daemon
from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs
from softarm.daemon.logbook import incidents, logs
from softarm.daemon.logbook.history import History
from softarm.daemon.runtime.devices import simulated_devices
from softarm.schemas.config import Config
from tests.processes import until


class Busy(History):
    """History to which the control loop adds an event after every look."""

    added = 0

    @property
    def entries(self):
        self.added += 1
        return self.kept[: self.added]

    @entries.setter
    def entries(self, kept):
        self.kept = kept


@pytest.fixture
def recorded(loop, app, client_of):
    """Return a client of a daemon with ten events."""
    history = History("run1", lambda: 0, lambda: 1_800_000_000_000_000_000)
    for tick in range(1, 11):
        mode = Mode.ARMED if tick % 2 else Mode.DISARMED
        history.take(Inputs(tick), Outputs(tick, tick, 0, 0, 0, mode, EStop.CLEAR))
    return client_of(app(loop, history=history))


def test_events_are_served_from_the_newest_or_after_a_number(recorded):
    answer = recorded.get("/api/events").json()
    assert [event["number"] for event in answer["events"]] == list(range(1, 11))
    assert (answer["run"], answer["oldest"], answer["newest"]) == ("run1", 1, 10)
    assert answer["events"][0] == {
        "number": 1,
        "t_ns": 1,
        "time": "2027-01-15T08:00:00Z",
        "tick": 1,
        "kind": "mode",
        "what": "armed",
        "text": "disarmed → armed",
        "who": None,
        "accepted": None,
    }
    assert [e["number"] for e in recorded.get("/api/events?limit=2").json()["events"]] == [9, 10]
    assert [e["number"] for e in recorded.get("/api/events?since=3&limit=2").json()["events"]] == [4, 5]
    assert [e["number"] for e in recorded.get("/api/events?since=9").json()["events"]] == [10]
    assert recorded.get("/api/events?since=10").json()["events"] == []


def test_the_newest_number_is_that_of_the_same_moment(loop, app, client_of):
    source, busy = (kind("run1", lambda: 0, lambda: 0) for kind in (History, Busy))
    busy.kept = [entry for tick in range(9) for entry in source.done(tick, "recorder", "text", "who")]
    answer = client_of(app(loop, history=busy)).get("/api/events").json()
    assert answer["newest"] == answer["events"][-1]["number"]


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("events?limit=0", "limit: is '0'; allowed a whole number from 1 to 1000"),
        ("events?limit=1001", "limit: is '1001'; allowed a whole number from 1 to 1000"),
        ("events?since=-1", "since: is '-1'; allowed a whole number from 0 on"),
        ("events?since=", "since: is ''; allowed a whole number from 0 on"),
        ("events?since=%C2%B2", "since: is '²'; allowed a whole number from 0 on"),
        ("events?since=" + "9" * 5000, "since: is '99999999999999999999'; allowed"),
        ("recent?seconds=0", "seconds: is '0'; allowed a whole number from 1 to 600"),
        ("recent?seconds=601", "seconds: is '601'; allowed a whole number from 1 to 600"),
        ("recent?seconds=1.5", "seconds: is '1.5'; allowed a whole number from 1 to 600"),
    ],
)
def test_an_invalid_number_is_refused_with_the_allowed_range(client, query, sentence):
    answer = client.get(f"/api/{query}")
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith(sentence)


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.usefixtures("ordinary_scheduling")
def test_rest_log_and_journal_name_the_same_source_of_a_stop(tmp_path, caplog):
    config = Config(api={"port": 0}, recorder={"directory": tmp_path}, control={"policy": "hold"})
    with caplog.at_level(logging.INFO, "softarm.events"), Daemon(config, simulated_devices()) as daemon:
        until(lambda: daemon.loop.snapshot is not None)
        assert httpx.post(daemon.stop_url, trust_env=False).status_code == 200
        daemon.stop_by_key()
        assert httpx.post(f"{daemon.url}/api/acknowledge", trust_env=False).status_code in (200, 409)
        until(lambda: any(entry.what == "acknowledge" for entry in daemon.recorder.history.entries))
        recorded = httpx.get(f"{daemon.url}/api/events", trust_env=False).json()["events"]
    asked = [(event["what"], event["who"]) for event in recorded if event["kind"] == "request"]
    assert asked == [("stop", "the dedicated stop port"), ("stop", "the terminal"), ("acknowledge", "the API")]
    (stop,) = (event for event in recorded if event["kind"] == "stop")
    assert (stop["who"], stop["text"][:15]) == ("the dedicated stop port", "emergency stop:")
    texts = [entry.text for entry in logs.read(daemon.recorder.path).entries()]
    assert texts[: len(recorded)] == [event["text"] for event in recorded]
    assert [record.message for record in caplog.records if record.name == "softarm.events"] == texts
    assert len(incidents.listing(tmp_path)) == 1
