"""Recipes of training runs: task, model, variation of the robots and other settings.

A recipe is a few lines of YAML; its `settings` have the names under which a policy's file records them.
"""

import json
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from softarm.common.plugins import PluginError
from softarm.common.words import did_you_mean
from softarm.schemas.base import Strict
from softarm.schemas.config import RailLimits
from softarm.simulator import model_file
from softarm.training.learn.network import NetworkShape
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record.checkpoint import TrainingConfig
from softarm.training.run.session import Session
from softarm.training.task import registry
from softarm.training.task.environment import Randomisation
from softarm.training.task.reach import TASKS, ReachTask, ShelfTask

# Settings with a place of their own -> what to do.
ELSEWHERE = {
    "run.seed": "give --seed, or the `seeds` of a sweep",
    "task.name": "give another TASK, or the `task` of a recipe",
    "network.inputs": "remove it: it follows from the task",
    "network.actions": "remove it: it follows from the task",
}

PRESETS: dict[str, ReachTask] = TASKS | {
    "reach-robust": replace(TASKS["reach-wide"], name="reach-robust"),
    "shelf": ShelfTask(),
}
# Ranges of robots on a bench, drawn in each episode. The rail's are widest, because the cart times a swing: trained
# on one drive alone, a policy loses a quarter of its targets on a later drive.
ROBUST = {
    "pressure.lag.inflate": (0.10, 0.32),
    "pressure.lag.deflate": (0.14, 0.44),
    "pressure.dead_time.delay": (0.0, 0.1),
    "pressure.gain.scale": (-0.08, 0.08),
    "rail.acceleration_limit.acceleration": (2.5, 8.0),
    "rail.delay.delay": (0.02, 0.1),
    "rail.lag.time": (0.0, 0.08),
    "arm.stiffness.scale": (-0.25, 0.35),
    "arm.damping.scale": (-0.3, 1.5),
    "arm.muscle_gain.scale": (-0.25, 0.25),
    "arm.torque_offset.scale": (-0.5, 0.5),
    "arm.payload.mass": (0.0, 0.1),
    "arm.tilt.angle": (-0.01, 0.01),
    "mocap.latency.delay": (0.0, 0.015),
    "mocap.noise.sigma": (0.0, 0.001),
}


class Recipe(Strict):
    """Recipe of a run, without its seed."""

    task: str = "reach"  # a preset's name, or that of another package's
    model: str = "seed"  # a shipped name or a file
    frames: int = Field(5_000_000, ge=1)  # control steps of single robots
    # 'part.field' of task, run, ppo or network -> its value, e.g. network.order: mlp
    settings: dict[str, Any] = Field(default_factory=dict)
    # 'stage.effect.parameter' of the effect registry -> lowest and highest value
    randomise: dict[str, tuple[float, float]] = Field(default_factory=dict)
    each_episode: bool = True  # draw a robot again for each of its episodes

    @property
    def model_name(self) -> str:
        """The model's shipped name, or the name of its file: the whole path where a shipped model has that name."""
        name = Path(self.model).stem
        return self.model if name in model_file.shipped() else name

    def changed(self, model: Path | None, settings: Mapping[str, Any]) -> "Recipe":
        """Return the recipe with changed values; None keeps a value."""
        given = {name: value for name, value in settings.items() if value is not None}
        return self.model_copy(
            update={"model": self.model if model is None else str(model), "settings": self.settings | given}
        )


class Ingredients(NamedTuple):
    """Recipe with objects instead of names, for a session."""

    task: ReachTask
    run: TrainingConfig
    ppo: PpoConfig
    network: NetworkShape
    randomisation: Randomisation


def preset(name: str) -> ReachTask:
    """Return a task by its name; built-in tasks take precedence. Raises ValueError."""
    if name in PRESETS:
        return PRESETS[name]
    known = (*PRESETS, *registry.names())
    if name not in known:
        raise ValueError(f"no task '{name}'; {did_you_mean(name, known)}there is {', '.join(known)}")
    try:
        return registry.load(name)
    except PluginError as error:
        raise ValueError(str(error)) from error


def named(name: str) -> Recipe:
    """Return the recipe of a shipped policy, or the default one for a plug-in's task. Raises ValueError."""
    return RECIPES.get(name) or Recipe.model_validate({"task": preset(name).name})


def prepare(recipe: Recipe, seed: int) -> Ingredients:
    """Replace names by objects. Raises ValueError with every invalid setting, or for an unknown task or effect."""
    usual: dict[str, Any] = {
        "task": preset(recipe.task),
        "run": TrainingConfig(seed=seed),
        "ppo": PpoConfig(),
        "network": NetworkShape(),
    }
    given: dict[str, dict[str, Any]] = {part: {} for part in usual}
    wrong = []
    for path, value in recipe.settings.items():
        part, _, name = path.partition(".")
        if path in ELSEWHERE:
            wrong.append(f"{path} is {value!r}; a recipe has no such setting: {ELSEWHERE[path]}")
        elif part not in usual:
            wrong.append(f"{path}: there is no part {part!r}; settings begin with {', '.join(usual)}")
        else:
            given[part][name] = value
    made = {}
    for part, before in usual.items():
        try:
            made[part] = _changed(before, given[part])
        except ValidationError as error:
            wrong += (_problem(f"{part}.", before, each) for each in error.errors())
    wrong += _conflicts(made)
    if wrong:
        raise ValueError("; ".join(wrong))
    return Ingredients(**made, randomisation=Randomisation(recipe.randomise, recipe.each_episode))


def begin(recipe: Recipe, seed: int, out: Path, pool: Executor, resume: bool) -> Session:
    """Create the session of a recipe. Raises ValueError, ModelFileError or CheckpointError."""
    parts, model = prepare(recipe, seed), model_file.load(recipe.model)
    task, run, ppo, network, randomisation = parts
    return Session(task, run, ppo, out, pool, resume, model, recipe.model_name, randomisation, network)


def _changed(before: Any, given: dict[str, Any]) -> Any:
    """Return a dataclass with other values for some fields. Raises ValidationError."""
    values = {each.name: getattr(before, each.name) for each in fields(before) if each.init}
    # In strict JSON a list is a tuple, and a number must be a number (not "0.1", not true).
    return TypeAdapter(type(before)).validate_json(json.dumps(values | given), strict=True)


def _problem(prefix: str, before: Any, error: ErrorDetails) -> str:
    """Return an error of pydantic as a sentence with the setting, its value, the allowed ones and the remedy."""
    said = error["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if not error["loc"]:
        return f"{prefix[:-1]}: {said}"
    name = str(error["loc"][0])
    path = prefix + ".".join(map(str, error["loc"]))
    if not hasattr(before, name):
        return f"{path}: no such setting; {prefix[:-1]} has {', '.join(sorted(each.name for each in fields(before)))}"
    return f"{path} is {error['input']!r}; allowed: {said}; give a value like {getattr(before, name)!r}"


def _conflicts(made: Mapping[str, Any]) -> Iterator[str]:
    """Yield the conflicts between valid settings."""
    if "task" in made:
        try:
            _ = made["task"].rail_limits
        except ValidationError as error:
            yield from (_problem("task.rail_", RailLimits(), each) for each in error.errors())
    if {"run", "ppo"} <= made.keys() and (rest := made["run"].robots % made["ppo"].minibatches):
        yield (
            f"run.robots is {made['run'].robots}; allowed are multiples of ppo.minibatches, "
            f"{made['ppo'].minibatches}; give {made['run'].robots - rest + made['ppo'].minibatches}"
        )


# Recipes of the policies known by name.
RECIPES: dict[str, Recipe] = {
    "reach": Recipe(task="reach", frames=5_000_000),
    "reach-wide": Recipe(task="reach-wide", frames=8_000_000),
    "reach-robust": Recipe(task="reach-robust", frames=12_000_000, randomise=ROBUST),
    # Successes are rare, so more learning steps per frame help.
    "shelf": Recipe(task="shelf", frames=5_000_000, settings={"run.robots": 1024}),
}
