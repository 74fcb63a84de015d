"""All checks of `softarm doctor` in their order; each part gathers its facts in its turn."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.common.finding import Finding, ok, warning
from softarm.daemon.doctor import clocks, disk, from_logs, models, ports, running, scheduling, software, untried
from softarm.daemon.doctor.running import Running
from softarm.daemon.runtime import preflight
from softarm.recordings.log_file import listing
from softarm.schemas.config import Config


@dataclass(frozen=True, slots=True)
class Target:
    """The computer, configuration and daemon under examination."""

    path: Path | None  # of the configuration; None for the defaults
    config: Config  # the defaults if the file has mistakes
    mistakes: tuple[Finding, ...]  # of the configuration
    url: str  # address of a running daemon
    daemon: Running | None  # None if no daemon answers
    simulated: bool = False  # a robot simulated in the daemon's process has no hardware
    logs: Path | None = None  # default: the recorder's folder

    @property
    def idle(self) -> bool:
        """Return whether heavy checks are allowed because no arm is in use."""
        return self.daemon is None or not self.daemon.in_use


Part = Callable[[Target], Iterator[Finding]]


def configuration(path: Path | None, wires: bool) -> tuple[Config, tuple[Finding, ...]]:
    """Return the configuration to check with, and the mistakes that would prevent the daemon's start."""
    loaded, mistakes, _ = preflight.read(path)
    if loaded is None or mistakes:
        return Config(), tuple(mistakes)
    return loaded.config, tuple(preflight.tokens_and_plug_ins(loaded.config, wires))


def _configuration(target: Target) -> Iterator[Finding]:
    """Report the mistakes; a simulated robot needs no file."""
    yield from target.mistakes
    if target.path is None and target.simulated:
        yield ok(preflight.NAME, "the defaults")
    elif target.path is None:
        advice = "name yours with --config; `softarm config new` writes one"
        yield warning(preflight.NAME, "no file was named, so the defaults are checked", advice)
    elif not target.mistakes:
        yield ok(preflight.NAME, f"{target.path} is valid")


def _wires(target: Target) -> Iterator[Finding]:
    """Examine the running daemon, or whether one can start."""
    config = target.config
    yield from ports.ros_router(config.ros)
    if target.daemon is not None:
        yield from running.judge(target.daemon, config)
        return
    yield ok("daemon", f"no daemon at {target.url}, so the following checks whether one can start")
    if not target.simulated:
        yield from ports.judge_serial(ports.look_serial(config.drivers.regulator.port))
        yield from ports.judge_axis(ports.look_axis(config.drivers.rail.host, config.drivers.rail.port))
        yield from (each for each in preflight.places(config, wires=True) if each.name == "emergency stop")
    yield from ports.listening(config, wires=not target.simulated)


def _disk(target: Target) -> Iterator[Finding]:
    recorder = target.config.recorder
    return disk.judge(disk.look(recorder, listing(recorder.directory), target.idle))


def _from_logs(target: Target) -> Iterator[Finding]:
    """Compare the rail's limits with the logs; those of a simulated robot say nothing about a rail."""
    if target.simulated:
        return iter(())
    folder = target.logs or target.config.recorder.directory
    return from_logs.judge(from_logs.look(folder, listing(folder), target.config), folder)


PARTS: dict[str, Part] = {
    "software": lambda target: software.judge(software.look()),
    "configuration": _configuration,
    "robot and daemon": _wires,
    "policies": lambda target: models.judge(
        models.look(target.config, target.idle), target.config.failsafe.policy_budget_s
    ),
    "scheduling": lambda target: scheduling.judge(
        scheduling.look(target.config.control.realtime_priority), target.simulated
    ),
    "clocks": lambda target: clocks.judge(clocks.look()),
    "disk": _disk,
    "limits": _from_logs,
    "never used with hardware": lambda target: iter(()) if target.simulated else untried.judge(),
}
