"""Export of a network from another learner as an ONNX policy for the daemon.

The network is feed-forward, in torch, with the observations of `softarm.training.gym_envs`; actions are clipped to
-1..1. Like a file of `softarm train`, the file has metadata, a golden run and the success in the validation set.
"""

import copy
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from onnx import ModelProto
from torch import nn

from softarm.schemas.model import Model
from softarm.schemas.policy import ACTION, OBSERVATION
from softarm.training.learn import validation
from softarm.training.record.checkpoint import Settings, flat
from softarm.training.record.export import Graph, described, finished, golden_run, write_model
from softarm.training.task.reach import ReachTask

Array = NDArray[np.float32]
STATE = 1  # unused; the file format needs a recurrent state
LAYERS: dict[type[nn.Module], str] = {nn.Tanh: "Tanh", nn.ReLU: "Relu", nn.Sigmoid: "Sigmoid", nn.Identity: "Identity"}
VALIDATION_TRIALS = 512


class ForeignNetworkError(Exception):
    """Unsupported network; the text names the layer and what is allowed."""


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
    """Write a network as a policy file and return its success in the task's validation set, as a share.

    `layers` map (observation - mean) / scale, clipped at +-cut, to the action's mean. `training` is recorded in the
    file. Raises ForeignNetworkError for layers other than Linear, Tanh, ReLU, ELU, Sigmoid, for wrong sizes or for an
    invalid normalisation.
    """
    task = task or ReachTask()
    inputs = len(OBSERVATION) + len(task.goal)
    # A copy, as the caller's network may be on a graphics card or in float64.
    layers = copy.deepcopy(layers).cpu().float()
    shift, width = _numbers("mean", mean, inputs), _numbers("scale", scale, inputs)
    if not (width > 0).all():
        raise ForeignNetworkError(f"scale is {scale!r}; allowed: one finite number or {inputs}, above 0: correct it")
    if not cut > 0:
        raise ForeignNetworkError(f"cut is {cut!r}; allowed: a number above 0, or infinity: correct it")
    model = _graph(layers, inputs, shift, width, cut)

    def act(observation: Array, flying: NDArray[np.bool_]) -> Array:
        with torch.no_grad():
            inside = torch.from_numpy(((observation - shift) / width).clip(-cut, cut))
            action: Array = layers(inside).clamp(-1.0, 1.0).numpy()
        return action

    trials = validation.validation_scenarios(task, Model().arm.links, VALIDATION_TRIALS)
    share = float(validation.fly_actions(act, task, trials).reached.mean())
    settings: Settings = flat(task=task) | {"run.validation_set": validation.chosen_by(task)} | (training or {})
    write_model(model, described(task, STATE, settings, seed, share, golden_run(act, task)), path)
    return share


def _numbers(name: str, values: ArrayLike, count: int) -> Array:
    """Return one number or `count` as float32 [count]. Raises ForeignNetworkError."""
    try:
        numbers = np.broadcast_to(np.asarray(values, dtype=np.float32), count).copy()
    except (TypeError, ValueError):  # no numbers, or not so many
        numbers = np.full(count, np.nan, dtype=np.float32)
    if not np.isfinite(numbers).all():
        raise ForeignNetworkError(f"{name} is {values!r}; allowed: one finite number or {count}: correct it")
    return numbers


def _graph(layers: nn.Sequential, inputs: int, mean: Array, scale: Array, cut: float) -> ModelProto:
    graph, width = Graph(), inputs
    x = graph.normalised(mean, scale, cut)
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
    graph.pass_state()
    return finished(graph, inputs, STATE)
