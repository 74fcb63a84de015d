"""Search for plug-ins of other packages by their entry points, and checks before their use."""

import inspect
import os
import sys
from collections.abc import Callable, Collection, Mapping
from functools import lru_cache
from importlib.metadata import EntryPoints, entry_points

from softarm.common.words import nearest

Option = str | float | int | bool
Plugin = Callable[..., object]


class PluginError(Exception):
    """Error for an unusable plug-in; the text names the plug-in, the cause and the next step."""


def installed(group: str) -> dict[str, Callable[[], Plugin]]:
    """Return the loaders of a group's plug-ins by name; loading imports the plug-in."""
    places = filter(os.path.exists, map(os.path.abspath, sys.path))  # an empty entry is the current folder
    changed = tuple((place, os.stat(place).st_mtime_ns) for place in places)
    return {point.name: point.load for point in _points(group, changed)}


@lru_cache(maxsize=8)
def _points(group: str, changed: tuple[tuple[str, int], ...]) -> EntryPoints:
    """Return a group's entry points, searched again when a folder of the path has changed; that takes 10 ms."""
    return entry_points(group=group)


def find(kind: str, name: str, plugins: Mapping[str, Callable[[], Plugin]], built_in: Collection[str] = ()) -> Plugin:
    """Import a plug-in; errors of the import are passed on.

    Raises:
        PluginError: No plug-in has this name.
    """
    if name not in plugins:
        known = sorted({*plugins, *built_in})
        raise PluginError(f"no {kind} '{name}'{_hint(name, known)} (installed: {', '.join(known) or 'none'})")
    return plugins[name]()


def check_options(kind: str, name: str, make: Plugin, options: Mapping[str, Option]) -> None:
    """Check that a plug-in knows the given options and that no required one is missing.

    Raises:
        PluginError: An option is unknown or missing.
    """
    parameters = inspect.signature(make).parameters.values()
    known = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    for option in options:
        if option not in known and not takes_any:
            known_here = ", ".join(known) or "none"
            raise PluginError(f"{kind} '{name}' has no option '{option}'{_hint(option, known)} (known: {known_here})")
    required = {p.name for p in parameters if p.name in known and p.default is p.empty}
    if missing := sorted(required - options.keys()):
        raise PluginError(
            f"{kind} '{name}' needs the option {', '.join(missing)}: give it under its `options` in the configuration"
        )


def check_interface(kind: str, name: str, plugin: object, ours: int) -> None:
    """Check the interface version of a plug-in; one without a version has version 1.

    Raises:
        PluginError: The version is newer than `ours`, or invalid.
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
    """Return an error as one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, PluginError) else f"{type(error).__name__}: {text}"


def _hint(word: str, known: Collection[str]) -> str:
    near = nearest(word, known)
    return f"; did you mean '{near}'?" if near else ""
