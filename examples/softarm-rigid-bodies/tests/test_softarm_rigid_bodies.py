"""An arm that is tracked through a server with other axes and another clock reaches its target."""

import math
import socket

import pytest
from softarm.evaluation import through_source
from softarm.schemas.messages import BODY_NAMES, MocapFrame, Pose

from softarm_rigid_bodies import Clock, RigidBodies

SERVER_S, MIDDLE_MM = 86_400.0, 1200.0


def body(name: str, pose: Pose) -> str:
    """Return a pose as the server sends it: the rail is along -z, and the arm's angle is a rotation about x."""
    half = pose.angle_rad / 2
    return f"{name} 250 {1000 * pose.z_m!r} {MIDDLE_MM - 1000 * pose.y_m!r} {math.sin(half)!r} 0 0 {math.cos(half)!r}"


def datagram(frame: MocapFrame) -> bytes:
    bodies = (body(name, pose) for name, pose in zip(BODY_NAMES, frame.bodies, strict=True))
    return f"{frame.sequence} {SERVER_S + frame.t_capture_ns / 1e9!r};{';'.join(bodies)}".encode()


def test_an_arm_tracked_by_the_server_reaches_its_target() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        source = RigidBodies(port, along="-z", middle_mm=MIDDLE_MM)
        flight = through_source.fly(source, lambda frame: server.sendto(datagram(frame), ("127.0.0.1", port)) and None)
    assert flight.reached
    assert flight.stop is None


@pytest.mark.parametrize("angle_rad", [-1.5, -0.3, 0.0, 0.7, 2.0])
def test_poses_are_those_of_the_arm(angle_rad: float) -> None:
    pose = Pose(-0.21, 0.64, angle_rad)
    source = RigidBodies(along="-z", middle_mm=MIDDLE_MM)
    number, seconds, bodies = source.parse(f"7 12.5;{body('link5', pose)}".encode())
    assert (number, seconds) == (7, 12.5)
    assert bodies == {"link5": pytest.approx(pose[:3])}


def test_the_quickest_datagram_of_a_minute_gives_the_clock_offset() -> None:
    clock, apart = Clock(), 5_000_000_000
    delays_ms = [3.0, 1.0, 4.0, 0.5, 2.0]
    seen = [clock.here_ns(t := k * 10_000_000, t + apart + round(1e6 * late)) for k, late in enumerate(delays_ms)]
    excess_ms = [(stamp - k * 10_000_000 - apart) / 1e6 for k, stamp in enumerate(seen)]
    assert excess_ms == [3.0, 1.0, 1.0, 0.5, 0.5]
    later = 100_000_000_000
    assert clock.here_ns(later, later + apart + 2_000_000) == later + apart + 2_000_000


@pytest.mark.parametrize("bad", [b"", b"7", b"7 1.0;link5 1 2 3", b"7 1.0;link5 1 2 3 a b c d", b"\xff"])
def test_an_invalid_frame_is_rejected(bad: bytes) -> None:
    with pytest.raises(ValueError):
        RigidBodies().parse(bad)


def test_invalid_options_are_rejected() -> None:
    with pytest.raises(ValueError, match="along is 'y'; allowed x, -x, z, -z"):
        RigidBodies(along="y")
