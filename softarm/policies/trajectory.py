"""Upper bound of the seed: a planned trajectory with weak feedback ([P] SM-H)."""

import hashlib
import math
from pathlib import Path

import numpy as np

from softarm.policies.base import HIGH, LOW, Array, PolicyError, PolicySpec
from softarm.policies.plans import Plans, find
from softarm.schemas.policy import TrainingRange, places

TARGET_TOLERANCE_M = 0.01
START_TOLERANCE_M = 0.03  # of cart and tip, from the start of a plan
[_CART], _TIP = places("cart_position_m"), places("tip_y_m", "tip_z_m")


class Trajectory:
    """Tracking of the nearest plan: a = a_ref + k (tip_ref - tip) at each step ([P] equations 5a, 5b).

    Args:
        plans: A path that ends in .npz, or a shipped name.
        k_y: Gain in 1/s (to m/s).
        k_z: Gain in kPa/m.
        extension_steps: Steps beyond a plan's end with its last command and tip, for a robot that lags. Then the cart
            rests.

    Raises:
        PolicyError: The file or a gain is invalid. `step` raises it if no plan leads to the goal from here.
    """

    spec = PolicySpec(name="trajectory", description="tracks planned trajectories, the paper's upper bound")

    def __init__(
        self, plans: str = "trajectories", k_y: float = 0.1, k_z: float = 5.0, extension_steps: int = 3
    ) -> None:
        for name, gain in {"k_y": k_y, "k_z": k_z, "extension_steps": extension_steps}.items():
            if not (math.isfinite(gain) and gain >= 0):
                raise PolicyError(f"option {name} is {gain}; allowed 0 or more: the policy sets the sign")
        self._gain = np.array([k_y, k_z], dtype=np.float32)
        self._extension = int(extension_steps)
        self._file = find(plans)
        self._plans = Plans.load(self._file)
        self.spec = _spec(self._file, self._plans, self._extension)
        self.reset()

    @classmethod
    def describe(
        cls, plans: str = "trajectories", k_y: float = 0.1, k_z: float = 5.0, extension_steps: int = 3
    ) -> PolicySpec:
        """Return the spec from the file of the plans."""
        file = find(plans)
        return _spec(file, Plans.load(file), int(extension_steps))

    def reset(self) -> None:
        """Choose a plan again at the next step."""
        self._chosen: int | None = None
        self._step = 0

    def step(self, observation: Array, goal: Array) -> Array:
        """Return [cart velocity, pressure] within `ACTION`'s ranges."""
        if self._chosen is None:
            self._chosen = self._choose(observation, goal)
        plan, k = self._chosen, self._step
        self._step += 1
        last = int(self._plans.steps[plan])
        reference = self._plans.command[plan, min(k, last - 1)]
        if k >= last + self._extension:
            return np.array((0.0, reference[1]), dtype=np.float32)
        tip = self._plans.tip_m[plan, min(k, last)]
        action: Array = np.clip(reference + self._gain * (tip - observation[_TIP]), LOW, HIGH)
        return action.astype(np.float32)

    def _choose(self, observation: Array, goal: Array) -> int:
        """Return the plan to the nearest target with the start nearest to the cart."""
        plans = self._plans
        off_m = np.hypot(*(plans.target_m - goal).T)
        nearest = int(off_m.argmin())
        if not off_m[nearest] <= TARGET_TOLERANCE_M:  # also true for NaN
            raise PolicyError(
                f"no plan for the target ({goal[0]:.3f}, {goal[1]:.3f}) m: the nearest of {_grid(plans)} is "
                f"{off_m[nearest] * 100:.1f} cm off, allowed {TARGET_TOLERANCE_M * 100:.0f} cm; "
                "plan it with `softarm dev plan --target Y Z --out FILE`"
            )
        same = np.flatnonzero((plans.target_m == plans.target_m[nearest]).all(axis=1))
        chosen = int(same[np.abs(plans.cart_start_m[same] - observation[_CART]).argmin()])
        cart_off_m = abs(float(observation[_CART] - plans.cart_start_m[chosen]))
        tip_off_m = float(np.hypot(*(observation[_TIP] - plans.tip_m[chosen, 0])))
        if not max(cart_off_m, tip_off_m) <= START_TOLERANCE_M:
            starts = ", ".join(f"{start:.2f}" for start in np.unique(plans.cart_start_m[same]))
            raise PolicyError(
                f"no plan from here: plans begin with the arm hanging at rest and the cart at {starts} m; now the cart "
                f"is {cart_off_m * 100:.1f} cm and the tip {tip_off_m * 100:.1f} cm off, allowed "
                f"{START_TOLERANCE_M * 100:.0f} cm; wait for rest, or plan with `softarm dev plan --start M --out FILE`"
            )
        return chosen


def _grid(plans: Plans) -> str:
    """Describe the planned targets in words."""
    y, z = (np.unique(column) for column in plans.target_m.T)
    count = len(np.unique(plans.target_m, axis=0))
    grid = f"a {len(y)} x {len(z)} grid over" if count == len(y) * len(z) else "within"
    return f"{count} targets, {grid} y {y[0]:.2f}..{y[-1]:.2f}, z {z[0]:.2f}..{z[-1]:.2f} m,"


def _spec(file: Path, plans: Plans, extension_steps: int) -> PolicySpec:
    (y_low, z_low), (y_high, z_high) = plans.target_m.min(axis=0), plans.target_m.max(axis=0)
    return PolicySpec(
        name="trajectory",
        description=f"tracks {len(plans.steps)} planned trajectories (made on the model {plans.model})",
        episode_steps=int(plans.steps.max()) + extension_steps,
        trained=TrainingRange(
            target_y_m=(float(y_low), float(y_high)),
            target_z_m=(float(z_low), float(z_high)),
            cart_start_m=(float(plans.cart_start_m.min()), float(plans.cart_start_m.max())),
        ),
        sha256=hashlib.sha256(file.read_bytes()).hexdigest(),
    )
