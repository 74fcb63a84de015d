"""The configuration file: read it, and say all that is wrong with it at once, line by line."""

import difflib
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from pydantic import ValidationError

from softarm.daemon.config.keys import Key, KeyPath, children, find, leaves, text_of
from softarm.schemas.config import Config


class ConfigurationError(Exception):
    """All that is wrong with a file; `problems` holds one `FILE:LINE: key: what; allowed; next step` each."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


@dataclass(frozen=True, slots=True)
class Loaded:
    """A file's content and where each of its keys stands."""

    path: Path
    config: Config
    lines: dict[KeyPath, int]  # from 1; a key that is absent has its default

    def place(self, path: KeyPath) -> str:
        """Where a key stands: `FILE:LINE`, or the file alone."""
        return f"{self.path}:{self.lines[path]}" if path in self.lines else str(self.path)


def load(path: Path | str) -> Config:
    """Read the daemon's configuration. Raises ConfigurationError with every problem of the file."""
    return read(path).config


def read(path: Path | str) -> Loaded:
    """Read the configuration and where in the file it stands. Raises ConfigurationError as `load` does."""
    path = Path(path)
    reader = _Reader(path)
    data = reader.compose(_text(path))
    try:
        # By way of JSON, where strict means that a number is a number (not "0.1", not yes), a path a text.
        config = Config.model_validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        reader.explain(error)
    if reader.problems:
        raise ConfigurationError([f"{path}:{line}: {text}" for line, text in sorted(set(reader.problems))])
    return Loaded(path, config, reader.lines)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigurationError(
            [f"{path}: no such file; name an existing one, or start from a copy of the example softarm.yaml"]
        ) from None
    except UnicodeDecodeError as error:
        raise ConfigurationError([f"{path}: not UTF-8 text ({error.reason}); save it as UTF-8"]) from None
    except OSError as error:
        raise ConfigurationError([f"{path}: cannot be read ({error.strerror}); name a readable file"]) from None


class _Loader(yaml.SafeLoader):
    """YAML 1.1 as PyYAML reads it, plus the numbers it takes for texts (1e-3)."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


_PLAIN_TAGS = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")


class _Reader:
    """Turns a file into plain data and remembers lines and problems."""

    def __init__(self, path: Path) -> None:
        self.lines: dict[KeyPath, int] = {}
        self.problems: list[tuple[int, str]] = []
        self._path = path

    def compose(self, text: str) -> Any:
        """Parse. Raises ConfigurationError at once for what is no YAML: nothing else can be said of it."""
        try:
            loader = _Loader(text)
            node = loader.get_single_node()
            if node is None:
                return {}
            if not isinstance(node, yaml.MappingNode):
                names = ", ".join(key.name for key in children(Config))
                raise ConfigurationError([f"{self._path}:1: must hold keys; allowed: {names}"])
            return self._value(loader, node, (), ())
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            line = mark.line + 1 if mark else 1
            what = " ".join(part for part in (error.context, error.problem) if part)
            raise ConfigurationError(
                [f"{self._path}:{line}: not valid YAML: {what}; check indentation, colons and quotes there"]
            ) from None
        except yaml.YAMLError as error:
            what = str(error).partition("\n")[0]
            raise ConfigurationError([f"{self._path}: not valid YAML: {what}"]) from None

    def _value(self, loader: _Loader, node: yaml.Node, path: KeyPath, above: tuple[yaml.Node, ...]) -> Any:
        if node in above:
            self._problem(node, path, "refers to itself; write the values out")
            return None
        if not isinstance(node, yaml.ScalarNode) and node.tag not in _PLAIN_TAGS:
            self._problem(node, path, f"has the tag {node.tag}; remove it")
            return None
        if isinstance(node, yaml.MappingNode):
            return self._mapping(loader, node, path, (*above, node))
        if isinstance(node, yaml.SequenceNode):
            return [self._value(loader, item, path, (*above, node)) for item in node.value]
        try:
            value = loader.construct_object(node)
        except (yaml.YAMLError, ValueError, LookupError, AttributeError) as error:  # of tags that do not fit
            what = getattr(error, "problem", None) or error
            self._problem(node, path, f"cannot be read ({what}); write a plain value")
            return None
        return value if isinstance(value, str | int | float | bool | None) else str(node.value)

    def _mapping(
        self, loader: _Loader, node: yaml.MappingNode, path: KeyPath, above: tuple[yaml.Node, ...]
    ) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self._problem(key_node, path, "a key must be a plain name")
                continue
            name = str(key_node.value)
            child = (*path, name)
            if name in data:
                self._problem(key_node, child, f"stands twice (first in line {self.lines[child]}); keep one")
                continue
            self.lines[child] = key_node.start_mark.line + 1
            value = self._value(loader, value_node, child, above)
            key = find(Config, child)
            if value is None and key is not None and key.group is not None and not key.nullable:
                value = {}  # a group whose keys are all commented out: its defaults
            data[name] = value
        return data

    def _problem(self, node: yaml.Node, path: KeyPath, text: str) -> None:
        self.problems.append((node.start_mark.line + 1, f"{'.'.join(path) or 'the file'}: {text}"))

    def explain(self, error: ValidationError) -> None:
        """Put what pydantic found into words, at the line where it stands."""
        for item in error.errors(include_url=False):
            path = self._known(tuple(str(part) for part in item["loc"]))
            key = find(Config, path)
            if item["type"] == "extra_forbidden":
                text = self._unknown_key(tuple(str(part) for part in item["loc"]))
                path = tuple(str(part) for part in item["loc"])
            elif item["type"] == "value_error":
                text = str(item["ctx"]["error"])
                path = self._named_in(text) or path
            elif item["type"] == "missing":
                missing = tuple(str(part) for part in item["loc"])
                wanted = find(Config, missing)
                text = f"{missing[-1]} is missing; allowed {wanted.allowed if wanted else 'any'}; add it"
            else:
                text = _wrong_value(key, item["input"], str(item["msg"]))
            name = ".".join(path) or "the file"
            self.problems.append((self.lines.get(path, 1), f"{name}: {text.removeprefix(name).lstrip()}"))

    def _known(self, path: KeyPath) -> KeyPath:
        """The part of pydantic's location that stands in the file: it adds the branches of a union."""
        while path and path not in self.lines:
            path = path[:-1]
        return path

    def _named_in(self, text: str) -> KeyPath | None:
        """The first key of the file that a sentence names by its full path."""
        for word in re.findall(r"[a-z_0-9.]+\.[a-z_0-9]+", text):
            if (path := tuple(word.split("."))) in self.lines:
                return path
        return None

    def _unknown_key(self, path: KeyPath) -> str:
        parent = find(Config, path[:-1])
        group = parent.group if parent is not None else Config
        siblings = children(group, path[:-1]) if group is not None else []
        known = {key.path[-1]: key for key in siblings}
        same = [key for key in leaves(Config) if key.path[-1] == path[-1]]
        near = difflib.get_close_matches(path[-1], known, n=1, cutoff=0.5)
        if len(same) == 1:
            key = same[0]
            return f"unknown key here; move it to {key.name} (allowed {key.allowed}; default {key.default})"
        if near:
            key = known[near[0]]
            default = "" if key.group else f"; default {key.default}"
            return f"unknown key; did you mean {near[0]}? (allowed {key.allowed}{default})"
        return f"unknown key; remove it, or use one of {', '.join(known)}"


def _wrong_value(key: Key | None, value: object, message: str) -> str:
    if key is None:
        return f"{message}; write another value"
    text = f"is {_shown(value)}; allowed {key.allowed}"
    if hint := key.unit_hint(value) or _text_hint(key, value):
        return f"{text}; {hint}"
    if key.group is not None or key.field.is_required():
        return f"{text}; change it"
    return f"{text}; change it, or remove the line for the default {key.default}"


def _text_hint(key: Key, value: object) -> str:
    """For a text where a number belongs: quotes, or a unit written out."""
    match = re.fullmatch(r"\s*[-+]?[0-9.]+(?:[eE][-+]?\d+)?(.*)", value) if isinstance(value, str) else None
    if match is None:
        return ""
    if match[1].strip():
        unit = f" ({key.unit})" if key.unit else ""
        return f"write the bare number, the unit is in the key's name{unit}"
    return "write the number without quotes"


def _shown(value: object) -> str:
    if isinstance(value, dict | list):
        return "a group" if isinstance(value, dict) else "a list"
    return text_of(value)


class LimitRow(NamedTuple):
    """One line of `softarm check`."""

    key: str
    value: str
    unit: str
    bounds: str  # how it is derived, for a derived one
    source: str  # its line in the file, or `default`, or `derived`


def effective_limits(loaded: Loaded) -> list[LimitRow]:
    """List what the arm is held to, as it is in force: limits, ages, workspace; then what follows."""
    rows = []
    for key in leaves(Config):
        if key.path[0] in ("limits", "failsafe", "goals"):
            value: Any = loaded.config
            for name in key.path:
                value = getattr(value, name)
            line = loaded.lines.get(key.path)
            source = "default" if line is None else f"line {line}"
            rows.append(LimitRow(key.name, text_of(value), key.unit, key.bounds, source))
    return rows + list(_derived(loaded.config))


def _derived(config: Config) -> Iterator[LimitRow]:
    rail, pressure, period_s = config.limits.rail, config.limits.pressure, 1 / config.control.rate_hz
    speed = rail.velocity_max_m_s
    stopping_m = speed * (rail.latency_s + period_s) + speed**2 / (2 * rail.braking_m_s2)

    def row(key: str, value: float, unit: str, how: str) -> LimitRow:
        return LimitRow(key, f"{value:.4g}", unit, how, "derived")

    yield row("tick", period_s * 1e3, "ms", "1 / control.rate_hz")
    yield row("stopping distance at full speed", stopping_m, "m", "v (latency + tick) + v^2 / (2 braking)")
    yield row(
        "full speed towards +y up to",
        rail.position_max_m - rail.margin_m - stopping_m,
        "m",
        "position_max - margin - stopping distance",
    )
    yield row(
        "full speed towards -y down to",
        rail.position_min_m + rail.margin_m + stopping_m,
        "m",
        "position_min + margin + stopping distance",
    )
    yield row("pressure step per tick", pressure.slew_max_kpa_s * period_s, "kPa", "slew_max x tick")
    ticks = math.ceil((pressure.max_kpa - pressure.min_kpa) / (pressure.slew_max_kpa_s * period_s) - 1e-9)
    yield row("full pressure range in", ticks, "ticks", "(max - min) / step")
    share = 100 * config.failsafe.policy_budget_s / period_s
    yield row("policy's share of a tick", share, "%", "policy_budget / tick")
