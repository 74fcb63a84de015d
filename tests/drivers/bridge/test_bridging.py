"""Frames from a NatNet server through the bridge to the daemon's driver, over real sockets and Zenoh."""

import socket
import time
from typing import Any

import pytest

from softarm.drivers.bridge.bridging import Bridging, NullOutlet, Publisher, look_at
from softarm.drivers.bridge.client import Client
from softarm.drivers.bridge.conversation import Conversation, StampedFrame
from softarm.drivers.bridge.frame import Plane
from softarm.drivers.bridge.natnet import Frame
from softarm.drivers.mocap.driver import ZenohMocapSource
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import IDS, Motive, bodies_of
from softarm.schemas.bridge import Bridge, Listener, Marked, Marks, Room
from softarm.schemas.config import Mocap
from softarm.schemas.messages import BODY_NAMES, Pose
from tests.drivers.bridge.streaming import Streaming

ROOM = Room(up="y", yaw_rad=0.4, tilt_rad=0.01, origin_m=(1.2, 0.1, -0.7))
POSES = {name: Pose(0.1 + 0.01 * i, 0.965 - 0.0885 * i, 0.05 * i) for i, name in enumerate(BODY_NAMES)}


def config(server: Motive, **changes: Any) -> Bridge:
    return Bridge(command_port=server.port, room=ROOM, **changes)


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("version", "exposed", "group"),
    [((3, 1), True, None), ((4, 1), False, None), ((4, 0), True, "239.255.42.99")],
)
async def test_the_daemon_receives_the_servers_frames(
    version: Any, exposed: bool, group: str | None, free_port: int, until: Any, running: Any
) -> None:
    lines: list[str] = []
    daemon = Listener(endpoint=f"tcp/127.0.0.1:{free_port}")
    source = ZenohMocapSource(Mocap(endpoint=daemon.endpoint))
    server = Motive(version, group=group, rate=1 + 50e-6, began_ns=time.monotonic_ns() - 10**12)
    publisher = Publisher(daemon, lines.append)
    setup = config(server, daemon=daemon, local="127.0.0.1" if group else "0.0.0.0")
    frames: list[Any] = []

    def check(frames: list[Any], streaming: Streaming) -> None:
        first, last = frames[0], frames[-1]
        taken = streaming.taken.copy()  # the server's thread goes on
        offset = min(taken, key=lambda n: abs(taken[n] - last.t_capture_ns)) - last.sequence
        for frame in frames[-50:]:
            error_ns = frame.t_capture_ns - taken[frame.sequence + offset]
            assert abs(error_ns) < 4_000_000
        for name, pose, seen in zip(BODY_NAMES, POSES.values(), first.bodies, strict=True):
            assert seen[:3] == pytest.approx(pose[:3], abs=2e-6), name
            assert seen.tracked

    publisher.open()
    try:
        with (
            server,
            Streaming(server, dict(POSES), ROOM, exposed) as streaming,
            Client(setup, "127.0.0.1", lines.append) as client,
        ):
            bridging = Bridging(setup, client, publisher, lines.append)
            async with running(source):

                def each() -> None:
                    bridging.step(0.0)
                    frames.extend(source.read(0))

                await until(lambda: len(frames) >= 100, each)
                streaming.poses["link3"] = Pose(0, 0, 0, tracked=False)
                await until(lambda: not frames[-1].bodies[3].tracked, each)
                check(frames, streaming)
                # Frames before the server's answer are a problem for a second, and a loaded computer answers late.
                await until(lambda: bridging.status().problem is None, each)
                status = bridging.status()
                assert status.daemon_listens
                assert status.lost == ("link3",)
                assert status.age_ms > 4.0
                assert source.malformed + source.misplaced == 0
    finally:
        publisher.close()
    assert f"the daemon at {daemon.endpoint} listens" in lines


def test_datagrams_from_other_senders_are_counted_and_ignored() -> None:
    with Motive() as server, Client(config(server), "127.0.0.1", lambda text: None) as client:
        assert client._commands is not None
        port = client._commands.getsockname()[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.bind(("127.0.0.2", 0))
            sender.sendto(motive.server_info((3, 1), 5, 1, None), ("127.0.0.1", port))
        deadline = time.monotonic() + 10
        while client.other_senders == 0 and time.monotonic() < deadline:
            client.poll(0.01)
        assert client.other_senders == 1
        assert client.conversation.server is None or client.conversation.server.clock_hz != 5


def test_an_inspection_lists_streamed_and_missing_bodies() -> None:
    marks = Marks(cart=Marked(rigid_body="Wagen"), link4=Marked(rigid_body=IDS["link4"]), link2=None)
    with Motive() as server, Streaming(server, dict(POSES), ROOM) as streaming:
        streaming.poses["link3"] = Pose(0, 0, 0, tracked=False)
        with Client(config(server, bodies=marks), "127.0.0.1", lambda text: None) as client:
            found = look_at(config(server, bodies=marks), client, 10.0)
    rows = {(row.body, row.rigid_body): row for row in found.rows}
    assert list(rows) == [
        ("cart", "Wagen"), ("link1", "link1"), ("link3", "link3"), ("link4", "link4"), ("link5", "link5"),
        ("", "cart"), ("", "link2"),
    ]  # fmt: skip
    assert rows["cart", "Wagen"].id is None
    assert rows["link3", "link3"].seen == 0.0
    assert rows["link1", "link1"].seen == 1.0
    assert rows["link1", "link1"].pose == pytest.approx(POSES["link1"][:3], abs=2e-6)
    assert rows["", "link2"].room_m is not None
    assert "cart: no such rigid body, the server streams cart (1), link1 (2)" in (found.problem or "")
    assert found.status.rate_hz > 20


def test_a_missing_server_is_reported() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        setup = Bridge(command_port=silent.getsockname()[1])
        with Client(setup, "127.0.0.1", lambda text: None) as client:
            found = look_at(setup, client, 0.05)
    assert (found.problem or "").startswith(f"127.0.0.1:{setup.command_port}: connect: no answer; start Motive")


class Scripted:
    """Inlet with the frames and problems of the test."""

    def __init__(self, clock: Any) -> None:
        self.conversation = Conversation(lambda text: None)
        self.conversation.ids = dict(IDS)
        self.other_senders, self.clock, self.sent, self.poses, self.number = 0, clock, None, dict(POSES), 0

    def poll(self, seconds: float) -> list[Any]:
        self.number += 1
        self.conversation.counts.frames += 1
        frame = Frame(self.number, bodies_of(Plane(ROOM), self.poses), 1, 1, 1, 0)
        return [StampedFrame(frame, self.clock() - 8_000_000, self.clock(), self.number)]

    def problem(self) -> str | None:
        return self.sent


@pytest.fixture
def scripted(clock: Any) -> Any:
    lines: list[str] = []
    inlet = Scripted(clock)
    bridging = Bridging(Bridge(room=ROOM), inlet, NullOutlet(), lines.append, clock)

    def run(seconds: float, rate_hz: int = 100) -> list[str]:
        """Step with this rate of frames and return the reported lines."""
        lines.clear()
        for _ in range(round(rate_hz * seconds)):
            clock.advance(1 / rate_hz)
            bridging.step()
        return list(lines)

    return inlet, bridging, run


def test_a_change_is_reported_once_and_not_with_every_frame(scripted: Any) -> None:
    inlet, bridging, run = scripted
    assert run(2.0) == ["frames arrive"]
    inlet.poses["link3"] = Pose(0, 0, 0, tracked=False)
    assert run(2.0) == ["link3 is lost"]
    inlet.poses["link3"] = POSES["link3"]
    assert run(2.0) == ["link3 is tracked again, after 2.0 s"]
    inlet.sent = "1.2.3.4:1510: read: it answers, and streams no frames; is it in Live mode?"
    assert run(3.0) == [inlet.sent]
    inlet.sent = None
    assert run(3.0) == ["frames arrive"]
    assert bridging.status().rate_hz == pytest.approx(100, abs=2)
    assert bridging.status().age_ms == pytest.approx(8.0)


def test_short_dropouts_are_reported_by_the_minute(scripted: Any) -> None:
    inlet, _, run = scripted
    run(1.0, 20)
    sent = []
    for _ in range(60):
        inlet.poses["link2"] = Pose(0, 0, 0, tracked=False)
        inlet.conversation.counts.gaps += 1
        sent += run(0.1, 20)
        inlet.poses["link2"] = POSES["link2"]
        sent += run(0.9, 20)
    [line] = sent
    assert line.startswith("in the last minute: 1200 frames; ")
    assert "59 missing from the server's count" in line
    assert "link2 lost in 9.8 %" in line


def test_a_missing_name_is_reported_and_requested_again(scripted: Any) -> None:
    inlet, bridging, run = scripted
    inlet.conversation.ids = {name: number for name, number in IDS.items() if name != "link5"} | {"tip": 6}
    inlet.conversation.wants_names = False
    lost, line = run(2.0)
    assert lost == "link5 is lost"
    assert line.startswith("link5: no such rigid body, the server streams cart (1), link1 (2)")
    assert "tip (6); rename it in Motive" in line
    assert inlet.conversation.wants_names
    assert bridging.status().problem == line
    inlet.conversation.ids = dict(IDS)
    assert run(2.0) == ["link5 is tracked again, after 2.0 s", "frames arrive"]


@pytest.mark.parametrize("text", ["127.0.0.1", ":1510", "127.0.0.1:65535", "127.0.0.1:x"])
def test_the_emulator_refuses_an_address_without_host_or_port(monkeypatch, capsys, text):
    monkeypatch.setattr("sys.argv", ["motive", "--serve", text])
    with pytest.raises(SystemExit):
        motive.main()
    assert f"{text!r} is no HOST:PORT; e.g. 127.0.0.1:1510" in capsys.readouterr().err
