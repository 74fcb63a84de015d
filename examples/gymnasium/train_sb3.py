"""PPO of Stable-Baselines3 on the vector environment, at its full speed.

pip install stable-baselines3
python train_sb3.py --steps 400000 --out mine.onnx
softarm evaluate mine.onnx reach
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from softarm.training.record import foreign

ENVIRONMENT = "softarm.training.gym_envs:SoftArmReach-v0"
Array = NDArray[np.float32]
ROBOTS, HORIZON = 256, 16
# Limit of normalised observations.
CUT = 5.0


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


class ManyArms(VecEnv):
    """Adapter of Gymnasium's vector environment for Stable-Baselines3; both reset in the step that ends an episode."""

    def __init__(self, robots: int) -> None:
        self.envs = gymnasium.make_vec(ENVIRONMENT, num_envs=robots)
        super().__init__(robots, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> Array:
        observation, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observation

    def step_async(self, actions: Array) -> None:
        self.actions = actions

    def step_wait(self) -> tuple[Array, Array, np.ndarray, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, info = self.envs.step(self.actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for robot in np.flatnonzero(terminated | truncated):
            infos[robot] = {
                "terminal_observation": info["final_obs"][robot],
                "TimeLimit.truncated": bool(truncated[robot]),
            }
        return observation, reward, terminated | truncated, infos

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.envs, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise AttributeError(f"{attr_name}: all robots are one environment; set it where that is made")

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **options: Any) -> list[Any]:
        raise AttributeError(f"{method_name}: all robots are one environment; call it there")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


def train(steps: int, seed: int = 1, show: bool = False) -> tuple[PPO, VecNormalize, Score, Score]:
    """Train for a number of steps of single robots and return model, normaliser and the scores before and after."""
    torch.set_num_threads(1)
    envs = VecNormalize(ManyArms(ROBOTS), norm_reward=False, clip_obs=CUT)
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=HORIZON,
        batch_size=ROBOTS * HORIZON // 4,
        n_epochs=4,
        learning_rate=1e-3,
        seed=seed,
        policy_kwargs={"log_std_init": -0.5},
        device="cpu",
        verbose=int(show),
    )

    def act(observation: Array) -> Array:
        action: Array = model.predict(envs.normalize_obs(observation), deterministic=True)[0]
        return action

    before = score(act)
    model.learn(steps)
    return model, envs, before, score(act)


def export(model: PPO, envs: VecNormalize, out: Path, seed: int = 1) -> float:
    """Write the policy's file and return the share of the validation set that it reaches."""
    actor = torch.nn.Sequential(*model.policy.mlp_extractor.policy_net, model.policy.action_net)
    mean, scale = envs.obs_rms.mean, np.sqrt(envs.obs_rms.var + envs.epsilon)
    training = {"learner": "stable-baselines3 PPO"}
    return foreign.export(actor, out, mean=mean, scale=scale, cut=CUT, seed=seed, training=training)


def main() -> None:
    """Train as the command line says, and export the policy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=400_000, help="of single robots")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("mine.onnx"), help="the policy's file")
    asked = parser.parse_args()
    model, envs, before, after = train(asked.steps, asked.seed, show=True)
    share = export(model, envs, asked.out, asked.seed)
    print(f"untrained: {before}; trained: {after}\nwrote {asked.out}, {share:.0%} of the validation set")


if __name__ == "__main__":
    main()
