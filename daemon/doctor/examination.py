"""All checks in their order, each part of them gathered when it is its turn."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.daemon.doctor import (
    clocks,
    disk,
    from_logs,
    models,
    ports,
    running,
    scheduling,
    settings,
    software,
)
from softarm.daemon.doctor.finding import Finding, ok, problem
from softarm.daemon.doctor.running import Running
from softarm.daemon.doctor.settings import Settings
from softarm.daemon.stop import latch
from softarm.recordings.listing import listing
from softarm.schemas.config import Config


@dataclass(frozen=True, slots=True)
class Patient:
    """What is examined."""

    settings: Settings
    url: str  # where a daemon would answer
    daemon: Running | None  # the one that does
    simulated: bool = False  # a robot simulated in the daemon's process has no wires
    logs: Path | None = None  # another folder than the recorder's

    @property
    def config(self) -> Config:
        """In force."""
        return self.settings.config

    @property
    def idle(self) -> bool:
        """Whether something heavy may be done on this computer: no arm is in use."""
        return self.daemon is None or not self.daemon.in_use


Part = Callable[[Patient], Iterator[Finding]]


def _software(patient: Patient) -> Iterator[Finding]:
    return software.judge(software.look())


def _settings(patient: Patient) -> Iterator[Finding]:
    return settings.judge(patient.settings)


def _wires(patient: Patient) -> Iterator[Finding]:
    """Of a daemon that answers what it says; else whether one could begin."""
    config = patient.config
    if patient.daemon is not None:
        yield from running.judge(patient.daemon, config)
        return
    yield ok("daemon", f"none answers at {patient.url}: what follows is whether one could begin")
    if not patient.simulated:
        yield from ports.judge_serial(ports.look_serial(config.drivers.regulator.port))
        yield from ports.judge_axis(ports.look_axis(config.drivers.rail.host, config.drivers.rail.port))
        yield from _latch(config)
    places = ports.look_listening(config)
    wanted = (each for each in places if each.key.startswith("api.") or not patient.simulated)
    yield from ports.judge_listening(tuple(wanted))


def _latch(config: Config) -> Iterator[Finding]:
    """Whether an emergency stop would outlive the daemon."""
    try:
        latch.try_out(latch.latch_path(config))
    except latch.LatchError as error:
        yield problem("emergency stop", str(error), "it could not be kept: mend that first")
    else:
        yield ok("emergency stop", f"can be kept in {latch.latch_path(config)}")


def _models(patient: Patient) -> Iterator[Finding]:
    return models.judge(models.look(patient.config, patient.idle), patient.config.failsafe.policy_budget_s)


def _scheduling(patient: Patient) -> Iterator[Finding]:
    return scheduling.judge(scheduling.look(patient.config.control.realtime_priority))


def _clocks(patient: Patient) -> Iterator[Finding]:
    return clocks.judge(clocks.look())


def _disk(patient: Patient) -> Iterator[Finding]:
    recorder = patient.config.recorder
    return disk.judge(disk.look(recorder, listing(recorder.directory), patient.idle))


def _from_logs(patient: Patient) -> Iterator[Finding]:
    folder = patient.logs or patient.config.recorder.directory
    return from_logs.judge(from_logs.look(folder, listing(folder), patient.config))


PARTS: dict[str, Part] = {
    "software": _software,
    "configuration": _settings,
    "robot and daemon": _wires,
    "policies": _models,
    "scheduling": _scheduling,
    "clocks": _clocks,
    "disk": _disk,
    "limits": _from_logs,
}
