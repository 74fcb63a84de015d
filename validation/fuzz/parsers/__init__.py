"""Every parser of external input, with valid examples and the errors that it may raise."""

from validation.fuzz.parsers import files, logs, policies, rest, wires  # noqa: F401  each registers its parsers
from validation.fuzz.parsers.base import PARSERS, Parser

__all__ = ["PARSERS", "Parser"]
