"""Mutants that no test can or should kill, each with the reason, from explained.yaml."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from softarm.common import yaml_lines
from validation.mutants.operators import Mutant

FILE = Path(__file__).with_name("explained.yaml")
Key = tuple[str, str, str, int]


class Explanation(NamedTuple):
    """Reason why one mutant of a module may survive."""

    module: str
    function: str
    was: str
    now: str
    which: int
    why: str

    @property
    def key(self) -> Key:
        """Return the key that matches this explanation with its mutant."""
        return self.function, self.was, self.now, self.which


def read(path: Path = FILE) -> list[Explanation]:
    """Return all explanations of a file.

    Raises:
        yaml_lines.FileError: The file cannot be read.
        ValueError: An entry is incomplete.
    """
    modules = yaml_lines.read(path, "it lists the mutants that may live").data or {}
    return [each for module, entries in modules.items() for entry in entries for each in _explanations(module, entry)]


def _explanations(module: str, entry: dict[str, Any]) -> Iterator[Explanation]:
    if not {"in", "was", "now", "why"} <= entry.keys() <= {"in", "was", "now", "which", "why"} or not entry["why"]:
        raise ValueError(f"{module}: an entry says in, was, now, why (and which, where several read alike): {entry}")
    for now in entry["now"] if isinstance(entry["now"], list) else [entry["now"]]:
        yield Explanation(module, entry["in"], entry["was"], now, entry.get("which", 1), entry["why"])


def key(mutant: Mutant) -> Key:
    """Return the key that matches a mutant with its explanation."""
    return mutant.function, mutant.was, mutant.now, mutant.which


def stale(explanations: Iterable[Explanation], module: str, mutants: Iterable[Mutant]) -> list[Explanation]:
    """Return the explanations of a module whose code no longer exists."""
    there = set(map(key, mutants))
    return [each for each in explanations if each.module == module and each.key not in there]


def as_entry(mutant: Mutant) -> str:
    """Return a mutant in the format of the file, for a person to add the reason."""
    lines = [f"in: {mutant.function}", f"was: {_quoted(mutant.was)}", f"now: {_quoted(mutant.now)}"]
    lines += [f"which: {mutant.which}"] if mutant.which > 1 else []
    return "  - " + "\n    ".join([*lines, "why:"])


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
