"""Score of a policy over fixed episodes, and the command line of the scripts that train one."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

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


def main(train: Callable[..., tuple[Any, ...]], export: Callable[..., float]) -> None:
    """Train as the command line says, and export what `train` returns before its two scores."""
    docs = sys.modules["__main__"].__doc__
    parser = argparse.ArgumentParser(description=docs, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=400_000, help="of single robots")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("mine.onnx"), help="the policy's file")
    asked = parser.parse_args()
    *learned, before, after = train(asked.steps, asked.seed, show=True)
    share = export(*learned, asked.out, asked.seed)
    print(f"untrained: {before}; trained: {after}\nwrote {asked.out}, {share:.0%} of the validation set")
