"""Checks before the start report all problems at once and leave nothing behind."""

import os
import socket
import threading

import pytest

from softarm.common import realtime
from softarm.daemon.access.sockets import listen
from softarm.daemon.config.configuration import latch_path
from softarm.daemon.runtime import preflight
from softarm.daemon.stop.latch import LatchKeeper


@pytest.fixture
def look(tmp_path):
    """Write a configuration file and return its preflight problems."""

    def look(text, wires=True, thorough=False):
        path = tmp_path / "arm.yaml"
        path.write_text(text)
        return preflight.look(path, wires, thorough)

    return look


@pytest.fixture
def taken():
    """Yield a port on which this process listens."""
    with listen("127.0.0.1", 0, "api.port", 1) as listener:
        yield listener.getsockname()[1]


def where(tmp_path):
    return f"api: {{port: 0}}\nrecorder: {{directory: {tmp_path}/logs}}\n"


def test_a_valid_file_has_no_problem_and_the_check_leaves_no_files(look, tmp_path):
    found = look(where(tmp_path) + "control: {policy: hold}\n")
    assert found.problems == ()
    assert found.config.control.policy == "hold"
    assert os.listdir(tmp_path) == ["arm.yaml"]


@pytest.mark.parametrize("key", ["port", "stop_port"])
def test_a_port_in_use_is_reported_with_its_process(look, tmp_path, taken, key):
    other = "stop_port: 0, " if key == "port" else "port: 0, "
    found = look(f"recorder: {{directory: {tmp_path}/logs}}\napi: {{{other}{key}: {taken}}}\n")
    line = f"{tmp_path}/arm.yaml:2: api.host 127.0.0.1, api.{key} {taken}: cannot listen there, process {os.getpid()} ("
    assert [problem.startswith(line) for problem in found.problems] == [True]
    assert f"does; stop that one (`softarm status` asks a daemon), or choose another api.{key}" in found.problems[0]


def test_checking_a_port_leaves_it_free(look, tmp_path):
    with socket.socket() as one, socket.socket() as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        port, stop_port = one.getsockname()[1], other.getsockname()[1]
    text = f"recorder: {{directory: {tmp_path}/logs}}\napi: {{port: {port}, stop_port: {stop_port}}}\n"
    failed = list(look(text, wires=False).problems)  # writes the file, which the threads only read

    def tries():
        for _ in range(6):
            failed.extend(preflight.look(tmp_path / "arm.yaml", False, False).problems)

    threads = [threading.Thread(target=tries) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []


def test_an_unusable_log_directory_is_reported_once(look, tmp_path):
    (tmp_path / "logs").write_text("a file")
    found = look(where(tmp_path))
    assert len(found.problems) == 1
    assert f":2: recorder.directory {tmp_path}/logs: no log can be written there" in found.problems[0]
    assert look("recorder: {enabled: false}\napi: {port: 0}\n", wires=False).problems == ()


def test_a_robot_of_another_daemon_is_reported(look, tmp_path):
    text = where(tmp_path)
    keeper = LatchKeeper(latch_path(look(text).config))
    keeper.start()
    try:
        assert "another daemon controls this robot" in look(text).problems[0]
        assert look(text, wires=False).problems == ()
    finally:
        keeper.stop()
    assert look(text).problems == ()


def test_a_policy_that_fails_in_its_first_step_is_found(look, tmp_path):
    text = where(tmp_path) + "control: {policy: mine}\npolicies: {mine: {plugin: pid, options: {kp_y: text}}}\n"
    assert look(text).problems == ()
    (problem,) = look(text, thorough=True).problems
    assert problem.startswith(f"{tmp_path}/arm.yaml:3: control.policy: policy 'mine': ")


def test_one_mistake_hides_no_other(look, tmp_path, taken):
    text = f"api: {{port: {taken}, view_token: x, token_file: no/token}}\ncontrol: {{rate_hz: 60, policy: raech}}\n"
    text += f"limits: {{rail: {{latency_s: 0}}}}\nrecorder: {{directory: {tmp_path}/logs, keep_mb: 1}}\n"
    text += "drivers: {mocap: {driver: zenho}}\n"
    reported = "\n".join(look(text).problems)
    for place, word in (
        (1, "api.view_token: unknown key"),
        (2, "control.rate_hz: is 60; allowed 30"),
        (3, "limits.rail.latency_s: is 0.0, below 0.005"),
        (4, "recorder.keep_mb: is 1; allowed"),
        (2, "control.policy: no policy 'raech'; did you mean 'reach'?"),
        (1, f"api.port {taken}: cannot listen there"),
        (1, "api.token_file no/token: cannot be read"),
        (5, "drivers.mocap.driver 'zenho': no motion capture source 'zenho'; did you mean 'zenoh'?"),
    ):
        assert f"arm.yaml:{place}: {word}" in reported or f"arm.yaml:{place}: api.host 127.0.0.1, {word}" in reported


def test_a_mistake_in_the_file_is_reported_once(look, tmp_path):
    found = look(f"api: {{port: 0}}\nrecorder: {{directory: {tmp_path}/logs}}\ncontrol: {{policy: 7}}\n")
    assert [problem.partition(":3: ")[2][:14] for problem in found.problems] == ["control.policy"]


def test_an_unreadable_file_skips_the_checks(look):
    assert look("- a list\n").loaded is None


def test_the_defaults_are_tried_without_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("softarm.policies.registry.MODELS", tmp_path / "none")
    problems = preflight.look(None, wires=False).problems
    assert problems[0].startswith("control.policy: no policy 'reach'")


def test_the_priority_check_leaves_the_priority_unchanged():
    before = os.sched_getscheduler(0)
    said = realtime.refused(20)
    assert said is None or "LimitRTPRIO=" in said
    assert os.sched_getscheduler(0) == before
    assert realtime.refused(0) is None


def test_a_ros_router_needs_rosbags_and_an_address_of_its_own(look, tmp_path, monkeypatch):
    text = where(tmp_path) + "ros: {router: tcp/localhost:7447}\n"
    assert look(text, wires=False).problems == ()
    (same,) = look(text).problems
    assert same.startswith(f"{tmp_path}/arm.yaml:3: ros.router is tcp/localhost:7447, and the daemon listens at ")
    assert same.endswith("tcp/127.0.0.1:7447; give motion capture another port, here and in bridge.yaml")
    monkeypatch.setattr(preflight.importlib.util, "find_spec", lambda name: None)
    (missing,) = look(text, wires=False).problems
    assert "rosbags is not installed; pip install 'softarm[ros]', or set it to null" in missing
