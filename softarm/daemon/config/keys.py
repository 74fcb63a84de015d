"""Reference of the configuration keys: unit, allowed values, default and meaning."""

from collections.abc import Iterator
from typing import NamedTuple

from softarm.common import yaml_lines
from softarm.common.keys import leaves
from softarm.common.quantity import shown
from softarm.common.revision import PACKAGE
from softarm.schemas.config import Config

EXAMPLE = PACKAGE / "softarm.yaml"  # every key at its default, with its meaning
TWIN = PACKAGE / "twin.yaml"  # twin and daemon on one computer


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
        allowed = key.allowed + (" or null" if key.nullable and "null" not in key.allowed else "")
        default = "none" if key.default == shown({}) else key.default
        yield KeyRow(key.name, key.unit, allowed, default, line.partition(" # ")[2].strip())


def for_a_simulated_robot() -> str:
    """Return a configuration file for `softarm run --simulated`: as for a real robot, without its drivers."""
    lines = EXAMPLE.read_text(encoding="utf-8").splitlines(keepends=True)
    begin = lines.index("drivers:\n")
    end = next(n for n in range(begin + 1, len(lines)) if lines[n][0] not in " #\n")
    return "".join(lines[:begin] + lines[end:])
