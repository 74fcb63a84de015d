"""From a room's frame to the robot's plane: where the rail lies, how each body's markers sit. Pure."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from softarm.drivers.bridge.natnet import Body, Quaternion, Vector
from softarm.drivers.mocap.payload import LOST
from softarm.schemas.bridge import Marked, Marks, Room
from softarm.schemas.messages import BODY_NAMES, Pose

_UPRIGHT: Mapping[str, tuple[Vector, Vector, Vector]] = {  # x, what is left of it seen from above, and up
    "y": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}


def level(up: str) -> tuple[Vector, Vector, Vector]:
    """A room's two level axes and the one up, right-handed: of y-up x, -z and y."""
    return _UPRIGHT[up]


class Plane:
    """The plane in which the arm bends, in a room: y along the rail, z up from the floor, x towards who looks at it."""

    def __init__(self, room: Room) -> None:
        first, second, up = level(room.up)
        ahead = _sum(math.cos(room.yaw_rad), first, math.sin(room.yaw_rad), second)
        self.along = _sum(math.cos(room.tilt_rad), ahead, math.sin(room.tilt_rad), up)
        self.up = _sum(math.cos(room.tilt_rad), up, -math.sin(room.tilt_rad), ahead)
        self.origin = room.origin_m

    def place(self, position_m: Vector) -> tuple[float, float]:
        """y and z (m) of a point of the room."""
        away = (position_m[0] - self.origin[0], position_m[1] - self.origin[1], position_m[2] - self.origin[2])
        return dot(away, self.along), dot(away, self.up)

    def point(self, y_m: float, z_m: float) -> Vector:
        """The room's point at y and z, in the plane of the rail."""
        at = _sum(y_m, self.along, z_m, self.up)
        return (self.origin[0] + at[0], self.origin[1] + at[1], self.origin[2] + at[2])

    def angle(self, turned: Quaternion, hanging: Quaternion) -> float:
        """By how much a body has turned towards +y since it was `hanging` (rad).

        What hung straight down then points where the arm's own axis points now; a twist about that axis does not count.
        """
        down = (-self.up[0], -self.up[1], -self.up[2])
        now = rotated(turned, rotated((-hanging[0], -hanging[1], -hanging[2], hanging[3]), down))
        return math.atan2(dot(now, self.along), -dot(now, self.up))

    def turn(self, angle_rad: float) -> Quaternion:
        """The turn by an angle towards +y: the lower end goes from -up to along, about the cross product of these."""
        along, up, half = self.along, self.up, angle_rad / 2
        sin = math.sin(half)
        return (
            sin * (along[1] * up[2] - along[2] * up[1]),
            sin * (along[2] * up[0] - along[0] * up[2]),
            sin * (along[0] * up[1] - along[1] * up[0]),
            math.cos(half),
        )


class Seen(NamedTuple):
    """The arm in one frame of the cameras."""

    poses: tuple[Pose, ...]  # `BODY_NAMES` order
    doubtful: tuple[str, ...]  # tracked, they say, with numbers that are none

    @property
    def lost(self) -> tuple[str, ...]:
        """Bodies that the cameras have lost."""
        return tuple(name for name, pose in zip(BODY_NAMES, self.poses, strict=True) if not pose.tracked)


class View:
    """What a room's cameras see, as the daemon wants it."""

    def __init__(self, room: Room, marks: Marks) -> None:
        self.plane = Plane(room)
        self._marks: dict[str, Marked | None] = {name: getattr(marks, name) for name in BODY_NAMES}

    def of(self, bodies: Iterable[Body], names: Mapping[int, str]) -> Seen:
        """Poses of a frame. names: streaming id -> the arm's body."""
        found = {names[body.id]: body for body in bodies if body.tracked and body.id in names}
        poses, doubtful = [], []
        for name, mark in self._marks.items():
            body = found.get(name)
            pose = LOST if body is None or mark is None else self.pose(body, mark)
            poses.append(pose)
            if body is not None and mark is not None and not pose.tracked:
                doubtful.append(name)
        return Seen(tuple(poses), tuple(doubtful))

    def pose(self, body: Body, mark: Marked) -> Pose:
        """One body; lost when its numbers are none, or its orientation has no length."""
        length = math.sqrt(sum(part * part for part in body.orientation))
        if not (all(map(math.isfinite, body.position_m)) and 0.5 < length < 2.0):
            return LOST
        y_m, z_m = self.plane.place(body.position_m)
        angle_rad = self.plane.angle(body.orientation, mark.hanging)
        cos, sin = math.cos(angle_rad), math.sin(angle_rad)
        # The arm's own axis points down at angle 0, and to +y at a right angle.
        right, up = mark.across_m, mark.along_m
        return Pose(y_m + cos * right - sin * up, z_m + sin * right + cos * up, angle_rad)


def names_of(marks: Marks, ids: Mapping[str, int]) -> tuple[dict[int, str], tuple[str, ...]]:
    """Streaming ids of the arm's bodies, and those bodies that none is named for. ids: the server's names."""
    names: dict[int, str] = {}
    missing = []
    for name in BODY_NAMES:
        mark: Marked | None = getattr(marks, name)
        if mark is None:
            continue
        number = number_of(name, mark, ids)
        if number is None:
            missing.append(name)
        else:
            names[number] = name
    return names, tuple(missing)


def number_of(name: str, mark: Marked, ids: Mapping[str, int]) -> int | None:
    """The streaming id of one of the arm's bodies; None: the server names none so."""
    wanted = name if mark.rigid_body is None else mark.rigid_body
    return wanted if isinstance(wanted, int) else ids.get(wanted)


def dot(a: Vector, b: Vector) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The turn b, then the turn a."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


def rotated(q: Quaternion, v: Vector) -> Vector:
    """A vector turned by a quaternion (x, y, z, w) of any length; its own length goes with the square of that."""
    x, y, z, w = q
    # v' = (w^2 - u.u) v + 2 (u.v) u + 2 w u x v, with u = (x, y, z).
    along, scale = 2 * (x * v[0] + y * v[1] + z * v[2]), w * w - x * x - y * y - z * z
    return (
        scale * v[0] + along * x + 2 * w * (y * v[2] - z * v[1]),
        scale * v[1] + along * y + 2 * w * (z * v[0] - x * v[2]),
        scale * v[2] + along * z + 2 * w * (x * v[1] - y * v[0]),
    )


def _sum(a: float, v: Vector, b: float, w: Vector) -> Vector:
    return (a * v[0] + b * w[0], a * v[1] + b * w[1], a * v[2] + b * w[2])
