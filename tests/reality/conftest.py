"""A short flight with all signals, and its measurements."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from softarm.reality.parameters import RobotParameters
from softarm.reality.robot import Robot
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

PERIOD_S = 1 / 30
GROUPS = {
    "Regulator": "regulator",
    "Rail": "rail",
    "Arm": "arm",
    "Mocap": "mocap",
    "PressureSensor": "pressure_sensor",
    "RailSensor": "rail_sensor",
    "Clock": "clock",
}


@dataclass(frozen=True)
class Flown:
    """Truth at every tick, and everything that was received."""

    pressure_kpa: np.ndarray  # [T]
    cart_m: np.ndarray  # [T]
    ends_m: np.ndarray  # [T, 5, 2]
    angles_rad: np.ndarray  # [T, 5]
    frames: list[MocapFrame]
    gauge: list[PressureReading]
    encoder: list[RailReading]


def shake(t_s: float) -> tuple[float, float]:
    """Both ways along the rail with a stop, pressure up and down and nearly off."""
    velocity = 0.6 if t_s < 0.3 else -0.6 if t_s < 0.7 else 0.0 if t_s < 1.0 else 0.4
    pressure = 15.0 if t_s < 0.5 else 4.0 if t_s < 0.8 else 1.0 if t_s < 1.1 else 6.0
    return velocity, pressure


def fly(parameters: RobotParameters, seconds: float = 1.5, excitation: Any = shake, **robot_options: Any) -> Flown:
    robot = Robot(parameters, 1, **robot_options)
    truths = []
    for tick in range(round(seconds / PERIOD_S)):
        robot.command(tick * PERIOD_S, *excitation(tick * PERIOD_S))
        robot.advance((tick + 1) * PERIOD_S)
        truths.append(robot.truth)
    return Flown(
        np.array([truth.pressure_kpa for truth in truths]),
        np.array([truth.cart_position_m for truth in truths]),
        np.array([truth.link_ends_m for truth in truths]),
        np.array([truth.link_angles_rad for truth in truths]),
        robot.mocap(),
        robot.pressure(),
        robot.rail(),
    )


def perturb(group: str, **values: float) -> RobotParameters:
    """The nominal robot with some values of one group."""
    name, nominal = GROUPS[group], RobotParameters()
    return replace(nominal, **{name: replace(getattr(nominal, name), **values)})


@pytest.fixture(name="fly")
def _fly() -> Any:
    return fly


@pytest.fixture(name="perturb")
def _perturb() -> Any:
    return perturb


@pytest.fixture(scope="session")
def nominal() -> Flown:
    return fly(RobotParameters())
