"""Plausible ticks, and recorders that are stopped at the end."""

from contextlib import contextmanager
from pathlib import Path

from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs, TickTiming
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.logbook.ticks import TickFile
from softarm.policies.base import PolicySpec
from softarm.schemas.config import Config
from softarm.schemas.messages import Command, MocapFrame, Pose, PressureReading, RailReading
from tests.processes import until

SPEC = PolicySpec("reach", "swings", sha256="ab" * 32)


def config(directory: Path, **recorder) -> Config:
    """Return a configuration that keeps all ticks; `test_thinning.py` tests thinning."""
    return Config(recorder={"directory": directory, "idle_interval_s": 0, **recorder})


def make_tick(number: int, t_ns: int | None = None) -> tuple[Inputs, Outputs, TickTiming]:
    """Return a tick with four frames and fresh readings."""
    now = t_ns if t_ns is not None else 5_000_000_000 + number * 33_333_333
    poses = tuple(Pose(0.01 * number, 0.5 + i / 7, -0.1 * i) for i in range(6))
    frames = tuple(
        MocapFrame(4 * number + i, now - 8_000_000 * (4 - i), now - 8_000_000 * (4 - i) + 900_000, poses)
        for i in range(4)
    )
    inputs = Inputs(
        now,
        mocap=frames,
        pressure=PressureReading(now - 1_000_000, 1.5 + number / 3, True, (), number),
        rail=RailReading(now - 2_000_000, 0.1, number / 9, True),
    )
    sent = Command(True, 0.1 + number / 7, 3.3)
    outputs = Outputs(now, number, 0, 0, 0, Mode.DISARMED, EStop.CLEAR, sent=sent, policy="reach")
    return inputs, outputs, TickTiming(10_000, 200_000, 5_000, 9_000_000)


def unfinished(path: Path, ticks) -> Path:
    """Write the log of a killed daemon, without chunks and end."""
    with path.open("wb") as file:
        live = TickFile(file)
        live.head(Config(), SPEC, 1, 2)
        for one in ticks:
            live.write(one)
    return path


@contextmanager
def recording(settings: Config, **clocks):
    """Yield a recorder that is stopped at the end."""
    recorder = Recorder(settings, SPEC, **clocks)
    recorder.start()
    yield recorder
    recorder.stop()


def recorded(settings: Config, ticks, **clocks) -> Recorder:
    """Record ticks and stop when all are written."""
    with recording(settings, **clocks) as recorder:
        for one in ticks:
            recorder.tick(*one)
        until(lambda: not recorder._queue, "the queue")
    assert recorder.problem is None
    return recorder
