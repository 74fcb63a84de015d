"""Mechanisms of the benchmark, with the laws of one joint that their models do not have."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

MODELS: Final = Path(__file__).parent / "models"


@dataclass(frozen=True, slots=True)
class JointLaw:
    """True laws of one joint, besides the shares by which its model's numbers are off."""

    viscous: float = 1.0  # factor of the model's number, as are the next four
    dry: float = 1.0
    armature: float = 1.0
    gain: float = 1.0  # of the actuator
    stiff: float = 1.0  # of a position loop
    more_viscous: float = 0.0  # N m s/rad or N s/m
    more_dry: float = 0.0  # N m or N
    more_inertia: float = 0.0
    spring: float = 0.0
    torque: float = 0.0  # constant
    limit: float = float("inf")
    delay_s: float = 0.0
    lag_s: float = 0.0
    dead: float = 0.0  # position errors that make no torque
    play: float = 0.0
    cogging: float = 0.0  # amplitude of a torque with eight periods a turn
    tiring: float = 0.0  # share of the torque that is lost within a minute
    uneven: float = 0.0  # more dry friction forwards, less backwards
    bent: float = 0.0  # amplitude of an encoder error with one period a turn


@dataclass(frozen=True, slots=True)
class Robot:
    """Mechanism with its joints' scales, and how it is recorded."""

    name: str
    follows: Mapping[str, float]  # position-controlled joint -> half range of its command
    pushed: Mapping[str, float]  # torque-controlled joint -> half range of the motion that its commands cause
    free: tuple[str, ...] = ()  # joints without an actuator
    moved: Mapping[str, float] = field(default_factory=dict)  # joint moved from outside -> half range
    step: Mapping[str, float] = field(default_factory=dict)  # joint -> resolution of its encoder, default 1e-3 rad

    @property
    def model(self) -> Path:
        """Return the MJCF file."""
        return MODELS / f"{self.name}.xml"

    @property
    def judged(self) -> tuple[str, ...]:
        """Return the joints that are diagnosed."""
        return (*self.follows, *self.pushed, *self.free)


ROBOTS: Final[Mapping[str, Robot]] = {
    robot.name: robot
    for robot in (
        Robot(
            "arm",
            {"base": 1.0, "shoulder": 0.7, "elbow": 0.8, "forearm_roll": 1.2, "wrist": 1.0, "tool_roll": 1.4},
            {},
        ),
        Robot("gantry", {"x": 0.25, "y": 0.2}, {}, ("swing",), step={"x": 5e-5, "y": 5e-5}),
        Robot("cartpole", {}, {"rail": 0.2}, ("hinge",), step={"rail": 1e-4}),
        Robot("leg", {}, {"hip": 0.5, "knee": 0.6, "ankle": 0.5}),
        Robot("camera", {"pan": 0.9, "tilt": 0.5}, {}, moved={"track": 0.15}, step={"track": 1e-4}),
    )
}
