"""What the control loop reads and writes, once per tick.

Plain frozen records, not models: they are made 30 to 120 times a second.

Every stamp is CLOCK_MONOTONIC nanoseconds of the daemon's host.
"""

from dataclasses import dataclass
from typing import NamedTuple

from softarm.schemas.base import json_object

BODY_NAMES = ("cart", "link1", "link2", "link3", "link4", "link5")


@json_object
class Pose(NamedTuple):
    """One rigid body in the plane; linkN is the marker set at the far end of link N."""

    y_m: float
    z_m: float
    angle_rad: float  # absolute; 0 hangs straight down
    tracked: bool = True


@dataclass(frozen=True, slots=True)
class MocapFrame:
    """Six poses (`BODY_NAMES` order) taken at one instant."""

    sequence: int  # the bridge's own count; a step of more than 1 is a lost frame
    t_capture_ns: int
    t_receive_ns: int  # when it arrived; logs up to November 2026: the tick that took it
    bodies: tuple[Pose, ...]

    def __post_init__(self) -> None:
        """Raises ValueError for another number of bodies."""
        if len(self.bodies) != len(BODY_NAMES):
            raise ValueError(f"a frame has {len(BODY_NAMES)} bodies ({', '.join(BODY_NAMES)}), not {len(self.bodies)}")


@dataclass(frozen=True, slots=True)
class PressureReading:
    """The regulator's answer."""

    t_receive_ns: int
    pressure_kpa: float  # its own sensor
    armed: bool  # False: the device vents and ignores set-points
    faults: tuple[str, ...] = ()
    sequence: int = 0  # of the last command that the device accepted


@dataclass(frozen=True, slots=True)
class RailReading:
    """The axis's own read-back."""

    t_receive_ns: int  # when it was asked for: it is no older; logs up to November 2026: when the answer came
    position_m: float
    velocity_m_s: float
    enabled: bool  # CiA 402 operation enabled
    remote: bool = True  # the drive's enable input (DI7); False is the hardware e-stop
    faults: tuple[str, ...] = ()
    linked: bool = True  # False: whoever spoke with the drive is gone, and the rest is what it said last
    cycle_p50_ns: int = 0  # from a set-point's turn on the wire to the end of what follows it, over the last second
    cycle_max_ns: int = 0
    homed: bool | None = None  # as the drive says of its zero; None: it does not, and logs up to November 2026


@json_object
class Command(NamedTuple):
    """What is sent to the actuators."""

    enable: bool  # False: the rail's drive is switched off, the regulator vents
    cart_velocity_m_s: float
    pressure_kpa: float


SAFE = Command(enable=False, cart_velocity_m_s=0.0, pressure_kpa=0.0)
