"""Checks of a target before the tip moves there. Pure."""

import math
from collections.abc import Iterator

from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.model import Arm
from softarm.schemas.policy import TrainingRange

HINGE_Z_M = Arm().base_height_m
_ARM_M = sum(Arm().link_length_m)


def allowed_y(config: Config) -> str:
    """Return the allowed range of y as text."""
    workspace = config.goals.workspace
    return f"{workspace.y_min_m:g}..{workspace.y_max_m:g} m"


def allowed_z(config: Config) -> str:
    """Return the allowed range of z as text."""
    workspace = config.goals.workspace
    return f"{workspace.z_min_m:g}..{workspace.z_max_m:g} m"


def refusals(goal: Goal, config: Config) -> tuple[str, ...]:
    """Return why a target is refused, with the allowed range; empty if it is accepted."""
    return () if goal.kind != "reach" else tuple(_refusals(goal.y_m, goal.z_m, config))


def _refusals(y_m: float, z_m: float, config: Config) -> Iterator[str]:
    workspace, rail = config.goals.workspace, config.limits.rail
    if not workspace.y_min_m <= y_m <= workspace.y_max_m:
        yield f"y_m {y_m:g} is outside the workspace; allowed {allowed_y(config)} (goals.workspace)"
    if not workspace.z_min_m <= z_m <= workspace.z_max_m:
        yield f"z_m {z_m:g} is outside the workspace; allowed {allowed_z(config)} (goals.workspace)"
    nearest_hinge_m = min(max(y_m, rail.position_min_m), rail.position_max_m)
    distance = math.hypot(y_m - nearest_hinge_m, z_m - HINGE_Z_M)
    reach = _ARM_M + config.goals.success_radius_m
    if distance > reach:
        yield (
            f"the target ({y_m:g}, {z_m:g}) is out of reach, {distance:.3f} m from the nearest position of the hinge; "
            f"allowed up to {reach:.3f} m (arm length and success radius): choose a target closer to "
            f"y {rail.position_min_m:g}..{rail.position_max_m:g}, z {HINGE_Z_M:g}"
        )


def warnings(goal: Goal, policy: str, trained: TrainingRange | None) -> tuple[str, ...]:
    """Return warnings about an accepted target outside the policy's training range."""
    if trained is None or goal.kind != "reach":
        return ()
    ranges = (("y_m", goal.y_m, trained.target_y_m), ("z_m", goal.z_m, trained.target_z_m))
    return tuple(
        f"{name} {value:g} is outside the training range of the policy '{policy}' ({low:g}..{high:g} m): it may miss"
        for name, value, (low, high) in ranges
        if not low <= value <= high
    )
