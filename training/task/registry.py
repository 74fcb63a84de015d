"""Tasks of other packages, by the entry-point group `softarm.tasks`.

A task is a frozen dataclass that derives from `softarm.training.task.reach.ReachTask` or
`softarm.training.task.shelf.ShelfTask`, or an object of one. What it may change: the fields (ranges, radius, rewards,
episode length; numbers, texts and tuples of numbers, for a policy's file records them), `reward`, `sample_targets` and
`sample_starts`.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from softarm.common import plugins
from softarm.common.plugins import PluginError
from softarm.training.task.reach import ReachTask
from softarm.training.task.shelf import ShelfTask

GROUP = "softarm.tasks"
INTERFACE = 1
_KIND = "task"


def names() -> tuple[str, ...]:
    """Of the tasks that other packages bring along."""
    return tuple(sorted(plugins.installed(GROUP)))


def load(name: str) -> ReachTask:
    """Make a task of another package; its `name` is the one that it is published under.

    Raises PluginError that names it, what is wrong and the next step.
    """
    try:
        published = plugins.find(_KIND, name, plugins.installed(GROUP))
        plugins.check_interface(_KIND, name, published, INTERFACE)
        task = published() if isinstance(published, type) else published
        if not isinstance(task, ReachTask) or not is_dataclass(task):
            raise PluginError(f"it is a {type(task).__name__}, not derived from ReachTask; see docs/plugins.md")
        for field in fields(task):
            _check_recordable(field.name, getattr(task, field.name))
        return replace(task, name=name)
    except (Exception, SystemExit) as error:  # a module may even call sys.exit() while it is imported
        raise PluginError(f"task '{name}': {plugins.said(error)}") from error


def plugin_of(task: ReachTask) -> str | None:
    """Under which name another package publishes a task's class; None for the house's own."""
    return None if type(task) in (ReachTask, ShelfTask) else task.name


def rebuilt(kind: str, given: Mapping[str, Any]) -> ReachTask:
    """A task from its kind and its fields as a file records them, `plugin` among them where it has one.

    Raises PluginError when its package is not installed, TypeError for a field that there is not.
    """
    own = dict(given)
    plugin = own.pop("plugin", None)
    task = load(plugin) if plugin else ShelfTask() if kind == "shelf" else ReachTask()
    return replace(task, **own)


def _check_recordable(name: str, value: object) -> None:
    """Raises PluginError for a field that a policy's file cannot record."""
    numbers = value if isinstance(value, tuple) else ()
    if not isinstance(value, bool | int | float | str | tuple) or not all(type(n) in (int, float) for n in numbers):
        raise PluginError(
            f"its field {name} is {value!r}; allowed are numbers, texts and tuples of numbers: a file records them"
        )
