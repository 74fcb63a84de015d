"""Every key of the configuration for people: unit, what it takes, its default, what it is for."""

from collections.abc import Iterator
from typing import NamedTuple

from softarm.common import yaml_lines
from softarm.common.keys import Key, leaves
from softarm.common.quantity import shown
from softarm.common.revision import ROOT
from softarm.schemas.config import Config

EXAMPLE = ROOT / "softarm.yaml"  # every key at its default, with a word on each
TWIN = ROOT / "twin.yaml"


class KeyRow(NamedTuple):
    """One key: where it stands, and what may stand there."""

    key: str
    unit: str  # empty: none
    allowed: str
    default: str
    meaning: str


def rows() -> Iterator[KeyRow]:
    """All keys that hold a value, in the schema's order; the words are those of the packaged softarm.yaml."""
    text = EXAMPLE.read_text(encoding="utf-8")
    lines, places = text.splitlines(), yaml_lines.parse(text, EXAMPLE).lines
    for key in leaves(Config):
        line = lines[places[key.path] - 1]
        yield KeyRow(key.name, key.unit, _allowed(key), _default(key), line.partition(" # ")[2].strip())


def _allowed(key: Key) -> str:
    """Without the default's own words, which stand in a column of theirs."""
    return key.allowed + (" or null" if key.nullable and "null" not in key.allowed else "")


def _default(key: Key) -> str:
    value = key.field.get_default(call_default_factory=True)
    return "none" if value == {} else shown(value)


def for_a_robot() -> str:
    """A new file for a robot on its wires: every key at its default, commented."""
    return EXAMPLE.read_text(encoding="utf-8")


def for_the_twin() -> str:
    """A new file for twin and daemon on one machine."""
    return TWIN.read_text(encoding="utf-8")


def for_a_simulated_robot() -> str:
    """A new file for `softarm run --simulated`: as for a robot, without the wires that it lacks."""
    lines = for_a_robot().splitlines(keepends=True)
    begin = lines.index("drivers:\n")
    end = next(n for n in range(begin + 1, len(lines)) if lines[n][0] not in " #\n")
    return "".join(lines[:begin] + lines[end:])
