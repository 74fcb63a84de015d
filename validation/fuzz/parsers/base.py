"""Description of a parser under test, and helpers that several of them use."""

import atexit
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple


class Parser(NamedTuple):
    """Parser under test: how to draw a case, the call to test, and the errors that it may raise."""

    draw: Callable[[Random], Any]
    take: Callable[[Any], object]
    errors: tuple[type[Exception], ...]


PARSERS: dict[str, Callable[[], Parser]] = {}  # by name; factories, since some parsers import large packages


def parser(name: str) -> Callable[[Callable[[], Parser]], Callable[[], Parser]]:
    """Register the factory of a parser under a name."""

    def register(make: Callable[[], Parser]) -> Callable[[], Parser]:
        PARSERS[name] = make
        return make

    return register


@cache
def folder() -> Path:
    """Return the temporary folder of this process, which is removed at its end."""
    made = Path(tempfile.mkdtemp(prefix="softarm-fuzz-"))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def written(name: str, data: bytes) -> Path:
    """Write a file into the temporary folder and return its path."""
    path = folder() / name
    path.write_bytes(data)
    return path
