"""GET /api/events, and who is behind a request, over real sockets and the real recorder."""

import pytest

from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs
from softarm.daemon.logbook.history import History
from softarm.schemas.config import Config

TOKEN, VIEW = "0123456789abcdef0123456789abcdef", "v" * 32


@pytest.fixture
def told(loop, app, client_of):
    """A client of a daemon to which ten things happened."""
    history = History("run1", lambda: 0, lambda: 1_800_000_000_000_000_000)
    for tick in range(1, 11):
        mode = Mode.ARMED if tick % 2 else Mode.DISARMED
        history.take(Inputs(tick), Outputs(tick, tick, 0, 0, 0, mode, EStop.CLEAR))
    return client_of(app(loop, history=history))


def test_events_are_told_from_the_newest_or_after_a_number(told):
    answer = told.get("/api/events").json()
    assert [event["number"] for event in answer["events"]] == list(range(1, 11))
    assert (answer["run"], answer["oldest"], answer["newest"]) == ("run1", 1, 10)
    assert answer["events"][0] == {
        "number": 1,
        "t_ns": 1,
        "time": "2027-01-15T08:00:00Z",
        "tick": 1,
        "kind": "mode",
        "what": "armed",
        "text": "armed, was disarmed",
        "who": None,
        "accepted": None,
    }
    assert [e["number"] for e in told.get("/api/events?limit=2").json()["events"]] == [9, 10]
    assert [e["number"] for e in told.get("/api/events?since=3&limit=2").json()["events"]] == [4, 5]


def test_before_anything_happened_there_is_nothing_to_tell(client):
    assert client.get("/api/events").json() == {"run": "", "events": [], "oldest": None, "newest": None}


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("limit=0", "limit: is '0'; allowed a whole number from 1 to 1000"),
        ("limit=1001", "limit: is '1001'; allowed a whole number from 1 to 1000"),
        ("since=-1", "since: is '-1'; allowed a whole number from 0 on"),
        ("since=", "since: is ''; allowed a whole number from 0 on"),
        ("since=%C2%B2", "since: is '²'; allowed a whole number from 0 on"),
        ("since=" + "9" * 5000, "since: is '99999999999999999999'; allowed"),
    ],
)
def test_another_number_is_refused_with_what_is_allowed(told, query, sentence):
    answer = told.get(f"/api/events?{query}")
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith(sentence)


def test_a_request_carries_whose_it_is(loop, app, client_of, tmp_path):
    for name, text in (("token", TOKEN), ("view", VIEW)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o600)
    config = Config(api={"host": "0.0.0.0", "token_file": tmp_path / "token", "view_token_file": tmp_path / "view"})
    client = client_of(app(loop, config), "http://robot.example")
    client.post("/api/arm", headers={"Authorization": f"Bearer {TOKEN}"})
    client.post("/api/stop", headers={"Authorization": f"Bearer {VIEW}"})
    assert [post.request.who for post in loop.taken] == [
        "the API with the command token",
        "the API with the view token",
    ]


def test_without_a_token_it_is_the_apis(client, loop):
    client.post("/api/disarm")
    assert loop.taken[-1].request.who == "the API"
