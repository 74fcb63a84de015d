"""What a policy is. Publish one under the entry-point group `softarm.policies` and the daemon finds it.

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
from softarm.schemas.policy import TrainingRange

Array = NDArray[np.float32]
GROUP = "softarm.policies"
INTERFACE = 1  # what a policy, as its class says it, may be written for; docs/policies.md has the promise
MODELS = Path(__file__).parent / "models"  # the shipped ones, chosen by their stem


class PolicyError(PluginError):
    """A policy that cannot be used; the text names it, what is wrong and the next step."""


@dataclass(frozen=True, slots=True)
class PolicySpec:
    """What a policy says of itself before it is run."""

    name: str
    description: str
    needs_target: bool = True  # False: `goal` may be NaN, as under a hold
    episode_steps: int | None = None  # ticks after which it was never trained to go on
    trained: TrainingRange | None = None
    sha256: str | None = None  # of the model file
    shelf_depth_m: float | None = None  # that targets lie behind a shelf's front edge; None: it flies without a shelf
    wants_sight: bool = False  # True: the observation has `softarm.schemas.policy.SIGHT` behind it


@runtime_checkable
class Policy(Protocol):
    """One controller for one robot at 30 Hz."""

    spec: PolicySpec

    def reset(self) -> None:
        """Forget the past; called before the first step of every goal."""

    def step(self, observation: Array, goal: Array) -> Array:
        """Choose the next command.

        observation: float32 [8], `softarm.schemas.policy.OBSERVATION` order, SI units and kPa; [10] with
            `spec.wants_sight`.
        goal: float32 [2], target y and z in metres.
        Returns float32 [2]: cart velocity (m/s), muscle pressure (kPa). The safety filter has the last word.
        """
