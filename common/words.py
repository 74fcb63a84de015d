"""Help for who mistyped a word."""

import difflib
from collections.abc import Iterable


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The known word that is nearest; None when all are far: their likeness (0 to 1) lies below the cutoff."""
    return next(iter(difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)), None)


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """`did you mean reach? `, to be put before what is allowed; empty where no known word is near."""
    near = nearest(word, known, cutoff)
    return f"did you mean {near}? " if near else ""
