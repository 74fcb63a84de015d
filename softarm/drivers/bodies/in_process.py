"""Devices of a body inside this process: in lockstep, without sleeping and without wires.

The caller supplies the time: each `mocap.read(now_ns)` first advances the body to `now_ns` under the last commands. The
same devices serve offline flights, where time jumps by a tick, and `softarm run --simulated` in real time.
"""

from dataclasses import replace

from softarm.drivers.base import MocapSource, WithoutWire
from softarm.drivers.bodies.base import Body
from softarm.schemas.config import DryveRail
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class InProcessRobot:
    """Body and its three devices at time `now_ns`.

    Increase `now_ns` to let time pass without motion. A set-point of the rail that is not renewed for `hold_s` becomes
    zero, as in the rail's process.
    """

    def __init__(self, body: Body, now_ns: int = 0, hold_s: float = DryveRail().hold_s) -> None:
        self.body = body
        self.now_ns = now_ns
        self._hold_ns = round(hold_s * 1e9)
        self.mocap: MocapSource = InProcessMocap(self)
        self.regulator = InProcessRegulator(self)
        self.rail = InProcessRail(self)

    @property
    def body_started_ns(self) -> int:
        """Time of the caller at which the body's clock was zero."""
        return self.now_ns - self.body.now_ns

    def advance(self, now_ns: int) -> None:
        """Advance to a time under the last commands."""
        held_until_ns = min(now_ns, self.rail.written_ns + self._hold_ns)
        self._step(self.rail.set_point_m_s, held_until_ns)
        self._step(0.0, now_ns)

    def _step(self, velocity_m_s: float, until_ns: int) -> None:
        if until_ns > self.now_ns:
            self.body.step(velocity_m_s, self.regulator.set_point_kpa, until_ns - self.now_ns)
            self.now_ns = until_ns


class InProcessMocap(WithoutWire):
    """Motion capture of the body."""

    def __init__(self, robot: InProcessRobot) -> None:
        self._robot = robot

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Advance the body to now and return its frames."""
        self._robot.advance(now_ns)
        start_ns = self._robot.body_started_ns
        return tuple(
            replace(frame, t_capture_ns=frame.t_capture_ns + start_ns, t_receive_ns=frame.t_receive_ns + start_ns)
            for frame in self._robot.body.frames()
        )


class InProcessRegulator(WithoutWire):
    """Regulator without lag or delay of its own; the body has them."""

    def __init__(self, robot: InProcessRobot) -> None:
        self._robot = robot
        self._armed = False
        self._sequence = 0
        self._seen: PressureReading | None = None
        self._newest: PressureReading | None = None
        self.set_point_kpa = 0.0

    def read(self) -> PressureReading | None:
        """Return the newest reading of the sensor."""
        seen = self._robot.body.gauge()
        if seen is not self._seen:
            self._seen, stamp_ns = seen, seen.t_receive_ns + self._robot.body_started_ns
            self._newest = replace(seen, t_receive_ns=stamp_ns, armed=self._armed, sequence=self._sequence)
        return self._newest

    def write(self, armed: bool, pressure_kpa: float) -> None:
        """Set the pressure until the next call; `armed=False` vents."""
        self._armed = armed
        self._sequence += 1
        self.set_point_kpa = pressure_kpa if armed else 0.0


class InProcessRail(WithoutWire):
    """Axis without ramp or delay of its own; the body has them."""

    def __init__(self, robot: InProcessRobot) -> None:
        self._robot = robot
        self._enabled = False
        self._seen: RailReading | None = None
        self._newest: RailReading | None = None
        self.set_point_m_s = 0.0
        self.written_ns = robot.now_ns

    def read(self) -> RailReading | None:
        """Return the newest read-back of the axis."""
        seen = self._robot.body.encoder()
        if seen is not self._seen:
            self._seen, stamp_ns = seen, seen.t_receive_ns + self._robot.body_started_ns
            self._newest = replace(seen, t_receive_ns=stamp_ns, enabled=self._enabled)
        return self._newest

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """Set the velocity until the next call or until it expires; a disabled axis stands still."""
        self._enabled = enable
        self.written_ns = self._robot.now_ns
        self.set_point_m_s = velocity_m_s if enable else 0.0
