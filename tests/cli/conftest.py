"""A fake daemon on a real socket, with answers in the format of the real API."""

import json
import threading
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from pydantic import TypeAdapter

from softarm.daemon.access import sockets
from softarm.daemon.api.status import Ages, RecorderInfo, Status
from softarm.daemon.control.records import EStop, Mode, Observed, Problems
from softarm.schemas.config import Api
from softarm.schemas.messages import Command
from softarm.schemas.policy import Observation
from tests.cli.invoke import invoke
from tests.cli.trial_folder import write_trial

STATUS = TypeAdapter(Status)


def status(**changes):
    """Return a status in the format of GET /api/status."""
    values = {
        "t_ns": 0,
        "time": 1.7e9,
        "bodies": None,
        "tick": 1234,
        "late_ns": 200_000,
        "missed": 0,
        "missed_total": 2,
        "mode": Mode.ARMED,
        "estop": EStop.CLEAR,
        "policy": "reach",
        "sent": Command(True, 0.25, 5.0),
        "observed": Observed(Observation(0.012, 0.1, -0.123, 0.541, 0.0, 0.0, 0.2, 4.2), 7, 0, 0, 0),
        "stalled": False,
        "ages_ms": Ages(),
        "problems": Problems(),
        "policy_info": None,
        "recorder": RecorderInfo("logs/a.mcap", 0, None),
        "uptime_s": 3.0,
        "version": "0.1.0",
    }
    return json.loads(STATUS.dump_json(Status(**values | changes)))


class FakeDaemon:
    """HTTP server that answers each request with the next of its given answers; the last one repeats."""

    def __init__(self):
        self.answers = {}
        self.extra_headers = {}
        self.requests = []
        daemon = self

        class Handler(BaseHTTPRequestHandler):
            def handle_one(self):
                body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
                daemon.requests.append((self.command, self.path, json.loads(body) if body else None))
                daemon.headers = dict(self.headers)
                waiting = daemon.answers[self.command, self.path]
                code, answer = waiting.popleft() if len(waiting) > 1 else waiting[0]
                if code is None:
                    self.close_connection = True
                    self.connection.close()
                    return
                data = answer if isinstance(answer, bytes) else json.dumps(answer).encode()
                self.send_response(code)
                self.send_header("Content-Length", str(len(data)))
                for name, value in daemon.extra_headers.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(data)

            do_GET = do_POST = do_PUT = do_DELETE = handle_one

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def on(self, method, path, *answers, code=200):
        self.answers[method, path] = deque((code, answer) for answer in answers)

    def hang_up(self, method, path):
        self.answers[method, path] = deque([(None, None)])

    def close(self):
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def daemon():
    fake = FakeDaemon()
    yield fake
    fake.close()


@pytest.fixture
def softarm(daemon, monkeypatch):
    """Run the command line against the fake daemon."""
    monkeypatch.setenv("SOFTARM_URL", daemon.url)
    monkeypatch.setenv("SOFTARM_STOP_PORT", "1")  # unused; the default port may belong to another test
    monkeypatch.delenv("SOFTARM_TOKEN", raising=False)

    return invoke


@pytest.fixture
def make_status():
    return status


@pytest.fixture
def campaign(tmp_path):
    """Return a campaign of one trial `a`: one second of pressure."""
    return write_trial(tmp_path / "campaign" / "a").parent


@pytest.fixture(autouse=True)
def _no_announcements(ordinary_scheduling: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Suppress announcements of long waits, which depend on the load, and keep the priority of the process."""
    monkeypatch.setattr("softarm.cli.shared.console.PATIENCE_S", 600.0)
    monkeypatch.setattr("softarm.common.processes.FIRST_LINE_S", 600.0)


@pytest.fixture(autouse=True)
def _free_default_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the check of the ports accept the default ones, which a daemon of this computer may use."""
    try_out = sockets.try_out
    defaults = {Api().port, Api().stops_at}
    monkeypatch.setattr(sockets, "try_out", lambda host, port, key: port in defaults or try_out(host, port, key))
