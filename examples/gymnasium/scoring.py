"""Score of a policy: mean return and share of reached targets over fixed episodes."""

from collections.abc import Callable
from typing import NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

ENVIRONMENT = "softarm.training.gym_envs:SoftArmReach-v0"
Array = NDArray[np.float32]


class Score(NamedTuple):
    """Score over a number of episodes; `reached` is a share."""

    mean_return: float
    reached: float

    def __str__(self) -> str:
        return f"return {self.mean_return:.2f}, {self.reached:.0%} reached"


def score(act: Callable[[Array], Array], episodes: int = 256, seed: int = 54) -> Score:
    """Fly one episode on each of many robots in parallel; `act` maps observations [R, 10] to actions [R, 2]."""
    envs = gymnasium.make_vec(ENVIRONMENT, num_envs=episodes)
    observation, _ = envs.reset(seed=seed)
    alive, reached = np.ones(episodes, np.bool_), np.zeros(episodes, np.bool_)
    returns = np.zeros(episodes)
    while alive.any():
        observation, reward, terminated, truncated, info = envs.step(np.clip(act(observation), -1.0, 1.0))
        returns += alive * reward
        reached |= alive & info["success"]
        alive &= ~(terminated | truncated)
    return Score(float(returns.mean()), float(reached.mean()))
