"""A fixed campaign of the independent robot: two trials, one effect or none, always the same bytes; also as logs."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from softarm.daemon.control.records import EStop, Inputs, Mode, Observed, Outputs, TickTiming
from softarm.daemon.logbook import ticks
from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.engine.result import Diagnosis
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import record
from softarm.recordings.live import MOCAP, PRESSURE, RAIL, LiveFile, LogMessage
from softarm.schemas.events import Entry
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.goals import GoalStatus
from softarm.schemas.log import CLOCK
from softarm.schemas.messages import Command, MocapFrame, Pose, PressureReading, RailReading
from softarm.schemas.model import Model
from softarm.schemas.policy import Observation
from softarm.simulator import model_file

LATER_NS = 7_000_000_000_000  # another clock's
KINDS = ("pressure-multisine", "both")
LENGTH_S, DEAD_TIME_S = 8.0, 0.06


def robot(dead_time_s: float) -> RobotParameters:
    """The independent robot; 0: nothing is wrong with it."""
    sound = RobotParameters()
    return replace(sound, regulator=replace(sound.regulator, dead_time_s=dead_time_s))


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float], Path]:
    """The campaign's folder, by the regulator's dead time; flown once."""

    @cache
    def fly(dead_time_s: float) -> Path:
        campaign = tmp_path_factory.mktemp("reality") / "campaign"
        for seed, kind in enumerate(KINDS):
            record(EXCITATIONS[kind].at, campaign / kind, LENGTH_S, robot(dead_time_s), seed, kind=kind)
        model_file.save(Model(), campaign / "model.yaml")
        return campaign

    return fly


@pytest.fixture(scope="session")
def diagnosed(flown: Callable[[float], Path]) -> Callable[[float], Diagnosis]:
    """Return the answers in the order of the folder."""
    return cache(lambda dead_time_s: diagnose(read_all([flown(dead_time_s)]), Model()))


@pytest.fixture(scope="session")
def as_logs(flown: Callable[[float], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The late campaign as a daemon's logs: by the daemon's own messages, its clock at another hour."""
    folder = tmp_path_factory.mktemp("logs")
    for kind in KINDS:
        with (folder / f"{kind}.mcap").open("wb") as file:
            log = LiveFile(file, ticks.CHANNELS)
            log.note(CLOCK, {"wall_minus_monotonic_ns": "0"})
            for message in sorted(messages(flown(DEAD_TIME_S) / kind), key=lambda each: each.log_time):
                log.add(message)
            log.flush()
    return folder


def messages(trial: Path) -> list[LogMessage]:
    """Every reading, frame and tick of a trial folder."""

    def rows(name: str) -> list[list[float]]:
        return np.loadtxt(trial / f"{name}.csv", delimiter=",", skiprows=1, ndmin=2).tolist()

    def ns(t_s: float) -> int:
        return LATER_NS + round(t_s * 1e9)

    found = []
    for number, (captured, received, *numbers) in enumerate(rows("mocap")):
        poses = tuple(Pose(*pose) for pose in np.reshape(numbers, (-1, 3)).tolist())
        frame = MocapFrame(number, ns(captured), ns(received), poses)
        found.append(LogMessage(MOCAP.topic, ns(received), ns(captured), MOCAP.encode(frame)))
    for t, kpa in rows("pressure"):
        found.append(LogMessage(PRESSURE.topic, ns(t), ns(t), PRESSURE.encode(PressureReading(ns(t), kpa, True))))
    for t, y, v in rows("rail"):
        found.append(LogMessage(RAIL.topic, ns(t), ns(t), RAIL.encode(RailReading(ns(t), y, v, True))))
    seen = {t: Observation(*values) for t, *values in rows("observation")}
    for number, (t, velocity, pressure) in enumerate(rows("command")):
        outputs = Outputs(
            ns(t),
            number,
            0,
            0,
            0,
            Mode.ARMED,
            EStop.CLEAR,
            sent=Command(True, velocity, pressure),
            policy=trial.name,
            observed=Observed(seen[t], 0, 0, 0, 0) if t in seen else None,
            goal=GoalStatus(state="running"),
        )
        tick = ticks.TickRecord(ticks._tick_inputs(Inputs(ns(t))), outputs, TickTiming(0, 0, 0, None))
        found.append(LogMessage(ticks.TICK.topic, ns(t), ns(t), ticks.TICK.encode(tick)))
    entry = Entry(1, ns(0.0), datetime.fromtimestamp(0, UTC), 0, "mode", "armed", "arming → armed")
    return [*found, LogMessage(ticks.EVENT.topic, ns(0.0), ns(0.0), ticks.EVENT.encode(entry))]
