"""rl_games on our environment with the seed's exact settings: the peer of `softarm bench train`.

Its key for sequences is `seq_length` (`seq_len` is ignored); compilation is off, it gains nothing on a CPU.
"""

# mypy: allow-untyped-defs, allow-subclassing-any

import contextlib
import io
import time
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import numpy as np
from rl_games.common import env_configurations, vecenv
from rl_games.torch_runner import Runner

from schemas.policy import ACTION
from training.environment import INPUTS, Environment
from training.tasks import ReachTask

NAME = "softarm"
ROBOTS, HORIZON = 4096, 16


class _Robots(vecenv.IVecEnv):
    """Our batch as rl_games wants it; counts its steps and when they were taken."""

    begun_s: list[float] = []  # noqa: RUF012, one run at a time

    def __init__(self, _config: str, robots: int, **_: Any) -> None:
        # The seed's exact task: no braking clamp.
        self._environment = Environment(ReachTask(rail_guard=False), robots, seed=1)
        self._robots = robots

    def step(self, action):
        self.begun_s.append(time.monotonic())
        step = self._environment.step(np.asarray(action, dtype=np.float32))
        # Copies: rl_games uses its buffers again.
        over = (step.terminated | step.truncated).copy()
        return step.observation.copy(), step.reward.copy(), over, {"time_outs": step.truncated.copy()}

    def reset(self):
        observation = self._environment.reset()
        self._environment.stagger()
        return observation.copy()

    def get_number_of_agents(self):
        return 1

    def get_env_info(self):
        return {
            "action_space": gymnasium.spaces.Box(-1.0, 1.0, (len(ACTION),), np.float32),
            "observation_space": gymnasium.spaces.Box(-np.inf, np.inf, (INPUTS,), np.float32),
        }


def steps_per_s(epochs: int = 6, warm_up: int = 2) -> float:
    """Train for a few epochs; control steps of single robots a second after the first ones."""
    vecenv.register(NAME, lambda config, robots, **options: _Robots(config, robots, **options))
    env_configurations.register(NAME, {"vecenv_type": NAME, "env_creator": lambda **_: None})
    _Robots.begun_s.clear()
    with TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        runner = Runner()
        runner.load({"params": _settings(epochs + warm_up, folder)})
        runner.run({"train": True, "play": False})
        end_s = time.monotonic()
    first = _Robots.begun_s[warm_up * HORIZON]
    return epochs * HORIZON * ROBOTS / (end_s - first)


def _settings(epochs: int, folder: str) -> dict[str, Any]:
    """The seed's ([P] SM-E; sizes as in docs/training.md)."""
    network = {
        "name": "actor_critic",
        "separate": False,
        "space": {
            "continuous": {
                "mu_activation": "None",
                "sigma_activation": "None",
                "mu_init": {"name": "default"},
                "sigma_init": {"name": "const_initializer", "val": 0},
                "fixed_sigma": True,
            }
        },
        "mlp": {
            "units": [256, 128, 64],
            "activation": "elu",
            "d2rl": False,
            "initializer": {"name": "default"},
            "regularizer": {"name": "None"},
        },
        "rnn": {
            "name": "lstm",
            "units": 256,
            "layers": 1,
            "before_mlp": False,
            "concat_input": True,
            "layer_norm": True,
        },
    }
    config = {
        "name": NAME,
        "env_name": NAME,
        "train_dir": folder,
        "device": "cpu",
        "device_name": "cpu",
        "torch_compile": False,
        "multi_gpu": False,
        "ppo": True,
        "mixed_precision": False,
        "normalize_input": True,
        "normalize_value": True,
        "value_bootstrap": True,
        "num_actors": ROBOTS,
        "reward_shaper": {"scale_value": 1.0},
        "normalize_advantage": True,
        "gamma": 0.99,
        "tau": 0.95,
        "learning_rate": 3e-4,
        "lr_schedule": "adaptive",
        "kl_threshold": 0.008,
        "score_to_win": 1e9,
        "max_epochs": epochs,
        "save_best_after": 10**6,
        "save_frequency": 0,
        "print_stats": False,
        "grad_norm": 1.0,
        "entropy_coef": 0.0,
        "truncate_grads": True,
        "e_clip": 0.2,
        "horizon_length": HORIZON,
        "minibatch_size": 32768,
        "mini_epochs": 4,
        "critic_coef": 2,
        "clip_value": True,
        "seq_length": 4,
        "bounds_loss_coef": 1e-4,
    }
    return {
        "seed": 1,
        "algo": {"name": "a2c_continuous"},
        "model": {"name": "continuous_a2c_logstd"},
        "network": network,
        "config": config,
    }
