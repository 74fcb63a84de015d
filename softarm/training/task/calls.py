"""Calls of a task's methods, with checks of their results: the methods may come from another package."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.common.plugins import PluginError, said
from softarm.training.task.reach import Moment, ReachTask, ShelfTask, Starts

Array = NDArray[np.float32]


def targets(task: ReachTask, rng: np.random.Generator, count: int) -> Array:
    """Draw targets y, z, m, float [count, 2]. Raises PluginError, as each function here, for an invalid result."""
    drawn: Array = _called(task, "sample_targets", (count, 2), "float32", rng, count)
    return drawn


def depths(task: ShelfTask, rng: np.random.Generator, count: int) -> Array:
    """Draw depths of targets in a shelf, m, float [count]."""
    drawn: Array = _called(task, "sample_depths", (count,), "float32", rng, count)
    return drawn


def starts(task: ReachTask, rng: np.random.Generator, count: int, links: int) -> Starts:
    """Draw start states for `count` robots."""
    drawn = _call(task, "sample_starts", rng, count, links)
    if not isinstance(drawn, Starts):
        raise PluginError(f"task '{task.name}': sample_starts gave {_kind(drawn)}; allowed is Starts: correct it")
    for name, values in drawn._asdict().items():
        shape = (count, links) if name == "joint_angles_rad" else (count,)
        _check(task, f"{name} of sample_starts", values, shape, "float32")
    return drawn


def succeeded(task: ReachTask, tip_m: Array, target_m: Array) -> NDArray[np.bool_]:
    """Return whether tips [R, 2] have reached their targets [R, 2], bool [R]."""
    reached: NDArray[np.bool_] = _called(task, "succeeded", (len(tip_m),), "bool", tip_m, target_m)
    return reached


def reward(task: ReachTask, now: Moment) -> Array:
    """Return the reward of a step, float [R]."""
    given: Array = _called(task, "reward", now.success.shape, "float32", now)
    return given


def _call(task: ReachTask, method: str, *arguments: object) -> Any:
    try:
        return getattr(task, method)(*arguments)
    except Exception as error:
        raise PluginError(f"task '{task.name}': {method} raised {said(error)}: correct it") from error


def _called(task: ReachTask, method: str, shape: tuple[int, ...], kind: str, *arguments: object) -> Any:
    _check(task, method, values := _call(task, method, *arguments), shape, kind)
    return values


def _check(task: ReachTask, name: str, values: object, shape: tuple[int, ...], kind: str) -> None:
    """Raise PluginError for another type or shape of an array than these, NaN or infinity."""
    if not isinstance(values, np.ndarray) or values.shape != shape or values.dtype.kind != np.dtype(kind).kind:
        raise PluginError(f"task '{task.name}': {name} gave {_kind(values)}; allowed is {kind} {shape}: correct it")
    if not (finite := np.isfinite(values)).all():
        robot = int(np.argwhere(~finite)[0, 0])
        raise PluginError(
            f"task '{task.name}': {name} gave {values[robot]} for robot {robot}; allowed are finite numbers: correct it"
        )


def _kind(values: object) -> str:
    return f"{values.dtype} {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
