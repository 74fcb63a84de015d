"""A network that another learner trained, as an ONNX policy that the daemon flies.

For feed-forward networks in torch, on the observations of `softarm.training.gym_envs`, with actions in -1..1 (what lies
outside is cut): Stable-Baselines3's, CleanRL's, one's own. The file is as `softarm train` leaves one, so it describes
itself, has a golden run and a share reached of the task's validation set. A recurrent state is handed through unused.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from onnx import ModelProto
from torch import nn

from softarm.schemas.policy import ACTION
from softarm.training.record.export import Graph, described, finished, recorded_run, write_model
from softarm.training.run import validation
from softarm.training.run.settings import Settings, flat
from softarm.training.task.reach import ReachTask
from softarm.training.task.shelf import environment_of

Array = NDArray[np.float32]
STATE = 1  # there must be one
LAYERS: dict[type[nn.Module], str] = {nn.Tanh: "Tanh", nn.ReLU: "Relu", nn.Sigmoid: "Sigmoid", nn.Identity: "Identity"}
VALIDATION_TRIALS = 512


class ForeignNetworkError(Exception):
    """A network that cannot be written; the text names the layer and what is allowed."""


def export(
    layers: nn.Sequential,
    path: Path,
    task: ReachTask | None = None,
    *,
    mean: ArrayLike = 0.0,
    scale: ArrayLike = 1.0,
    cut: float = float("inf"),
    seed: int = 0,
    training: Settings | None = None,
) -> float:
    """Write a network as a policy file; returns the share of the task's validation set that it reaches.

    layers: from the normalised observation to the action's mean. mean, scale, cut: an observation goes in as
    (observation - mean) / scale, cut at +-cut. training: what a person may want to know of how it was trained.
    Raises ForeignNetworkError for layers that are not Linear, Tanh, ReLU, ELU, Sigmoid, or sizes that do not fit.
    """
    task = task or ReachTask()
    inputs = environment_of(task, 1, 0).inputs
    shift, width = (np.broadcast_to(np.asarray(each, dtype=np.float32), inputs).copy() for each in (mean, scale))
    model = _graph(layers, inputs, shift, width, cut)

    def act(observation: Array) -> Array:
        with torch.no_grad():
            inside = torch.from_numpy(((observation - shift) / width).clip(-cut, cut))
            action: Array = layers.cpu()(inside).clamp(-1.0, 1.0).numpy()
        return action

    share = _validated(act, task)
    said: Settings = flat(task=task) | {"run.validation_set": validation.chosen_by(task)} | (training or {})
    write_model(model, described(task, STATE, said, seed, share, recorded_run(act, task)), path)
    return share


def _graph(layers: nn.Sequential, inputs: int, mean: Array, scale: Array, cut: float) -> ModelProto:
    graph, width = Graph(), inputs
    x = graph.node("Sub", ["observation", graph.weight("observation_mean", mean)], ["centred"])
    x = graph.node("Div", [x, graph.weight("observation_scale", scale)], ["scaled"])
    if np.isfinite(cut):
        x = graph.clip(x, cut, "normalised", "observation")
    for k, layer in enumerate(layers):
        if isinstance(layer, nn.Linear):
            if layer.in_features != width or layer.bias is None:
                raise ForeignNetworkError(f"layer {k}, {layer}: allowed is a Linear with {width} inputs and a bias")
            x, width = graph.linear(f"layer_{k}", layer, x), layer.out_features
        elif isinstance(layer, nn.ELU):
            x = graph.node("Elu", [x], [f"layer_{k}"], alpha=float(layer.alpha))
        elif type(layer) in LAYERS:
            x = graph.node(LAYERS[type(layer)], [x], [f"layer_{k}"])
        else:
            known = ", ".join(("Linear", "ELU", *(each.__name__ for each in LAYERS)))
            raise ForeignNetworkError(f"layer {k} is a {type(layer).__name__}; allowed are {known}")
    if width != len(ACTION):
        raise ForeignNetworkError(f"the network gives {width} numbers; an action has {len(ACTION)}")
    graph.clip(x, 1.0, "action", "action")
    graph.hand_state_through()
    return finished(graph, inputs, STATE)


def _validated(act: Callable[[Array], Array], task: ReachTask) -> float:
    """Share of the validation set reached, without noise of the action's."""
    environment = environment_of(replace(task, action_noise=0.0), VALIDATION_TRIALS, 0)
    scenarios = validation.validation_scenarios(task, environment.simulator.links, VALIDATION_TRIALS)
    count = len(scenarios.target_m)
    if count != VALIDATION_TRIALS:  # a third of them, rounded
        environment = environment_of(replace(task, action_noise=0.0), count, 0)
    observation, alive = scenarios.begin(environment), np.ones(count, dtype=np.bool_)
    reached = np.zeros(count, dtype=np.bool_)
    for _ in range(task.episode_steps):
        step = environment.step(act(observation))
        reached |= alive & step.success
        alive &= ~(step.terminated | step.truncated)
        observation = step.observation
    return float(reached.mean())
