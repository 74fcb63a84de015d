"""What would keep the daemon from starting is told beforehand, all of it at once, and nothing is left behind."""

import os
import socket
import threading

import pytest

from softarm.daemon.api.sockets import ApiError, holder, listen
from softarm.daemon.shell import preflight, realtime
from softarm.daemon.stop.latch import LatchKeeper, latch_path


@pytest.fixture
def look(tmp_path):
    """A file, and what a preflight with it says."""

    def look(text, wires=True, thorough=False):
        path = tmp_path / "arm.yaml"
        path.write_text(text)
        return preflight.look(path, wires, thorough)

    return look


@pytest.fixture
def taken():
    """A port at which this process listens."""
    with listen("127.0.0.1", 0, "api.port", 1) as listener:
        yield listener.getsockname()[1]


def where(tmp_path, port=0):
    return f"api: {{port: {port}}}\nrecorder: {{directory: {tmp_path}/logs}}\n"


def test_a_sound_file_has_no_problem_and_nothing_is_left_behind(look, tmp_path):
    found = look(where(tmp_path) + "control: {policy: hold}\n", thorough=True)
    assert found.problems == ()
    assert found.config.control.policy == "hold"
    assert os.listdir(tmp_path) == ["arm.yaml"]


@pytest.mark.parametrize("key", ["port", "stop_port"])
def test_a_port_that_is_taken_is_told_with_who_has_it(look, tmp_path, taken, key):
    other = "" if key == "port" else "port: 0, "
    found = look(f"recorder: {{directory: {tmp_path}/logs}}\napi: {{{other}{key}: {taken}}}\n")
    line = f"{tmp_path}/arm.yaml:2: api.host 127.0.0.1, api.{key} {taken}: cannot listen there, process {os.getpid()} ("
    assert [problem.startswith(line) for problem in found.problems] == [True]
    assert f"does; stop that one (`softarm status` asks a daemon), or choose another api.{key}" in found.problems[0]


def test_trying_a_port_out_keeps_nobody_from_it(look, tmp_path):
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    failed = []

    def tries():
        for _ in range(50):
            failed.extend(look(where(tmp_path, port), wires=False).problems)

    threads = [threading.Thread(target=tries) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []


def test_an_address_of_another_machine_is_told_as_that():
    with pytest.raises(ApiError, match=r"api\.port 1: cannot listen there \(.*\); name an address of this machine"):
        listen("192.0.2.1", 1, "api.port", 1)


def test_nobody_holds_a_port_that_is_free(taken):
    assert holder(taken).startswith(f"process {os.getpid()} (")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        assert holder(free.getsockname()[1]) is None


def test_a_folder_for_logs_that_is_none_is_told_once(look, tmp_path):
    (tmp_path / "logs").write_text("a file")
    found = look(where(tmp_path))
    assert len(found.problems) == 1
    assert f":2: recorder.directory {tmp_path}/logs: no log can be written there" in found.problems[0]
    assert look("recorder: {enabled: false}\napi: {port: 0}\n", wires=False).problems == ()


def test_a_robot_that_another_daemon_has_is_told(look, tmp_path):
    text = where(tmp_path)
    keeper = LatchKeeper(latch_path(look(text).config))
    keeper.start()
    try:
        assert "another daemon has this robot" in look(text).problems[0]
        assert look(text, wires=False).problems == ()
    finally:
        keeper.stop()
    assert look(text).problems == ()


def test_a_policy_that_cannot_do_a_step_is_found_where_it_is_tried_out(look, tmp_path):
    text = where(tmp_path) + "control: {policy: mine}\npolicies: {mine: {plugin: pid, options: {kp_y: text}}}\n"
    assert look(text).problems == ()
    (problem,) = look(text, thorough=True).problems
    assert problem.startswith(f"{tmp_path}/arm.yaml:3: control.policy: policy 'mine': ")


def test_one_mistake_hides_no_other(look, tmp_path, taken):
    text = f"api: {{port: {taken}, view_token: x}}\ncontrol: {{rate_hz: 60, policy: raech}}\n"
    text += f"limits: {{rail: {{latency_s: 0}}}}\nrecorder: {{directory: {tmp_path}/logs, keep_mb: 1}}\n"
    told = "\n".join(look(text).problems)
    for place, word in (
        (1, "api.view_token: unknown key"),
        (2, "control.rate_hz: is 60; allowed 30"),
        (3, "limits.rail.latency_s: is 0.0, below 0.005"),
        (4, "recorder.keep_mb: is 1; allowed"),
        (2, "control.policy: no policy 'raech'; did you mean 'reach'?"),
        (1, f"api.port {taken}: cannot listen there"),
    ):
        assert f"arm.yaml:{place}: {word}" in told or f"arm.yaml:{place}: api.host 127.0.0.1, {word}" in told


def test_what_stands_wrong_in_the_file_is_not_told_again_by_its_default(look, tmp_path):
    found = look(f"api: {{port: 0}}\nrecorder: {{directory: {tmp_path}/logs}}\ncontrol: {{policy: 7}}\n")
    assert [problem.partition(":3: ")[2][:14] for problem in found.problems] == ["control.policy"]


def test_a_file_that_says_nothing_leaves_nothing_to_try(look):
    assert look("- a list\n").loaded is None


def test_the_defaults_are_tried_without_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("softarm.policies.registry.MODELS", tmp_path / "none")
    problems = preflight.look(None, wires=False).problems
    assert problems[0].startswith("control.policy: no policy 'reach'")


def test_whether_priority_is_granted_is_asked_without_taking_it():
    before = os.sched_getscheduler(0)
    said = realtime.refused(20)
    assert said is None or "LimitRTPRIO=" in said
    assert os.sched_getscheduler(0) == before
    assert realtime.refused(0) is None
