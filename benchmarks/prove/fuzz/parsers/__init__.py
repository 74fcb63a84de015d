"""Every parser of what comes from outside, with valid examples of its own and what it may say to the rest."""

from collections.abc import Callable

from softarm.benchmarks.prove.fuzz.parsers import files, http, logs, policies, wires
from softarm.benchmarks.prove.fuzz.parsers.base import Parser

# By name; each is made when it is asked for, since some stand on large packages.
PARSERS: dict[str, Callable[[], Parser]] = {
    **wires.PARSERS,
    **http.PARSERS,
    **files.PARSERS,
    **logs.PARSERS,
    **policies.PARSERS,
}

__all__ = ["PARSERS", "Parser"]
