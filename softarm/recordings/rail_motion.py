"""Commands and motion of the rail from a log, from which its limits are measured."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Message, Metadata
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from softarm.recordings import flight, live, mcap_file
from softarm.schemas import log
from softarm.schemas.config import Config
from softarm.schemas.messages import Command

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RailMotion:
    """Recording of the axis; all stamps are seconds of one clock."""

    source: Path
    sent_s: Array  # [N] times of the set-points, increasing; each holds until the next
    set_point_m_s: Array  # [N]
    obeyed: NDArray[np.bool_]  # [N] the drive was on and the set-point renewed in time
    t_s: Array  # [K] stamps of the read-back, increasing
    position_m: Array  # [K]
    velocity_m_s: Array  # [K]
    config: Config | None = None  # used during the recording, if known


class _Outputs(BaseModel):
    """Needed fields of a tick; other fields are ignored, so logs of other versions can be read."""

    t_ns: int
    sent: Command


class _Tick(BaseModel):
    outputs: _Outputs


def read(path: Path) -> RailMotion:
    """Read a log of the daemon; stamps are CLOCK_MONOTONIC of its host. Readings that are NaN or infinity are left out.

    Raises:
        LogError: The file is not a log, or has an unknown format.
    """
    ticks: list[_Outputs] = []
    seen: dict[int, tuple[float, float]] = {}
    said: Config | None = None
    try:
        for topic, record in mcap_file.records(path):
            if isinstance(record, Metadata) and record.name == log.CONFIGURATION:
                said = Config.model_validate_json(record.metadata["json"])
            elif isinstance(record, Message) and topic == log.TICK:
                ticks.append(_Tick.model_validate_json(record.data).outputs)
            elif isinstance(record, Message) and topic == log.RAIL:
                reading = live.RAIL.decode(record.data)
                if math.isfinite(reading.position_m) and math.isfinite(reading.velocity_m_s):
                    seen[reading.t_receive_ns] = reading.position_m, reading.velocity_m_s
    except ValidationError as error:
        raise flight.unreadable(path, topic or log.CONFIGURATION, error) from None
    sent_ns = np.array([tick.t_ns for tick in ticks], dtype=np.int64)
    stamps_ns = np.array(sorted(seen), dtype=np.int64)
    read_back = np.array([seen[stamp] for stamp in stamps_ns.tolist()], dtype=np.float64).reshape(-1, 2)
    # The rail's process brakes by itself when a set-point is older.
    renewed = np.diff(sent_ns, append=sent_ns[-1:]) * 1e-9 <= (said or Config()).drivers.rail.hold_s
    return RailMotion(
        path,
        np.asarray(sent_ns * 1e-9, dtype=np.float64),
        np.array([tick.sent.cart_velocity_m_s for tick in ticks]),
        np.array([tick.sent.enable for tick in ticks], dtype=bool) & renewed,
        np.asarray(stamps_ns * 1e-9, dtype=np.float64),
        read_back[:, 0],
        read_back[:, 1],
        said,
    )
