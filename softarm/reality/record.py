"""Recorder of trials: runs the robot with an excitation, ticks like a controller at 30 Hz and writes a trial folder.

The files follow the trial format: trial.yaml, command.csv, pressure.csv, rail.csv, mocap.csv, observation.csv.
"""

import csv
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from softarm.reality.parameters import RobotParameters
from softarm.reality.robot import Robot
from softarm.schemas.messages import BODY_NAMES, MocapFrame
from softarm.schemas.policy import OBSERVATION, Observation
from softarm.schemas.robot import CONTROL_RATE_HZ

# Time before the recording, in which every sensor delivers a sample.
SETTLE_S = 0.5
# A longer gap between two frames gives velocities of zero.
STALE_S = 0.1
# Random stream of the controller, after the robot's own streams.
_CLOCK = 4

# Seconds since the recording began -> cart velocity (m/s), pressure (kPa). No filter limits them.
Excitation = Callable[[float], tuple[float, float]]
Row = tuple[float | str, ...]

_COLUMNS = {
    "command": ("t", "cart_velocity", "pressure"),
    "pressure": ("t", "pressure"),
    "rail": ("t", "position", "velocity"),
    "mocap": ("t_capture", "t_receive", *(f"{body}_{part}" for body in BODY_NAMES for part in ("y", "z", "angle"))),
    "observation": ("t", *(signal.name for signal in OBSERVATION)),
}


@dataclass
class _Log:
    """State of the recording controller and the rows that it has written."""

    rows: dict[str, list[Row]] = field(default_factory=lambda: {name: [] for name in _COLUMNS})
    frame: MocapFrame | None = None
    # First differences over a tick: cart, tip y, tip z.
    velocities: tuple[float, ...] = (0.0, 0.0, 0.0)
    pressure_kpa: float | None = None
    cart_command_m_s: float = 0.0

    def take(self, robot: Robot) -> None:
        """Add rows for all samples received since the last call and keep the newest frame."""
        frames = robot.mocap()
        for frame in frames:
            poses = [value for pose in frame.bodies for value in pose[:3]]
            self.rows["mocap"].append((_seconds(frame.t_capture_ns), _seconds(frame.t_receive_ns), *poses))
        for pressure in robot.pressure():
            self.pressure_kpa = pressure.pressure_kpa
            self.rows["pressure"].append((_seconds(pressure.t_receive_ns), pressure.pressure_kpa))
        for rail in robot.rail():
            self.rows["rail"].append((_seconds(rail.t_receive_ns), rail.position_m, rail.velocity_m_s))
        if frames:
            self._difference(frames[-1])

    def observe(self, t_s: float) -> None:
        """Add an observation if every sensor has delivered a sample."""
        if self.frame is None or self.pressure_kpa is None:
            return
        cart, tip = self.frame.bodies[0], self.frame.bodies[-1]
        cart_m_s, tip_y_m_s, tip_z_m_s = self.velocities
        row = Observation(
            cart_position_m=cart.y_m,
            cart_velocity_m_s=cart_m_s,
            tip_y_m=tip.y_m,
            tip_z_m=tip.z_m,
            tip_vy_m_s=tip_y_m_s,
            tip_vz_m_s=tip_z_m_s,
            previous_cart_velocity_command_m_s=self.cart_command_m_s,
            pressure_kpa=self.pressure_kpa,
        )
        self.rows["observation"].append((f"{t_s:.9f}", *row))

    def _difference(self, frame: MocapFrame) -> None:
        step_s = (frame.t_capture_ns - self.frame.t_capture_ns) * 1e-9 if self.frame else math.inf
        if 0 < step_s <= STALE_S and self.frame is not None:
            new, old = frame.bodies, self.frame.bodies
            moves = (new[0].y_m - old[0].y_m, new[-1].y_m - old[-1].y_m, new[-1].z_m - old[-1].z_m)
            self.velocities = tuple(move / step_s for move in moves)
        else:
            self.velocities = (0.0, 0.0, 0.0)
        self.frame = frame


def record(
    excitation: Excitation,
    folder: Path | str,
    duration_s: float,
    parameters: RobotParameters | None = None,
    seed: int = 0,
    *,
    kind: str,
    held: bool = False,
) -> Path:
    """Write one trial to a new or empty folder and return the folder.

    The arm hangs at rest. The first half second has zero commands and is not recorded, so the stamps begin at 0.5 s.
    The same arguments write the same bytes.

    Args:
        duration_s: Length of the recording, 0.1 .. 3600 s.
        kind: Any text; it is written to trial.yaml.
        held: Whether the cart is clamped.

    Raises:
        FileExistsError: The folder is not empty.
        ValueError: The duration is out of bounds, or `Robot` rejects the arguments.
    """
    folder = Path(folder)
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty; name a new folder for the trial")
    if not 0.1 <= duration_s <= 3600:
        raise ValueError(f"duration_s is {duration_s}; give 0.1 to 3600 seconds")
    robot = Robot(parameters, seed, held=held, hanging=True)
    log = _fly(robot, excitation, duration_s, np.random.default_rng((seed, _CLOCK)))
    folder.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump({"kind": kind, "rail": "held" if held else "free"}, sort_keys=False)
    (folder / "trial.yaml").write_text(text, encoding="utf-8")
    for name, columns in _COLUMNS.items():
        _write(folder / f"{name}.csv", columns, log.rows[name])
    return folder


def _fly(robot: Robot, excitation: Excitation, duration_s: float, random: np.random.Generator) -> _Log:
    """Run all ticks of the recording: read, observe, command."""
    clock, log, before = robot.parameters.clock, _Log(), _Log()
    robot.command(0.0, 0.0, 0.0)
    robot.advance(SETTLE_S)
    before.take(robot)
    log.frame, log.pressure_kpa = before.frame, before.pressure_kpa
    for tick in range(round(duration_s * CONTROL_RATE_HZ)):
        late_s, fate = abs(random.normal()) * clock.tick_jitter_s, random.random()
        if fate < clock.missed_ticks:
            continue
        since_s = tick / CONTROL_RATE_HZ + min(late_s, 0.9 / CONTROL_RATE_HZ)
        t_s = SETTLE_S + since_s
        robot.advance(t_s)
        log.take(robot)
        log.observe(t_s)
        velocity, pressure = excitation(since_s)
        robot.command(t_s, velocity, pressure)
        log.cart_command_m_s = velocity
        log.rows["command"].append((f"{t_s:.9f}", velocity, pressure))
    robot.advance(SETTLE_S + duration_s)
    log.take(robot)
    return log


def _seconds(t_ns: int) -> str:
    return f"{t_ns * 1e-9:.9f}"


def _write(path: Path, columns: tuple[str, ...], rows: Iterable[Row]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
