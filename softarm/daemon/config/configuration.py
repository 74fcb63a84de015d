"""Reader of the configuration file, which reports all mistakes at once with their lines, and reference of its keys."""

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from softarm.common import yaml_lines
from softarm.common.keys import Key, leaves
from softarm.common.quantity import shown
from softarm.common.revision import PACKAGE
from softarm.common.yaml_lines import FileError, Place
from softarm.common.yaml_schema import fit
from softarm.daemon.access.auth import TOKEN_FILES
from softarm.daemon.config.contradictions import contradictions
from softarm.schemas.config import Config


@dataclass(frozen=True, slots=True)
class Loaded:
    """Content of a configuration file and the line of each key."""

    path: Path
    config: Config
    lines: dict[Place, int]  # from 1; keys with default values are missing

    def place(self, path: Place) -> str:
        """Return the location of a key: `FILE:LINE`, or the file alone."""
        return f"{self.path}:{self.lines[path]}" if path in self.lines else str(self.path)

    def source(self, path: Place, otherwise: str) -> str:
        """Return `line LINE` for a key of the file, and another text for a key with its default value."""
        return f"line {self.lines[path]}" if path in self.lines else otherwise


class ConfigurationError(FileError):
    """All mistakes of a configuration; `remains` is the configuration without them, if possible."""

    remains: Loaded | None = None


def load(path: Path | str) -> Config:
    """Read the daemon's configuration, or raise ConfigurationError with all mistakes of the file."""
    return read(path).config


def read(path: Path | str) -> Loaded:
    """Read the daemon's configuration with the line of each key, or raise ConfigurationError with all mistakes."""
    document: yaml_lines.Document | None = None
    try:
        document = yaml_lines.read(path, "name an existing file, or write one with `softarm config new`")
        return Loaded(document.path, fit(document, Config, rules=contradictions), document.lines)
    except FileError as error:
        refused = ConfigurationError(error.problems, error.rest, error.left_out)
        if document is not None and isinstance(error.rest, Config):
            refused.remains = Loaded(document.path, error.rest, document.lines)
        raise refused from None


def differences(one: Config, other: Config) -> Iterator[tuple[Key, Any, Any]]:
    """Yield each key whose values differ, with both values."""
    for key in leaves(Config):
        values = [attrgetter(key.name)(config) for config in (one, other)]
        if values[0] != values[1]:
            yield key, values[0], values[1]


def changed(loaded: Loaded) -> list[tuple[str, str, str, str, str]]:
    """Return key, value, unit, default and line of each value of the file that differs from its default."""
    return [
        (key.name, _text(value), key.unit, _text(usual), loaded.source(key.path, ""))
        for key, value, usual in differences(loaded.config, Config())
    ]


def _text(value: object) -> str:
    return (", ".join(value) or "none") if isinstance(value, dict) else shown(value)


class LimitRow(NamedTuple):
    """One line of `softarm check --all`."""

    key: str
    value: str
    unit: str
    bounds: str  # for a derived value: its formula
    source: str  # line in the file, `default` or `derived`


def effective_limits(loaded: Loaded) -> list[LimitRow]:
    """Return the limits, ages and workspace in force, followed by the values derived from them."""
    rows = []
    for key in leaves(Config):
        if key.path[0] in ("limits", "failsafe", "goals"):
            value, source = attrgetter(key.name)(loaded.config), loaded.source(key.path, "default")
            rows.append(LimitRow(key.name, shown(value), key.unit, key.bounds, source))
    return rows + list(_derived(loaded.config))


def _derived(config: Config) -> Iterator[LimitRow]:
    rail, pressure, period_s = config.limits.rail, config.limits.pressure, 1 / config.control.rate_hz
    speed, hold_s = rail.velocity_max_m_s + rail.drag_m_s, config.drivers.rail.hold_s
    stopping_m = speed * (rail.latency_s + hold_s) + speed**2 / (2 * rail.braking_m_s2)
    step_kpa = pressure.slew_max_kpa_s * period_s
    ticks = math.ceil((pressure.max_kpa - pressure.min_kpa) / step_kpa - 1e-9)
    roles = [role.name.lower() for role, key in TOKEN_FILES.items() if getattr(config.api, key) is not None]
    clients = f"clients with a token: {', '.join(roles)}" if roles else "programs on this computer"
    latch_folder = "in the service's state directory, else recorder.directory; named after the axis"
    highest_m = rail.position_max_m - rail.margin_m - stopping_m
    lowest_m = rail.position_min_m + rail.margin_m + stopping_m
    stop_address = f"{config.api.host}:{config.api.stops_at}"
    rows: tuple[tuple[str, float | str, str, str], ...] = (
        ("tick", period_s * 1e3, "ms", "1 / control.rate_hz"),
        ("stopping distance at full speed", stopping_m, "m", "u (latency + hold) + u^2 / (2 braking), u = v + drag"),
        ("full speed towards +y up to", highest_m, "m", "position_max - margin - stopping distance"),
        ("full speed towards -y down to", lowest_m, "m", "position_min + margin + stopping distance"),
        ("pressure step per tick", step_kpa, "kPa", "slew_max x tick"),
        ("full pressure range in", ticks, "ticks", "(max - min) / step"),
        ("stop port", stop_address, "", "api.stop_port, or the one after api.port"),
        ("clients of the API", clients, "", "api.token_file, view_token_file, stop_token_file"),
        ("latch of the emergency stop", str(latch_path(config)), "", latch_folder),
        ("policy's share of a tick", 100 * config.failsafe.policy_budget_s / period_s, "%", "policy_budget / tick"),
    )
    for key, value, unit, how in rows:
        yield LimitRow(key, value if isinstance(value, str) else f"{value:.4g}", unit, how, "derived")


def latch_path(config: Config, environment: Mapping[str, str] = os.environ) -> Path:
    """Return the file of the emergency stop's latch: in the service's state directory, otherwise next to the logs.

    The axis names the file: a robot has one axis, whichever configuration and port its daemon uses.
    """
    directory = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    rail = config.drivers.rail
    name = re.sub(r"[^A-Za-z0-9.-]", "_", f"stop-{rail.host}-{rail.port}")
    return (Path(directory) if directory else config.recorder.directory) / f"{name}.json"


EXAMPLE = PACKAGE / "softarm.yaml"  # every key at its default, with its meaning
TWIN = PACKAGE / "twin.yaml"  # twin and daemon on one computer


class KeyRow(NamedTuple):
    """One configuration key and its allowed values."""

    key: str
    unit: str  # empty if it has none
    allowed: str
    default: str
    meaning: str


def key_rows() -> Iterator[KeyRow]:
    """Yield all keys that hold a value, in the schema's order, with the meanings from the packaged softarm.yaml."""
    text = EXAMPLE.read_text(encoding="utf-8")
    lines, places = text.splitlines(), yaml_lines.parse(text, EXAMPLE).lines
    for key in leaves(Config):
        line = lines[places[key.path] - 1]
        allowed = key.allowed + (" or null" if key.nullable and "null" not in key.allowed else "")
        default = "none" if key.default == shown({}) else key.default
        yield KeyRow(key.name, key.unit, allowed, default, line.partition(" # ")[2].strip())


def for_a_simulated_robot() -> str:
    """Return a configuration file for `softarm run --simulated`: as for a real robot, without its drivers."""
    lines = EXAMPLE.read_text(encoding="utf-8").splitlines(keepends=True)
    begin = lines.index("drivers:\n")
    end = next(n for n in range(begin + 1, len(lines)) if lines[n][0] not in " #\n")
    return "".join(lines[:begin] + lines[end:])
