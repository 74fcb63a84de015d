"""Is the configuration readable and sound, as `softarm check` asks."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.common.plugins import PluginError
from softarm.daemon.api.auth import AuthError, load_tokens
from softarm.daemon.config.configuration import ConfigurationError, read
from softarm.daemon.doctor.finding import Finding, ok, problem, warning
from softarm.drivers.mocap import plugged
from softarm.schemas.config import Config

MEND = "correct it; `softarm config units` tells what each key takes"


@dataclass(frozen=True, slots=True)
class Settings:
    """A configuration, and what is wrong with it."""

    path: Path | None  # None: the defaults
    config: Config  # the defaults where it cannot be read
    problems: tuple[str, ...] = ()


def look(path: Path | None) -> Settings:
    """Read a file; without one, the defaults."""
    config, problems = Config(), []
    if path is not None:
        try:
            config = read(path).config
        except ConfigurationError as error:
            return Settings(path, config, tuple(error.problems))
    try:
        load_tokens(config.api)
    except AuthError as error:
        problems.append(f"api.{error.key}: {error}")
    mocap = config.drivers.mocap
    if mocap.driver != plugged.BUILT_IN:
        try:
            plugged.load(mocap.driver, mocap.options)
        except PluginError as error:
            problems.append(f"drivers.mocap.driver: {error}")
    return Settings(path, config, tuple(problems))


def judge(facts: Settings) -> Iterator[Finding]:
    """Findings on the file."""
    for text in facts.problems:
        yield problem("configuration", text, MEND)
    if facts.path is None:
        advice = "name yours with --config; `softarm config new` writes one"
        yield warning("configuration", "none was named: what follows is about the defaults", advice)
    elif not facts.problems:
        yield ok("configuration", f"{facts.path} is sound")
