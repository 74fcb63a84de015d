"""Live data for Foxglove by its own protocol: read-only, and no part of the daemon waits for it."""

import json
import socket
import struct
import time
from contextlib import contextmanager

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from softarm.daemon.assembly import Daemon
from softarm.daemon.foxglove.publisher import QUEUE_MAX, FoxgloveError, FoxglovePublisher
from softarm.daemon.runtime.devices import simulated_devices
from softarm.schemas.config import Config
from tests.processes import until

pytest.importorskip("foxglove")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]


class Viewer:
    """Client of the protocol foxglove.sdk.v1 with channels by topic."""

    def __init__(self, socket):
        self.socket = socket
        self.server = json.loads(self.socket.recv(10))
        self.channels = {}
        while not {"/tick", "/tf", "/state"} <= self.channels.keys():
            said = json.loads(self.socket.recv(10))
            assert said["op"] == "advertise"
            self.channels |= {channel["topic"]: channel for channel in said["channels"]}

    def subscribe(self, *topics):
        self.topics = dict(enumerate(topics))
        wanted = [{"id": number, "channelId": self.channels[topic]["id"]} for number, topic in self.topics.items()]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def messages(self):
        """Yield (topic, wall time in ns, content) without an end."""
        while True:
            data = self.socket.recv(10)
            if isinstance(data, bytes) and data[0] == 1:
                number, at_ns = struct.unpack_from("<IQ", data, 1)
                yield self.topics[number], at_ns, json.loads(data[13:])

    def until(self, *topics):
        """Return the first message of each topic."""
        found, messages = {}, self.messages()
        while not set(topics) <= found.keys():
            topic, *rest = next(messages)
            found.setdefault(topic, rest)
        return found


@contextmanager
def viewing(publisher, **options):
    with connect(
        publisher.url, subprotocols=["foxglove.sdk.v1"], max_size=None, close_timeout=0.2, **options
    ) as socket:
        yield Viewer(socket)


def config_of(folder):
    """Run a daemon without real-time priority, which the test's processes would inherit."""
    return Config.model_validate(
        {"api": {"port": 0, "stop_port": 0}, "recorder": {"directory": folder}, "control": {"realtime_priority": 0}}
    )


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    config = config_of(tmp_path_factory.mktemp("logs"))
    with Daemon(config, simulated_devices(), foxglove=FoxglovePublisher(config, port=0)) as daemon:
        yield daemon


@pytest.mark.parametrize(
    ("host", "url"), [("127.0.0.1", "ws://127.0.0.1:8765"), ("::1", "ws://[::1]:8765"), ("::", "ws://127.0.0.1:8765")]
)
def test_the_printed_address_opens_on_this_computer(host, url):
    assert FoxglovePublisher(Config(), host).url == url


@pytest.fixture(scope="module")
def robot(running):
    with httpx.Client(base_url=running.url, timeout=60) as client:
        yield client


def test_every_tick_arrives_once_and_in_order(running):
    with viewing(running.foxglove) as viewer:
        viewer.subscribe("/state")
        ticks = [said["tick"] for (_, _, said), _ in zip(viewer.messages(), range(30), strict=False)]
    assert ticks == list(range(ticks[0], ticks[0] + 30))


def test_events_are_published(running, robot):
    with viewing(running.foxglove) as viewer:
        viewer.subscribe("/state", "/log")
        viewer.until("/state")
        robot.post("/api/disarm").raise_for_status()
        said = next(said for topic, _, said in viewer.messages() if topic == "/log" and said["name"] == "request")
    assert (said["message"].partition(" requested")[0], said["level"]) == ("disarm", 2)


def test_a_viewer_cannot_command_the_robot(running, robot):
    """The server offers no capability and ignores messages, parameters and calls."""
    before = robot.get("/api/events").json()["newest"]
    with viewing(running.foxglove) as viewer:
        assert viewer.server["capabilities"] == []
        channel = {"id": 1, "topic": "/request", "encoding": "json", "schemaName": "", "schema": ""}
        for said in (
            {"op": "advertise", "channels": [channel]},
            {"op": "setParameters", "parameters": [{"name": "mode", "value": "armed"}]},
            {"op": "subscribeConnectionGraph"},
        ):
            viewer.socket.send(json.dumps(said))
        viewer.socket.send(struct.pack("<BI", 1, 1) + json.dumps({"number": 1, "kind": "arm"}).encode())
        viewer.socket.send(struct.pack("<BII4s", 2, 1, 1, b"json") + b"{}")
        viewer.subscribe("/state")
        assert viewer.until("/state")["/state"][1]["mode"] == "disarmed"
    assert robot.get("/api/events").json()["newest"] == before


def test_a_client_that_does_not_read_delays_no_other(running):
    """A client with a full connection loses messages; another one still gets the newest tick."""
    seen, publisher = [], running.foxglove
    running.recorder.listener = lambda tick, entries: (seen.append(tick), publisher.take(tick, entries))
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
    narrow.connect(("127.0.0.1", publisher.port))
    with viewing(publisher, sock=narrow) as stuck, viewing(publisher) as viewer:
        stuck.subscribe(*stuck.channels)
        viewer.subscribe("/state")
        viewer.until("/state")
        until(lambda: seen)
        for _ in range(500):  # some 5 MB
            publisher.take(seen[-1], [])
            time.sleep(0.0005)
        newest = seen[-1][1].tick
        assert next(said["tick"] for _, _, said in viewer.messages() if said["tick"] > newest)
    assert running.recorder.dropped == 0


def test_the_server_listens_on_loopback_only(running):
    with socket.create_connection(("127.0.0.1", running.foxglove.port)):
        pass
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.2", running.foxglove.port))


def test_the_daemon_survives_a_crash_of_the_server(running, robot, caplog):
    running.foxglove._server.kill()
    running.foxglove._thread.join(10)
    assert "Foxglove's server has ended" in caplog.text
    tick = robot.get("/api/status").json()["tick"]
    for _ in range(2 * QUEUE_MAX):  # more than the queue takes
        running.foxglove.take(None, [])
    while robot.get("/api/status").json()["tick"] < tick + 10:
        pass


def test_a_used_port_is_reported_and_ends_the_start(tmp_path):
    config = config_of(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        daemon = Daemon(config, simulated_devices(), foxglove=FoxglovePublisher(config, port=port))
        message = rf"Foxglove cannot be served at 127.0.0.1:{port} .*another port"
        with pytest.raises(FoxgloveError, match=message), daemon:
            pass
    assert daemon.foxglove._server.poll() is not None


def test_the_server_ends_with_its_daemon(tmp_path, monkeypatch):
    monkeypatch.setattr("softarm.daemon.foxglove.publisher.STOP_S", 120.0)  # a busy machine's server is not killed
    config = config_of(tmp_path)
    publisher = FoxglovePublisher(config, port=0)
    publisher.start()
    with viewing(publisher) as viewer:
        publisher.stop()
        with pytest.raises(ConnectionClosed):
            next(message for message in viewer.messages() if message is None)
    assert publisher._server.returncode == 0
