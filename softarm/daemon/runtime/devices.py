"""Devices of the control loop: the real robot's, or those of a robot simulated in this process."""

import time
from dataclasses import dataclass

from softarm.drivers.base import Device, MocapSource, PressureRegulator, RailAxis
from softarm.schemas.config import Config, DryveRail, Mocap
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
    """Return the drivers of the real robot or of its twin; raise PluginError as `motion_capture` does."""
    from softarm.drivers.rail.driver import DryveRailAxis
    from softarm.drivers.regulator.driver import TeensyRegulator

    return Devices(
        motion_capture(config.drivers.mocap),
        TeensyRegulator(config.drivers.regulator),
        DryveRailAxis(config.drivers.rail, config.control.realtime_priority),
    )


def motion_capture(config: Mocap) -> MocapSource:
    """Return the built-in Zenoh source of motion capture or the configured plug-in, or raise PluginError."""
    from softarm.drivers.mocap import plugged

    if config.driver != plugged.BUILT_IN:
        return plugged.load(config.driver, config.options)
    from softarm.drivers.mocap.driver import ZenohMocapSource

    return ZenohMocapSource(config)


def simulated_devices(model: Model | None = None, hold_s: float = DryveRail().hold_s) -> Devices:
    """Return a robot simulated in this process, which moves in real time from now on. Needs the extra `sim`.

    Args:
        model: model of the robot; the nominal one by default.
        hold_s: `drivers.rail.hold_s`, after which a set-point of the rail expires.
    """
    from softarm.drivers.bodies.in_process import InProcessRobot
    from softarm.drivers.bodies.simulated import SimulatedBody

    robot = InProcessRobot(SimulatedBody(model), time.monotonic_ns(), hold_s)
    return Devices(robot.mocap, robot.regulator, robot.rail, simulated=True)
