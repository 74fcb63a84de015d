"""A simulated test bench: the robot under an excitation, as noisy sensors see it."""

import csv
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.trials import Series, Trial
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from softarm.simulator.simulator import Simulator

MOCAP_HZ = 120
MOCAP_NOISE_M, ANGLE_NOISE_RAD, PRESSURE_NOISE_KPA = 0.2e-3, 2e-3, 0.05


def _record(excitation: str, model: Model | None = None, seed: int = 0, noise: float = 1.0) -> Trial:
    """A trial at 1200 Hz physics: mocap at 120 Hz, commands, regulator and rail at 60 Hz."""
    draw = np.random.default_rng(seed)
    plan = EXCITATIONS[excitation]
    robot = Simulator(model, physics_rate_hz=1200.0)
    for _ in range(90):  # hang still before the recording
        robot.step(0.0, 0.0, 1 / 30)
    frames, slow = [], []
    for k in range(round((plan.duration_s + 0.5) * MOCAP_HZ)):
        t = k / MOCAP_HZ
        bodies = [(robot.cart_position_m[0], robot.model.arm.base_height_m, 0.0)]
        bodies += [(y, z, a) for (y, z), a in zip(robot.link_ends_m()[0], robot.link_angles_rad[0], strict=True)]
        poses = np.array(bodies) + noise * draw.normal(size=(6, 3)) * (MOCAP_NOISE_M, MOCAP_NOISE_M, ANGLE_NOISE_RAD)
        frames.append((t, t + 0.004, *poses.ravel()))
        if k % 2 == 0:
            command = plan.at(t)
            reading = robot.pressure_kpa[0] + noise * draw.normal() * PRESSURE_NOISE_KPA
            slow.append((t, *command, reading, robot.cart_position_m[0], robot.cart_velocity_m_s[0]))
        robot.step(*command, 1 / MOCAP_HZ)
    return _trial(excitation, np.array(frames, dtype=float), np.array(slow, dtype=float))


def _trial(name: str, frames: np.ndarray, slow: np.ndarray) -> Trial:
    bodies = ("cart", *(f"link{i}" for i in range(1, 6)))
    mocap = ["t_receive", *(f"{body}_{part}" for body in bodies for part in ("y", "z", "angle"))]
    t = slow[:, 0].copy()
    channels = {
        "command": Series(t, {"cart_velocity": slow[:, 1].copy(), "pressure": slow[:, 2].copy()}),
        "pressure": Series(t, {"pressure": slow[:, 3].copy()}),
        "rail": Series(t, {"position": slow[:, 4].copy(), "velocity": slow[:, 5].copy()}),
        "mocap": Series(frames[:, 0].copy(), {c: frames[:, i].copy() for i, c in enumerate(mocap, 1)}),
    }
    return Trial(name, name, Path(name), channels, "free")


def _write(trial: Trial, folder: Path) -> Path:
    """A trial as a folder that another stack might have recorded."""
    folder.mkdir(parents=True)
    (folder / "trial.yaml").write_text(f"kind: {trial.kind}\nrail: {trial.rail}\n")
    for name, series in trial.channels.items():
        with (folder / f"{name}.csv").open("w", newline="") as file:
            out = csv.writer(file)
            out.writerow(["t_capture" if name == "mocap" else "t", *series.columns])
            out.writerows(zip(series.t_s.tolist(), *(v.tolist() for v in series.columns.values()), strict=True))
    return folder


@pytest.fixture(scope="session")
def record() -> Callable[..., Trial]:
    """Record an excitation on the bench."""
    return _record


@pytest.fixture(scope="session")
def write() -> Callable[[Trial, Path], Path]:
    """Write a trial as a trial folder."""
    return _write


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real data."""
    folder = os.environ.get("SOFTARM_DATA")
    if folder is None or not Path(folder).is_dir():
        pytest.skip("SOFTARM_DATA does not name the folder of real data: nothing of it is loaded or diagnosed")
    return Path(folder)
