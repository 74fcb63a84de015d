"""Interface of policies. The daemon finds a policy by its entry point in the group `softarm.policies`.

class Mine:
    interface = 1
    spec = PolicySpec(name="mine", description="one line")
    def __init__(self, **options): ...
    def reset(self): ...
    def step(self, observation, goal): return np.array([cart_velocity_m_s, pressure_kpa])
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from softarm.common.plugins import PluginError
from softarm.schemas.policy import ACTION, TrainingRange

Array = NDArray[np.float32]
GROUP = "softarm.policies"
INTERFACE = 1  # version that a policy's class states; docs/policies/interface.md describes it
MODELS = Path(__file__).parent / "models"  # shipped models, named by their stem
# Ranges of the two commands, m/s and kPa.
LOW: Array = np.array([signal.low for signal in ACTION], dtype=np.float32)
HIGH: Array = np.array([signal.high for signal in ACTION], dtype=np.float32)


class PolicyError(PluginError):
    """An unusable policy; the text names the policy, the problem and the remedy."""


@dataclass(frozen=True, slots=True)
class PolicySpec:
    """Description of a policy, known before it runs."""

    name: str
    description: str
    needs_target: bool = True  # False: `goal` may be NaN, as under a hold
    episode_steps: int | None = None  # longest episode of its training, ticks
    trained: TrainingRange | None = None
    sha256: str | None = None  # of the model file
    shelf_depth_m: float | None = None  # depth of targets behind the shelf's front edge; None: no shelf
    # True: two values follow the observation: seconds without tracking, and the deviation of the estimated tip, m.
    wants_tracking: bool = False


@runtime_checkable
class Policy(Protocol):
    """Controller of one robot at 30 Hz."""

    spec: PolicySpec

    def reset(self) -> None:
        """Reset the internal state; called before the first step of every goal."""

    def step(self, observation: Array, goal: Array) -> Array:
        """Choose the next command.

        Args:
            observation: float32 [8] in the order of `softarm.schemas.policy.OBSERVATION`, SI units and kPa; [10] with
                `spec.wants_tracking`.
            goal: float32 [2], target y and z, m.

        Returns:
            float32 [2]: cart velocity (m/s), muscle pressure (kPa). The safety filter may still change them.
        """
