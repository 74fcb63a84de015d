"""Measure simulator, environment and learner on a graphics card, and the difference of its tips from the CPU's.

python -m benchmarks.card --json FILE
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch

from benchmarks import results
from softarm.schemas.model import Model
from softarm.simulator.cuda.simulator import TensorSimulator
from softarm.simulator.effects import exemplars
from softarm.simulator.simulator import Simulator
from softarm.training.learn.inference import device_named, workers
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import Ppo, PpoConfig
from softarm.training.task.environment import ACTIONS, INPUTS
from softarm.training.task.reach import TASKS
from softarm.training.task.tensor_environment import TensorEnvironment

BATCHES = (16384, 131072, 1048576)
LEARNERS = (2048, 8192, 32768)
COMPARED, STEPS = 2048, 90
MODELS = {"seed": Model(), "every": Model(effects=exemplars())}


def rate(run: Callable[[], Any], work: int, times: int = 50) -> float:
    """Return work per second: the best of three rounds after a warm-up."""
    rounds = []
    for _ in range(4):
        torch.cuda.synchronize()
        start = time.perf_counter()
        for _ in range(times):
            run()
        torch.cuda.synchronize()
        rounds.append(time.perf_counter() - start)
    return work * times / min(rounds[1:])


def captured(run: Callable[[], Any], generator: torch.Generator) -> Callable[[], None]:
    """Return the replay of a CUDA graph of a function that has run before."""
    graph = torch.cuda.CUDAGraph()
    graph.register_generator_state(generator)
    with torch.cuda.graph(graph):
        run()
    return lambda: graph.replay()


def differences(model: Model) -> dict[str, float]:
    """Return the largest and the mean distance of the tips from the CPU's after random commands, m."""
    rng = np.random.default_rng(0)
    one, other = Simulator(model, COMPARED), TensorSimulator(model, COMPARED)
    for _ in range(STEPS):
        velocity, pressure = (rng.uniform(low, high, COMPARED).astype(np.float32) for low, high in ((-1, 1), (0, 20)))
        one.step(velocity, pressure)
        other.step(torch.from_numpy(velocity).cuda(), torch.from_numpy(pressure).cuda())
    away = np.linalg.norm(one.tip_m() - other.tip_m().cpu().numpy(), axis=1)
    return {"max_m": float(away.max()), "mean_m": float(away.mean())}


def environment_rate(robots: int) -> float:
    """Return the control steps per second of the reach task, with observation, reward, rail guard and restarts."""
    environment = TensorEnvironment(TASKS["reach"], robots, 0)
    environment.reset()
    environment.stagger()
    action = torch.zeros((robots, ACTIONS), device="cuda")
    environment.step(action)
    return rate(captured(lambda: environment.step(action), environment.generator), robots)


def learner_rate(robots: int) -> float:
    """Return the control steps per second of the whole training with the paper's network."""
    network = PolicyNetwork(NetworkShape(INPUTS, ACTIONS)).to(device_named("cuda"))
    with workers(1) as pool:
        learner = Ppo(network, TensorEnvironment(TASKS["reach"], robots, 0), PpoConfig(), pool, 0)
        return rate(learner.iterate, robots * learner.config.horizon, 10)


@click.command()
@results.json_option
def main(json_file: Path | None) -> None:
    """Measure a graphics card.

    \b
    Example:
      python -m benchmarks.card --json card.json
    """
    if not torch.cuda.is_available():
        raise click.ClickException("PyTorch finds no graphics card; run this where `nvidia-smi` lists one")
    figures: dict[str, Any] = {"card": torch.cuda.get_device_name(), "cuda": torch.version.cuda}
    figures["difference"] = {name: differences(model) for name, model in MODELS.items()}
    figures["simulator_steps_per_s"] = {
        name: {str(robots): rate(TensorSimulator(model, robots).advance, robots) for robots in BATCHES}
        for name, model in MODELS.items()
    }
    figures["environment_steps_per_s"] = {str(robots): environment_rate(robots) for robots in BATCHES}
    figures["training_steps_per_s"] = {str(robots): learner_rate(robots) for robots in LEARNERS}
    results.write(json_file, figures)
    for name, value in figures.items():
        click.echo(f"{name}: {value}")


if __name__ == "__main__":
    main()
