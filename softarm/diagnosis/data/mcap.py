"""Reading of the daemon's own log as a trial."""

from pathlib import Path

import numpy as np

from softarm.diagnosis.data import checks
from softarm.diagnosis.data.trials import ROBOT_CHANNELS, Series, Trial, TrialError
from softarm.recordings import flight, mcap_file
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

# A cart that moved less was held.
HELD_M = 5e-4

Rows = dict[str, list[tuple[float, ...]]]


def read(path: Path) -> Trial:
    """Read a log as a trial.

    Stamps are seconds since the first message, `kind` is the name of the policy that moved the arm, and the command
    starts with the first tick that enabled the drive. Raises TrialError if the file is not a log of the daemon.
    """
    readings = _Readings()
    try:
        for record in flight.records(path):
            readings.add(record)
    except mcap_file.LogError as error:
        raise TrialError(str(error)) from None
    return _trial(path, readings.rows, readings.policies)


class _Readings:
    """Rows of each channel, with stamps in seconds since the first message."""

    def __init__(self) -> None:
        self.rows: Rows = {name: [] for name in ROBOT_CHANNELS}
        self.policies: set[str] = set()
        self._origin_ns: int | None = None
        self._enabled = False

    def add(self, record: flight.Record | None) -> None:
        """Append a message's values to their channel."""
        match record:
            case MocapFrame():
                self._add_frame(record)
            case PressureReading():
                self.rows["pressure"].append((self._seconds(record.t_receive_ns), record.pressure_kpa))
            case RailReading():
                stamp = self._seconds(record.t_receive_ns)
                self.rows["rail"].append((stamp, record.position_m, record.velocity_m_s))
            case flight.Tick():
                self._add_tick(record.outputs)

    def _add_frame(self, frame: MocapFrame) -> None:
        if frame.from_another_clock:
            return  # stamped by another clock: the control loop rejected this frame
        poses = [
            value
            for body in frame.bodies
            for value in ((body.y_m, body.z_m, body.angle_rad) if body.tracked else (np.nan,) * 3)
        ]
        captured = self._seconds(frame.t_capture_ns)
        self.rows["mocap"].append((captured, self._seconds(frame.t_receive_ns), *poses))

    def _add_tick(self, tick: flight.Outputs) -> None:
        now, sent = self._seconds(tick.t_ns), tick.sent
        self._enabled = self._enabled or sent.enable
        if tick.goal.state == "running" and tick.policy:
            self.policies.add(tick.policy)
        if self._enabled:
            self.rows["command"].append((now, sent.cart_velocity_m_s, sent.pressure_kpa))
            if tick.observed is not None:
                self.rows["observation"].append((now, *tick.observed.values))

    def _seconds(self, stamp_ns: int) -> float:
        if self._origin_ns is None:
            self._origin_ns = stamp_ns
        return (stamp_ns - self._origin_ns) * 1e-9


def _trial(path: Path, rows: Rows, policies: set[str]) -> Trial:
    found: dict[str, Series] = {}
    missing: dict[str, str] = {}
    warnings: list[str] = []
    for name, units in ROBOT_CHANNELS.items():
        if not rows[name]:
            missing[name] = f"{path} contains no {name} readings"
            continue
        table = np.array(rows[name], dtype=float)
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
