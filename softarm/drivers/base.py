"""Interfaces between the control loop and the devices.

No call here blocks: a driver keeps its connection in a thread or task of its own.
"""

from typing import Protocol

from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class DeviceError(Exception):
    """Failure of a device, with the port, the operation, the cause and the next step."""

    def __init__(self, port: str, command: str, problem: str, remedy: str) -> None:
        super().__init__(f"{port}: {command}: {problem}; {remedy}")


class Device(Protocol):
    """Device that connects by itself and keeps trying.

    Failures are reported by `problem`, never as an exception in the control loop.
    """

    def start(self) -> None:
        """Begin to connect and return at once. The control loop's asyncio loop must be running."""

    async def stop(self) -> None:
        """Leave the device safe (cart braked, muscle vented) and free the port."""

    def reset_fault(self) -> None:
        """Clear the device's fault after an acknowledgement, if its cause is gone. Nothing moves."""

    def problem(self) -> str | None:
        """Return why there is no fresh reading, as one sentence with the next step, or None if all is well."""


class WithoutWire:
    """Base of devices inside this process, which have no connection that could fail."""

    def start(self) -> None:
        """Do nothing: there is no connection."""

    async def stop(self) -> None:
        """Do nothing: there is no port to free."""

    def reset_fault(self) -> None:
        """Do nothing: there are no faults."""

    def problem(self) -> str | None:
        """Return None: such a device is always ready."""
        return None


class MocapSource(Device, Protocol):
    """Source of the poses of six rigid bodies."""

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Return all frames since the last call, oldest first, each stamped on arrival.

        Args:
            now_ns: Time of the tick. A simulated source without a clock of its own advances to it.
        """


class PressureRegulator(Device, Protocol):
    """Regulator of the muscle's pressure."""

    def read(self) -> PressureReading | None:
        """Return the newest reading, or None if none has arrived."""

    def write(self, armed: bool, pressure_kpa: float) -> None:
        """Set the pressure until the next call. `armed=False` vents; the device also vents when calls stop."""


class RailAxis(Device, Protocol):
    """Axis that moves the cart along the rail."""

    def read(self) -> RailReading | None:
        """Return the newest reading, or None if none has arrived."""

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """Set the velocity until the next call. `enable=False` brakes, then disables the drive."""
