"""Record a robot that differs from robot.xml by the dry friction of its elbow: python record.py recordings.

Each table has the commands and encoder readings in degrees, at 100 Hz.
"""

import csv
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

DURATION_S, RATE_HZ = 8.0, 100
HIDDEN_FRICTION_NM = 0.20  # robot.xml has 0.05
ENCODER_STEP_DEG = 0.05
JOINTS = ("shoulder", "elbow")

Commands = Callable[[float], np.ndarray]


def sweeps(random: np.random.Generator) -> Commands:
    """Return a sum of sines from 0.1 to 1.5 Hz for each joint, in rad."""
    frequency_hz, phase = np.geomspace(0.1, 1.5, 6), random.uniform(0, 2 * np.pi, (len(JOINTS), 6))
    return lambda t_s: 0.12 * np.sin(2 * np.pi * frequency_hz * t_s + phase).sum(axis=1)


def holds(random: np.random.Generator) -> Commands:
    """Return a random angle for each joint, which changes every 0.8 s, in rad."""
    angles = random.uniform(-0.6, 0.6, (int(DURATION_S / 0.8) + 1, len(JOINTS)))
    return lambda t_s: angles[int(t_s / 0.8)]


def record(commands: Commands, file: Path) -> None:
    """Simulate the robot at 2 kHz and write a table of commands and readings."""
    model = mujoco.MjModel.from_xml_path(str(Path(__file__).parent / "robot.xml"))
    model.opt.timestep = 5e-4
    model.joint("elbow").frictionloss[:] = HIDDEN_FRICTION_NM
    data = mujoco.MjData(model)
    with file.open("w", newline="") as out:
        table = csv.writer(out)
        table.writerow(["t", *(f"{joint}_command" for joint in JOINTS), *(f"{joint}_angle" for joint in JOINTS)])
        for tick in range(int(DURATION_S * RATE_HZ)):
            data.ctrl[:] = commands(data.time)
            readings = np.round(np.degrees(data.qpos) / ENCODER_STEP_DEG) * ENCODER_STEP_DEG
            table.writerow([f"{tick / RATE_HZ:.3f}", *np.degrees(data.ctrl).round(4), *readings.round(4)])
            mujoco.mj_step(model, data, nstep=round(1 / RATE_HZ / model.opt.timestep))


def main(folder: Path) -> None:
    """Write two tables of each kind of motion."""
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(1)
    for number in (1, 2):
        record(sweeps(random), folder / f"sweeps-{number}.csv")
        record(holds(random), folder / f"holds-{number}.csv")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
