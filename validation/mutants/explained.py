"""Mutants that no test can or should kill, each with the reason, from explained.yaml."""

from pathlib import Path
from typing import Any

from softarm.common import yaml_lines
from validation.mutants.operators import Key, Mutant

FILE = Path(__file__).with_name("explained.yaml")


def read() -> dict[str, dict[Key, str]]:
    """Return the reasons of the file: module -> key of the mutant -> reason. Raises FileError, KeyError, ValueError."""
    modules = yaml_lines.read(FILE, "it lists the mutants that may live").data or {}
    return {
        module: {key: entry["why"] for entry in entries for key in _keys(entry)} for module, entries in modules.items()
    }


def _keys(entry: dict[str, Any]) -> list[Key]:
    if not entry["why"]:
        raise ValueError(f"an entry says why the mutant may live: {entry}")
    instead = entry["now"] if isinstance(entry["now"], list) else [entry["now"]]
    return [(entry["in"], entry["was"], now, entry.get("which", 1)) for now in instead]


def as_entry(mutant: Mutant) -> str:
    """Return a mutant in the format of the file, for a person to add the reason."""
    was, now = (text.replace("'", "''") for text in (mutant.was, mutant.now))
    lines = [f"in: {mutant.function}", f"was: '{was}'", f"now: '{now}'"]
    lines += [f"which: {mutant.which}"] if mutant.which > 1 else []
    return "  - " + "\n    ".join([*lines, "why:"])
