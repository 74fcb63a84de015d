"""Checks of the configuration, the same as at the start of the daemon."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.common.finding import Finding, ok, problem, warning
from softarm.daemon.config.configuration import ConfigurationError, read
from softarm.daemon.runtime.preflight import CORRECT, NAME, tokens_and_plug_ins
from softarm.schemas.config import Config


@dataclass(frozen=True, slots=True)
class Settings:
    """A configuration and its problems."""

    path: Path | None  # None for the defaults
    config: Config  # the defaults if the file is not readable
    problems: tuple[Finding, ...] = ()


def look(path: Path | None, wires: bool = True) -> Settings:
    """Read a configuration, or the defaults without a path, and check the files and plug-ins it names."""
    config = Config()
    if path is not None:
        try:
            config = read(path).config
        except ConfigurationError as error:
            return Settings(path, config, tuple(problem(NAME, text, CORRECT) for text in error.problems))
    return Settings(path, config, tuple(tokens_and_plug_ins(config, wires)))


def judge(facts: Settings, simulated: bool = False) -> Iterator[Finding]:
    """Yield the findings on the configuration; a simulated robot needs no file."""
    yield from facts.problems
    if facts.path is None and simulated:
        yield ok(NAME, "the defaults")
    elif facts.path is None:
        advice = "name yours with --config; `softarm config new` writes one"
        yield warning(NAME, "no file was named, so the defaults are checked", advice)
    elif not facts.problems:
        yield ok(NAME, f"{facts.path} is valid")
