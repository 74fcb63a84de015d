"""Frames on their way, over real sockets and real Zenoh: what the cameras' server shows, the daemon's driver hears."""

import socket
import threading
import time
from typing import Any

import pytest
from natnet import NatNetClient

from softarm.drivers.bridge.bridging import Bridging, Status
from softarm.drivers.bridge.client import Client
from softarm.drivers.bridge.conversation import Conversation
from softarm.drivers.bridge.frame import Plane
from softarm.drivers.bridge.look import Nowhere, look_at
from softarm.drivers.bridge.natnet import Body, Frame
from softarm.drivers.bridge.publisher import Publisher
from softarm.drivers.mocap.driver import ZenohMocapSource
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import IDS, Motive, bodies_of
from softarm.schemas.bridge import Bridge, Listener, Marked, Marks, Room
from softarm.schemas.config import Mocap
from softarm.schemas.messages import BODY_NAMES, Pose

ROOM = Room(up="y", yaw_rad=0.4, tilt_rad=0.01, origin_m=(1.2, 0.1, -0.7))
POSES = {name: Pose(0.1 + 0.01 * i, 0.965 - 0.0885 * i, 0.05 * i) for i, name in enumerate(BODY_NAMES)}


class Streaming:
    """A server that streams the same arm 200 times a second, and knows when it took which frame."""

    def __init__(self, server: Motive, exposed: bool) -> None:
        self.taken: dict[int, int] = {}
        self.poses = dict(POSES)
        self._server, self._exposed = server, exposed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "Streaming":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        number = 0
        while not self._ended.wait(0.005):
            number += 1
            taken_ns = time.monotonic_ns() - 8_000_000
            taken = self._server.ticks(taken_ns)
            stamps = (taken if self._exposed else 0, taken + motive.CLOCK_HZ // 200, self._server.ticks())
            self.taken[number] = taken_ns
            self._server.stream(motive.frame(self._server.version, number, bodies_of(Plane(ROOM), self.poses), stamps))


def config(server: Motive, **changes: Any) -> Bridge:
    return Bridge(command_port=server.port, room=ROOM, **changes)


@pytest.mark.parametrize(
    ("version", "exposed", "group"),
    [((3, 1), True, None), ((4, 1), False, None), ((4, 0), True, "239.255.42.99")],
)
def test_the_daemon_hears_what_the_server_shows(
    version: Any, exposed: bool, group: str | None, free_port: int, run: Any, until: Any, running: Any
) -> None:
    lines: list[str] = []
    daemon = Listener(endpoint=f"tcp/127.0.0.1:{free_port}")
    source = ZenohMocapSource(Mocap(endpoint=daemon.endpoint))
    server = Motive(version, group=group, rate=1 + 50e-6, began_ns=time.monotonic_ns() - 10**12)
    publisher = Publisher(daemon, lines.append)
    setup = config(server, daemon=daemon, local="127.0.0.1" if group else "0.0.0.0")
    frames: list[Any] = []

    async def play() -> None:
        publisher.open()  # before the daemon: it tries until somebody listens
        with server, Streaming(server, exposed) as streaming, Client(setup, "127.0.0.1", lines.append) as client:
            bridging = Bridging(setup, client, publisher, lines.append)
            async with running(source):

                def each() -> None:
                    bridging.step(0.0)
                    frames.extend(source.read(0))

                await until(lambda: len(frames) >= 100, each)
                streaming.poses["link3"] = Pose(0, 0, 0, tracked=False)
                await until(lambda: not frames[-1].bodies[3].tracked, each)
                check(frames, streaming)
                status = bridging.status()
                assert status.is_heard
                assert status.problem is None
                assert status.lost == ("link3",)
                assert status.age_ms > 4.0
                assert source.malformed + source.misplaced == 0

    def check(frames: list[Any], streaming: Streaming) -> None:
        first, last = frames[0], frames[-1]
        offset = min(streaming.taken, key=lambda n: abs(streaming.taken[n] - last.t_capture_ns)) - last.sequence
        for frame in frames[-50:]:  # once the clocks are known well
            error_ns = frame.t_capture_ns - streaming.taken[frame.sequence + offset]
            assert abs(error_ns) < 4_000_000  # with other programs beside it; the next frame is 5 ms away
        for name, pose, seen in zip(BODY_NAMES, POSES.values(), first.bodies, strict=True):
            assert seen[:3] == pytest.approx(pose[:3], abs=2e-6), name
            assert seen.tracked

    try:
        run(play())
    finally:
        publisher.close()
    assert f"the daemon at {daemon.endpoint} hears" in lines


def test_an_independent_client_hears_our_server_as_well() -> None:
    """The package natnet in unicast: its CONNECT has five bytes, and it says a keep-alive whenever it looks."""
    frames: list[Any] = []
    models: list[Any] = []
    with Motive((3, 1)) as server, Streaming(server, True):
        theirs = NatNetClient("127.0.0.1", "127.0.0.1", command_port=server.port, use_multicast=False)
        theirs.on_data_frame_received_event.handlers.append(frames.append)
        theirs.on_data_description_received_event.handlers.append(models.append)
        with theirs:
            theirs.request_modeldef()
            deadline = time.monotonic() + 10
            while not (len(frames) > 5 and models) and time.monotonic() < deadline:
                theirs.update_sync()
    assert {body.name: body.id_num for body in models[0].rigid_bodies} == IDS
    shown = {body.id_num: body for body in frames[-1].rigid_bodies}
    assert shown[IDS["link5"]].pos == pytest.approx(Plane(ROOM).point(*POSES["link5"][:2]))
    assert shown[IDS["link5"]].tracking_valid


def test_datagrams_from_elsewhere_are_counted_and_not_read() -> None:
    with Motive() as server, Client(config(server), "127.0.0.1", lambda text: None) as client:
        assert client._commands is not None
        port = client._commands.getsockname()[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.2", 0))
            stranger.sendto(motive.server_info((3, 1), 5, 1, None), ("127.0.0.1", port))
        deadline = time.monotonic() + 10
        while client.strangers == 0 and time.monotonic() < deadline:
            client.poll(0.01)
        assert client.strangers == 1
        assert client.conversation.server is None or client.conversation.server.clock_hz != 5


def test_a_look_tells_what_is_streamed_and_what_is_missing() -> None:
    marks = Marks(cart=Marked(rigid_body="Wagen"), link4=Marked(rigid_body=IDS["link4"]), link2=None)
    with Motive() as server, Streaming(server, True) as streaming:
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
    assert "cart: no such rigid body, the server names cart (1), link1 (2)" in (found.problem or "")
    assert found.status.rate_hz > 20  # of 200, beside other programs


def test_a_server_that_is_not_there_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
        nobody.bind(("127.0.0.1", 0))
        setup = Bridge(command_port=nobody.getsockname()[1])
        with Client(setup, "127.0.0.1", lambda text: None) as client:
            found = look_at(setup, client, 0.05)
    assert (found.problem or "").startswith(f"127.0.0.1:{setup.command_port}: connect: no answer; is Motive running")


class Scripted:
    """An inlet whose frames and problems the test makes."""

    def __init__(self, clock: Any) -> None:
        self.conversation = Conversation(lambda text: None)
        self.conversation.ids = dict(IDS)
        self.strangers, self.clock, self.said, self.poses, self.number = 0, clock, None, dict(POSES), 0

    def poll(self, seconds: float) -> list[Any]:
        from softarm.drivers.bridge.conversation import Taken

        self.number += 1
        self.conversation.counts.frames += 1
        frame = Frame(self.number, bodies_of(Plane(ROOM), self.poses), 1, 1, 1, 0)
        return [Taken(frame, self.clock() - 8_000_000, self.clock(), self.number)]

    def problem(self) -> str | None:
        return self.said


@pytest.fixture
def scripted(clock: Any) -> Any:
    lines: list[str] = []
    inlet = Scripted(clock)
    bridging = Bridging(Bridge(room=ROOM), inlet, Nowhere(), lines.append, clock)

    def run(seconds: float) -> list[str]:
        """Frames at 100 Hz; what was said meanwhile."""
        lines.clear()
        for _ in range(round(100 * seconds)):
            clock.advance(0.01)
            bridging.step()
        return list(lines)

    return inlet, bridging, run


def test_what_changes_is_told_in_a_line_not_in_one_a_frame(scripted: Any) -> None:
    inlet, bridging, run = scripted
    assert run(2.0) == ["frames come"]
    inlet.poses["link3"] = Pose(0, 0, 0, tracked=False)
    assert run(2.0) == ["link3 is lost"]
    inlet.poses["link3"] = POSES["link3"]
    assert run(2.0) == ["link3 is seen again, after 2.0 s"]
    inlet.said = "1.2.3.4:1510: read: it answers, and streams no frames; is it in Live mode?"
    assert run(3.0) == [inlet.said]
    inlet.said = None
    assert run(3.0) == ["frames come"]
    assert bridging.status().rate_hz == pytest.approx(100, abs=2)
    assert bridging.status().age_ms == pytest.approx(8.0)


def test_what_flickers_is_told_by_the_minute(scripted: Any) -> None:
    inlet, _, run = scripted
    run(1.0)
    said = []
    for _ in range(60):
        inlet.poses["link2"] = Pose(0, 0, 0, tracked=False)
        inlet.conversation.counts.gaps += 1
        said += run(0.1)
        inlet.poses["link2"] = POSES["link2"]
        said += run(0.9)
    [line] = said
    assert line.startswith("in the last minute: 6000 frames; ")
    assert "59 that the server counted never came" in line
    assert "link2 lost in 9.8 %" in line


def test_a_name_that_the_server_lacks_is_told_and_asked_for_again(scripted: Any) -> None:
    inlet, bridging, run = scripted
    inlet.conversation.ids = {name: number for name, number in IDS.items() if name != "link5"} | {"tip": 6}
    inlet.conversation.wants_names = False
    lost, line = run(2.0)
    assert lost == "link5 is lost"
    assert line.startswith("link5: no such rigid body, the server names cart (1), link1 (2)")
    assert "tip (6); name it in Motive" in line
    assert inlet.conversation.wants_names
    assert bridging.status().problem == line
    inlet.conversation.ids = dict(IDS)
    assert run(2.0) == ["link5 is seen again, after 2.0 s", "frames come"]


def test_a_line_for_a_terminal_says_rate_age_clock_and_who_hears() -> None:
    status = Status(119.9, 6.1, ("link3",), -12.3, 0.15, 23.4, "x", True, None, {})
    assert status.line() == (
        "119.9 frames/s | 6.1 ms old | lost: link3 | clock -12.300 s +- 0.15 ms, +23.4 ppm | the daemon hears"
    )


def test_a_body_that_is_tracked_without_numbers_is_lost_not_sent(scripted: Any) -> None:
    sent: list[bytes] = []

    class Kept(Nowhere):
        def put(self, frame: bytes) -> None:
            sent.append(frame)

    inlet, _, _ = scripted
    bridging = Bridging(Bridge(room=ROOM), inlet, Kept(), lambda text: None, inlet.clock)
    broken = Body(IDS["cart"], (float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 0.0, True)
    poll = inlet.poll

    def one(seconds: float) -> list[Any]:
        [taken] = poll(seconds)
        return [taken._replace(frame=taken.frame._replace(bodies=(broken, *taken.frame.bodies[1:])))]

    inlet.poll = one
    bridging.step()
    assert b'"cart":null' in sent[0]
