"""What the control loop asks of a device.

No call here blocks: a driver keeps its wire in a thread or task of its own.
"""

from typing import Protocol

from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class DeviceError(Exception):
    """Names the port, what was asked of it, what came back and what to do."""

    def __init__(self, port: str, command: str, problem: str, remedy: str) -> None:
        super().__init__(f"{port}: {command}: {problem}; {remedy}")
        self.port, self.command, self.problem, self.remedy = port, command, problem, remedy


class Device(Protocol):
    """Connects by itself and keeps trying; `problem` tells what is wrong, never an exception in the loop."""

    def start(self) -> None:
        """Begin to connect, from within the control loop's running asyncio loop; returns at once."""

    async def stop(self) -> None:
        """Leave the device safe (cart braked, muscle vented) and free the port."""

    def reset_fault(self) -> None:
        """A person acknowledged: clear the device's fault if its cause is gone. Nothing moves."""

    def problem(self) -> str | None:
        """Why there is no fresh reading: port, command and next step in one sentence; None: all is well."""


class WithoutWire:
    """The part of a device in this process that is the same for all: there is nothing that could come loose."""

    def start(self) -> None:
        """Nothing to connect to."""

    async def stop(self) -> None:
        """Nothing to free."""

    def reset_fault(self) -> None:
        """There are no faults."""

    def problem(self) -> str | None:
        """None."""
        return None


class MocapSource(Device, Protocol):
    """Poses of six rigid bodies."""

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """All frames since the last call, oldest first, each with the stamp of its arrival; empty when none came.

        `now_ns` is the tick's time: what has no clock of its own moves on to it.
        """


class PressureRegulator(Device, Protocol):
    """The muscle's pressure."""

    def read(self) -> PressureReading | None:
        """The newest reading; None before the first."""

    def write(self, armed: bool, pressure_kpa: float) -> None:
        """Set-point until the next call; `armed=False` vents. The device vents by itself when calls stop."""


class RailAxis(Device, Protocol):
    """The cart's axis."""

    def read(self) -> RailReading | None:
        """The newest reading; None before the first."""

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """Velocity set-point until the next call; `enable=False` brakes, then switches the drive off."""
