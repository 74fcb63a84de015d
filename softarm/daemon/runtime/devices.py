"""Devices of the control loop: the real robot's, or those of a robot simulated in this process."""

import time
from dataclasses import dataclass

from softarm.drivers.base import Device, MocapSource, PressureRegulator, RailAxis
from softarm.schemas.config import Config, Mocap
from softarm.schemas.model import Model


@dataclass(frozen=True, slots=True)
class Devices:
    """The three devices that the control loop reads and writes."""

    mocap: MocapSource
    regulator: PressureRegulator
    rail: RailAxis
    simulated: bool = False

    def all(self) -> tuple[Device, ...]:
        """Return the devices in the order in which they are started."""
        return (self.rail, self.regulator, self.mocap)


def real_devices(config: Config) -> Devices:
    """Return the drivers of the real robot, or of a twin that answers in its place.

    Raises:
        PluginError: The configured motion capture source cannot be used.
    """
    from softarm.drivers.rail.driver import DryveRailAxis
    from softarm.drivers.regulator.driver import TeensyRegulator

    return Devices(
        motion_capture(config.drivers.mocap),
        TeensyRegulator(config.drivers.regulator),
        DryveRailAxis(config.drivers.rail, config.control.realtime_priority),
    )


def motion_capture(config: Mocap) -> MocapSource:
    """Return the configured motion capture source: the built-in Zenoh source or a plug-in.

    Raises:
        PluginError: The configured plug-in cannot be used.
    """
    from softarm.drivers.mocap import plugged

    if config.driver != plugged.BUILT_IN:
        return plugged.load(config.driver, config.options)
    from softarm.drivers.mocap.driver import ZenohMocapSource

    return ZenohMocapSource(config)


def simulated_devices(model: Model | None = None) -> Devices:
    """Return the devices of a robot simulated in this process, which moves in real time from now on.

    Needs the extra `sim`.
    """
    from softarm.drivers.bodies.in_process import InProcessRobot
    from softarm.drivers.bodies.simulated import SimulatedBody

    robot = InProcessRobot(SimulatedBody(model), time.monotonic_ns())
    return Devices(robot.mocap, robot.regulator, robot.rail, simulated=True)
