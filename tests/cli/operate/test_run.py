"""Command `softarm run` on a robot that exists only in this process."""

import os
import signal
import socket

import httpx
import pytest

from softarm.daemon.assembly import Daemon
from softarm.daemon.logbook import logs
from tests.cli.invoke import invoke, refuse
from tests.processes import WAIT_S, running, said, until

pytestmark = pytest.mark.timeout(120)


def write(path, text):
    path.write_text(text)
    return path


# Over 3 s: a whole run from start to finished log, as a process of its own.
@pytest.mark.realtime
def test_a_simulated_run_arms_swings_and_ends_cleanly(tmp_path):
    config = write(tmp_path / "c.yaml", f"api: {{port: 0}}\nrecorder: {{directory: {tmp_path}}}\n")
    typist, terminal = os.openpty()
    with running("run", "--simulated", "--config", config, stdin=terminal, start_new_session=True) as process:
        url = said(process, r"serving (http://\S+)")
        recording = said(process, r"recording (\S+)")
        stop_url = said(process, r"POST (\S+); space or s here")
        with httpx.Client(base_url=url) as client:

            def shows(path: str, key: str, value: object) -> bool:
                return client.get(path).json().get(key, "nothing") == value

            # Not a status before the first tick, refusals until motion capture has settled.
            until(lambda: shows("/api/status", "arming_refusals", []))
            assert shows("/api/status", "mode", "disarmed")
            assert client.post("/api/arm").status_code == 200
            until(lambda: shows("/api/status", "mode", "armed"))
            goal = {"kind": "reach", "y_m": -0.2, "z_m": 0.6}
            assert client.post("/api/goal", json=goal).status_code == 200
            until(lambda: not shows("/api/goal", "state", "running"))
            assert shows("/api/goal", "state", "reached")
            assert httpx.post(stop_url).json()["mode"] == "stopped"
            until(lambda: shows("/api/status", "estop", "latched"))
            assert client.post("/api/acknowledge").status_code == 200
            os.write(typist, b" ")
            until(lambda: shows("/api/status", "estop", "latched"))
        process.send_signal(signal.SIGTERM)
        output = process.communicate(timeout=WAIT_S)[0]
    assert process.returncode == 0
    assert output.endswith(f"ended: the drive is off, the muscle vented; {recording} is closed\n")
    os.close(typist)
    os.close(terminal)
    assert logs.read(recording).finished


@pytest.fixture
def started(monkeypatch):
    """Replace the run of the daemon by its announcement, on port 9123 if any port will do."""

    def run(config, devices, announce, **_):
        announce(Daemon(config, devices))

    monkeypatch.setattr("softarm.daemon.assembly.run", run)
    monkeypatch.setattr("softarm.daemon.runtime.preflight.sockets.try_out", lambda *_: None)
    monkeypatch.setattr(Daemon, "port", property(lambda self: self.config.api.port or 9123, lambda *_: None), False)


@pytest.mark.usefixtures("started")
@pytest.mark.parametrize("port", [0, 8080, None])
def test_the_next_commands_name_a_port_that_is_not_the_default(tmp_path, port):
    config = write(tmp_path / "c.yaml", f"api: {{port: 9300, stop_port: 1}}\nrecorder: {{directory: {tmp_path}}}\n")
    option = () if port is None else ("--port", str(port))
    output = invoke("run", "--simulated", "--config", config, *option).output
    address = {0: " --url http://127.0.0.1:9123", 8080: "", None: " --url http://127.0.0.1:9300"}[port]
    assert f"next: `softarm arm{address}`, then `softarm goal reach -0.2 0.6{address}`" in output
    assert f"stop: `softarm stop{address}`" in output


@pytest.mark.usefixtures("started")
def test_the_next_commands_name_the_token_of_the_daemon(tmp_path):
    token = write(tmp_path / "a token", "0123456789abcdef")
    token.chmod(0o600)
    config = write(tmp_path / "c.yaml", f"api: {{token_file: {token}}}\nrecorder: {{directory: {tmp_path}}}\n")
    output = invoke("run", "--simulated", "--config", config).output
    assert f"next: `softarm arm --token-file '{token}'`, then" in output


@pytest.mark.usefixtures("started")
def test_the_dashboard_is_opened_on_request_at_an_address_of_this_computer(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("softarm.cli.operate.run.open_page", opened.append)
    config = write(tmp_path / "c.yaml", f"api: {{port: 0}}\nrecorder: {{directory: {tmp_path}}}\n")
    invoke("run", "--simulated", "--config", config)
    assert opened == []
    invoke("run", "--simulated", "--config", config, "--open")
    assert opened == ["http://127.0.0.1:9123"]


@pytest.mark.parametrize("verb", [["run", "--config"], ["excite", "seed", "--config"]])
def test_a_port_in_use_leaves_no_log(tmp_path, verb):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        config = write(tmp_path / "c.yaml", f"api: {{port: {port}}}\nrecorder: {{directory: {tmp_path}/logs}}\n")
        refuse(f"api.port {port}: cannot listen there, process {os.getpid()} (", *verb, config)
    assert os.listdir(tmp_path) == ["c.yaml"]
