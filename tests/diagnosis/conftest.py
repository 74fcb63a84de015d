"""A simulated test bench: the robot under an excitation, as noisy sensors see it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, Trial
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Arm, Model, seed_effects
from softarm.simulator.simulator import Simulator

MOCAP_HZ = 120
MOCAP_NOISE_M, ANGLE_NOISE_RAD, PRESSURE_NOISE_KPA = 0.2e-3, 2e-3, 0.05


def _record(
    excitation: str, model: Model | None = None, seed: int = 0, noise: float = 1.0, length_s: float | None = None
) -> Trial:
    length_s = length_s or EXCITATIONS[excitation].duration_s + 0.5
    return _recorded(excitation, (model or Model()).model_dump_json(), seed, noise, length_s)


@cache
def _recorded(excitation: str, model: str, seed: int, noise: float, length_s: float) -> Trial:
    """A trial at 1200 Hz physics: mocap at 120 Hz, commands, regulator and rail at 60 Hz."""
    robot = Simulator(Model.model_validate_json(model), physics_rate_hz=1200.0)
    for _ in range(90):  # hang still before the recording
        robot.step(0.0, 0.0, 1 / 30)
    return _flight(excitation, robot, length_s, seed, noise)


def _flight(
    kind: str, robot: Simulator, length_s: float, seed: int, noise: float = 1.0, from_s: float = 0.0, ticks: int = 1
) -> Trial:
    """Fly an excitation from a second on: mocap at 120 Hz, readings at 60 Hz, a command every `ticks` readings."""
    draw, plan = np.random.default_rng(seed), EXCITATIONS[kind]
    frames, slow = [], []
    for k in range(round(length_s * MOCAP_HZ)):
        t = k / MOCAP_HZ
        frames.append((t, t + MOCAP_LATE_S, *_poses(robot, draw, noise).ravel()))
        command = plan.at(from_s + 2 * ticks * (k // (2 * ticks)) / MOCAP_HZ)
        if k % 2 == 0:
            reading = robot.pressure_reading_kpa[0] + noise * draw.normal() * PRESSURE_NOISE_KPA
            slow.append((t, *command, reading, robot.cart_position_m[0], robot.cart_velocity_m_s[0]))
        robot.step(*command, 1 / MOCAP_HZ)
    return _trial(kind, frames, slow, ticks)


def _poses(robot: Simulator, draw: np.random.Generator, noise: float) -> np.ndarray:
    """Return the noisy poses of cart and links: y, z and angle of each."""
    bodies = [(robot.cart_position_m[0], robot.model.arm.base_height_m, 0.0)]
    bodies += [(y, z, a) for (y, z), a in zip(robot.link_ends_m()[0], robot.link_angles_rad[0], strict=True)]
    errors = noise * draw.normal(size=(6, 3)) * (MOCAP_NOISE_M, MOCAP_NOISE_M, ANGLE_NOISE_RAD)
    return np.array(bodies, dtype=float) + errors


def _trial(name: str, frames: list[tuple[float, ...]], slow: list[tuple[float, ...]], rows_a_command: int) -> Trial:
    """Return a trial of frames (capture, reception, poses) and rows (stamp, commands, pressure, position, velocity)."""
    bodies = ("cart", *(f"link{i}" for i in range(1, 6)))
    mocap = ["t_receive", *(f"{body}_{part}" for body in bodies for part in ("y", "z", "angle"))]
    seen, rows = np.array(frames, dtype=float), np.array(slow, dtype=float)
    t, sent = rows[:, 0], rows[::rows_a_command]
    channels = {
        "command": Series(sent[:, 0].copy(), {"cart_velocity": sent[:, 1].copy(), "pressure": sent[:, 2].copy()}),
        "pressure": Series(t.copy(), {"pressure": rows[:, 3].copy()}),
        "rail": Series(t.copy(), {"position": rows[:, 4].copy(), "velocity": rows[:, 5].copy()}),
        "mocap": Series(seen[:, 0].copy(), {c: seen[:, i].copy() for i, c in enumerate(mocap, 1)}),
    }
    return Trial(name, name, Path(name), channels, "free")


# Excitation -> from which second of it on; 5 s of each make a campaign that is diagnosed in seconds.
CAMPAIGN = {"pressure-multisine": 0.0, "both": 1.0, "rail-steps": 9.5, "rail-multisine": 1.7}
LENGTH_S, MOCAP_LATE_S, FRAMES_A_TICK = 5.0, 0.004, 4


@cache
def _campaign(
    effects: tuple[Any, ...] = (), kinds: tuple[str, ...] = tuple(CAMPAIGN), arm: Arm | None = None
) -> tuple[Trial, ...]:
    """The seed's robot with further effects ((name, ((parameter, value), ...)), ...) under a campaign's excitations."""
    model = Model(effects=seed_effects() | {name: dict(values) for name, values in effects})
    model = model if arm is None else model.model_copy(update={"arm": arm})
    return tuple(_fly(kind, model, seed) for seed, kind in enumerate(kinds))


def _fly(kind: str, model: Model, seed: int) -> Trial:
    """A trial with ticks at 30 Hz whose velocities are differences over a tick."""
    from_s, plan = CAMPAIGN.get(kind, 0.0), EXCITATIONS[kind]
    robot = Simulator(model, physics_rate_hz=720.0)
    for _ in range(60):  # hang still before the recording
        robot.step(*plan.at(from_s), 1 / 30)
    trial = _flight(kind, robot, LENGTH_S, seed, from_s=from_s, ticks=FRAMES_A_TICK // 2)
    ticks = trial.channels["command"].t_s[2:]
    return replace(trial, channels={**trial.channels, "observation": _observation(trial.channels["mocap"], ticks)})


def _observation(mocap: Series, ticks: np.ndarray) -> Series:
    """Return the observation of a policy at its ticks, with velocities as differences between ticks."""
    newest = np.searchsorted(mocap["t_receive"], ticks + 1e-9, side="right") - 1
    rates = {}
    for part in ("y", "z"):
        place, before = mocap[f"link5_{part}"][newest], mocap[f"link5_{part}"][newest - FRAMES_A_TICK]
        rates[f"tip_v{part}"] = (place - before) / (mocap.t_s[newest] - mocap.t_s[newest - FRAMES_A_TICK])
    return Series(ticks.copy(), rates)


@pytest.fixture(scope="session")
def campaign() -> Callable[..., tuple[Trial, ...]]:
    """A short campaign of the seed's robot, flown once for all tests."""
    return _campaign


@pytest.fixture(scope="session")
def record() -> Callable[..., Trial]:
    """Record an excitation on the bench; equal recordings are made once."""
    return _record
