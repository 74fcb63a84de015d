"""Every parser of external input, with valid examples and the errors that it may raise."""

from collections.abc import Callable

from validation.fuzz.parsers import files, logs, policies, rest, wires
from validation.fuzz.parsers.base import Parser

# Name -> factory, since some parsers import large packages.
PARSERS: dict[str, Callable[[], Parser]] = {
    **wires.PARSERS,
    **rest.PARSERS,
    **files.PARSERS,
    **logs.PARSERS,
    **policies.PARSERS,
}

__all__ = ["PARSERS", "Parser"]
