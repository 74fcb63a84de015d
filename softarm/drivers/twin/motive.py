"""NatNet server of the twin: it streams the robot as OptiTrack's Motive would.

    python -m softarm.drivers.twin.motive --listen tcp/127.0.0.1:7448 --serve 127.0.0.1:1510

It receives the twin's frames (set `drivers.mocap.endpoint` of the twin to the endpoint of --listen) and streams the
same bodies in its own coordinates and on its own clock. `softarm bridge natnet --server 127.0.0.1` connects it to a
daemon.
"""

import argparse
import contextlib
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Self

import zenoh

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.frame import Plane
from softarm.drivers.bridge.natnet import Body, Version, message
from softarm.drivers.mocap import payload
from softarm.drivers.mocap.zenoh_session import listener
from softarm.schemas.bridge import Room
from softarm.schemas.config import Mocap
from softarm.schemas.messages import BODY_NAMES, Pose

CLOCK_HZ = 10_000_000
# A client that sends nothing for so long receives no more frames.
FORGET_S = 5.0
IDS = {name: number for number, name in enumerate(BODY_NAMES, 1)}


def frame(
    version: Version,
    number: int,
    bodies: Sequence[Body],
    stamps: tuple[int, int, int],
    parameters: int = 0,
    others: Mapping[str, tuple[int, bytes]] = {},
) -> bytes:
    """Return a FRAMEOFDATA message.

    Args:
        stamps: Times of exposure, reception and transmission, in ticks.
        parameters: Flags of the frame.
        others: Number and bytes of the items in other sections, which a reader must skip.
    """
    sized = version >= (4, 1)

    def section(name: str) -> bytes:
        count, content = others.get(name, (0, b""))
        return struct.pack("<I", count) + (struct.pack("<I", len(content)) if sized else b"") + content

    def rigid(body: Body) -> bytes:
        return struct.pack("<i3f4ffh", body.id, *body.position_m, *body.orientation, 0.0, body.tracked)

    others = {**others, "bodies": (len(bodies), b"".join(map(rigid, bodies)))}
    names = ("marker sets", "markers", "bodies", "skeletons", *(("assets",) if sized else ()), "labeled markers")
    parts = [
        struct.pack("<I", number),
        *map(section, (*names, "force plates", "devices")),
        struct.pack("<IIdQQQ", 0, 0, number / 120, *stamps),
        struct.pack("<II", 1, 2) if sized else b"",
        struct.pack("<h", parameters),
        bytes(4),
    ]
    return message(natnet.FRAME, b"".join(parts))


def server_info(version: Version, clock_hz: int, data_port: int, group: str | None) -> bytes:
    """Return a SERVERINFO message."""
    multicast = socket.inet_aton(group) if group else bytes(4)
    name = struct.pack("<256s4B4B", b"Motive", 3, 1, 0, 0, *version, 0, 0)
    return message(natnet.SERVER_INFO, name + struct.pack("<QHB", clock_hz, data_port, group is not None) + multicast)


def models(version: Version, ids: Mapping[str, int]) -> bytes:
    """Return a MODELDEF message: for each name a marker set and a rigid body with three markers, as Motive sends."""
    described = []
    for name, number in ids.items():
        words = b"".join(f"{name}_{k}".encode() + b"\0" for k in range(3))
        text = name.encode() + b"\0"
        described.append((0, text + struct.pack("<I", 3) + words))
        turn = bytes(16) if version >= (4, 2) else b""
        body = text + struct.pack("<ii", number, -1) + bytes(12) + turn + struct.pack("<I", 3) + bytes(3 * 16)
        described.append((1, body + (words if version >= (4, 0) else b"")))
    parts = [struct.pack("<I", len(described))]
    for kind, content in described:
        parts.append(
            struct.pack("<I", kind) + (struct.pack("<I", len(content)) if version >= (4, 1) else b"") + content
        )
    return message(natnet.MODELS, b"".join(parts))


def bodies_of(plane: Plane, poses: Mapping[str, Pose]) -> tuple[Body, ...]:
    """Return the rigid bodies for poses in the robot's plane; bodies without tracking are at Motive's default pose."""
    return tuple(
        Body(IDS[name], plane.point(pose.y_m, pose.z_m), plane.turn(pose.angle_rad), True)
        if pose.tracked
        else Body(IDS[name], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), False)
        for name, pose in poses.items()
    )


class Motive:
    """NatNet server with a command and a data socket, like Motive's: `with Motive() as motive`.

    Frames go to all connected clients or to the multicast group.
    """

    def __init__(
        self,
        version: Version = (4, 1),
        host: str = "127.0.0.1",
        port: int = 0,
        data_port: int = 0,
        group: str | None = None,
        rate: float = 1.0,
        began_ns: int = 0,
    ) -> None:
        """Create the server; its clock runs `rate` times as fast as CLOCK_MONOTONIC and was 0 at `began_ns`."""
        self.version, self.group = version, group
        self._rate, self._began_ns = rate, began_ns
        self._commands, self._data = _bound(host, port), _bound(host, data_port)
        self._data.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(host))
        self._clients: dict[tuple[str, int], float] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="motive", daemon=True)

    @property
    def port(self) -> int:
        """Port of the command socket."""
        return int(self._commands.getsockname()[1])

    @property
    def data_port(self) -> int:
        """Port of the data socket."""
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
        """Return the server's clock in ticks."""
        now_ns = time.monotonic_ns() if now_ns is None else now_ns
        return round((now_ns - self._began_ns) * self._rate * CLOCK_HZ / 1e9)

    def stream(self, datagram: bytes) -> None:
        """Send a frame to all clients."""
        if self.group is not None:
            self._data.sendto(datagram, (self.group, self.data_port))
            return
        over = time.monotonic() - FORGET_S
        for client, spoke in tuple(self._clients.items()):
            if spoke < over:
                del self._clients[client]
            else:
                self._data.sendto(datagram, client)

    def _serve(self) -> None:
        self._commands.settimeout(0.05)
        while not self._stopping.is_set():
            try:
                datagram, client = self._commands.recvfrom(natnet.LONGEST)
            except TimeoutError:
                continue
            if len(datagram) >= 4:
                self._answer(datagram, client)

    def _answer(self, datagram: bytes, client: tuple[str, int]) -> None:
        kind, content = struct.unpack_from("<H", datagram)[0], datagram[4:]
        if kind == natnet.CONNECT:
            self._clients[client] = time.monotonic()
            self._commands.sendto(server_info(self.version, CLOCK_HZ, self.data_port, self.group), client)
        elif kind == natnet.KEEP_ALIVE and client in self._clients:
            self._clients[client] = time.monotonic()
        elif kind == natnet.DISCONNECT:
            self._clients.pop(client, None)
        elif kind == natnet.REQUEST_MODELS:
            self._commands.sendto(models(self.version, IDS), client)
        elif kind == natnet.ECHO_REQUEST and len(content) == 8:
            self._commands.sendto(message(natnet.ECHO_RESPONSE, content + struct.pack("<Q", self.ticks())), client)


def _bound(host: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((host, port))
    return made


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and 0 < int(port) < 65535):
        raise argparse.ArgumentTypeError(f"{text!r} is no HOST:PORT; e.g. 127.0.0.1:1510")
    return host, int(port)


def main() -> None:
    """Stream the twin's frames until SIGINT or SIGTERM."""
    parser = argparse.ArgumentParser(description="Stream the twin's frames as OptiTrack's Motive does.")
    add = parser.add_argument
    add("--listen", default="tcp/127.0.0.1:7448", help="Zenoh endpoint to listen at; the twin connects to it")
    serves = "HOST:PORT of the command socket; the data socket has the next port"
    add("--serve", default="127.0.0.1:1510", type=_address, help=serves)
    options = parser.parse_args()
    host, port = options.serve
    # Before any thread starts: a real camera system is not delayed by programs on this computer.
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    room = Room(yaw_rad=0.4, origin_m=(1.2, 0.1, -0.7))
    plane = Plane(room)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    # A clock that is 30 ppm fast.
    motive = Motive(host=host, port=port, data_port=port + 1, rate=1 + 30e-6)

    def show(sample: zenoh.Sample) -> None:
        seen = payload.decode(sample.payload.to_bytes(), time.monotonic_ns())
        bodies = bodies_of(plane, dict(zip(BODY_NAMES, seen.bodies, strict=True)))
        # Stamps of cameras that do not report the exposure.
        stamps = (0, motive.ticks(seen.t_capture_ns) + CLOCK_HZ // 200, motive.ticks())
        motive.stream(frame(motive.version, seen.sequence, bodies, stamps))

    with motive, zenoh.open(listener(options.listen)) as session:
        session.declare_subscriber(Mocap().key, show)
        print(f"NatNet server at {host}:{port}, frames from {options.listen}", flush=True)
        print(f"bridge.yaml for this server: room: {room.model_dump_json()}", flush=True)
        ended.wait()


if __name__ == "__main__":
    main()
