"""Recipes of training runs: task, model, variation of the robots and other settings.

A recipe is a few lines of YAML; its `settings` have the names under which a policy's file records them.
"""

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_type_hints

from pydantic import Field

from softarm.common.plugins import PluginError
from softarm.common.words import did_you_mean
from softarm.schemas.base import Strict
from softarm.simulator import model_file
from softarm.training.learn.network import NetworkShape
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record.checkpoint import TrainingConfig
from softarm.training.run.session import Session
from softarm.training.task import registry
from softarm.training.task.environment import Randomisation
from softarm.training.task.reach import TASKS, ReachTask, ShelfTask

Setting = bool | int | float | str | tuple[int, ...] | tuple[float, ...]
# Settings that must lie above zero.
POSITIVE = (
    "task.episode_steps",
    "task.rate_hz",
    "run.robots",
    "run.physics_rate_hz",
    "run.validate_every",
    "run.validation_trials",
    "ppo.horizon",
    "ppo.minibatches",
    "ppo.mini_epochs",
)

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
    settings: dict[str, Setting] = Field(default_factory=dict)
    # 'stage.effect.parameter' of the effect registry -> lowest and highest value
    randomise: dict[str, tuple[float, float]] = Field(default_factory=dict)
    each_episode: bool = True  # draw a robot again for each of its episodes

    def changed(self, model: Path | None, settings: Mapping[str, Setting | None]) -> "Recipe":
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
    parts: dict[str, Any] = {
        "task": preset(recipe.task),
        "run": TrainingConfig(seed=seed),
        "ppo": PpoConfig(),
        "network": NetworkShape(),
    }
    given: dict[str, dict[str, Setting]] = {part: {} for part in parts}
    wrong = []
    for path, value in recipe.settings.items():
        part, _, name = path.partition(".")
        if path == "run.seed":
            wrong.append(f"run.seed is {value!r}; a recipe has no seed: give --seed, or the `seeds` of a sweep")
        elif part not in parts:
            wrong.append(f"{path}: there is no part {part!r}; settings begin with {', '.join(parts)}")
        else:
            given[part][name] = value
    for part, usual in parts.items():
        wrong += _problems(part, usual, given[part])
    if wrong:
        raise ValueError("; ".join(wrong))
    parts = {part: replace(usual, **given[part]) for part, usual in parts.items()}
    return Ingredients(**parts, randomisation=Randomisation(recipe.randomise, recipe.each_episode))


def begin(recipe: Recipe, seed: int, out: Path, pool: Executor, resume: bool) -> Session:
    """Create the session of a recipe. Raises ValueError, ModelFileError or CheckpointError."""
    parts, model = prepare(recipe, seed), model_file.load(recipe.model)
    task, run, ppo, network, randomisation = parts
    name = Path(recipe.model).stem
    return Session(task, run, ppo, out, pool, resume, model, name, randomisation, network)


def _problems(part: str, usual: Any, given: Mapping[str, Any]) -> Iterator[str]:
    """Yield why settings of a dataclass are refused: unknown, of another type or length, or not above zero."""
    kinds = get_type_hints(type(usual))
    known = {each.name for each in fields(usual)}
    for name, value in given.items():
        path = f"{part}.{name}"
        if name not in known:
            yield f"{path}: no such setting; {part} has {', '.join(sorted(known))}"
        elif not _fits(value, before := getattr(usual, name), kinds[name]):
            yield f"{path} is {value!r}; give a value like {before!r}"
        elif path in POSITIVE and value <= 0:
            yield f"{path} is {value!r}; give a number above 0, such as {before!r}"


def _fits(value: object, before: object, kind: Any) -> bool:
    """Return whether a value has the type of another, and its length where the type states one."""
    if isinstance(before, tuple):
        return isinstance(value, tuple) and (... in get_args(kind) or len(value) == len(before))
    if type(before) is float:
        return type(value) in (int, float)
    return type(value) is type(before)


# Recipes of the policies known by name.
RECIPES: dict[str, Recipe] = {
    "reach": Recipe(task="reach", frames=5_000_000),
    "reach-wide": Recipe(task="reach-wide", frames=8_000_000),
    "reach-robust": Recipe(task="reach-robust", frames=12_000_000, randomise=ROBUST),
    # Successes are rare, so more learning steps per frame help.
    "shelf": Recipe(task="shelf", frames=5_000_000, settings={"run.robots": 1024}),
}
