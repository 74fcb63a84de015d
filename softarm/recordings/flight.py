"""Contents of a log for display: ticks, frames and readings in the order of the file.

Only the fields that are drawn, plotted and tabulated are read, so logs of other versions can be shown.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from softarm.recordings import live, mcap_file
from softarm.schemas import log
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.flights import SHELF_MIDDLE_M, Scenario
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.messages import Command, MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation


class Observed(BaseModel):
    """Observation given to the policy."""

    values: Observation
    mocap_age_ns: int = 0
    pressure_age_ns: int = 0
    rail_age_ns: int = 0
    bridged_ns: int = 0


class ActiveEvent(BaseModel):
    """Active event of the failsafe table."""

    name: str


class Outputs(BaseModel):
    """Decisions of a tick."""

    t_ns: int  # start of the tick, CLOCK_MONOTONIC
    tick: int = 0
    late_ns: int = 0
    missed: int = 0
    mode: str = ""
    estop: str = ""
    sent: Command
    action: tuple[float, float] | None = None
    policy: str = ""
    policy_ns: int = 0
    clamps: tuple[str, ...] = ()
    observed: Observed | None = None
    goal: GoalStatus = GoalStatus()
    events: tuple[ActiveEvent, ...] = ()


class Timing(BaseModel):
    """Durations of the parts of a tick."""

    read_ns: int = 0
    compute_ns: int = 0
    write_ns: int = 0
    sensor_to_command_ns: int | None = None


class Tick(BaseModel):
    """Control tick with its outputs and timing."""

    outputs: Outputs
    timing: Timing = Timing()


class Moment(NamedTuple):
    """Tick together with the newest data of every device at that time."""

    tick: Tick
    frame: MocapFrame | None
    pressure: PressureReading | None
    rail: RailReading | None


Record = Tick | MocapFrame | PressureReading | RailReading | Entry
_DECODERS: dict[str, Callable[[bytes], Record]] = {
    log.TICK: Tick.model_validate_json,
    log.MOCAP: live.MOCAP.decode,
    log.PRESSURE: live.PRESSURE.decode,
    log.RAIL: live.RAIL.decode,
    log.EVENT: live.EVENT.decode,
}


def record(topic: str, data: bytes) -> Record | None:
    """Return one message of a log, or None for a channel that is not shown.

    Raises:
        pydantic.ValidationError: The message has another format.
    """
    decode = _DECODERS.get(topic)
    return None if decode is None else decode(data)


def records(path: Path) -> Iterator[Record | None]:
    """Yield every message of a log in file order, with None for channels that are not shown.

    Raises:
        LogError: The file is not a log, or has an unknown format.
    """
    for topic, data in mcap_file.messages(path):
        try:
            yield record(topic, data)
        except ValidationError as error:
            raise unreadable(path, topic, error) from None


def moments(path: Path) -> Iterator[Moment | None]:
    """Yield every tick with the newest device data, and None for every other message, to show progress."""
    frame: MocapFrame | None = None
    pressure: PressureReading | None = None
    rail: RailReading | None = None
    for one in records(path):
        match one:
            case MocapFrame():
                frame = one
            case PressureReading():
                pressure = one
            case RailReading():
                rail = one
            case Tick():
                yield Moment(one, frame, pressure, rail)
                continue
        yield None


def figures(moment: Moment) -> dict[str, Any]:
    """Return the numbers and states of a tick by their names with units; NaN stands for a missing number."""
    nan = math.nan
    out, timing, rail, seen = moment.tick.outputs, moment.tick.timing, moment.rail, moment.tick.outputs.observed
    goal, action, whole_ns = out.goal.goal, out.action or (nan, nan), timing.sensor_to_command_ns
    values = seen.values if seen else Observation(*(nan,) * len(Observation._fields))
    return {
        "tick": out.tick,
        "mode": out.mode,
        "estop": out.estop,
        "policy": out.policy,
        "goal_number": out.goal.number,
        "goal_kind": goal.kind if goal else "",
        "goal_state": out.goal.state,
        "target_y_m": goal.y_m if goal else nan,
        "target_z_m": goal.z_m if goal else nan,
        "closest_m": nan if out.goal.closest_m is None else out.goal.closest_m,
        **{f"sent_{name}": value for name, value in out.sent._asdict().items()},
        "action_cart_velocity_m_s": action[0],
        "action_pressure_kpa": action[1],
        "measured_pressure_kpa": moment.pressure.pressure_kpa if moment.pressure else nan,
        "rail_position_m": rail.position_m if rail else nan,
        "rail_velocity_m_s": rail.velocity_m_s if rail else nan,
        **{f"observed_{name}": value for name, value in values._asdict().items()},
        "bridged_s": seen.bridged_ns * 1e-9 if seen else nan,
        "mocap_age_ms": seen.mocap_age_ns * 1e-6 if seen else nan,
        "pressure_age_ms": seen.pressure_age_ns * 1e-6 if seen else nan,
        "rail_age_ms": seen.rail_age_ns * 1e-6 if seen else nan,
        "late_ms": out.late_ns * 1e-6,
        "missed_ticks": out.missed,
        "policy_ms": out.policy_ns * 1e-6,
        "read_ms": timing.read_ns * 1e-6,
        "compute_ms": timing.compute_ns * 1e-6,
        "write_ms": timing.write_ns * 1e-6,
        "sensor_to_command_ms": nan if whole_ns is None else whole_ns * 1e-6,
        "clamps": " ".join(out.clamps),
        "events": " ".join(event.name for event in out.events),
    }


def first_stamp_ns(path: Path) -> int:
    """Return the stamp of the first measurement or tick, CLOCK_MONOTONIC; seconds of a log count from it.

    A frame that another clock has stamped does not count.

    Raises:
        LogError: The file is not a log.
    """
    for one in records(path):
        match one:
            case MocapFrame() if not one.from_another_clock:
                return one.t_capture_ns
            case PressureReading() | RailReading():
                return one.t_receive_ns
            case Tick():
                return one.outputs.t_ns
    raise nothing_in(path)


def shelf_m(goal: Goal, policy: str, config: Config) -> tuple[float, float] | None:
    """Return y of the front edge and z of the lower board of a policy's shelf, m, or None without a shelf."""
    made = config.policies.get(policy)
    options = made.options if made else {"model": policy}
    depth_m = options.get("target_depth_m", SHELF_MIDDLE_M if options.get("model") == "shelf" else None)
    return Scenario(goal, 0.0, depth_m=None if depth_m is None else float(depth_m)).shelf_m


def wall_minus_monotonic_ns(path: Path, metadata: log.Metadata) -> int:
    """Return the offset from the stamps of a log to wall-clock time.

    Raises:
        LogError: The log does not contain the offset.
    """
    try:
        return int(metadata[log.CLOCK]["wall_minus_monotonic_ns"])
    except (KeyError, ValueError):
        raise mcap_file.LogError(f"{path}: does not say what time it was; name a log of the daemon's") from None


def nothing_in(path: Path) -> mcap_file.LogError:
    """Return the error for a log without a tick."""
    return mcap_file.LogError(f"{path}: holds nothing to show; was the daemon stopped before its first tick?")


def unreadable(path: Path, topic: str, error: ValidationError) -> mcap_file.LogError:
    """Return the error for a message of an unknown format."""
    problem = error.errors(include_url=False)[0]
    where = f"{'.'.join(map(str, problem['loc']))}: " if problem["loc"] else ""
    return mcap_file.LogError(
        f"{path}: a message on {topic}: {where}{problem['msg']}; was it edited, or recorded by another version?"
    )
