"""What is said of a parser, and what several of them need."""

import atexit
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[4]


class Parser(NamedTuple):
    """A parser under test: how a case is drawn, who takes it, and what may be raised at it."""

    draw: Callable[[Random], Any]
    take: Callable[[Any], object]
    errors: tuple[type[Exception], ...]


@cache
def folder() -> Path:
    """A folder for this process, for what is read from files; it goes when the process ends."""
    made = Path(tempfile.mkdtemp(prefix="softarm-fuzz-"))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def written(name: str, data: bytes) -> Path:
    """A file of this name with this content."""
    path = folder() / name
    path.write_bytes(data)
    return path
