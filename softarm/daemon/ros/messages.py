"""Standard ROS 2 messages of the robot's state, by the types of rosbags, and the wire format of rmw_zenoh.

Keys, liveliness tokens and attachments: the design document, liveliness_utils.cpp and attachment_helpers.cpp of
ros2/rmw_zenoh.
"""

import hashlib
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import zenoh
from zenoh.ext import Int64, z_serialize

from softarm.daemon.control.records import EStop, Outputs
from softarm.schemas.goals import Goal
from softarm.schemas.messages import BODY_NAMES, MocapFrame

PUBLISHER, SUBSCRIPTION = "MP", "MS"
# Reliable, volatile, the last ten; a field left out has the default of rmw_zenoh.
QOS = "::,10:,:,:,,"


class Topic(NamedTuple):
    """A topic with its message type."""

    name: str  # qualified, without the first slash: softarm/tip
    type_name: str  # geometry_msgs/msg/PoseStamped
    type_hash: str  # RIHS01_...

    @property
    def _path(self) -> tuple[str, str]:
        package, kind, name = self.type_name.split("/")
        return f"{package}::{kind}::dds_::{name}_", self.type_hash

    def key(self, domain: int) -> str:
        """Return the key expression of the topic's messages."""
        return "/".join((str(domain), self.name, *self._path))


class Node(NamedTuple):
    """The only node of a Zenoh session, in the root namespace."""

    domain: int
    session: str  # id of the Zenoh session
    name: str

    @property
    def token(self) -> str:
        """Return the liveliness token by which ROS 2 knows the node."""
        return self._token("0", "NN")

    def endpoint(self, number: int, kind: str, topic: Topic) -> str:
        """Return the liveliness token of the node's publisher or subscription with this number."""
        mangled = f"/{topic.name}".replace("/", "%")
        return "/".join((self._token(str(number), kind), mangled, *topic._path, QOS))

    def _token(self, number: str, kind: str) -> str:
        return f"@ros2_lv/{self.domain}/{self.session}/0/{number}/{kind}/%/%/{self.name}"


def attachment(sequence: int, source_ns: int, token: str) -> zenoh.ZBytes:
    """Return a message's attachment: its number, its time in ns since 1970, and the publisher's 16-byte id.

    rmw_zenoh hashes the token with XXH3; receivers need only an id that differs between publishers.
    """
    gid = hashlib.blake2b(token.encode(), digest_size=16).digest()
    return z_serialize((Int64(sequence), Int64(source_ns), gid))


WORLD = "world"
# As in the exported MJCF: the cart slides (m), the joints turn against the link above (rad).
JOINTS = ("cart", *(f"joint{k}" for k in range(1, len(BODY_NAMES))))
PA_PER_KPA = 1e3

STATES = {
    "joint_states": "sensor_msgs/msg/JointState",
    "tip": "geometry_msgs/msg/PoseStamped",
    "pressure": "sensor_msgs/msg/FluidPressure",
    "goal": "geometry_msgs/msg/PointStamped",
    "stopped": "std_msgs/msg/Bool",
}
ANSWER, ANSWER_TYPE = "answer", "std_msgs/msg/String"
STOP, GOAL = "command/stop", "command/goal"
COMMANDS = {STOP: "std_msgs/msg/Empty", GOAL: "geometry_msgs/msg/PointStamped"}


class Messages:
    """Maker and reader of the messages, in CDR."""

    def __init__(self) -> None:
        """Load the message definitions. Raises ModuleNotFoundError without the extra `ros`."""
        from rosbags.typesys import Stores, get_typestore

        self._store: Any = get_typestore(Stores.ROS2_JAZZY)

    def topic(self, name: str, type_name: str) -> Topic:
        """Return a topic with the hash of its type."""
        return Topic(name, type_name, self._store.hash_rihs01(type_name))

    def of_frame(self, frame: MocapFrame, at_ns: int) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of the messages of a motion capture frame; an untracked body leaves them out.

        `at_ns` is the time of the capture since 1970.
        """
        bodies = frame.bodies
        if not all(body.tracked and all(map(math.isfinite, body[:3])) for body in bodies):
            return
        angles = [below.angle_rad - above.angle_rad for above, below in pairwise(bodies)]
        position, none = np.array([bodies[0].y_m, *angles]), np.empty(0)
        yield self._cdr("joint_states", self._header(at_ns, ""), list(JOINTS), position, none, none)
        tip = bodies[-1]
        half = tip.angle_rad / 2
        about_x = self._new("geometry_msgs/msg/Quaternion", math.sin(half), 0.0, 0.0, math.cos(half))
        pose = self._new("geometry_msgs/msg/Pose", self._point(tip.y_m, tip.z_m), about_x)
        yield self._cdr("tip", self._header(at_ns, WORLD), pose)

    def of_tick(self, outputs: Outputs, at_ns: int) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of the messages of a tick, which began at `at_ns` since 1970."""
        if (seen := outputs.observed) is not None:
            read = self._header(at_ns - seen.pressure_age_ns, "muscle")
            yield self._cdr("pressure", read, seen.values.pressure_kpa * PA_PER_KPA, 0.0)
        goal = outputs.goal.goal
        if outputs.goal.state == "running" and goal is not None and goal.kind == "reach":
            yield self._cdr("goal", self._header(at_ns, WORLD), self._point(goal.y_m, goal.z_m))
        yield self._cdr("stopped", outputs.estop is not EStop.CLEAR)

    def answer(self, text: str) -> bytes:
        """Return the message that answers a command."""
        return self._bytes(ANSWER_TYPE, text)

    def goal(self, data: bytes) -> Goal:
        """Return the goal of a received point. Raises ValueError with the reason if it is unusable."""
        from rosbags.serde import SerdeError

        try:
            message = self._store.deserialize_cdr(data, COMMANDS[GOAL])
        except SerdeError as error:
            raise ValueError(f"the message is no {COMMANDS[GOAL]} ({error}); publish that type") from None
        frame, point = message.header.frame_id, message.point
        if frame not in ("", WORLD):
            raise ValueError(f"frame_id is {frame[:40]!r}; allowed '{WORLD}' or none: give the point in that frame")
        if point.x != 0.0:
            raise ValueError(f"x is {point.x:g}; allowed 0: the arm moves in the plane of y and z")
        return Goal("reach", point.y, point.z)

    def _cdr(self, name: str, *fields: object) -> tuple[str, bytes]:
        return name, self._bytes(STATES[name], *fields)

    def _bytes(self, type_name: str, *fields: object) -> bytes:
        return bytes(self._store.serialize_cdr(self._new(type_name, *fields), type_name, little_endian=True))

    def _new(self, type_name: str, *fields: object) -> Any:
        return self._store.types[type_name](*fields)

    def _header(self, at_ns: int, frame: str) -> Any:
        stamp = self._new("builtin_interfaces/msg/Time", *divmod(at_ns, 1_000_000_000))
        return self._new("std_msgs/msg/Header", stamp, frame)

    def _point(self, y_m: float, z_m: float) -> Any:
        return self._new("geometry_msgs/msg/Point", 0.0, y_m, z_m)
