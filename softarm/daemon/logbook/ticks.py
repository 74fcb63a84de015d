"""Splits a tick into messages of a log, one JSON channel per kind of record, and joins them again.

A new measurement is written once, on its own channel; /tick names the ones it used, which precede it in the file.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, BinaryIO

from softarm.common import revision
from softarm.daemon.control.records import Inputs, Outputs, Problems, Request, Tick, TickTiming
from softarm.policies.base import PolicySpec
from softarm.recordings.live import EVENT, MOCAP, PRESSURE, RAIL, LiveFile, LogChannel, LogMessage
from softarm.schemas import log
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


@dataclass(frozen=True, slots=True)
class TickInputs:
    """The inputs without their own channel, and references to the other channels' messages."""

    t_ns: int
    late_ns: int
    missed: int
    mocap_frames: int  # number of the last messages of /mocap
    requests: int  # number of the last messages of /request
    pressure_t_receive_ns: int | None  # stamp of the last reading on /pressure, or None
    rail_t_receive_ns: int | None  # the same of /rail
    problems: Problems
    recorder_dropped: int
    recorder_problem: str | None = None
    latched: str | None = None
    latch_problem: str | None = None


@dataclass(frozen=True, slots=True)
class TickRecord:
    """Record of a tick; with the referenced messages it can be replayed."""

    inputs: TickInputs
    outputs: Outputs
    timing: TickTiming


# Fields that both records have; `requests` is a number in one of them.
_SHARED = {each.name for each in fields(TickInputs)} & {each.name for each in fields(Inputs)} - {"requests"}


def _tick_inputs(inputs: Inputs) -> TickInputs:
    return TickInputs(
        mocap_frames=len(inputs.mocap),
        requests=len(inputs.requests),
        pressure_t_receive_ns=None if inputs.pressure is None else inputs.pressure.t_receive_ns,
        rail_t_receive_ns=None if inputs.rail is None else inputs.rail.t_receive_ns,
        **_shared(inputs),
    )


def _shared(inputs: Inputs | TickInputs) -> dict[str, Any]:
    """Return the inputs without their own channel by name."""
    return {name: getattr(inputs, name) for name in _SHARED}


REQUEST = LogChannel(log.REQUEST, Request)
TICK = LogChannel(log.TICK, TickRecord)

CHANNELS: tuple[LogChannel[Any], ...] = (MOCAP, PRESSURE, RAIL, REQUEST, EVENT, TICK)


class EncodingError(Exception):
    """A tick that cannot be encoded as JSON."""


class Splitter:
    """Splits ticks into messages."""

    def __init__(self) -> None:
        self._pressure: PressureReading | None = None  # the last one written
        self._rail: RailReading | None = None

    def split(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> tuple[LogMessage, ...]:
        """Return all messages of a tick, /tick last, or raise EncodingError."""
        try:
            return tuple(self._split(inputs, outputs, timing))
        except Exception as error:  # pydantic raises many
            self._pressure = self._rail = None  # were not written: the next tick does
            raise EncodingError(f"tick {outputs.tick}: {type(error).__name__} ({error})") from error

    def _split(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> Iterator[LogMessage]:
        now = inputs.t_ns
        for frame in inputs.mocap:
            yield LogMessage(MOCAP.topic, frame.t_receive_ns, frame.t_capture_ns, MOCAP.encode(frame))
        # By identity: 0.0 equals -0.0, but a replay needs the original one.
        if inputs.pressure is not None and inputs.pressure is not self._pressure:
            self._pressure = inputs.pressure
            yield LogMessage(PRESSURE.topic, self._pressure.t_receive_ns, now, PRESSURE.encode(self._pressure))
        if inputs.rail is not None and inputs.rail is not self._rail:
            self._rail = inputs.rail
            yield LogMessage(RAIL.topic, self._rail.t_receive_ns, now, RAIL.encode(self._rail))
        for request in inputs.requests:
            yield LogMessage(REQUEST.topic, now, now, REQUEST.encode(request))
        yield LogMessage(TICK.topic, now, now, TICK.encode(TickRecord(_tick_inputs(inputs), outputs, timing)))


class Joiner:
    """Joins messages to ticks."""

    def __init__(self) -> None:
        self._frames: list[MocapFrame] = []
        self._requests: list[Request] = []
        self._pressure: PressureReading | None = None
        self._rail: RailReading | None = None

    def join(self, topic: str, data: bytes) -> tuple[Inputs, Outputs, TickTiming] | None:
        """Add a message; return the tick if the message completes one.

        Raises ValueError when the messages before /tick are not those it names, or are of another format.
        """
        if topic == MOCAP.topic:
            self._frames.append(MOCAP.decode(data))
        elif topic == PRESSURE.topic:
            self._pressure = PRESSURE.decode(data)
        elif topic == RAIL.topic:
            self._rail = RAIL.decode(data)
        elif topic == REQUEST.topic:
            self._requests.append(REQUEST.decode(data))
        elif topic == TICK.topic:
            tick = TICK.decode(data)
            return self._joined(tick.inputs), tick.outputs, tick.timing
        return None

    def _joined(self, tick: TickInputs) -> Inputs:
        inputs = Inputs(
            mocap=tuple(self._frames),
            pressure=None if tick.pressure_t_receive_ns is None else self._pressure,
            rail=None if tick.rail_t_receive_ns is None else self._rail,
            requests=tuple(self._requests),
            **_shared(tick),
        )
        if _tick_inputs(inputs) != tick:
            raise ValueError(f"the messages before the tick at {tick.t_ns} ns are not those that it names")
        self._frames.clear()
        self._requests.clear()
        return inputs


# Packages whose versions are recorded.
PACKAGES = ("numpy", "onnxruntime", "pyserial", "eclipse-zenoh", "pydantic", "mcap", "fastapi", "uvicorn")


@lru_cache
def running_software() -> dict[str, str]:
    """Return the versions at the first call, for the daemon's first log: a later commit is not the running one."""
    return revision.software(PACKAGES)


class TickFile(LiveFile):
    """Live file of ticks with the metadata that a reader needs."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, CHANNELS)
        self._splitter = Splitter()

    def head(
        self,
        config: Config,
        policy: PolicySpec | None,
        monotonic_ns: int,
        wall_ns: int,
        run: Mapping[str, str] | None = None,
    ) -> None:
        """Write the log's metadata: configuration, software, clocks, run and policy."""
        self.note(log.CONFIGURATION, {"json": config.model_dump_json()})
        self.note(log.SOFTWARE, {**running_software(), log.FORMAT_KEY: str(log.FORMAT)})
        self.note(log.MACHINE, revision.machine())
        self.note(
            log.CLOCK,
            {
                "monotonic_ns": str(monotonic_ns),
                "wall_ns": str(wall_ns),
                "wall_minus_monotonic_ns": str(wall_ns - monotonic_ns),
            },
        )
        if run is not None:
            self.note(log.RUN, run)
        if policy is not None:
            self.policy(policy)
        self.flush()

    def write(self, tick: Tick) -> tuple[LogMessage, ...]:
        """Write a tick completely and return its messages, or raise EncodingError."""
        messages = self._splitter.split(*tick)
        for message in messages:
            self.add(message)
        return messages

    def entry(self, entry: Entry) -> None:
        """Write an entry of the event history."""
        self.add(LogMessage(EVENT.topic, entry.t_ns, entry.t_ns, EVENT.encode(entry)))

    def policy(self, spec: PolicySpec) -> None:
        """Note the policy of the following ticks."""
        self.note(log.POLICY, {"name": spec.name, "description": spec.description, "sha256": spec.sha256 or ""})
