"""The source `rigid-bodies`: a camera server's stream in the arm's plane and on this host's clock."""

import math
import socket
from collections import deque

from softarm.drivers.mocap.source import Frames

# Bytes of a datagram.
LONGEST = 4096
MINUTE_NS = 60_000_000_000
AXES = {"x": (0, 1.0), "-x": (0, -1.0), "z": (2, 1.0), "-z": (2, -1.0)}

Pose = tuple[float, float, float]


class RigidBodies:
    """Receiver of `NUMBER SECONDS;BODY X Y Z QX QY QZ QW;...` in millimetres, y up, seconds of the server's clock.

    Args:
        port: Port to listen at, 1 to 65535.
        host: Address to listen at.
        along: Axis of the server that is the rail's +y.
        middle_mm: Middle of the rail on that axis.
        floor_mm: Floor on the server's vertical axis.

    Raises:
        ValueError: An option is invalid.
    """

    interface = 1
    description = "rigid bodies in millimetres and quaternions over UDP, with the server's clock"

    def __init__(
        self, port: int = 9764, host: str = "127.0.0.1", along: str = "x", middle_mm: float = 0.0, floor_mm: float = 0.0
    ) -> None:
        if not 1 <= port <= 65535:
            raise ValueError(f"option port is {port}; allowed: 1 to 65535")
        if along not in AXES:
            raise ValueError(f"option along is '{along}'; allowed {', '.join(AXES)}")
        self.port, self.host = port, host
        self.axis, self.sign = AXES[along]
        self.middle_mm, self.floor_mm = middle_mm, floor_mm

    def run(self, frames: Frames) -> None:
        """Put frames until none are wanted."""
        clock = Clock()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inlet:
            inlet.bind((self.host, self.port))
            inlet.settimeout(0.1)
            while frames.are_wanted:
                try:
                    datagram = inlet.recv(LONGEST)
                except TimeoutError:
                    continue
                try:
                    number, seconds, bodies = self.parse(datagram)
                except ValueError as error:
                    frames.refuse(str(error))
                    continue
                frames.put(number, clock.here_ns(round(1e9 * seconds), frames.now_ns()), bodies)

    def parse(self, datagram: bytes) -> tuple[int, float, dict[str, Pose]]:
        """Return the frame's number, the server's time, s, and the poses in the arm's plane. Raises ValueError."""
        head, *parts = datagram.decode("ascii").strip(";\n").split(";")
        number, seconds = head.split()
        bodies = {}
        for part in parts:
            name, *values = part.split()
            if len(values) != 7:
                raise ValueError(f"{name}: {len(values)} numbers; expected x y z in mm and qx qy qz qw")
            bodies[name] = self._pose([float(value) for value in values])
        return int(number), float(seconds), bodies

    def _pose(self, values: list[float]) -> Pose:
        position_mm, (qx, qy, qz, qw) = values[:3], values[3:]
        y_m = self.sign * (position_mm[self.axis] - self.middle_mm) / 1000.0
        z_m = (position_mm[1] - self.floor_mm) / 1000.0
        # The arm's axis points down at angle 0, so this is the direction of the rotated (0, -1, 0).
        down = (-2.0 * (qx * qy - qw * qz), -(1.0 - 2.0 * (qx * qx + qz * qz)), -2.0 * (qy * qz + qw * qx))
        return y_m, z_m, math.atan2(self.sign * down[self.axis], -down[1])


class Clock:
    """Conversion of another host's stamps: the smallest offset of the last minute is that of the clocks."""

    def __init__(self) -> None:
        # Arrival and offset, both rising, so that the first offset is the smallest.
        self._least: deque[tuple[int, int]] = deque()

    def here_ns(self, there_ns: int, arrived_ns: int) -> int:
        """Return the time on this host's clock for a stamp of the other host that has just arrived."""
        offset = arrived_ns - there_ns
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((arrived_ns, offset))
        while arrived_ns - self._least[0][0] > MINUTE_NS:
            self._least.popleft()
        return there_ns + self._least[0][1]
