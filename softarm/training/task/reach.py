"""Reach and shelf task: ranges, rewards and starts. [P]: the paper; [C]: its authors' configuration."""

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from softarm.schemas import flights
from softarm.schemas.base import Strict
from softarm.schemas.config import RailLimits
from softarm.schemas.policy import REACH_GOAL, SHELF_GOAL, Signal, TaskKind
from softarm.schemas.robot import CONTROL_RATE_HZ, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA, RAIL_LIMIT_M

Array = NDArray[np.float32]


def _ordered(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError("a lower number and then a higher one")
    return ends


Range = Annotated[tuple[float, float], AfterValidator(_ordered)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class Starts(NamedTuple):
    """Start states of robots at rest."""

    cart_position_m: Array  # [R]
    joint_angles_rad: Array  # [R, links]
    pressure_kpa: Array  # [R]


class Moment(NamedTuple):
    """Inputs of a reward, one entry per robot: true values, not those of the sensors."""

    tip_m: Array  # y, z, [R, 2]
    tip_speed_m_s: Array  # [R]
    target_m: Array  # y, z, [R, 2]
    cart_position_m: Array  # [R]
    success: NDArray[np.bool_]  # the tip lies within the radius, and the cart is on the rail
    off_rail: NDArray[np.bool_]


# Of limits.rail; the drive's acceleration_max_m_s2 has no part in the clamp.
CLAMP_KEYS = (
    "position_min_m",
    "position_max_m",
    "margin_m",
    "velocity_max_m_s",
    "latency_s",
    "braking_m_s2",
    "surge_m_s2",
    "drag_m_s",
)


@dataclass(frozen=True)
class ReachTask:
    """Swing the tip to a target in free space. The defaults are the seed's training range ([P] SM-E)."""

    __pydantic_config__ = Strict.model_config
    goal: ClassVar[tuple[Signal, ...]] = REACH_GOAL  # at the end of an observation
    kind: ClassVar[TaskKind] = "reach"  # in a policy's file

    name: str = "reach"
    target_y_m: Range = (-0.4, 0.0)
    target_z_m: Range = (0.55, flights.TRAINED_Z_MAX_M)
    cart_start_m: Range = (-0.025, RAIL_LIMIT_M)  # [C]
    joint_start_deg: NotNegative = 10.0  # uniform within +- this [C]
    pressure_start_kpa: Range = (PRESSURE_MIN_KPA, PRESSURE_MAX_KPA)
    # Share of the starts without pressure; [C] keeps the last episode's.
    vented_starts: Annotated[float, Field(ge=0, le=1)] = 0.5
    success_radius_m: Positive = 0.04
    episode_steps: Annotated[int, Field(ge=1)] = 100
    rate_hz: Annotated[float, Field(ge=CONTROL_RATE_HZ, le=CONTROL_RATE_HZ)] = float(CONTROL_RATE_HZ)
    rail_limit_m: Positive = RAIL_LIMIT_M  # an episode ends beyond it
    success_reward: float = 1000.0
    speed_reward: float = 0.1  # per m/s of the tip
    rail_penalty: float = -100.0
    reward_scale: float = 0.01  # [C]
    action_noise: NotNegative = 0.001  # standard deviation on the +-1 action ([P] SM-E)
    # Commands pass the same braking clamp as in the daemon; without it the exact task of the seed.
    rail_guard: bool = True
    # Parameters of that clamp, as in the daemon's limits.rail (softarm.schemas.config.RailLimits).
    rail_position_min_m: float = RailLimits().position_min_m
    rail_position_max_m: float = RailLimits().position_max_m
    rail_margin_m: float = RailLimits().margin_m
    rail_velocity_max_m_s: float = RailLimits().velocity_max_m_s
    rail_latency_s: float = RailLimits().latency_s
    rail_braking_m_s2: float = RailLimits().braking_m_s2
    rail_surge_m_s2: float = RailLimits().surge_m_s2
    rail_drag_m_s: float = RailLimits().drag_m_s
    muscle: bool = True  # False: always vented ([P] section 4.2, cart actions only)

    @property
    def rail_limits(self) -> RailLimits:
        """Rail limits that clamp the commands."""
        return RailLimits(**{key: getattr(self, f"rail_{key}") for key in CLAMP_KEYS})

    def under(self, limits: RailLimits) -> Self:
        """Return the task with other rail limits."""
        return replace(self, **{f"rail_{key}": getattr(limits, key) for key in CLAMP_KEYS})

    def sample_targets(self, rng: np.random.Generator, count: int) -> Array:
        """Draw targets y, z in metres, float32 [count, 2], uniform over the range."""
        y = rng.uniform(*self.target_y_m, count)
        z = rng.uniform(*self.target_z_m, count)
        return np.stack((y, z), axis=1).astype(np.float32)

    def sample_starts(self, rng: np.random.Generator, count: int, links: int) -> Starts:
        """Draw start states for `count` robots."""
        cart = rng.uniform(*self.cart_start_m, count)
        angles = rng.uniform(-1.0, 1.0, (count, links)) * np.deg2rad(self.joint_start_deg)
        pressure = rng.uniform(*self.pressure_start_kpa, count)
        pressure[rng.random(count) < (self.vented_starts if self.muscle else 1.0)] = 0.0
        return Starts(cart.astype(np.float32), angles.astype(np.float32), pressure.astype(np.float32))

    def succeeded(self, tip_m: Array, target_m: Array) -> NDArray[np.bool_]:
        """Return whether tips [R, 2] lie within the radius of their targets [R, 2]."""
        offset = tip_m - target_m
        near: NDArray[np.bool_] = np.hypot(offset[:, 0], offset[:, 1]) < self.success_radius_m
        return near

    def reward(self, now: Moment) -> Array:
        """Return the scaled reward of a step, float32 [R] ([P] section 4)."""
        scaled: Array = self.score(now).astype(np.float32)
        return scaled

    def score(self, now: Moment) -> Any:
        """Return the scaled reward of arrays, or of tensors on a graphics card."""
        total = self.success_reward * now.success + self.rail_penalty * now.off_rail
        return self.reward_scale * (total + self.speed_reward * now.tip_speed_m_s)


@dataclass(frozen=True)
class ShelfTask(ReachTask):
    """Targets in a shelf with a new place in each episode; defaults: the seed's training range ([P] section 4.2)."""

    goal = SHELF_GOAL
    kind = "shelf"

    name: str = "shelf"
    target_y_m: Range = flights.SHELF_Y_M
    target_z_m: Range = flights.SHELF_Z_M
    target_depth_m: Range = flights.SHELF_DEPTH_M  # behind the shelf's front edge; negative: before it
    board_below_m: float = flights.BOARD_BELOW_M  # from the target down to the lower board's top [C]
    action_noise: NotNegative = 0.01  # [C]

    def sample_depths(self, rng: np.random.Generator, count: int) -> Array:
        """Draw depths in metres, float32 [count], uniform over the range."""
        return rng.uniform(*self.target_depth_m, count).astype(np.float32)


# reach-wide is for chained targets, as in the demo: each starts where the last one left the cart.
TASKS = {
    task.name: task
    for task in (
        ReachTask(),
        ReachTask(
            name="reach-wide",
            target_y_m=(-0.42, 0.02),
            target_z_m=(0.54, 0.80),
            cart_start_m=(-0.22, 0.24),
            joint_start_deg=15.0,
        ),
    )
}
