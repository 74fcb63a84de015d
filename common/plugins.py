"""What other packages bring along: found by their entry points, and asked what they are before they are used."""

import inspect
from collections.abc import Callable, Collection, Mapping
from importlib.metadata import entry_points

from softarm.common.words import nearest

Option = str | float | int | bool
Plugin = Callable[..., object]


class PluginError(Exception):
    """A plugin that cannot be used; the text names it, what is wrong and the next step."""


def installed(group: str) -> dict[str, Callable[[], Plugin]]:
    """Find the plugins of a group by name, not yet imported. An editable install may list one twice."""
    return {point.name: point.load for point in entry_points(group=group)}


def find(kind: str, name: str, plugins: Mapping[str, Callable[[], Plugin]], built_in: Collection[str] = ()) -> Plugin:
    """Import a plugin. Raises PluginError when there is none of that name, and whatever importing it raises."""
    if name not in plugins:
        known = sorted({*plugins, *built_in})
        near = nearest(name, known)
        hint = f"; did you mean '{near}'?" if near else ""
        raise PluginError(f"no {kind} '{name}'{hint} (installed: {', '.join(known) or 'none'})")
    return plugins[name]()


def check_options(kind: str, name: str, make: Plugin, options: Mapping[str, Option]) -> None:
    """Does a plugin take these options, all that it needs among them? Raises PluginError."""
    parameters = inspect.signature(make).parameters.values()
    known = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    for option in options:
        if option not in known and not takes_any:
            near = nearest(option, known)
            hint = f"; did you mean '{near}'?" if near else ""
            raise PluginError(f"{kind} '{name}' has no option '{option}'{hint} (known: {', '.join(known) or 'none'})")
    required = {p.name for p in parameters if p.name in known and p.default is p.empty}
    if missing := sorted(required - options.keys()):
        raise PluginError(
            f"{kind} '{name}' needs the option {', '.join(missing)}: give it under its `options` in the configuration"
        )


def check_interface(kind: str, name: str, plugin: object, ours: int) -> None:
    """Was a plugin written for an interface that is spoken here? One that does not say was written for the first.

    Raises PluginError for a newer one.
    """
    theirs = getattr(plugin, "interface", 1)
    if type(theirs) is not int or theirs < 1:
        raise PluginError(f"{kind} '{name}' says interface = {theirs!r}; allowed is an integer from 1 to {ours}")
    if theirs > ours:
        raise PluginError(
            f"{kind} '{name}' was written for interface {theirs}, this software speaks {ours}: update softarm, or "
            "install an older version of the plugin"
        )


def said(error: BaseException) -> str:
    """What an error says, in one line; a PluginError speaks for itself."""
    text = " ".join(str(error).split())
    return text if isinstance(error, PluginError) else f"{type(error).__name__}: {text}"
