"""What has to be in order before the daemon starts: asked by `softarm run`, before anything is opened, and `check`."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from softarm.common.plugins import PluginError
from softarm.common.yaml_lines import Place
from softarm.daemon.api import sockets
from softarm.daemon.api.auth import AuthError, load_tokens
from softarm.daemon.config import configuration
from softarm.daemon.config.configuration import ConfigurationError, Loaded
from softarm.daemon.logbook import folder
from softarm.daemon.stop import latch
from softarm.drivers.mocap import plugged
from softarm.policies import registry, trial
from softarm.policies.base import PolicyError
from softarm.schemas.config import Config


class Problem(NamedTuple):
    """Something that keeps the daemon from starting, and the key of the configuration that it is about."""

    place: Place
    text: str  # what is wrong, what is allowed, the next step


class Preflight(NamedTuple):
    """What a configuration says, as far as it can be told, and all that keeps the daemon from starting."""

    loaded: Loaded | None
    problems: tuple[str, ...]

    @property
    def config(self) -> Config:
        """Of a preflight without problems."""
        assert self.loaded is not None
        return self.loaded.config


def look(path: Path | None, wires: bool, thorough: bool = False) -> Preflight:
    """Read a configuration (None: the defaults) and try what it asks of this machine; nothing stays behind.

    wires: the robot's, else it is simulated in this process. thorough: the policy does its first step, and those that
    are only at hand are looked at, too; else that is left to who loads it.
    """
    loaded, wrong, left_out = _read(path)
    for problem in () if loaded is None else _problems(loaded.config, wires, thorough):
        if loaded is not None and not any(_same(problem.place, other) for other in left_out):
            wrong.append(problem.text if path is None else f"{loaded.place(problem.place)}: {problem.text}")
    return Preflight(loaded, tuple(wrong))


def _read(path: Path | None) -> tuple[Loaded | None, list[str], tuple[Place, ...]]:
    """What a file says but for its mistakes, those, and where they stand."""
    if path is None:
        return Loaded(Path(), Config(), {}), [], ()
    try:
        return configuration.read(path), [], ()
    except ConfigurationError as error:
        return error.remains, list(error.problems), error.left_out


def _same(place: Place, other: Place) -> bool:
    """Is one of them the other, or around it?"""
    return all(one == another for one, another in zip(place, other, strict=False))


def _problems(config: Config, wires: bool, thorough: bool) -> Iterator[Problem]:
    yield from _policies(config, thorough)
    try:
        load_tokens(config.api)
    except AuthError as error:
        yield Problem(("api", error.key), str(error))
    for key, port in (("port", config.api.port), ("stop_port", config.api.stops_at)):
        try:
            sockets.try_out(config.api.host, port, f"api.{key}")
        except sockets.ApiError as error:
            yield Problem(("api", key), str(error))
    yield from _places(config, wires)
    mocap = config.drivers.mocap
    if wires and mocap.driver != plugged.BUILT_IN:
        try:
            plugged.load(mocap.driver, mocap.options)
        except PluginError as error:
            yield Problem(("drivers", "mocap", "driver"), str(error))


def _places(config: Config, wires: bool) -> Iterator[Problem]:
    """Where the log and the emergency stop's latch are kept."""
    key, directory = ("recorder", "directory"), config.recorder.directory
    if config.recorder.enabled:
        try:
            folder.try_out(directory)
        except OSError as error:
            yield Problem(key, folder.advice(directory, error))
            wires = wires and latch.latch_path(config).parent != directory  # said already
    if wires:
        try:
            latch.try_out(latch.latch_path(config))
        except latch.LatchError as error:
            yield Problem(key, str(error))


def _policies(config: Config, thorough: bool) -> Iterator[Problem]:
    name = config.control.policy
    entries = registry.available(config.policies)
    for other in config.policies if thorough else ():
        if error := entries[other].error:
            yield Problem(("policies", other), f"policies.{other}: {error}")
    entry = entries.get(name)
    try:
        if entry is None or entry.error is not None:
            registry.load(name, config.policies)  # says what is wrong
        elif thorough:
            trial.try_out(name, config.policies, trial.TRIAL_S)
    except PolicyError as error:
        yield Problem(("control", "policy"), f"control.policy: {error}")
