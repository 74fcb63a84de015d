"""Messages that the control loop reads and writes once per tick.

They are plain frozen records instead of pydantic models, since 30 to 120 are made each second.

Every stamp is CLOCK_MONOTONIC nanoseconds of the daemon's host.
"""

from dataclasses import dataclass
from typing import NamedTuple

from softarm.schemas.base import json_object

CAPTURE_AHEAD_MAX_NS = 5_000_000  # clock noise
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
    """Poses of the six bodies at one instant, in the order of `BODY_NAMES`."""

    sequence: int  # the bridge's own count; a step of more than 1 is a lost frame
    t_capture_ns: int
    t_receive_ns: int  # when it arrived
    bodies: tuple[Pose, ...]

    def __post_init__(self) -> None:
        """Raise ValueError for another number of bodies."""
        if len(self.bodies) != len(BODY_NAMES):
            raise ValueError(f"a frame has {len(BODY_NAMES)} bodies ({', '.join(BODY_NAMES)}), not {len(self.bodies)}")

    @property
    def from_another_clock(self) -> bool:
        """Return whether the frame is stamped ahead of its reception by more than clock noise."""
        return self.t_capture_ns - self.t_receive_ns > CAPTURE_AHEAD_MAX_NS


@dataclass(frozen=True, slots=True)
class PressureReading:
    """Reading of the pressure regulator."""

    t_receive_ns: int
    pressure_kpa: float  # its own sensor
    armed: bool  # False: the device vents and ignores set-points
    faults: tuple[str, ...] = ()
    sequence: int = 0  # of the last command that the device accepted


@dataclass(frozen=True, slots=True)
class RailReading:
    """Read-back of the rail's axis."""

    t_receive_ns: int  # when the request was sent: the reading is no older
    position_m: float
    velocity_m_s: float
    enabled: bool  # CiA 402 operation enabled
    remote: bool = True  # the drive's enable input (DI7); False is the hardware e-stop
    faults: tuple[str, ...] = ()
    linked: bool = True  # False: the connection to the drive is lost; the other fields are the last ones received
    cycle_p50_ns: int = 0  # duration of a communication cycle, median over the last second
    cycle_max_ns: int = 0
    homed: bool | None = None  # None if the drive does not report it


@json_object
class Command(NamedTuple):
    """Command that is sent to the actuators."""

    enable: bool  # False: the rail's drive is switched off, the regulator vents
    cart_velocity_m_s: float
    pressure_kpa: float


SAFE = Command(enable=False, cart_velocity_m_s=0.0, pressure_kpa=0.0)
