"""Tasks of other packages, by the entry-point group `softarm.tasks`.

A task is a frozen dataclass derived from `softarm.training.task.reach.ReachTask` or
`softarm.training.task.reach.ShelfTask`, or an object of one. It may change `reward`, `sample_targets`, `sample_starts`
and the fields (ranges, radius, rewards, episode length). Fields are numbers, texts and tuples of numbers, because a
policy's file records them.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from pydantic import TypeAdapter

from softarm.common import plugins
from softarm.common.plugins import PluginError
from softarm.training.task.reach import ReachTask, ShelfTask

GROUP = "softarm.tasks"
INTERFACE = 1
_KIND = "task"


def names() -> tuple[str, ...]:
    """Return the tasks of installed plug-ins by name."""
    return tuple(sorted(plugins.installed(GROUP)))


def load(name: str) -> ReachTask:
    """Create the task of a plug-in, with the entry point's name. Raises PluginError with the problem and the remedy."""
    try:
        published = plugins.find(_KIND, name, plugins.installed(GROUP))
        plugins.check_interface(_KIND, name, published, INTERFACE)
        task = published() if isinstance(published, type) else published
        if not isinstance(task, ReachTask) or not is_dataclass(task):
            raise PluginError(
                f"it is a {type(task).__name__}, not derived from ReachTask; see docs/policies/plugins.md"
            )
        TypeAdapter(type(task)).rebuild()  # raises for a field whose type cannot be checked
        for field in fields(task):
            _check_recordable(field.name, getattr(task, field.name))
        return replace(task, name=name)
    except (Exception, SystemExit) as error:  # a module may even call sys.exit() while it is imported
        raise PluginError(f"task '{name}': {plugins.said(error)}") from error


def plugin_of(task: ReachTask) -> str | None:
    """Return the plug-in name of a task's class, or None for a built-in task."""
    return None if type(task) in (ReachTask, ShelfTask) else task.name


def rebuilt(kind: str, given: Mapping[str, Any]) -> ReachTask:
    """Create a task from its kind and its recorded fields, which include `plugin` for a plug-in.

    Raises PluginError if its package is not installed, TypeError for an unknown field.
    """
    own = dict(given)
    plugin = own.pop("plugin", None)
    task = load(plugin) if plugin else ShelfTask() if kind == "shelf" else ReachTask()
    return replace(task, **own)


def _check_recordable(name: str, value: object) -> None:
    """Check a task's fields. Raises PluginError if a policy's file cannot record one."""
    numbers = value if isinstance(value, tuple) else ()
    if not isinstance(value, bool | int | float | str | tuple) or not all(type(n) in (int, float) for n in numbers):
        raise PluginError(
            f"its field {name} is {value!r}; allowed are numbers, texts and tuples of numbers: a file records them"
        )
