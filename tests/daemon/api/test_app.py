"""REST API over a real inbox: every endpoint and every refusal with its message."""

import json
import re
import threading
import time
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.daemon.control import workspace
from softarm.daemon.control.records import ActiveEvent, EStop, Outputs, Problems
from softarm.daemon.logbook.recorder import Recorder
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal, GoalStatus


def test_the_status_is_the_snapshot_and_its_context(client, loop):
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


def test_before_the_first_tick_there_is_no_status(silent):
    client, loop = silent
    loop.outputs = None
    for path in ("/api/status", "/api/goal"):
        answer = client.get(path)
        assert answer.status_code == 503
        assert "has not ticked yet" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"events": (ActiveEvent("tick_late", "warn", "late"),)}, None),
        (
            {"estop": EStop.LATCHED},
            "the emergency stop is latched: make sure that the arm is free, then run `softarm acknowledge`",
        ),
        ({"estop": EStop.ENGAGED}, "the emergency stop is engaged: remove its cause"),
        (
            {"events": (ActiveEvent("mocap_stale", "soft_stop", "too old (230 ms): check the bridge"),)},
            "mocap_stale: too old (230 ms): check the bridge",
        ),
    ],
)
def test_health_is_503_with_the_reason_unless_it_is_a_warning(client, loop, change, sentence):
    loop.outputs = replace(loop.outputs, **change)
    answer = client.get("/api/health")
    assert (answer.status_code, answer.json()["healthy"]) == ((200, True) if sentence is None else (503, False))
    assert all(reason.startswith(sentence) for reason in answer.json()["reasons"])


def test_a_wrong_method_is_answered_with_the_allowed_ones(client):
    answer = client.request("PATCH", "/api/goal")
    assert answer.status_code == 405
    assert answer.headers["Allow"] == "DELETE, GET, POST"


def test_health_names_devices_and_recorder(loop, app, client_of):
    recorder = Recorder(Config())
    recorder.problem = "the log ends here: the disk is full"
    loop.problems = Problems(mocap="tcp/127.0.0.1:7447: listen: address in use; stop the other one")
    client = client_of(app(loop, recorder=recorder))
    reasons = client.get("/api/health").json()["reasons"]
    assert reasons == [
        "mocap: tcp/127.0.0.1:7447: listen: address in use; stop the other one",
        "recorder: the log ends here: the disk is full",
    ]


def test_health_and_status_report_a_stalled_loop(silent):
    client, loop = silent
    loop.outputs = replace(loop.outputs, t_ns=time.monotonic_ns() - 3_000_000_000)
    answer = client.get("/api/health")
    assert answer.status_code == 503
    assert answer.json()["reasons"][0].startswith("the control loop has not ticked for 3.")
    assert client.get("/api/status").json()["stalled"] is True


@pytest.mark.parametrize("kind", ["arm", "disarm", "stop", "acknowledge", "cancel_goal"])
def test_a_request_is_answered_by_the_loop(client, loop, kind):
    request = ("DELETE", "/api/goal") if kind == "cancel_goal" else ("POST", f"/api/{kind}")
    answer = client.request(*request)
    assert answer.status_code == 200
    number = loop.taken[-1].request.number
    assert loop.taken[-1].request.kind == kind
    assert {"number": number, "accepted": True, "reasons": []} in answer.json()["results"]  # the new status
    loop.refuse = ("the arm is stopping", "no mocap: start the bridge")
    answer = client.request(*request)
    assert answer.status_code == 409
    assert answer.json() == {
        "detail": "the arm is stopping; no mocap: start the bridge",
        "reasons": ["the arm is stopping", "no mocap: start the bridge"],
    }


@pytest.mark.slow
def test_a_silent_loop_is_a_503_with_the_reason(silent):
    client, _ = silent
    answer = client.post("/api/arm")
    assert answer.status_code == 503
    assert "arm: the control loop did not answer within 0.5 s" in answer.json()["detail"]
    assert "use the emergency-stop button" in client.post("/api/stop").json()["detail"]


def test_a_goal_reaches_the_loop_and_comes_back(client, loop):
    answer = client.post("/api/goal", json={"kind": "reach", "y_m": -0.2, "z_m": 0.65})
    assert answer.status_code == 200
    assert answer.json()["warnings"] == []
    assert loop.taken[-1].request.goal == Goal("reach", -0.2, 0.65)
    client.post("/api/goal", json={"kind": "hold"})
    assert loop.taken[-1].request.goal.kind == "hold"


def test_a_target_outside_the_training_range_is_accepted_with_a_warning(client):
    warnings = client.post("/api/goal", json={"kind": "reach", "y_m": 0.2, "z_m": 0.75}).json()["warnings"]
    assert warnings == [
        "y_m 0.2 is outside the training range of the policy 'reach' (-0.4..0 m): it may miss",
        "z_m 0.75 is outside the training range of the policy 'reach' (0.55..0.7 m): it may miss",
    ]


def test_the_goal_is_shown_flat(client, loop):
    def shown() -> tuple:
        answer = client.get("/api/goal").json()
        assert list(answer) == ["kind", "state", "reason", "y_m", "z_m", "closest_m", "time_s", "number"]
        return tuple(answer.values())

    assert shown() == (None, "none", None, None, None, None, 0.0, 0)
    loop.outputs = replace(loop.outputs, goal=GoalStatus(Goal("reach", -0.2, 0.6), "failed", "too far", 0.07, 3.3, 4))
    assert shown() == ("reach", "failed", "too far", -0.2, 0.6, 0.07, 3.3, 4)
    loop.outputs = replace(loop.outputs, goal=GoalStatus(Goal("hold"), "running"))
    assert shown() == ("hold", "running", None, None, None, None, 0.0, 0)


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ('{"kind": "reach", "y_m": "0.1", "z_m": 0.6}', "y_m: must be a number; allowed -0.6..0.6 m"),
        ('{"kind": "reach", "y_m": NaN, "z_m": 0.6}', "y_m: must be a number; allowed -0.6..0.6 m"),
        ('{"kind": "reach", "y_m": 0, "z_m": 1e999}', "z_m: must be a number; allowed 0.5..0.85 m"),
        ('{"kind": "reach", "y_m": 0}', "z_m: missing; must be a number; allowed 0.5..0.85 m"),
        ('{"kind": "reach", "y_m": null, "z_m": 0.6}', "y_m: must be a number; allowed -0.6..0.6 m"),
        ('{"kind": "fly"}', "kind: must be 'reach', 'hold' or 'run'; send {"),
        ('{"y_m": 0, "z_m": 0.6}', "kind: must be 'reach', 'hold' or 'run'; send {"),
        ('{"kind": "hold", "y_m": 0}', "y_m: unknown key; did you mean y_m? send {"),
        ('{"kind": "reach", "y": 1, "z_m": 0.6}', "y: unknown key; did you mean y_m? send {"),
        ('{"kind": "reach"', "the body is not JSON ("),
        ("[1, 2]", "the body must be a JSON object"),
        ("", "the body must be a JSON object"),
        ('{"kind": "reach", "y_m": 0.7, "z_m": 0.6}', "y_m 0.7 is outside the workspace; allowed -0.6..0.6 m"),
        ('{"kind": "reach", "y_m": 0, "z_m": 0.9}', "z_m 0.9 is outside the workspace; allowed 0.5..0.85 m"),
        (
            '{"kind": "reach", "y_m": 0.6, "z_m": 0.5}',
            "the target (0.6, 0.5) is out of reach, 0.582 m from the nearest position of the hinge",
        ),
    ],
)
def test_a_wrong_goal_is_refused_with_what_is_allowed(client, loop, body, sentence):
    answer = client.post("/api/goal", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert answer.json()["reasons"][0].startswith(sentence)
    assert not loop.taken


def test_a_body_without_content_type_is_refused_with_an_example(client):
    answer = client.post("/api/goal", content='{"kind": "hold"}', headers={"Content-Type": "text/plain"})
    assert (answer.status_code, "Content-Type: application/json" in answer.json()["detail"]) == (422, True)


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
    assert list(by_name) == ["reach", "pid", "broken", "lost"]  # the active one first, unusable ones last


def test_a_policy_is_loaded_and_warmed_up_outside_the_loop(loop, app, client_of, shelf):
    # Longer than a configuration allows: a busy machine delays the step.
    lenient = Config().failsafe.model_copy(update={"policy_budget_s": 60.0})
    client = client_of(app(loop, Config().model_copy(update={"failsafe": lenient}), policies=shelf))
    answer = client.put("/api/policy", json={"name": "pid"})
    assert answer.status_code == 200
    policy, thread = shelf.loaded[0]
    assert (len(policy.seen), policy.resets) == (2, 2)
    assert thread == "worker: loading the policy 'pid'"
    post = loop.taken[-1]
    assert post.request.policy == "pid"
    outcome = post.runner.step(np.zeros(8, dtype=np.float32), np.zeros(2, dtype=np.float32))
    assert outcome.fault is None


def test_the_runner_of_a_refused_policy_ends(client, loop):
    loop.refuse = ("a goal is running: wait for it or DELETE /api/goal first",)
    before = set(threading.enumerate())
    answer = client.put("/api/policy", json={"name": "pid"})
    assert answer.status_code == 409
    for runner in {thread for thread in threading.enumerate() if thread.name == "policy pid"} - before:
        runner.join(60)
        assert not runner.is_alive()


def test_the_runner_of_a_policy_that_found_the_inbox_full_ends(silent):
    client, stalled = silent
    for _ in range(16):
        stalled.inbox.post("arm")
    before = set(threading.enumerate())
    answer = client.put("/api/policy", json={"name": "pid"})
    assert (answer.status_code, "has not taken the last 16 requests" in answer.text) == (503, True)
    assert [thread for thread in set(threading.enumerate()) - before if thread.name == "policy pid"] == []


def test_a_policy_that_never_loads_delays_neither_the_next_nor_the_end(loop, app, serving, shelf, monkeypatch):
    monkeypatch.setattr("softarm.daemon.api.endpoints.policies.LOADING_S", 0.2)
    wedged = threading.Event()  # stands for a first step without end
    load = shelf.load
    shelf.load = lambda name: (wedged.wait(), load(name))[1] if name == "reach" else load(name)
    with serving(app(loop, policies=shelf)) as port:  # which checks that its end comes soon
        with httpx.Client(base_url=f"http://127.0.0.1:{port}") as client:
            answer = client.put("/api/policy", json={"name": "reach"})
            assert answer.status_code == 504
            assert "loading the policy 'reach': not finished within 0.2 s" in answer.json()["detail"]
            assert client.put("/api/policy", json={"name": "pid"}).status_code == 200
            assert client.put("/api/policy", json={"name": "reach"}).status_code == 504
            answer = client.put("/api/policy", json={"name": "pid"})
            assert answer.status_code == 503  # two that never end are enough
            assert "2 of these are running already" in answer.json()["detail"]
        wedges = [thread for thread in threading.enumerate() if thread.name.startswith("worker: ")]
    assert [thread.daemon for thread in wedges] == [True, True]  # the process does not wait for them
    wedged.set()
    for thread in wedges:
        thread.join()


@pytest.mark.parametrize(
    ("body", "code", "sentence"),
    [
        ({"name": "nix"}, 404, "no policy 'nix'; available: broken, lost, pid, reach"),
        ({"name": "lost"}, 422, "policy 'lost': its file is gone; available: pid, reach"),
        ({"name": "broken"}, 422, "policy 'broken': step raised ValueError: no weights; repair it"),
        ({}, 422, "name: missing; must be text; GET /api/policies lists the names"),
        ({"name": 3}, 422, "name: must be text; GET /api/policies lists the names"),
    ],
)
def test_a_wrong_policy_is_refused(client, loop, body, code, sentence):
    answer = client.put("/api/policy", json=body)
    assert answer.status_code == code
    assert answer.json()["detail"].startswith(sentence)
    assert not loop.taken


def test_the_logs_are_listed_and_the_current_one_is_marked(loop, tmp_path, app, client_of):
    config = Config(recorder={"directory": tmp_path})
    old, new = Recorder(config), Recorder(config)
    old.start()
    old.stop()
    new.start()
    try:
        client = client_of(app(loop, config, recorder=new))
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


PAGE = Path(__file__).parents[3] / "docs/reference/rest.md"


def test_the_documentation_names_every_endpoint_with_an_example(client):
    page = client.get("/docs")
    assert page.status_code == 200
    scripts = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert scripts
    assert all(client.get(script).status_code == 200 for script in scripts)  # nothing from the internet
    api = client.get("/openapi.json").json()
    served = {(method.upper(), path) for path, methods in api["paths"].items() for method in methods}
    listed = re.findall(r"`(GET|POST|PUT|DELETE) (/\S+)`", PAGE.read_text(encoding="utf-8"))
    assert {(method, path.replace("NAME", "{name}")) for method, path in listed} == served
    tags = {tag["name"] for tag in api["tags"]}
    assert all(set(method["tags"]) <= tags for methods in api["paths"].values() for method in methods.values())
    goal = api["paths"]["/api/goal"]["post"]["requestBody"]["content"]["application/json"]
    assert goal["examples"]["reach"]["value"] == {"kind": "reach", "y_m": -0.2, "z_m": 0.65}
    assert "warnings" in api["components"]["schemas"]["RequestAnswer"]["properties"]
    assert "prefixItems" not in json.dumps(api["components"]["schemas"]["RecentAnswer"])  # Schemathesis misreads it
    assert all(method["description"] for methods in api["paths"].values() for method in methods.values())


def test_every_answer_has_the_apis_version(client):
    for answer in (client.get("/api/status"), client.get("/nothing"), client.get("/api/status", headers={"Host": "x"})):
        assert answer.headers["softarm-api"] == "1"


@pytest.mark.parametrize("version", ["2", "99999999999999999999999", "one"])
def test_a_request_of_a_newer_version_is_refused_unless_it_is_a_stop(client, version):
    answer = client.post("/api/arm", headers={"softarm-api": version})
    assert answer.status_code == 400
    assert f"the request has version {version[:20]} of the API, this daemon supports 1" in answer.json()["detail"]
    assert client.post("/api/stop", headers={"softarm-api": version}).status_code == 200
    assert client.post("/api/arm", headers={"softarm-api": "1"}).status_code == 200
