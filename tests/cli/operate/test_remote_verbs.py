"""Tests of the verbs that use a running daemon."""

import json
import socket
import threading
import time
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from softarm.cli.shared.console import clock
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import ActiveEvent, EStop, Mode, Outputs, Problems
from softarm.daemon.stop.listener import StopListener
from softarm.schemas.config import Api
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.log import LogEntry
from softarm.schemas.rest import GoalAnswer, LogsAnswer, PoliciesAnswer, PolicyAnswer
from tests.cli.invoke import invoke, refuse
from tests.tls import certified

RUNNING = GoalStatus(Goal("reach", -0.2, 0.6), "running", closest_m=0.083, time_s=1.23, number=3)


def goal(kind, state, number=3, **more):
    """Return a goal in the format of GET /api/goal."""
    values = {"kind": kind, "reason": None, "y_m": None, "z_m": None, "closest_m": None, "time_s": 0.0}
    return GoalAnswer(state=state, number=number, **values | more).model_dump()


@pytest.fixture
def accepts_goal(daemon, make_status):
    daemon.on("POST", "/api/goal", make_status(goal=RUNNING, policy="wave") | {"warnings": []})
    daemon.on("DELETE", "/api/goal", make_status())
    return daemon


def test_arm_waits_until_the_arm_is_armed(softarm, daemon, make_status):
    daemon.on("POST", "/api/arm", make_status(mode=Mode.ARMING))
    arming = make_status(mode=Mode.ARMING)
    daemon.on("GET", "/api/status", make_status(mode=Mode.DISARMED), arming, arming, make_status(mode=Mode.ARMED))
    result = softarm("arm")
    assert (result.exit_code, result.stdout) == (0, "armed\n")
    assert [path for _, path, _ in daemon.requests] == ["/api/status", "/api/arm"] + ["/api/status"] * 3


def settling(make_status, *more):
    text = "motion capture has only just come up (9 of 30 frames): wait for it"
    events = [{"name": "mocap_settling", "response": "warn", "text": text}]
    return make_status(mode=Mode.DISARMED) | {"events": events, "arming_refusals": [text, *more]}


def test_arm_waits_for_motion_capture_to_settle(softarm, daemon, make_status):
    ready, armed = make_status(mode=Mode.DISARMED), make_status(mode=Mode.ARMED)
    daemon.on("POST", "/api/arm", armed)
    daemon.on("GET", "/api/status", settling(make_status), settling(make_status), ready, armed)
    assert softarm("arm").exit_code == 0
    assert [path for _, path, _ in daemon.requests] == ["/api/status"] * 3 + ["/api/arm", "/api/status"]


def test_arm_does_not_wait_if_another_reason_remains(softarm, daemon, make_status):
    daemon.on("GET", "/api/status", settling(make_status, "no reading from the rail yet: check it"))
    daemon.on("POST", "/api/arm", make_status(mode=Mode.DISARMED))
    softarm("arm")
    assert [path for _, path, _ in daemon.requests][:2] == ["/api/status", "/api/arm"]


def test_arm_limits_its_wait_for_motion_capture(softarm, daemon, make_status, monkeypatch):
    monkeypatch.setattr("softarm.cli.operate.arming._SETTLES_S", 0.02)
    daemon.on("GET", "/api/status", settling(make_status))
    daemon.on("POST", "/api/arm", make_status(mode=Mode.DISARMED))
    softarm("arm")
    assert ("POST", "/api/arm", None) in daemon.requests


def test_a_failed_arm_prints_the_reason(softarm, daemon, make_status):
    daemon.on("POST", "/api/arm", make_status(mode=Mode.ARMING))
    daemon.on("GET", "/api/status", make_status(mode=Mode.DISARMED, last_stop="the drive did not enable"))
    result = softarm("arm")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == "not armed, mode disarmed: the drive did not enable\n"


@pytest.mark.parametrize(
    ("verb", "path", "printed"),
    [
        ("disarm", "/api/disarm", "disarmed"),
        ("stop", "/api/stop", "stopped and latched; `softarm acknowledge` releases the latch"),
        ("acknowledge", "/api/acknowledge", "disarmed"),
    ],
)
def test_disarm_stop_and_acknowledge_print_the_result(softarm, daemon, make_status, verb, path, printed):
    daemon.on("POST", path, make_status())
    daemon.on("GET", "/api/status", make_status(mode=Mode.DISARMED))
    result = softarm(verb)
    assert (result.exit_code, result.stdout) == (0, printed + "\n")
    assert daemon.requests[0] == ("POST", path, None)


def test_a_long_disarm_prints_once_what_it_waits_for(softarm, daemon, make_status, monkeypatch):
    monkeypatch.setattr("softarm.cli.shared.console.PATIENCE_S", 0.0)
    daemon.on("POST", "/api/disarm", make_status(mode=Mode.STOPPING))
    stopping = [make_status(mode=Mode.STOPPING)] * 4
    daemon.on("GET", "/api/status", *stopping, make_status(mode=Mode.DISARMED))
    result = softarm("disarm")
    assert (result.exit_code, result.stdout) == (0, "disarmed\n")
    assert result.stderr == "holding the cart until the arm is still ...\n"


@pytest.fixture
def stop_port():
    """Run the dedicated stop port of a stopped daemon; yield its inbox and port."""
    inbox = Inbox()
    stopped = Outputs(1 << 62, 1, 0, 0, 0, Mode.STOPPED, EStop.LATCHED)
    way = StopListener(Api(port=0), inbox, lambda: stopped)
    yield inbox, way.start()
    way.stop()


def test_stop_uses_the_dedicated_port(softarm, daemon, stop_port):
    inbox, port = stop_port
    result = softarm("stop", "--stop-port", port)
    assert (result.exit_code, result.stdout) == (0, "stopped and latched; `softarm acknowledge` releases the latch\n")
    assert [post.request.kind for post in inbox.take()] == ["stop"]
    assert daemon.requests == []


def test_the_stop_port_is_by_default_the_port_of_the_api_plus_one(softarm, stop_port, monkeypatch):
    inbox, port = stop_port
    monkeypatch.delenv("SOFTARM_STOP_PORT")
    assert softarm("stop", "--url", f"http://127.0.0.1:{port - 1}").exit_code == 0
    assert [post.request.kind for post in inbox.take()] == ["stop"]


def test_a_stop_that_no_daemon_confirms_names_the_button_within_seconds(softarm):
    with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts and never answers, like a frozen daemon
        port = silent.getsockname()[1]
        begun_s = time.monotonic()
        result = softarm("stop", "--url", f"http://127.0.0.1:{port}", "--stop-port", port)
        assert time.monotonic() - begun_s < 4.0
    assert result.exit_code == 1
    assert result.stderr.startswith("NOT confirmed: use the emergency-stop button; the daemon at")
    assert "has not answered for 1 s" in result.stderr


class Late(BaseHTTPRequestHandler):
    """Daemon behind a proxy whose TLS handshake takes longer than a stop waits for its answer."""

    def do_POST(self):
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"{}")


def test_a_stop_over_a_link_that_connects_slowly_arrives(softarm, tmp_path, monkeypatch):
    context, certificate = certified(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    with HTTPServer(("127.0.0.1", 0), Late) as server:
        server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
        threading.Timer(1.2, server.serve_forever).start()
        result = softarm("stop", "--url", f"https://localhost:{server.server_port}")
        server.shutdown()
    assert "stopped and latched" in result.stdout


def test_stop_falls_back_to_rest_if_another_program_has_the_port(softarm, daemon, make_status):
    daemon.on("POST", "/api/stop", make_status())  # an answer without `stopped`
    result = softarm("stop", "--stop-port", daemon.server.server_port)
    assert result.exit_code == 0
    assert [path for _, path, _ in daemon.requests] == ["/api/stop"] * 2


@pytest.mark.parametrize(
    ("arguments", "body", "said"),
    [
        (("reach", "-0.2", "0.6"), {"kind": "reach", "y_m": -0.2, "z_m": 0.6}, "reaching for y -0.2, z 0.6 m\n"),
        (("run",), {"kind": "run"}, "running wave\n"),
        (("hold",), {"kind": "hold"}, "holding\n"),
    ],
)
def test_a_goal_is_requested_and_printed(softarm, accepts_goal, arguments, body, said):
    result = softarm("goal", *arguments)
    assert (result.exit_code, result.stdout) == (0, said)
    assert accepts_goal.requests == [("POST", "/api/goal", body)]


REACH, RUN = ("reach", -0.2, 0.6, "--wait"), ("run", "--wait")


@pytest.mark.parametrize(
    ("arguments", "end", "said"),
    [
        (REACH, goal("reach", "reached", time_s=1.234, closest_m=0.0391), "reached in 1.23 s, closest 0.039 m\n"),
        (RUN, goal("run", "reached", time_s=28.0), "played to its end in 28.00 s\n"),
        (("run", "--seconds", 0.01), goal("run", "cancelled", time_s=0.2), "cancelled after 0.20 s, as requested\n"),
    ],
)
def test_wait_ends_with_the_goal(softarm, accepts_goal, arguments, end, said):
    running = goal(end["kind"], "running", time_s=0.4, closest_m=0.2)
    accepts_goal.on("GET", "/api/goal", running, running, end)
    result = softarm("goal", *arguments)
    assert (result.exit_code, result.stdout) == (0, said)
    deleted = ("DELETE", "/api/goal", None) in accepts_goal.requests
    assert deleted == ("--seconds" in arguments)


@pytest.mark.parametrize(
    ("arguments", "end", "message"),
    [
        (REACH, goal("reach", "failed", reason="time limit of 3.33 s"), "failed: time limit of 3.33 s\n"),
        (REACH, goal("reach", "cancelled", reason="disarmed"), "cancelled: disarmed\n"),
        (("run", "--seconds", 60), goal("run", "cancelled", time_s=0.2, reason="disarmed"), "cancelled: disarmed\n"),
        (REACH, goal("reach", "running", number=4), "another goal has replaced this one: see `softarm status`\n"),
        (REACH, goal("reach", "reached", number=5), "another goal has replaced this one: see `softarm status`\n"),
    ],
)
def test_wait_fails_with_the_reason_if_the_goal_is_not_reached(softarm, accepts_goal, arguments, end, message):
    accepts_goal.on("GET", "/api/goal", goal(end["kind"], "running"), end)
    result = softarm("goal", *arguments)
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.endswith(message)


@pytest.mark.parametrize(("end", "code"), [("reached", 0), ("failed", 1)])
def test_json_output_contains_only_the_end(softarm, accepts_goal, end, code):
    accepts_goal.on("GET", "/api/goal", goal("run", end, time_s=1.0, reason="why"))
    result = softarm("goal", *RUN, "--json")
    assert (result.exit_code, json.loads(result.stdout)["state"]) == (code, end)


def test_warnings_go_to_stderr(softarm, daemon, make_status):
    daemon.on("POST", "/api/goal", make_status() | {"warnings": ["never trained there"]})
    result = softarm("goal", "reach", 0.5, 0.6)
    assert result.exit_code == 0
    assert result.stderr == "warning: never trained there\n"


def test_cancel_ends_the_goal(softarm, accepts_goal):
    assert softarm("goal", "cancel").stdout == "cancelled\n"
    assert accepts_goal.requests == [("DELETE", "/api/goal", None)]


def test_goal_without_a_verb_shows_the_state_of_the_goal(softarm, daemon, make_status):
    daemon.on("GET", "/api/status", make_status(), make_status(goal=RUNNING))
    assert softarm("goal").stdout == "no goal since the daemon started; `softarm goal --help` lists the verbs\n"
    assert softarm("goal", "--url", daemon.url).stdout == "reach y -0.2, z 0.6 m: running, 1.2 s, closest 0.083 m\n"
    result = softarm("goal", "--url", daemon.url, "hold")
    assert (result.exit_code, daemon.requests[2:]) == (2, [])
    assert "--url goes after the verb" in result.stderr


def test_policies_are_listed_with_the_one_in_use_marked(softarm, daemon):
    policies = (
        PolicyAnswer(name="hold", plugin="hold", description="stands still", error=None),
        PolicyAnswer(name="reach-wide", plugin="onnx", description="learned", error=None),
    )
    daemon.on("GET", "/api/policies", PoliciesAnswer(active="reach-wide", policies=policies).model_dump())
    assert softarm("policy", "list").stdout == "  hold        stands still\n* reach-wide  learned\n"
    assert json.loads(softarm("policy", "list", "--json").stdout)["active"] == "reach-wide"


def test_without_a_daemon_the_installed_policies_are_listed(softarm, daemon):
    daemon.close()
    result = softarm("policy", "list")
    assert (result.exit_code, result.stderr.startswith(f"no daemon answers at {daemon.url}: ")) == (0, True)
    assert "  hold          cart at rest" in result.stdout
    assert "\n  reach-wide    learned" in result.stdout


def test_the_policies_of_a_configuration_are_listed_without_a_daemon(softarm, daemon, tmp_path):
    config = tmp_path / "arm.yaml"
    config.write_text("control: {policy: mine}\npolicies: {mine: {plugin: pid}, broken: {plugin: pdi}}\n")
    lines = softarm("policy", "list", "--config", config).stdout.splitlines()
    assert any(line.startswith("* mine          PID") for line in lines)
    assert any("cannot be used: no plugin 'pdi'; did you mean 'pid'?" in line for line in lines)
    assert daemon.requests == []
    config.write_text("polices: {}\n")
    assert "did you mean policies?" in softarm("policy", "list", "--config", config).stderr


def test_a_policy_is_chosen_by_name(softarm, daemon, make_status):
    daemon.on("PUT", "/api/policy", make_status())
    assert softarm("policy", "use", "pid").stdout == "using pid\n"
    assert daemon.requests == [("PUT", "/api/policy", {"name": "pid"})]


def test_logs_are_listed_with_size_duration_and_path(softarm, daemon):
    logs = tuple(
        LogEntry(
            name=name,
            bytes=size,
            modified="2026-11-21T10:00:00+00:00",
            duration_s=length,
            finished=length is not None,
            recording=recording,
        )
        for name, size, length, recording in (
            ("b.mcap", 2_500_000, None, True),
            ("a.mcap", 9_100_000, 61.04, False),
            ("c.mcap", 0, None, False),
        )
    )
    daemon.on("GET", "/api/logs", LogsAnswer(directory="/var/log/softarm", logs=logs).model_dump(mode="json"))
    lines = softarm("logs", "list").stdout.splitlines()
    assert [line[19:] for line in lines] == [
        "       2.5 MB             /var/log/softarm/b.mcap  (recording)",
        "       9.1 MB     61.0 s  /var/log/softarm/a.mcap",
        "       0.0 MB             /var/log/softarm/c.mcap  (unfinished)",
    ]


def test_status_of_a_healthy_arm_is_complete(softarm, daemon, make_status):
    daemon.on("GET", "/api/status", make_status(goal=RUNNING, clamps=("rail_velocity",)))
    assert softarm("status").stdout.splitlines() == [
        "mode      armed",
        "policy    reach",
        "goal      reach y -0.2, z 0.6 m: running, 1.2 s, closest 0.083 m",
        "tip       y -0.123 m, z 0.541 m",
        "cart      y +0.012 m, +0.10 m/s",
        "pressure  4.2 kPa",
        "sent      +0.25 m/s, 5.0 kPa (limited by rail_velocity)",
        "loop      tick 1234, 2 missed, 0.2 ms late",
        "log       logs/a.mcap",
    ]


def test_status_shows_every_fault(softarm, daemon, make_status):
    event = ActiveEvent("mocap_stale", "stop", "no frame for 0.3 s [see the bridge]")
    daemon.on(
        "GET",
        "/api/status",
        make_status(
            mode=Mode.STOPPED,
            estop=EStop.LATCHED,
            observed=None,
            events=(event,),
            stalled=True,
            policy_fault="late: 20 ms",
            problems=Problems(rail="10.0.0.1:502: connect: refused; switch it on"),
            arming_refusals=("acknowledge the stop first",),
            last_stop="mocap_stale",
            last_stop_at=datetime(2026, 11, 22, 12, 0, 0, 250_000, tzinfo=UTC),
            goal=GoalStatus(Goal("hold"), "cancelled", reason="stopped"),
        ),
    )
    out = softarm("status").stdout
    for line in (
        "the control loop has stopped: the values below are old; see the daemon's own output",
        "mode      stopped; emergency stop latched",
        "policy    reach: late: 20 ms",
        "goal      hold: cancelled (stopped), 0.0 s",
        "rail      10.0.0.1:502: connect: refused; switch it on",
        "event     mocap_stale (stop): no frame for 0.3 s [see the bridge]",
        "cannot arm: acknowledge the stop first",
        f"last stop: mocap_stale ({clock('2026-11-22T12:00:00.250Z')})",
    ):
        assert line + "\n" in out
    assert "tip" not in out


def test_status_as_json_is_the_unchanged_answer_of_the_api(softarm, daemon, make_status):
    daemon.on("GET", "/api/status", b'{"mode": "armed"}')
    assert softarm("status", "--json").stdout == '{\n "mode": "armed"\n}\n'


def test_a_missing_token_names_the_option(softarm, daemon):
    daemon.on("GET", "/api/status", {"detail": "send `Authorization: Bearer TOKEN`", "reasons": []}, code=401)
    result = refuse("give it with --token-file FILE or $SOFTARM_TOKEN", "status")
    assert "Bearer" not in result.stderr


@pytest.mark.parametrize(
    ("code", "detail", "said"),
    [
        (409, "mocap: no frame; see the bridge", "mocap: no frame; see the bridge"),
        (500, [{}], "POST /api/arm: HTTP 500"),
    ],
)
def test_a_refusal_is_printed_in_the_daemons_words(softarm, daemon, make_status, code, detail, said):
    daemon.on("GET", "/api/status", make_status())
    daemon.on("POST", "/api/arm", {"detail": detail, "reasons": []}, code=code)
    result = softarm("arm")
    assert (result.exit_code, result.stdout, result.stderr) == (1, "", f"{said}\n")


def test_a_daemon_that_does_not_answer_times_out(monkeypatch):
    monkeypatch.setattr("softarm.cli.shared.client.TIMEOUT_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        refuse("has not answered for 0.05 s", "status", "--url", f"http://127.0.0.1:{silent.getsockname()[1]}")


def test_a_broken_connection_is_reported(softarm, daemon):
    daemon.hang_up("GET", "/api/status")
    refuse(f"the connection to {daemon.url} broke", "status")


def test_a_token_file_overrides_the_token_of_the_environment(softarm, daemon, tmp_path, monkeypatch, make_status):
    daemon.on("GET", "/api/status", make_status())
    softarm("status")
    assert "Authorization" not in daemon.headers
    monkeypatch.setenv("SOFTARM_TOKEN", "from-environment")
    softarm("status")
    assert daemon.headers["Authorization"] == "Bearer from-environment"
    (tmp_path / "token").write_text("from-file\n")
    softarm("status", "--token-file", tmp_path / "token")
    assert daemon.headers["Authorization"] == "Bearer from-file"
    refuse("none: cannot be read", "status", "--token-file", tmp_path / "none")
    (tmp_path / "token").write_text("schlüssel")
    message = "token: is no token; allowed are letters, digits and other printable ASCII characters; name"
    refuse(message, "status", "--token-file", tmp_path / "token")


def test_proxies_of_the_environment_are_ignored(softarm, daemon, monkeypatch, make_status):
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:9")
    daemon.on("GET", "/api/status", make_status())
    assert softarm("status").exit_code == 0


def test_a_newer_api_is_refused_except_for_a_stop(softarm, daemon, make_status):
    daemon.extra_headers = {"softarm-api": "2"}
    daemon.on("POST", "/api/acknowledge", make_status())
    refuse("uses version 2 of the API, this command version 1: update softarm here", "acknowledge")
    assert daemon.headers["softarm-api"] == "1"
    daemon.on("POST", "/api/stop", make_status())
    assert softarm("stop").exit_code == 0


def test_the_next_command_has_the_address_and_the_token_that_were_typed(daemon, make_status, tmp_path):
    token = tmp_path / "a token"
    token.write_text("secret")
    daemon.on("POST", "/api/stop", make_status())
    result = invoke("stop", "--url", daemon.url, "--token-file", token, "--stop-port", 1)
    assert result.stdout == (
        f"stopped and latched; `softarm acknowledge --url {daemon.url} --token-file '{token}'` releases the latch\n"
    )
