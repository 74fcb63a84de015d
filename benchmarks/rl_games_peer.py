"""rl_games on our environment with the seed's exact settings: the peer of benchmarks/training.py.

    python -m softarm.benchmarks.rl_games_peer --json FILE      what it learns from 4.5 million frames, some ten minutes

Its key for sequences is `seq_length` (`seq_len` is ignored); compilation is off, it gains nothing on a CPU.
"""

# mypy: allow-untyped-defs, allow-subclassing-any

import contextlib
import io
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import gymnasium
import numpy as np
import torch
from rl_games.common import env_configurations, vecenv
from rl_games.common.algo_observer import AlgoObserver
from rl_games.torch_runner import Runner

from softarm.benchmarks import results
from softarm.schemas.policy import ACTION
from softarm.training.learn.inference import workers
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.run import validation
from softarm.training.task.environment import INPUTS, Environment
from softarm.training.task.reach import ReachTask

NAME = "softarm"
TASK = ReachTask(rail_guard=False)  # the seed's exact task: no braking clamp
ROBOTS, HORIZON = 4096, 16


class _Robots(vecenv.IVecEnv):
    """Our batch as rl_games wants it; counts its steps and when they were taken."""

    begun_s: list[float] = []  # noqa: RUF012, one run at a time

    def __init__(self, _config: str, robots: int, **_: Any) -> None:
        self._environment = Environment(TASK, robots, seed=1)
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


class _Watcher(AlgoObserver):
    """Hands every so many epochs' policy to a function."""

    def __init__(self, every: int, look: Callable[[int, PolicyNetwork], None]) -> None:
        super().__init__()
        self._every, self._look = every, look

    def after_init(self, algo):
        self._algorithm = algo

    def after_print_stats(self, frame, epoch_num, total_time):
        if epoch_num % self._every == 0:
            self._look(frame, ours(self._algorithm.model))


def ours(model: Any) -> PolicyNetwork:
    """The policy of rl_games in our network: the same layers under other names. Its critic stays behind."""
    theirs = model.state_dict()
    network = PolicyNetwork(NetworkShape())
    names = {
        "w_x": "rnn.rnn.weight_ih_l0",
        "w_h": "rnn.rnn.weight_hh_l0",
        "layer_norm.weight": "layer_norm.weight",
        "layer_norm.bias": "layer_norm.bias",
        "mean_head.weight": "mu.weight",
        "mean_head.bias": "mu.bias",
    } | {f"mlp.{k}.{part}": f"actor_mlp.{k}.{part}" for k in (0, 2, 4) for part in ("weight", "bias")}
    state = {mine: theirs[f"a2c_network.{name}"] for mine, name in names.items()}
    state["bias"] = theirs["a2c_network.rnn.rnn.bias_ih_l0"] + theirs["a2c_network.rnn.rnn.bias_hh_l0"]
    state["observation_normaliser.mean"] = theirs["running_mean_std.running_mean"]
    state["observation_normaliser.variance"] = theirs["running_mean_std.running_var"]
    network.load_state_dict(network.state_dict() | state)
    return network


def train(epochs: int, watcher: AlgoObserver | None = None) -> float:
    """Train for so many epochs; returns when it ended, by the monotonic clock."""
    vecenv.register(NAME, lambda config, robots, **options: _Robots(config, robots, **options))
    env_configurations.register(NAME, {"vecenv_type": NAME, "env_creator": lambda **_: None})
    _Robots.begun_s.clear()
    with TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        runner = Runner(watcher)
        runner.load({"params": _settings(epochs, folder)})
        runner.run({"train": True, "play": False})
    return time.monotonic()


def steps_per_s(epochs: int = 6, warm_up: int = 2) -> float:
    """Train for a few epochs; control steps of single robots a second after the first ones."""
    end_s = train(epochs + warm_up)
    return epochs * HORIZON * ROBOTS / (end_s - _Robots.begun_s[warm_up * HORIZON])


@click.command()
@click.option("--frames", type=click.IntRange(ROBOTS * HORIZON), default=4_500_000, show_default=True)
@click.option("--every", type=click.IntRange(1), default=10, show_default=True, help="Epochs from test to test.")
@results.json_option
def main(frames: int, every: int, json_file: Path | None) -> None:
    """Train with rl_games and fly the 54 targets with what it learnt, by the same means as our own policies.

    \b
    Example:
      python -m softarm.benchmarks.rl_games_peer --json rl_games.json
    """
    begun_s, curve = time.monotonic(), []
    threads = torch.get_num_threads()

    def look(frame: int, network: PolicyNetwork) -> None:
        with workers() as pool:
            report = validation.grid_shares(network, TASK, pool)
        torch.set_num_threads(threads)
        curve.append((time.monotonic() - begun_s, int(frame), *report))
        shares = " / ".join(f"{100 * share:.1f}" for share in report)
        click.echo(f"{curve[-1][0]:.0f} s, {frame / 1e6:.2f} M frames: {shares} %", err=True)

    train(frames // (ROBOTS * HORIZON), _Watcher(every, look))
    if json_file is not None:
        results.write(json_file, {"seconds, frames, in range, above, all": curve})


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


if __name__ == "__main__":
    main()
