"""Suggestions for misspelled words."""

import difflib
from collections.abc import Iterable


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """Return the nearest known word, or None if every similarity (0 to 1) is below the cutoff."""
    return next(iter(difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)), None)


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return `did you mean reach? ` for the nearest known word, or an empty text."""
    near = nearest(word, known, cutoff)
    return f"did you mean {near}? " if near else ""
