"""Reading of the daemon's own log as a trial."""

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from softarm.diagnosis.data import checks
from softarm.diagnosis.data.trials import ROBOT_CHANNELS, Series, Trial, TrialError
from softarm.recordings import channels, mcap_file
from softarm.schemas import log
from softarm.schemas.messages import BODY_NAMES, CAPTURE_AHEAD_MAX_NS, Command

# A cart that moved less was held.
HELD_M = 5e-4

Rows = dict[str, list[tuple[float, ...]]]


class _Observed(BaseModel):
    values: tuple[float, ...]


class _Goal(BaseModel):
    state: str = "none"


class _Outputs(BaseModel):
    """Fields of a tick's outputs that a trial needs."""

    t_ns: int
    sent: Command
    policy: str = ""
    observed: _Observed | None = None
    goal: _Goal = _Goal()


class _Tick(BaseModel):
    outputs: _Outputs


def read(path: Path) -> Trial:
    """Read a log as a trial.

    Stamps are seconds since the first message, `kind` is the name of the policy that moved the arm, and the command
    starts with the first tick that enabled the drive. Raises TrialError if the file is not a log of the daemon.
    """
    rows: Rows = {name: [] for name in ROBOT_CHANNELS}
    policies: set[str] = set()
    origin_ns: int | None = None
    enabled = False
    messages = 0
    try:
        for topic, data in mcap_file.messages(path):
            messages += 1
            record: Any
            if topic == log.MOCAP:
                record = channels.MOCAP.decode(data)
                stamp = record.t_capture_ns
                if stamp - record.t_receive_ns > CAPTURE_AHEAD_MAX_NS:
                    continue  # stamped by another clock: the control loop rejected this frame
            elif topic == log.PRESSURE:
                record = channels.PRESSURE.decode(data)
                stamp = record.t_receive_ns
            elif topic == log.RAIL:
                record = channels.RAIL.decode(data)
                stamp = record.t_receive_ns
            elif topic == log.TICK:
                record = _Tick.model_validate_json(data).outputs
                stamp = record.t_ns
                enabled = enabled or record.sent.enable
                if record.goal.state == "running" and record.policy:
                    policies.add(record.policy)
            else:
                continue
            origin_ns = stamp if origin_ns is None else origin_ns
            _add(rows, topic, record, origin_ns, enabled)
    except mcap_file.LogError as error:
        raise TrialError(str(error)) from None
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        raise TrialError(
            f"{path}: message {messages} on {topic}: {'.'.join(map(str, problem['loc']))}: {problem['msg']}; "
            "check whether another version recorded it, or it was edited"
        ) from None
    return _trial(path, rows, policies)


def _add(rows: Rows, topic: str, record: Any, origin_ns: int, enabled: bool) -> None:
    """Append a message's values to their channel."""

    def seconds(stamp_ns: int) -> float:
        return (stamp_ns - origin_ns) * 1e-9

    if topic == log.MOCAP:
        poses = [
            value
            for body in record.bodies
            for value in ((body.y_m, body.z_m, body.angle_rad) if body.tracked else (np.nan,) * 3)
        ]
        rows["mocap"].append((seconds(record.t_capture_ns), seconds(record.t_receive_ns), *poses))
    elif topic == log.PRESSURE:
        rows["pressure"].append((seconds(record.t_receive_ns), record.pressure_kpa))
    elif topic == log.RAIL:
        rows["rail"].append((seconds(record.t_receive_ns), record.position_m, record.velocity_m_s))
    elif enabled:
        now = seconds(record.t_ns)
        rows["command"].append((now, record.sent.cart_velocity_m_s, record.sent.pressure_kpa))
        if record.observed is not None:
            rows["observation"].append((now, *record.observed.values))


def _trial(path: Path, rows: Rows, policies: set[str]) -> Trial:
    found: dict[str, Series] = {}
    missing: dict[str, str] = {}
    warnings: list[str] = []
    for name, units in ROBOT_CHANNELS.items():
        if not rows[name]:
            missing[name] = f"{path} contains no {name} readings"
            continue
        table = np.array(rows[name], dtype=float)
        if table.shape[1] != len(units) + 1:
            raise TrialError(
                f"{path}: a {name} reading has {table.shape[1] - 1} values, but {len(units)} are needed "
                f"(bodies: {', '.join(BODY_NAMES)}); name a log of this robot"
            )
        series = Series(table[:, 0].copy(), {c: table[:, i].copy() for i, c in enumerate(units, 1)})
        # The loop may log a reading twice; it counts once.
        found[name], odd = checks.tidy_stamps(series, f"{path}: {name}")
        warnings += odd
    if not found:
        raise TrialError(
            f"{path}: contains no readings; the daemon may have stopped before its first tick. Record again"
        )
    # A drive at rest gives way to the swinging arm; only a clamped cart does not move at all.
    held = "rail" in found and float(np.ptp(found["rail"]["position"])) < HELD_M
    kind = ", ".join(sorted(policies)) or "at rest"
    return Trial(path.stem, kind, path, found, "held" if held else "free", None, tuple(warnings), missing)
