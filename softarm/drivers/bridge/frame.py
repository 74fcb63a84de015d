"""Transformation from the cameras' coordinates to the robot's plane. Pure."""

import math
from collections.abc import Iterable, Mapping

from softarm.drivers.bridge.natnet import Body, Quaternion, Vector
from softarm.drivers.mocap.payload import LOST
from softarm.schemas.bridge import Marked, Marks, Room
from softarm.schemas.messages import BODY_NAMES, Pose

# The x axis, the axis to its left seen from above, and the vertical.
_UPRIGHT: Mapping[str, tuple[Vector, Vector, Vector]] = {
    "y": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}


def level(up: str) -> tuple[Vector, Vector, Vector]:
    """Return the horizontal axes and the vertical of cameras with y or z up, right-handed: x, -z and y if y is up."""
    return _UPRIGHT[up]


class Plane:
    """Plane in which the arm bends: y along the rail, z up from the floor, x towards the viewer."""

    def __init__(self, room: Room) -> None:
        first, second, up = level(room.up)
        ahead = _sum(math.cos(room.yaw_rad), first, math.sin(room.yaw_rad), second)
        self.along = _sum(math.cos(room.tilt_rad), ahead, math.sin(room.tilt_rad), up)
        self.up = _sum(math.cos(room.tilt_rad), up, -math.sin(room.tilt_rad), ahead)
        self.origin = room.origin_m

    def place(self, position_m: Vector) -> tuple[float, float]:
        """Return y and z (m) of a point in the cameras' coordinates."""
        away = (position_m[0] - self.origin[0], position_m[1] - self.origin[1], position_m[2] - self.origin[2])
        return dot(away, self.along), dot(away, self.up)

    def point(self, y_m: float, z_m: float) -> Vector:
        """Return the point in the cameras' coordinates for y and z in the plane."""
        at = _sum(y_m, self.along, z_m, self.up)
        return (self.origin[0] + at[0], self.origin[1] + at[1], self.origin[2] + at[2])

    def angle(self, turned: Quaternion, hanging: Quaternion) -> float:
        """Return the rotation of a body towards +y since it was `hanging`, rad.

        The direction that pointed down then is the direction of the arm's axis now; twist about that axis is ignored.
        """
        down = (-self.up[0], -self.up[1], -self.up[2])
        now = rotated(turned, rotated((-hanging[0], -hanging[1], -hanging[2], hanging[3]), down))
        return math.atan2(dot(now, self.along), -dot(now, self.up))

    def turn(self, angle_rad: float) -> Quaternion:
        """Return the rotation by an angle towards +y, which turns the lower end from -up to along."""
        along, up, half = self.along, self.up, angle_rad / 2
        sin = math.sin(half)
        return (
            sin * (along[1] * up[2] - along[2] * up[1]),
            sin * (along[2] * up[0] - along[0] * up[2]),
            sin * (along[0] * up[1] - along[1] * up[0]),
            math.cos(half),
        )


class View:
    """Transformation of a frame's rigid bodies to poses."""

    def __init__(self, room: Room, marks: Marks) -> None:
        self.plane = Plane(room)
        self._marks = marks.used

    def of(self, bodies: Iterable[Body], names: Mapping[int, str]) -> tuple[Pose, ...]:
        """Return the poses of a frame, in the order of `BODY_NAMES`; `names` are those of the streaming ids."""
        found = {names[body.id]: body for body in bodies if body.tracked and body.id in names}
        poses = []
        for name in BODY_NAMES:
            body, mark = found.get(name), self._marks.get(name)
            poses.append(LOST if body is None or mark is None else self.pose(body, mark))
        return tuple(poses)

    def pose(self, body: Body, mark: Marked) -> Pose:
        """Return the pose of one body, LOST if it contains NaN, infinity or an invalid orientation."""
        length = math.sqrt(sum(part * part for part in body.orientation))
        if not (all(map(math.isfinite, body.position_m)) and 0.5 < length < 2.0):
            return LOST
        y_m, z_m = self.plane.place(body.position_m)
        angle_rad = self.plane.angle(body.orientation, mark.hanging)
        cos, sin = math.cos(angle_rad), math.sin(angle_rad)
        # The arm's axis points down at angle 0 and to +y at a right angle.
        right, up = mark.across_m, mark.along_m
        return Pose(y_m + cos * right - sin * up, z_m + sin * right + cos * up, angle_rad)


def names_of(marks: Marks, ids: Mapping[str, int]) -> tuple[dict[int, str], tuple[str, ...]]:
    """Return the body names by streaming id, and the bodies that the server, with its `ids`, does not stream."""
    names: dict[int, str] = {}
    missing = []
    for name, mark in marks.used.items():
        number = number_of(name, mark, ids)
        if number is None:
            missing.append(name)
        else:
            names[number] = name
    return names, tuple(missing)


def number_of(name: str, mark: Marked, ids: Mapping[str, int]) -> int | None:
    """Return the streaming id of a body of the arm, or None if the server does not stream it."""
    wanted = name if mark.rigid_body is None else mark.rigid_body
    return wanted if isinstance(wanted, int) else ids.get(wanted)


def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the product of two quaternions: rotation b, then rotation a."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


def rotated(q: Quaternion, v: Vector) -> Vector:
    """Return a vector rotated by a quaternion (x, y, z, w), scaled by the square of the quaternion's length."""
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
