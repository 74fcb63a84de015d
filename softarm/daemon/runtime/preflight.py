"""Checks before the daemon starts, for `softarm run` and `softarm check`."""

import importlib.util
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from pydantic import ValidationError

from softarm.common.address import is_loopback
from softarm.common.finding import Finding, problem
from softarm.common.plugins import PluginError
from softarm.common.yaml_lines import Place
from softarm.daemon.access import sockets
from softarm.daemon.access.auth import AuthError, load_tokens
from softarm.daemon.config import configuration
from softarm.daemon.config.configuration import ConfigurationError, Loaded, latch_path
from softarm.daemon.logbook import folder
from softarm.daemon.stop import latch
from softarm.drivers.mocap import plugged
from softarm.policies import registry, trial
from softarm.policies.base import PolicyError
from softarm.schemas.config import Api, Config

NAME, CORRECT = "configuration", "correct it; `softarm config units` lists what each key allows"


class Preflight(NamedTuple):
    """Result of the checks: the readable part of the configuration and all problems."""

    loaded: Loaded | None
    findings: tuple[Finding, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """Return the text of each problem."""
        return tuple(each.figure for each in self.findings)

    @property
    def config(self) -> Config:
        """Return the configuration of a preflight without problems."""
        assert self.loaded is not None
        return self.loaded.config


def look(path: Path | None, wires: bool, thorough: bool = False, port: int | None = None) -> Preflight:
    """Read a configuration (None: the defaults) and check that this computer can run it, leaving nothing behind.

    `wires` is false for a robot simulated in this process. `thorough` also runs the policy's first step and checks the
    policies that are not selected. `port` replaces the file's `api.port`.
    """
    loaded, found, left_out = read(path)
    if loaded is not None and port is not None:
        try:
            loaded = _with_port(loaded, port)
        except ValidationError as error:
            text = error.errors()[0]["msg"].removeprefix("Value error, ")
            return Preflight(loaded, (problem(NAME, f"--port {port}: {text}", CORRECT), *found))
    for each in () if loaded is None else _problems(loaded.config, wires, thorough):
        if loaded is not None and not any(_same(each.place, other) for other in left_out):
            text = each.figure if path is None else f"{loaded.place(each.place)}: {each.figure}"
            found.append(each._replace(figure=text))
    return Preflight(loaded, tuple(found))


def read(path: Path | None) -> tuple[Loaded | None, list[Finding], tuple[Place, ...]]:
    """Return the readable part of a file, its mistakes and the keys concerned."""
    if path is None:
        return Loaded(Path(), Config(), {}), [], ()
    try:
        return configuration.read(path), [], ()
    except ConfigurationError as error:
        return error.remains, [problem(NAME, text, CORRECT) for text in error.problems], error.left_out


def _with_port(loaded: Loaded, port: int) -> Loaded:
    """Return a configuration with another port of the API. Raises ValidationError if the stop port collides."""
    api = Api.model_validate(dict(loaded.config.api) | {"port": port})
    lines = {place: line for place, line in loaded.lines.items() if place != ("api", "port")}
    return replace(loaded, config=loaded.config.model_copy(update={"api": api}), lines=lines)


def _same(place: Place, other: Place) -> bool:
    """Return whether two keys are the same or one contains the other."""
    return all(one == another for one, another in zip(place, other, strict=False))


def _problems(config: Config, wires: bool, thorough: bool) -> Iterator[Finding]:
    yield from _policies(config, thorough)
    yield from tokens_and_plug_ins(config, wires)
    for key, port in (("port", config.api.port), ("stop_port", config.api.stops_at)):
        try:
            sockets.try_out(config.api.host, port, f"api.{key}")
        except sockets.ApiError as error:
            yield problem("port", str(error), place=("api", key))
    yield from places(config, wires)


def tokens_and_plug_ins(config: Config, wires: bool) -> Iterator[Finding]:
    """Check the files and plug-ins that a configuration names."""
    try:
        load_tokens(config.api)
    except AuthError as error:
        yield problem(NAME, str(error), CORRECT, ("api", error.key))
    mocap = config.drivers.mocap
    if wires and mocap.driver != plugged.BUILT_IN:
        try:
            plugged.load(mocap.driver, mocap.options)
        except PluginError as error:
            yield problem(NAME, str(error), CORRECT, ("drivers", "mocap", "driver"))
    yield from _ros(config, wires)


def _ros(config: Config, wires: bool) -> Iterator[Finding]:
    """Check the package for ROS 2 messages and the router's address, on which the daemon may listen itself."""
    ros, mocap, key = config.ros, config.drivers.mocap, ("ros", "router")
    if ros.router is None:
        return
    if importlib.util.find_spec("rosbags") is None:
        text = (
            f"ros.router is {ros.router}, and rosbags is not installed; pip install 'softarm[ros]', or set it to null"
        )
        yield problem(NAME, text, CORRECT, key)
    host, port = ros.address
    if wires and mocap.driver == plugged.BUILT_IN and is_loopback(host) and mocap.endpoint.endswith(f":{port}"):
        text = (
            f"ros.router is {ros.router}, and the daemon listens at drivers.mocap.endpoint {mocap.endpoint}; "
            "give motion capture another port, here and in bridge.yaml"
        )
        yield problem(NAME, text, CORRECT, key)


def places(config: Config, wires: bool) -> Iterator[Finding]:
    """Check the directories of the log and, for a real robot, of the latch of the emergency stop."""
    key, directory = ("recorder", "directory"), config.recorder.directory
    if config.recorder.enabled:
        try:
            folder.try_out(directory)
        except OSError as error:
            yield problem("logs", folder.advice(directory, error), place=key)
            wires = wires and latch_path(config).parent != directory  # reported above
    if wires:
        try:
            latch.try_out(latch_path(config))
        except latch.LatchError as error:
            yield problem("emergency stop", str(error), "the stop could not be kept: correct that first", key)


def _policies(config: Config, thorough: bool) -> Iterator[Finding]:
    name = config.control.policy
    entries = registry.available(config.policies)
    for other in config.policies if thorough else ():
        if error := entries[other].error:
            yield problem("policies", f"policies.{other}: {error}", place=("policies", other))
    entry = entries.get(name)
    try:
        if entry is None or entry.error is not None:
            registry.load(name, config.policies)  # raises the error
        elif thorough:
            trial.try_out(name, config.policies, trial.TRIAL_S)
    except PolicyError as error:
        yield problem("policy", f"control.policy: {error}", place=("control", "policy"))
