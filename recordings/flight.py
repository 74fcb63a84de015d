"""What a person wants to see of a log: ticks, frames and readings in the order in which they were written.

Of a tick only what is drawn, plotted and tabled; all else is passed over, so that a log of any version will do.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, ValidationError

from softarm.recordings import channels, mcap_file
from softarm.schemas import log
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.flights import SHELF_MIDDLE_M
from softarm.schemas.goals import GoalStatus
from softarm.schemas.messages import Command, MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation


class Observed(BaseModel):
    """What the policy was fed."""

    values: Observation
    mocap_age_ns: int = 0
    pressure_age_ns: int = 0
    rail_age_ns: int = 0
    dark_ns: int = 0


class ActiveEvent(BaseModel):
    """An event of the failsafe table that held."""

    name: str


class Outputs(BaseModel):
    """What a tick decided."""

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
    """How long a tick's parts took."""

    read_ns: int = 0
    compute_ns: int = 0
    write_ns: int = 0
    sensor_to_command_ns: int | None = None


class Tick(BaseModel):
    """A control tick."""

    outputs: Outputs
    timing: Timing = Timing()


class Sight(NamedTuple):
    """A tick with the newest that the devices had said when it was written."""

    tick: Tick
    frame: MocapFrame | None
    pressure: PressureReading | None
    rail: RailReading | None


EVENT = channels.LogChannel(log.EVENT, Entry)
Record = Tick | MocapFrame | PressureReading | RailReading | Entry


def record(topic: str, data: bytes) -> Record | None:
    """One message of a log; None: of a channel that is not shown. Raises pydantic.ValidationError."""
    match topic:
        case log.TICK:
            return Tick.model_validate_json(data)
        case log.MOCAP:
            return channels.MOCAP.decode(data)
        case log.PRESSURE:
            return channels.PRESSURE.decode(data)
        case log.RAIL:
            return channels.RAIL.decode(data)
        case log.EVENT:
            return EVENT.decode(data)
    return None


def records(path: Path) -> Iterator[Record | None]:
    """Every message of a log, in file order; None: of a channel that is not shown.

    Raises LogError when it is no log, or one of a format that cannot be read.
    """
    for topic, data in mcap_file.messages(path):
        try:
            yield record(topic, data)
        except ValidationError as error:
            raise unreadable(path, topic, error) from None


def sights(path: Path) -> Iterator[Sight | None]:
    """Every tick with what it could see; None for each message that is none, so that progress can be shown."""
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
                yield Sight(one, frame, pressure, rail)
                continue
        yield None


def first_stamp_ns(path: Path) -> int:
    """When a log's first measurement or tick was, CLOCK_MONOTONIC: what its seconds count from. Raises LogError."""
    for one in records(path):
        match one:
            case MocapFrame():
                return one.t_capture_ns
            case PressureReading() | RailReading():
                return one.t_receive_ns
            case Tick():
                return one.outputs.t_ns
    raise nothing_in(path)


def shelf_depth_m(policy: str, config: Config) -> float | None:
    """How far behind a shelf's front edge a policy's targets lie; None: it flies to no shelf."""
    made = config.policies.get(policy)
    options = made.options if made else {"model": policy}
    depth_m = options.get("target_depth_m", SHELF_MIDDLE_M if options.get("model") == "shelf" else None)
    return None if depth_m is None else float(depth_m)


def wall_minus_monotonic_ns(path: Path, metadata: log.Metadata) -> int:
    """What makes a log's stamps wall-clock time. Raises LogError where the log does not say."""
    try:
        return int(metadata[log.CLOCK]["wall_minus_monotonic_ns"])
    except (KeyError, ValueError):
        raise mcap_file.LogError(f"{path}: does not say what time it was; name a log of the daemon's") from None


def nothing_in(path: Path) -> mcap_file.LogError:
    """What to say of a log without a tick."""
    return mcap_file.LogError(f"{path}: holds nothing to show; was the daemon stopped before its first tick?")


def unreadable(path: Path, topic: str, error: ValidationError) -> mcap_file.LogError:
    """What to say of a message that is not as ours are."""
    problem = error.errors(include_url=False)[0]
    where = f"{'.'.join(map(str, problem['loc']))}: " if problem["loc"] else ""
    return mcap_file.LogError(
        f"{path}: a message on {topic}: {where}{problem['msg']}; was it edited, or recorded by another version?"
    )
