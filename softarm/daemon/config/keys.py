"""Reference of the configuration keys: unit, allowed values, default and meaning."""

from collections.abc import Iterator
from typing import NamedTuple

from softarm.common import yaml_lines
from softarm.common.keys import Key, leaves
from softarm.common.quantity import shown
from softarm.common.revision import PACKAGE
from softarm.schemas.config import Config

EXAMPLE = PACKAGE / "softarm.yaml"  # every key at its default, with its meaning
TWIN = PACKAGE / "twin.yaml"


class KeyRow(NamedTuple):
    """One configuration key and its allowed values."""

    key: str
    unit: str  # empty if it has none
    allowed: str
    default: str
    meaning: str


def rows() -> Iterator[KeyRow]:
    """Yield all keys that hold a value, in the schema's order, with the meanings from the packaged softarm.yaml."""
    text = EXAMPLE.read_text(encoding="utf-8")
    lines, places = text.splitlines(), yaml_lines.parse(text, EXAMPLE).lines
    for key in leaves(Config):
        line = lines[places[key.path] - 1]
        yield KeyRow(key.name, key.unit, _allowed(key), _default(key), line.partition(" # ")[2].strip())


def _allowed(key: Key) -> str:
    """Return the allowed values."""
    return key.allowed + (" or null" if key.nullable and "null" not in key.allowed else "")


def _default(key: Key) -> str:
    value = key.field.get_default(call_default_factory=True)
    return "none" if value == {} else shown(value)


def for_a_robot() -> str:
    """Return a configuration file for a real robot: every key at its default, with comments."""
    return EXAMPLE.read_text(encoding="utf-8")


def for_the_twin() -> str:
    """Return a configuration file for twin and daemon on one computer."""
    return TWIN.read_text(encoding="utf-8")


def for_a_simulated_robot() -> str:
    """Return a configuration file for `softarm run --simulated`: as for a real robot, without its drivers."""
    lines = for_a_robot().splitlines(keepends=True)
    begin = lines.index("drivers:\n")
    end = next(n for n in range(begin + 1, len(lines)) if lines[n][0] not in " #\n")
    return "".join(lines[:begin] + lines[end:])
