"""The cameras' server of the twin: what OptiTrack's Motive would stream of the robot, over NatNet.

    python -m softarm.drivers.twin.motive --hear tcp/127.0.0.1:7448 --serve 127.0.0.1:1510

It listens where the twin's cameras publish (a configuration whose `drivers.mocap.endpoint` is --hear) and streams the
same bodies in a room of its own, by a clock of its own; `softarm bridge natnet --server 127.0.0.1` goes between it and
a daemon.
"""

import argparse
import contextlib
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Self

import zenoh

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.frame import Plane
from softarm.drivers.bridge.natnet import Body, Version
from softarm.drivers.mocap import payload
from softarm.drivers.mocap.zenoh_session import listener
from softarm.schemas.bridge import Room
from softarm.schemas.messages import BODY_NAMES, Pose

CLOCK_HZ = 10_000_000
FORGET_S = 5.0  # a client that says nothing for so long gets no more frames
GROUP = "239.255.42.99"
IDS = {name: number for number, name in enumerate(BODY_NAMES, 1)}


class Extras(NamedTuple):
    """What else a frame may carry; a reader has to get past it."""

    marker_sets: Mapping[str, int] = {}  # name -> markers
    unlabeled: int = 0
    skeletons: Sequence[int] = ()  # bones of each
    labeled: int = 0
    plates: Sequence[Sequence[int]] = ()  # values of each channel of each


def frame(
    version: Version,
    number: int,
    bodies: Sequence[Body],
    stamps: tuple[int, int, int],
    parameters: int = 0,
    extras: Extras = Extras(),  # noqa: B008
    precise: bool | None = None,
) -> bytes:
    """A FRAMEOFDATA. stamps: exposed, received, sent in ticks. precise: with the stamp that 4.1 has and 4.0 may."""
    sized = version >= (4, 1)

    def section(count: int, content: bytes = b"") -> bytes:
        return struct.pack("<I", count) + (struct.pack("<I", len(content)) if sized else b"") + content

    def rigid(body: Body) -> bytes:
        return struct.pack("<i3f4ffh", body.id, *body.position_m, *body.orientation, body.error_m, body.tracked)

    sets = b"".join(
        name.encode() + b"\0" + struct.pack("<I", n) + bytes(12 * n) for name, n in extras.marker_sets.items()
    )
    bones = b"".join(struct.pack("<II", 7, n) + bytes(38 * n) for n in extras.skeletons)
    plates = b"".join(
        struct.pack("<II", 1, len(channels)) + b"".join(struct.pack("<I", n) + bytes(4 * n) for n in channels)
        for channels in extras.plates
    )
    parts = [
        struct.pack("<I", number),
        section(len(extras.marker_sets), sets),
        section(extras.unlabeled, bytes(12 * extras.unlabeled)),
        section(len(bodies), b"".join(map(rigid, bodies))),
        section(len(extras.skeletons), bones),
        section(0) if sized else b"",
        section(extras.labeled, bytes(26 * extras.labeled)),
        section(len(extras.plates), plates),
        section(0),
        struct.pack("<IIdQQQ", 0, 0, number / 120, *stamps),
        struct.pack("<II", 1, 2) if (sized if precise is None else precise) else b"",
        struct.pack("<h", parameters),
        bytes(4),
    ]
    return message(natnet.FRAME, b"".join(parts))


def server_info(version: Version, clock_hz: int, data_port: int, group: str | None) -> bytes:
    """A SERVERINFO."""
    multicast = socket.inet_aton(group) if group else bytes(4)
    name = struct.pack("<256s4B4B", b"Motive", 3, 1, 0, 0, *version, 0, 0)
    return message(natnet.SERVER_INFO, name + struct.pack("<QHB", clock_hz, data_port, group is not None) + multicast)


def models(version: Version, ids: Mapping[str, int]) -> bytes:
    """A MODELDEF: each name a set of markers and a rigid body with three, as Motive has it."""
    told = []
    for name, number in ids.items():
        words = b"".join(f"{name}_{k}".encode() + b"\0" for k in range(3))
        text = name.encode() + b"\0"
        told.append((0, text + struct.pack("<I", 3) + words))
        turn = bytes(16) if version >= (4, 2) else b""
        body = text + struct.pack("<ii", number, -1) + bytes(12) + turn + struct.pack("<I", 3) + bytes(3 * 16)
        told.append((1, body + (words if version >= (4, 0) else b"")))
    parts = [struct.pack("<I", len(told))]
    for kind, content in told:
        parts.append(
            struct.pack("<I", kind) + (struct.pack("<I", len(content)) if version >= (4, 1) else b"") + content
        )
    return message(natnet.MODELS, b"".join(parts))


def message(number: int, content: bytes) -> bytes:
    """A NatNet message."""
    return struct.pack("<HH", number, len(content)) + content


def bodies_of(plane: Plane, poses: Mapping[str, Pose]) -> tuple[Body, ...]:
    """Poses of the robot's plane as a room sees them; what is lost stands where Motive leaves it, untracked."""
    return tuple(
        Body(IDS[name], plane.point(pose.y_m, pose.z_m), plane.turn(pose.angle_rad), 2e-4, True)
        if pose.tracked
        else Body(IDS[name], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 0.0, False)
        for name, pose in poses.items()
    )


class Motive:
    """A server on two sockets: commands, and data, as Motive has them. Use as `with Motive() as motive`.

    Frames go from the data port to whoever said CONNECT, at the place whence it came, or to the multicast group.
    """

    def __init__(
        self,
        version: Version = (4, 1),
        host: str = "127.0.0.1",
        port: int = 0,
        data_port: int = 0,
        group: str | None = None,
        ids: Mapping[str, int] = IDS,
        clock: Callable[[], int] = time.monotonic_ns,
        rate: float = 1.0,
        began_ns: int = 0,
    ) -> None:
        """rate: of its clock beside `clock`; began_ns: of `clock` when it was at 0."""
        self.version, self.ids, self.group = version, dict(ids), group
        self.answers = True
        self.heard: list[int] = []
        self._clock, self._rate, self._began_ns = clock, rate, began_ns
        self._commands, self._data = _bound(host, port), _bound(host, data_port)
        self._data.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(host))
        self._clients: dict[tuple[str, int], float] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="motive", daemon=True)

    @property
    def port(self) -> int:
        """Of commands."""
        return int(self._commands.getsockname()[1])

    @property
    def data_port(self) -> int:
        """Whence frames come."""
        return int(self._data.getsockname()[1])

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()
        self._commands.close()
        self._data.close()

    def ticks(self, now_ns: int | None = None) -> int:
        """Its clock."""
        now_ns = self._clock() if now_ns is None else now_ns
        return round((now_ns - self._began_ns) * self._rate * CLOCK_HZ / 1e9)

    def stream(self, datagram: bytes) -> None:
        """Send a frame to all that want it."""
        if self.group is not None:
            self._data.sendto(datagram, (self.group, self.data_port))
            return
        over = time.monotonic() - FORGET_S
        for client, spoke in tuple(self._clients.items()):
            if spoke < over:
                del self._clients[client]
            else:
                self._data.sendto(datagram, client)

    def forget(self) -> None:
        """Be a server that was started again: it knows no client."""
        self._clients.clear()

    def _serve(self) -> None:
        self._commands.settimeout(0.05)
        while not self._stopping.is_set():
            try:
                datagram, client = self._commands.recvfrom(natnet.LONGEST)
            except TimeoutError:
                continue
            if self.answers and len(datagram) >= 4:
                self._answer(datagram, client)

    def _answer(self, datagram: bytes, client: tuple[str, int]) -> None:
        kind, content = struct.unpack_from("<H", datagram)[0], datagram[4:]
        self.heard.append(kind)
        if kind == natnet.CONNECT:
            self._clients[client] = time.monotonic()
            self._commands.sendto(server_info(self.version, CLOCK_HZ, self.data_port, self.group), client)
        elif kind == natnet.KEEP_ALIVE and client in self._clients:
            self._clients[client] = time.monotonic()
        elif kind == natnet.DISCONNECT:
            self._clients.pop(client, None)
        elif kind == natnet.REQUEST_MODELS:
            self._commands.sendto(models(self.version, self.ids), client)
        elif kind == natnet.ECHO_REQUEST and len(content) == 8:
            self._commands.sendto(message(natnet.ECHO_RESPONSE, content + struct.pack("<Q", self.ticks())), client)


def _bound(host: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((host, port))
    return made


def main() -> None:
    """Hear the twin, stream what it shows, until SIGINT or SIGTERM."""
    parser = argparse.ArgumentParser(description="Stream the twin's cameras as OptiTrack's Motive would.")
    add = parser.add_argument
    add(
        "--hear",
        default="tcp/127.0.0.1:7448",
        help="endpoint to listen at, as the daemon would; the twin connects to it",
    )
    add("--key", default="softarm/mocap")
    add("--serve", default="127.0.0.1:1510", help="HOST:PORT of commands; frames come from the port after it")
    add("--natnet", default="4.1", help="version, 3.0 to 4.4")
    add("--up", choices=("y", "z"), default="y")
    add("--yaw", type=float, default=0.4, help="of the rail in the room, rad")
    add("--exposed", action="store_true", help="stamp the middle of the exposure, as Ethernet cameras do")
    add("--ppm", type=float, default=30.0, help="by how much its clock is fast")
    options = parser.parse_args()
    host, _, port = options.serve.partition(":")
    major, _, minor = options.natnet.partition(".")
    with contextlib.suppress(OSError):  # before any thread is started; a camera system does not wait for programs here
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    room = Room(up=options.up, yaw_rad=options.yaw, origin_m=(1.2, 0.1, -0.7))
    plane = Plane(room)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    motive = Motive((int(major), int(minor)), host, int(port), int(port) + 1, rate=1 + options.ppm * 1e-6)

    def show(sample: zenoh.Sample) -> None:
        seen = payload.decode(sample.payload.to_bytes(), time.monotonic_ns())
        bodies = bodies_of(plane, dict(zip(BODY_NAMES, seen.bodies, strict=True)))
        taken = motive.ticks(seen.t_capture_ns)
        stamps = (taken if options.exposed else 0, taken + CLOCK_HZ // 200, motive.ticks())
        motive.stream(frame(motive.version, seen.sequence, bodies, stamps))

    with motive, zenoh.open(listener(options.hear)) as session:
        session.declare_subscriber(options.key, show)
        print(f"NatNet {options.natnet} at {options.serve}, of what is published to {options.hear}", flush=True)
        print(f"bridge.yaml for it: room: {room.model_dump_json()}", flush=True)
        ended.wait()


if __name__ == "__main__":
    main()
