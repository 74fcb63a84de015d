"""Suggestions for misspelled words, and numbers for repeated ones."""

import difflib
from collections import Counter
from collections.abc import Hashable, Iterable
from itertools import repeat


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """Return the nearest known word, or None if every similarity (0 to 1) is below the cutoff."""
    return next(iter(difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)), None)


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return `did you mean reach? ` for the nearest known word, or an empty text."""
    near = nearest(word, known, cutoff)
    return f"did you mean {near}? " if near else ""


def numbered(names: Iterable[str], groups: Iterable[Hashable] = repeat(None)) -> list[str]:
    """Return names with a number after each one that its group repeats, such as `seed`, `seed (2)`."""
    seen, found = Counter[tuple[Hashable, str]](), []
    for group, name in zip(groups, names, strict=False):
        seen[group, name] += 1
        found.append(name if seen[group, name] == 1 else f"{name} ({seen[group, name]})")
    return found
