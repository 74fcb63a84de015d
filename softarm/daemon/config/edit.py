"""Editor of single values in a configuration file that keeps comments and order."""

import copy
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softarm.common import yaml_lines
from softarm.common.yaml_lines import Document, FileError
from softarm.common.yaml_schema import fit
from softarm.daemon.config.contradictions import contradictions
from softarm.schemas.config import Config

Value = float | bool


def with_values(text: str, path: Path, group: tuple[str, ...], values: Mapping[str, Value]) -> str:
    """Return the text of a configuration file with new values for keys of one group.

    Raises:
        FileError: The new file would have mistakes, or its layout cannot be kept; then the message names the lines to
            write by hand.
    """
    document, changed = yaml_lines.parse(text, path), text
    wanted = copy.deepcopy(document.data) or {}
    place: Any = wanted
    for name in group:
        place[name] = place.get(name) or {}
        place = place[name]
    place.update(values)
    try:
        for key, value in values.items():
            changed = _with_value(changed, path, (*group, key), value)
        edited = yaml_lines.parse(changed, path)
    except FileError:
        edited = document
    if edited.data != wanted:  # for example groups in braces, or an anchor used for another value
        keys = "; ".join(f"{'.'.join((*group, key))}: {_written(value)}" for key, value in values.items())
        text = f"{path}: the layout of the file cannot be kept, so it stays unchanged; write by hand {keys}"
        raise FileError([text])
    fit(edited, Config, rules=contradictions)
    return changed


def _with_value(text: str, path: Path, place: tuple[str, ...], value: Value) -> str:
    document, lines = yaml_lines.parse(text, path), text.splitlines(keepends=True)
    if place in document.lines:
        number = document.lines[place] - 1
        found = re.match(
            r"(\s*[\"']?" + re.escape(place[-1]) + r"[\"']?\s*:\s*)([^\s#&*{\[|>]+)(.*)", lines[number], re.S
        )
        if found is not None:
            lines[number] = f"{found[1]}{_written(value).ljust(len(found[2]))}{found[3]}"
        return "".join(lines)
    return _inserted(document, lines, place, value)


def _inserted(document: Document, lines: list[str], place: tuple[str, ...], value: Value) -> str:
    """Insert a value at the start of its innermost existing group, or at the end of the file."""
    depth = max(n for n in range(len(place)) if place[:n] in document.lines)
    inside = [at for at in document.lines if at[:depth] == place[:depth] and len(at) == depth + 1]
    if inside:
        begin = min(document.lines[at] for at in inside) - 1
        indent = re.match(r" *", lines[begin])
        first = indent[0] if indent else ""
    else:
        begin = document.lines[place[:depth]] if depth else len(lines)
        above = re.match(r" *", lines[begin - 1]) if depth else None
        first = (above[0] if above else "") + ("  " if depth else "")
    if depth == 0:
        begin = len(lines)
        if lines and not lines[-1].endswith("\n"):
            lines[-1] += "\n"
    new = [f"{first}{'  ' * n}{name}:\n" for n, name in enumerate(place[depth:-1])]
    new.append(f"{first}{'  ' * len(new)}{place[-1]}: {_written(value)}\n")
    return "".join(lines[:begin] + new + lines[begin:])


def _written(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.10g}"
