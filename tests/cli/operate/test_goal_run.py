"""Tests of `softarm goal run`, also with the documented policy."""

import json
import os
import re
from pathlib import Path

import pytest

from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.rest import GoalAnswer
from tests.cli.invoke import invoke
from tests.processes import running, said, until

ROOT = Path(__file__).parents[3]
READY = '"arming_refusals": []'


def run(state, number=3, **more):
    """Return a goal in the format of GET /api/goal."""
    values = {"kind": "run", "reason": None, "y_m": None, "z_m": None, "closest_m": None, "time_s": 0.0}
    return GoalAnswer(state=state, number=number, **values | more).model_dump()


@pytest.fixture
def runs(daemon, make_status):
    goal = GoalStatus(Goal("run"), "running", number=3)
    daemon.on("POST", "/api/goal", make_status(goal=goal, policy="wave") | {"warnings": []})
    return daemon


def test_goal_run_requests_a_run_and_prints_the_policy(softarm, runs):
    result = softarm("goal", "run")
    assert (result.exit_code, result.stdout) == (0, "running wave\n")
    assert runs.requests == [("POST", "/api/goal", {"kind": "run"})]


def test_goal_run_waits_for_the_end_of_the_episode(softarm, runs):
    runs.on("GET", "/api/goal", run("running"), run("reached", time_s=28.0))
    result = softarm("goal", "run", "--wait")
    assert (result.exit_code, result.stdout) == (0, "played to its end in 28.00 s\n")


def test_a_run_is_cancelled_after_the_given_time(softarm, runs, make_status):
    runs.on("GET", "/api/goal", run("running"), run("cancelled", time_s=0.2, reason="cancelled by request"))
    runs.on("DELETE", "/api/goal", make_status())
    result = softarm("goal", "run", "--seconds", 0.01)
    assert (result.exit_code, result.stdout) == (0, "cancelled after 0.20 s, as requested\n")


def test_a_run_cancelled_by_another_client_fails(softarm, runs):
    runs.on("GET", "/api/goal", run("cancelled", time_s=0.2, reason="disarmed by request"))
    result = softarm("goal", "run", "--seconds", 60)
    assert (result.exit_code, result.stderr) == (1, "cancelled: disarmed by request\n")


@pytest.mark.parametrize(("end", "code"), [("reached", 0), ("failed", 1)])
def test_json_output_contains_only_the_end(softarm, runs, end, code):
    runs.on("GET", "/api/goal", run(end, time_s=1.0, reason="why"))
    result = softarm("goal", "run", "--wait", "--json")
    assert (result.exit_code, json.loads(result.stdout)["state"]) == (code, end)


@pytest.mark.realtime
@pytest.mark.timeout(120)
def test_the_documented_policy_flies_from_the_command_line(install, tmp_path, monkeypatch):
    page = (ROOT / "docs" / "policies" / "interface.md").read_text(encoding="utf-8").partition("## Your own policy")[2]
    code = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert code is not None
    install("my_package", code[1], wave="Wave")
    config = tmp_path / "arm.yaml"
    config.write_text(f"api: {{port: 0}}\ncontrol: {{policy: wave}}\nrecorder: {{directory: {tmp_path}/logs}}\n")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', ROOT)}"}

    with running("run", "--simulated", "--config", config, env=environment) as daemon:
        monkeypatch.setenv("SOFTARM_URL", said(daemon, r"serving (http://\S+)"))

        def printed(*arguments):
            return invoke(*arguments).output

        until(lambda: (status := invoke("status", "--json")).exit_code == 0 and READY in status.output)
        assert printed("arm") == "armed\n"
        listed = printed("policy", "list")
        assert "* wave          sweeps the cart to and fro  (needs no target: `softarm goal run`)" in listed
        assert re.fullmatch(r"cancelled after 0\.\d\d s, as requested\n", printed("goal", "run", "--seconds", "0.5"))
        assert json.loads(printed("status", "--json"))["rail_position_m"] > 0.02
