"""The REST API over a real inbox: every endpoint, and every refusal with its sentence."""

import asyncio
import json
import math
import re
import signal
import socket
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect as connect_sync

from daemon import logs, workspace
from daemon.api import ApiContext, create_app
from daemon.auth import AuthError, is_loopback, load_token
from daemon.inbox import Inbox
from daemon.recorder import Recorder
from daemon.records import ActiveEvent, EStop, Mode, Observed, Outputs, Problems, RequestResult
from daemon.server import ApiError, ApiServer
from daemon.status import StatusView
from policies.base import PolicyError, PolicySpec
from policies.registry import PolicyEntry
from schemas.config import Api, Config
from schemas.goals import Goal, GoalStatus
from schemas.messages import Command
from schemas.policy import TrainingRange

LOCAL = "http://127.0.0.1"
TOKEN = "0123456789abcdef0123456789abcdef"


class Swing:
    """A policy that does as it is told by the test."""

    def __init__(self, name: str, failure: Exception | None = None) -> None:
        self.spec = PolicySpec(name, "swings")
        self.failure, self.steps, self.resets = failure, 0, 0

    def reset(self) -> None:
        self.resets += 1

    def step(self, observation, goal):
        self.steps += 1
        if self.failure:
            raise self.failure
        return np.zeros(2, dtype=np.float32)


class Shelf:
    """The policies of this test."""

    def __init__(self) -> None:
        trained = TrainingRange(target_y_m=(-0.4, 0.0), target_z_m=(0.55, 0.70), cart_start_m=(-0.025, 0.25))
        self.entries = {
            "broken": PolicyEntry("broken", "test", spec=PolicySpec("broken", "raises")),
            "lost": PolicyEntry("lost", "test", error="its file is gone; train it again"),
            "pid": PolicyEntry("pid", "test", spec=PolicySpec("pid", "the seed's gains")),
            "reach": PolicyEntry("reach", "test", spec=PolicySpec("reach", "swings", True, 100, trained, "ab")),
        }
        self.loaded: list[tuple[Swing, str]] = []

    def available(self):
        return self.entries

    def load(self, name):
        if name == "lost":
            raise PolicyError("policy 'lost': its file is gone; available: pid, reach")
        policy = Swing(name, ValueError("no weights") if name == "broken" else None)
        self.loaded.append((policy, threading.current_thread().name))
        return policy


class Loop:
    """Stands in for the control loop: empties the inbox and answers what the test wants answered."""

    def __init__(self) -> None:
        self.inbox = Inbox()
        self.refuse: tuple[str, ...] = ()
        self.problems = Problems()
        self.taken = []
        self.outputs: Outputs | None = Outputs(
            time.monotonic_ns(),
            0,
            0,
            0,
            0,
            Mode.ARMED,
            EStop.CLEAR,
            sent=Command(True, 0.25, math.nan),
            policy="reach",
            observed=Observed((0.0,) * 8, 7, 5_000_000, 6_000_000, 7_000_000),
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self._stop.wait(1 / 100):
            posts = self.inbox.take()
            self.taken += posts
            results = tuple(RequestResult(p.request.number, not self.refuse, self.refuse) for p in posts)
            before = self.outputs
            self.outputs = replace(
                before, t_ns=time.monotonic_ns(), tick=before.tick + 1, results=(*before.results, *results)[-32:]
            )

    @contextmanager
    def running(self):
        self._thread.start()
        try:
            yield self
        finally:
            self._stop.set()
            self._thread.join()
            for post in self.taken:
                if post.runner is not None:
                    post.runner.close()


class Client:
    """Asks an application in this thread, without a socket."""

    def __init__(self, app, url: str = LOCAL) -> None:
        self._app, self._url = app, url

    def request(self, method: str, path: str, **kwargs) -> httpx.Response:
        async def ask() -> httpx.Response:
            async with httpx.AsyncClient(transport=httpx.ASGITransport(self._app), base_url=self._url) as client:
                return await client.request(method, path, **kwargs)

        return asyncio.run(ask())

    def get(self, path: str, **kwargs) -> httpx.Response:
        return self.request("GET", path, **kwargs)

    def post(self, path: str, **kwargs) -> httpx.Response:
        return self.request("POST", path, **kwargs)

    def put(self, path: str, **kwargs) -> httpx.Response:
        return self.request("PUT", path, **kwargs)


def context(loop: Loop, config: Config | None = None, **kwargs) -> ApiContext:
    shared = {"policies": Shelf(), "problems": lambda: loop.problems} | kwargs
    return ApiContext(config or Config(), loop.inbox, lambda: loop.outputs, **shared)


@pytest.fixture
def loop():
    with Loop().running() as running:
        yield running


@pytest.fixture
def client(loop):
    made = Client(create_app(context(loop)), LOCAL)
    return made


@pytest.fixture
def silent():
    """A client of a daemon whose control loop does not tick."""
    loop = Loop()
    made = Client(create_app(context(loop)), LOCAL)
    return made, loop


def test_the_status_is_the_snapshot_and_what_stands_around_it(client, loop):
    loop.problems = Problems(rail="127.0.0.1:502: connect: refused; is the gateway on?")
    status = client.get("/api/status").json()
    assert set(Outputs.__dataclass_fields__) <= set(status)
    assert status["mode"] == "armed"
    assert status["sent"] == {"enable": True, "cart_velocity_m_s": 0.25, "pressure_kpa": None}
    assert status["ages_ms"] == {"mocap": 5.0, "pressure": 6.0, "rail": 7.0}
    assert status["policy_info"]["trained"]["target_z_m"] == [0.55, 0.70]
    assert status["problems"]["rail"].startswith("127.0.0.1:502")
    assert status["recorder"] == {"log": None, "dropped": 0, "problem": None}
    assert status["stalled"] is False
    assert status["uptime_s"] >= 0
    assert status["version"]


def test_a_snapshot_is_encoded_once_however_many_ask(silent):
    _, loop = silent
    loop.outputs = replace(loop.outputs, t_ns=time.monotonic_ns() + 60_000_000_000)
    view = StatusView(lambda: loop.outputs, Problems, None, {}, time.monotonic_ns, "1")
    assert view.json() is view.json()
    before = view.json()
    loop.outputs = replace(loop.outputs, tick=99)
    assert view.json() is not before
    assert json.loads(view.json())["tick"] == 99


def test_before_the_first_tick_there_is_no_status(silent):
    client, loop = silent
    loop.outputs = None
    for path in ("/api/status", "/api/goal"):
        answer = client.get(path)
        assert answer.status_code == 503
        assert "has not ticked yet" in answer.json()["detail"]


def test_health_is_200_when_nothing_is_wrong(client):
    answer = client.get("/api/health")
    assert (answer.status_code, answer.json()) == (200, {"healthy": True, "reasons": []})


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"estop": EStop.LATCHED}, "the emergency stop is latched: POST /api/acknowledge"),
        ({"estop": EStop.ENGAGED}, "the emergency stop is engaged: remove its cause"),
        (
            {"events": (ActiveEvent("mocap_stale", "soft_stop", "too old (230 ms): check the bridge"),)},
            "mocap_stale: too old (230 ms): check the bridge",
        ),
    ],
)
def test_health_is_503_with_the_reason(client, loop, change, sentence):
    loop.outputs = replace(loop.outputs, **change)
    answer = client.get("/api/health")
    assert answer.status_code == 503
    assert answer.json()["healthy"] is False
    assert any(reason.startswith(sentence) for reason in answer.json()["reasons"])


def test_a_warning_is_not_ill_health(client, loop):
    loop.outputs = replace(loop.outputs, events=(ActiveEvent("tick_late", "warn", "late"),))
    assert client.get("/api/health").status_code == 200


def test_health_names_devices_and_recorder(loop, tmp_path):
    recorder = Recorder(Config())
    recorder.problem = "the log ends here: the disk is full"
    loop.problems = Problems(mocap="tcp/127.0.0.1:7447: listen: address in use; stop the other one")
    client = Client(create_app(context(loop, recorder=recorder)), LOCAL)
    reasons = client.get("/api/health").json()["reasons"]
    assert reasons == [
        "mocap: tcp/127.0.0.1:7447: listen: address in use; stop the other one",
        "recorder: the log ends here: the disk is full",
    ]


def test_a_loop_that_stands_still_is_told_by_health_and_status(silent):
    client, loop = silent
    loop.outputs = replace(loop.outputs, t_ns=time.monotonic_ns() - 3_000_000_000)
    answer = client.get("/api/health")
    assert answer.status_code == 503
    assert answer.json()["reasons"][0].startswith("the control loop has not ticked for 3.")
    assert client.get("/api/status").json()["stalled"] is True


@pytest.mark.parametrize(
    ("method", "path", "kind"),
    [
        ("POST", "/api/arm", "arm"),
        ("POST", "/api/disarm", "disarm"),
        ("POST", "/api/stop", "stop"),
        ("POST", "/api/acknowledge", "acknowledge"),
        ("DELETE", "/api/goal", "cancel_goal"),
    ],
)
def test_a_request_is_answered_by_the_loop(client, loop, method, path, kind):
    answer = client.request(method, path)
    assert answer.status_code == 200
    number = loop.taken[-1].request.number
    assert loop.taken[-1].request.kind == kind
    assert {"number": number, "accepted": True, "reasons": []} in answer.json()["results"]  # the new status
    loop.refuse = ("the arm is stopping", "no mocap: start the bridge")
    answer = client.request(method, path)
    assert answer.status_code == 409
    assert answer.json() == {
        "detail": "the arm is stopping; no mocap: start the bridge",
        "reasons": ["the arm is stopping", "no mocap: start the bridge"],
    }


def test_a_silent_loop_is_a_503_that_says_so(silent):
    client, _ = silent
    answer = client.post("/api/arm")
    assert answer.status_code == 503
    assert "arm: the control loop did not answer within 0.5 s" in answer.json()["detail"]
    assert "use the emergency-stop button" in client.post("/api/stop").json()["detail"]


def test_a_full_inbox_is_a_503_but_a_stop_gets_through(silent):
    client, loop = silent
    for _ in range(16):
        loop.inbox.post("disarm")
    answer = client.post("/api/arm")
    assert answer.status_code == 503
    assert "has not taken the last 16 requests" in answer.json()["detail"]
    client.post("/api/stop")
    assert loop.inbox.take()[0].request.kind == "stop"


def test_a_goal_reaches_the_loop_and_comes_back(client, loop):
    answer = client.post("/api/goal", json={"kind": "reach", "y_m": -0.2, "z_m": 0.65})
    assert answer.status_code == 200
    assert answer.json()["warnings"] == []
    assert loop.taken[-1].request.goal == Goal("reach", -0.2, 0.65)
    client.post("/api/goal", json={"kind": "hold"})
    assert loop.taken[-1].request.goal.kind == "hold"


def test_a_target_outside_the_training_range_is_taken_with_a_warning(client):
    warnings = client.post("/api/goal", json={"kind": "reach", "y_m": 0.2, "z_m": 0.75}).json()["warnings"]
    assert warnings == [
        "y_m 0.2 lies outside what the policy 'reach' was trained on (-0.4..0 m): it may miss",
        "z_m 0.75 lies outside what the policy 'reach' was trained on (0.55..0.7 m): it may miss",
    ]


def test_the_goal_is_shown_flat(client, loop):
    nothing = client.get("/api/goal").json()
    assert nothing == {
        "kind": None,
        "state": "none",
        "reason": None,
        "y_m": None,
        "z_m": None,
        "closest_m": None,
        "time_s": 0.0,
        "number": 0,
    }
    loop.outputs = replace(loop.outputs, goal=GoalStatus(Goal("reach", -0.2, 0.6), "failed", "too far", 0.07, 3.3, 4))
    assert client.get("/api/goal").json() == {
        "kind": "reach",
        "state": "failed",
        "reason": "too far",
        "y_m": -0.2,
        "z_m": 0.6,
        "closest_m": 0.07,
        "time_s": 3.3,
        "number": 4,
    }
    loop.outputs = replace(loop.outputs, goal=GoalStatus(Goal("hold"), "running"))
    assert client.get("/api/goal").json()["y_m"] is None


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ('{"kind": "reach", "y_m": "left", "z_m": 0.6}', "y_m: must be a number; allowed -0.6..0.6 m"),
        ('{"kind": "reach", "y_m": "0.1", "z_m": 0.6}', "y_m: must be a number; allowed -0.6..0.6 m"),
        ('{"kind": "reach", "y_m": NaN, "z_m": 0.6}', "y_m: must be a number; allowed -0.6..0.6 m"),
        ('{"kind": "reach", "y_m": 0, "z_m": 1e999}', "z_m: must be a number; allowed 0.5..0.85 m"),
        ('{"kind": "reach", "y_m": 0}', "z_m: is missing, it must be a number; allowed 0.5..0.85 m"),
        ('{"kind": "reach", "y_m": null, "z_m": 0.6}', "y_m: must be a number; allowed -0.6..0.6 m"),
        ('{"kind": "fly"}', "kind: must be 'reach', 'hold' or 'run'; send {"),
        ('{"y_m": 0, "z_m": 0.6}', "kind: must be 'reach', 'hold' or 'run'; send {"),
        ('{"kind": "hold", "y_m": 0}', "y_m: is not known here; send {"),
        ('{"kind": "reach"', "the body is not JSON ("),
        ("[1, 2]", "the body must be a JSON object"),
        ("", "the body must be a JSON object"),
        ('{"kind": "reach", "y_m": 0.7, "z_m": 0.9}', "y_m 0.7 is outside the workspace; allowed -0.6..0.6 m"),
        ('{"kind": "reach", "y_m": 0, "z_m": 0.9}', "z_m 0.9 is outside the workspace; allowed 0.5..0.85 m"),
        ('{"kind": "reach", "y_m": 0.6, "z_m": 0.5}', "the target (0.6, 0.5) is 0.582 m from where the hinge"),
    ],
)
def test_a_wrong_goal_is_refused_with_what_is_allowed(client, loop, body, sentence):
    answer = client.post("/api/goal", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert answer.json()["reasons"][0].startswith(sentence)
    assert not loop.taken


def test_a_body_without_its_content_type_is_told_what_to_send(client):
    answer = client.post("/api/goal", content='{"kind": "hold"}', headers={"Content-Type": "text/plain"})
    assert answer.status_code == 422
    assert "Content-Type: application/json" in answer.json()["detail"]


@given(y=st.floats(-0.6, 0.6), z=st.floats(0.5, 0.85))
def test_a_target_is_within_reach_exactly_when_some_hinge_position_reaches_it(y, z):
    refused = bool(workspace.refusals(Goal("reach", y, z), Config()))
    hinges = np.linspace(-0.25, 0.25, 2001)
    distance = np.hypot(y - hinges, z - 0.965).min()
    if abs(distance - 0.4825) > 1e-3:
        assert refused == (distance > 0.4825)


def test_the_policies_are_listed_with_those_that_cannot_be_used(client):
    answer = client.get("/api/policies").json()
    assert answer["active"] == "reach"
    by_name = {policy["name"]: policy for policy in answer["policies"]}
    assert by_name["reach"]["sha256"] == "ab"
    assert by_name["reach"]["trained"]["target_y_m"] == [-0.4, 0.0]
    assert by_name["lost"]["error"] == "its file is gone; train it again"


def test_a_policy_is_loaded_and_warmed_up_beside_the_loop(loop):
    shelf = Shelf()
    client = Client(create_app(context(loop, policies=shelf)), LOCAL)
    answer = client.put("/api/policy", json={"name": "pid"})
    assert answer.status_code == 200
    policy, thread = shelf.loaded[0]
    assert (policy.steps, policy.resets) == (1, 2)
    assert "asyncio" in thread  # a worker's name
    post = loop.taken[-1]
    assert post.request.policy == "pid"
    outcome = post.runner.step(np.zeros(8, dtype=np.float32), np.zeros(2, dtype=np.float32))
    assert outcome.fault is None


def test_the_log_notes_which_model_flies(loop, tmp_path):
    recorder = Recorder(Config(recorder={"directory": tmp_path}), PolicySpec("reach", "swings"))
    recorder.start()
    client = Client(create_app(context(loop, recorder=recorder)))
    assert client.put("/api/policy", json={"name": "pid"}).status_code == 200
    loop.refuse = ("a goal is running",)
    assert client.put("/api/policy", json={"name": "reach"}).status_code == 409
    recorder.stop()
    assert [policy["name"] for policy in logs.read(recorder.path).policies] == ["reach", "pid"]


def test_the_runner_of_a_refused_policy_ends(client, loop):
    loop.refuse = ("a goal is running: wait for it or DELETE /api/goal first",)
    answer = client.put("/api/policy", json={"name": "pid"})
    assert answer.status_code == 409
    assert not any(thread.name == "policy pid" for thread in threading.enumerate())


@pytest.mark.parametrize(
    ("body", "code", "sentence"),
    [
        ({"name": "nix"}, 404, "no policy 'nix'; there are: broken, lost, pid, reach"),
        ({"name": "lost"}, 422, "policy 'lost': its file is gone; available: pid, reach"),
        ({"name": "broken"}, 422, "policy 'broken': its first step failed (ValueError: no weights)"),
        ({}, 422, "name: is missing, it must be text; GET /api/policies lists the names"),
        ({"name": 3}, 422, "name: must be text; GET /api/policies lists the names"),
    ],
)
def test_a_wrong_policy_is_refused(client, loop, body, code, sentence):
    answer = client.put("/api/policy", json=body)
    assert answer.status_code == code
    assert answer.json()["detail"].startswith(sentence)
    assert not loop.taken


def test_the_logs_are_listed_and_the_present_one_is_marked(loop, tmp_path):
    config = Config(recorder={"directory": tmp_path})
    old, new = Recorder(config), Recorder(config)
    old.start()
    old.stop()
    new.start()
    try:
        client = Client(create_app(context(loop, config, recorder=new)), LOCAL)
        answer = client.get("/api/logs").json()
        status = client.get("/api/status").json()
    finally:
        new.stop()
    assert answer["directory"] == str(tmp_path)
    assert {entry["name"]: entry["recording"] for entry in answer["logs"]} == {
        old.path.name: False,
        new.path.name: True,
    }
    assert status["recorder"]["log"] == str(new.path)


def test_the_documentation_names_every_endpoint_with_an_example(client):
    page = client.get("/docs")
    assert page.status_code == 200
    scripts = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert scripts
    assert all(client.get(script).status_code == 200 for script in scripts)  # nothing from the internet
    api = client.get("/openapi.json").json()
    assert {(method.upper(), path) for path, methods in api["paths"].items() for method in methods} == {
        ("GET", "/api/status"),
        ("GET", "/api/health"),
        ("POST", "/api/arm"),
        ("POST", "/api/disarm"),
        ("POST", "/api/stop"),
        ("POST", "/api/acknowledge"),
        ("POST", "/api/goal"),
        ("DELETE", "/api/goal"),
        ("GET", "/api/goal"),
        ("GET", "/api/policies"),
        ("PUT", "/api/policy"),
        ("GET", "/api/logs"),
    }
    goal = api["paths"]["/api/goal"]["post"]["requestBody"]["content"]["application/json"]
    assert goal["examples"]["reach"]["value"] == {"kind": "reach", "y_m": -0.2, "z_m": 0.65}
    assert all(method["description"] for methods in api["paths"].values() for method in methods.values())


# Who may ask


def test_loopback_refuses_foreign_hosts_and_pages(client):
    answer = client.get("/api/status", headers={"Host": "robot.example:8080"})
    assert answer.status_code == 403
    assert "the Host header is 'robot.example:8080'" in answer.json()["detail"]
    answer = client.post("/api/arm", headers={"Origin": "https://evil.example"})
    assert answer.status_code == 403
    assert "a page of 'https://evil.example' may not command this robot" in answer.json()["detail"]
    assert client.post("/api/arm", headers={"Origin": "null"}).status_code == 403
    assert client.post("/api/arm", headers={"Origin": LOCAL}).status_code == 200
    for host in ("localhost:8080", "[::1]:8080", "127.0.0.1"):
        assert client.get("/api/status", headers={"Host": host}).status_code == 200


def test_loopback_refuses_foreign_pages_on_the_stream_too(loop):
    with serving(create_app(context(loop))) as port, pytest.raises(InvalidStatus) as refusal:
        connect_sync(f"ws://127.0.0.1:{port}/api/stream", origin="https://evil.example")
    assert refusal.value.response.status_code == 403
    assert b"may not command this robot" in refusal.value.response.body


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("192.168.1.4", False),
        ("robot.example", False),
    ],
)
def test_loopback_is_known(host, expected):
    assert is_loopback(host) is expected


def token_file(directory: Path, text: str = TOKEN + "\n", mode: int = 0o600) -> Path:
    path = directory / "token"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_another_address_requires_a_token(loop):
    with pytest.raises(AuthError, match=r"api\.host 0\.0\.0\.0 .* needs api\.token_file: write a long random"):
        create_app(context(loop, Config(api={"host": "0.0.0.0"})))


@pytest.mark.parametrize(
    ("text", "mode", "sentence"),
    [
        ("short", 0o600, "holds 5 characters; allowed: one word, 16 or more"),
        ("two words that are long enough", 0o600, "one word"),
        (TOKEN, 0o604, "every user of this machine can open it; `chmod o= "),
        ("ü" * 20, 0o600, "cannot be read"),
    ],
)
def test_a_bad_token_file_is_refused(tmp_path, text, mode, sentence):
    with pytest.raises(AuthError) as refusal:
        load_token(Api(host="0.0.0.0", token_file=token_file(tmp_path, text, mode)))
    assert sentence in str(refusal.value)
    with pytest.raises(AuthError, match="cannot be read"):
        load_token(Api(token_file=tmp_path / "missing"))


def test_with_a_token_every_request_needs_it(loop, tmp_path):
    config = Config(api={"host": "0.0.0.0", "token_file": token_file(tmp_path)})
    client = Client(create_app(context(loop, config)), "http://robot.example")
    for path in ("/api/status", "/docs", "/openapi.json", "/nothing"):
        answer = client.get(path)
        assert answer.status_code == 401
        assert "send `Authorization: Bearer" in answer.json()["detail"]
    wrong = client.get("/api/status", headers={"Authorization": f"Bearer {TOKEN}x"})
    assert (wrong.status_code, wrong.json()["detail"][:18]) == (401, "the token is wrong")
    assert client.get("/api/status", headers={"Authorization": TOKEN}).status_code == 401
    right = {"Authorization": f"Bearer {TOKEN}"}
    assert client.get("/api/status", headers=right).status_code == 200


def test_with_a_token_the_stream_needs_it_too(loop, tmp_path):
    config = Config(api={"port": 0, "token_file": token_file(tmp_path)})
    with serving(create_app(context(loop, config)), config.api) as port:
        address = f"ws://127.0.0.1:{port}/api/stream"
        with pytest.raises(InvalidStatus) as refusal:
            connect_sync(address)
        assert refusal.value.response.status_code == 401
        right = {"Authorization": f"Bearer {TOKEN}"}
        with connect_sync(address, additional_headers=right) as socket:
            assert json.loads(socket.recv(timeout=5))["mode"] == "armed"


# Over a real socket, in a thread of its own


@contextmanager
def serving(app, config: Api | None = None):
    server = ApiServer(config or Api(port=0), app)
    port = server.start()
    try:
        yield port
    finally:
        started = time.monotonic()
        server.stop()
        assert time.monotonic() - started < 1.2
        assert not any(thread.name == "api" for thread in threading.enumerate())


def test_the_server_answers_and_gives_its_port_back(loop):
    with serving(create_app(context(loop))) as port:
        assert httpx.get(f"{LOCAL}:{port}/api/status").json()["mode"] == "armed"
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{LOCAL}:{port}/api/status")


def test_a_port_that_is_taken_is_refused_with_the_next_step(loop):
    app = create_app(context(loop))
    with serving(app) as port, pytest.raises(ApiError) as refusal:
        ApiServer(Api(port=port), app).start()
    assert f"api.host 127.0.0.1, api.port {port}: cannot listen there" in str(refusal.value)
    assert "choose another api.port" in str(refusal.value)
    with pytest.raises(ApiError, match=r"api\.host 192\.0\.2\.1"):
        ApiServer(Api(host="192.0.2.1", port=0), app).start()


def test_the_server_takes_no_signals(loop):
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
    with serving(create_app(context(loop))):
        assert {s: signal.getsignal(s) for s in before} == before


def test_the_stream_sends_new_snapshots_at_the_rate_asked_for(loop):
    async def watch(port: int, query: str) -> tuple[list[int], float]:
        async with connect(f"ws://127.0.0.1:{port}/api/stream{query}") as socket:
            await socket.recv()
            started = time.monotonic()
            ticks = [json.loads(await socket.recv())["tick"] for _ in range(8)]
            return ticks, time.monotonic() - started

    async def both(port: int):
        return await asyncio.gather(watch(port, ""), watch(port, "?hz=10"))

    with serving(create_app(context(loop))) as port:  # the loop ticks at about 100 Hz
        (fast, fast_s), (slow, slow_s) = asyncio.run(both(port))
    assert fast == sorted(set(fast))
    assert slow == sorted(set(slow))
    assert fast_s >= 8 * 0.8 / 30
    assert slow_s >= 8 * 0.08
    assert slow[-1] - slow[0] > fast[-1] - fast[0]


@pytest.mark.parametrize("hz", ["0", "-1", "31", "nan", "fast"])
def test_the_stream_refuses_a_rate_it_does_not_have(loop, hz):
    with (
        serving(create_app(context(loop))) as port,
        pytest.raises((InvalidStatus, ConnectionClosed)),
        connect_sync(f"ws://127.0.0.1:{port}/api/stream?hz={hz}") as socket,
    ):
        socket.recv(timeout=5)


def test_a_client_that_does_not_read_holds_up_nobody_and_piles_nothing_up(loop):
    loop.outputs = replace(loop.outputs, clamps=("x" * 1_000_000,))
    with serving(create_app(context(loop))) as port, ExitStack() as stack:
        address = f"ws://127.0.0.1:{port}/api/stream"
        pipe = small_pipe(port)
        deaf = stack.enter_context(connect_sync(address, sock=pipe, max_size=None, max_queue=1, close_timeout=0.2))
        good = stack.enter_context(connect_sync(address, max_size=None))
        seen = [json.loads(good.recv(timeout=5))["tick"] for _ in range(40)]
        in_the_pipe = 0
        while json.loads(deaf.recv(timeout=5))["tick"] <= seen[-1]:
            in_the_pipe += 1
    assert in_the_pipe < 20  # of 40: what the sender's system had buffered (4 MB), and then the present


def small_pipe(port: int) -> socket.socket:
    """A connection whose receiving side holds little: left to itself, a system may buffer 32 MB of it."""
    pipe = socket.socket()
    pipe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
    pipe.connect(("127.0.0.1", port))
    return pipe


@pytest.mark.parametrize("reading", [True, False])
def test_stopping_closes_open_streams_at_once(loop, reading):
    with ExitStack() as stack:
        with serving(create_app(context(loop))) as port:  # which checks how long that takes
            address = f"ws://127.0.0.1:{port}/api/stream"
            good = stack.enter_context(connect_sync(address, max_size=None))
            other = stack.enter_context(connect_sync(address, max_size=None, max_queue=1, close_timeout=0.2))
            other.recv(timeout=5)
            if not reading:
                loop.outputs = replace(loop.outputs, clamps=("x" * 1_000_000,))
            for _ in range(3 if reading else 30):
                good.recv(timeout=5)
        with pytest.raises(ConnectionClosed):
            drain(good)


def drain(socket) -> None:
    while True:
        socket.recv(timeout=5)
