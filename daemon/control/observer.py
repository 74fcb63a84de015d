"""From what the devices measured to what the policy is fed. Pure; time comes in with the inputs."""

import math

import numpy as np
from numpy.typing import NDArray

from softarm.daemon.control.records import Inputs, Observed
from softarm.daemon.control.safety import CartState
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation

CART, TIP = 0, -1  # places in MocapFrame.bodies


def is_usable(frame: MocapFrame) -> bool:
    """The cart and the tip are seen, and every number of theirs is one."""
    return all(
        body.tracked and math.isfinite(body.y_m) and math.isfinite(body.z_m)
        for body in (frame.bodies[CART], frame.bodies[TIP])
    )


class Observer:
    """Keeps the newest usable frame and the one used a tick before, for first differences.

    Velocities are first differences over a control step ([P] section 3.3), by real capture stamps; zero until
    there are two frames.
    """

    def __init__(self, stale_ns: int, disagreement_m: float) -> None:
        self._stale_ns = stale_ns  # a gap longer than this is not differenced over
        self._disagreement_m = disagreement_m  # between axis and mocap: farther apart, they disagree
        self._frame: MocapFrame | None = None
        self._velocities = (0.0, 0.0, 0.0)  # cart, tip y, tip z
        self.newest: MocapFrame | None = None  # usable or not
        self.pressure: PressureReading | None = None
        self.rail: RailReading | None = None
        self.frames_in_a_row = 0  # usable frames without a longer gap, for arming
        self.frames_lost = 0  # by the bridge's own count
        self.disagreeing_ticks = 0  # in a row, until now

    def update(self, inputs: Inputs) -> None:
        """Take in a tick's measurements."""
        self.pressure = inputs.pressure
        self.rail = inputs.rail
        usable: MocapFrame | None = None
        for frame in inputs.mocap:
            if self.newest is not None and frame.sequence > self.newest.sequence + 1:
                self.frames_lost += frame.sequence - self.newest.sequence - 1
            self.newest = frame
            if is_usable(frame) and (self._frame is None or frame.t_capture_ns > self._frame.t_capture_ns):
                usable = frame
                self.frames_in_a_row += 1
        if usable is not None:
            self._difference(usable)
            self._frame = usable
        elif (self.mocap_age_ns(inputs.t_ns) or 0) > self._stale_ns:
            self.frames_in_a_row = 0
            self._velocities = (0.0, 0.0, 0.0)
        distance_m = self.rail_against_mocap_m()
        apart = distance_m is not None and distance_m > self._disagreement_m
        self.disagreeing_ticks = self.disagreeing_ticks + 1 if apart else 0

    def _difference(self, frame: MocapFrame) -> None:
        before = self._frame
        step_ns = frame.t_capture_ns - before.t_capture_ns if before is not None else 0
        if before is None or step_ns > self._stale_ns:
            self._velocities = (0.0, 0.0, 0.0)
            return
        cart, old_cart = frame.bodies[CART], before.bodies[CART]
        tip, old_tip = frame.bodies[TIP], before.bodies[TIP]
        per_s = 1e9 / step_ns
        self._velocities = (
            (cart.y_m - old_cart.y_m) * per_s,
            (tip.y_m - old_tip.y_m) * per_s,
            (tip.z_m - old_tip.z_m) * per_s,
        )

    def mocap_age_ns(self, now_ns: int) -> int | None:
        """Age of the newest usable frame's capture; None before the first."""
        return None if self._frame is None else now_ns - self._frame.t_capture_ns

    def cart(self, now_ns: int) -> CartState | None:
        """The axis's own read-back, carried forward to now; None when there is none."""
        if self.rail is None:
            return None
        age_s = max(0, now_ns - self.rail.t_receive_ns) * 1e-9
        return CartState(self.rail.position_m + self.rail.velocity_m_s * age_s, self.rail.velocity_m_s)

    def rail_against_mocap_m(self) -> float | None:
        """Distance between the cart as the axis reads it and as mocap sees it, brought to one instant."""
        if self.rail is None or self._frame is None:
            return None
        lead_s = (self._frame.t_capture_ns - self.rail.t_receive_ns) * 1e-9
        return abs(self.rail.position_m + self.rail.velocity_m_s * lead_s - self._frame.bodies[CART].y_m)

    def observe(self, now_ns: int, previous_cart_velocity_m_s: float) -> Observed | None:
        """The observation and its age; None while a sensor has never been heard."""
        if self._frame is None or self.pressure is None or self.rail is None:
            return None
        cart, tip = self._frame.bodies[CART], self._frame.bodies[TIP]
        cart_velocity, tip_vy, tip_vz = self._velocities
        return Observed(
            values=Observation(
                cart_position_m=cart.y_m,
                cart_velocity_m_s=cart_velocity,
                tip_y_m=tip.y_m,
                tip_z_m=tip.z_m,
                tip_vy_m_s=tip_vy,
                tip_vz_m_s=tip_vz,
                previous_cart_velocity_command_m_s=previous_cart_velocity_m_s,
                pressure_kpa=self.pressure.pressure_kpa,
            ),
            mocap_sequence=self._frame.sequence,
            mocap_age_ns=now_ns - self._frame.t_capture_ns,
            pressure_age_ns=now_ns - self.pressure.t_receive_ns,
            rail_age_ns=now_ns - self.rail.t_receive_ns,
        )


def as_array(observed: Observed) -> NDArray[np.float32]:
    """The observation as the policy takes it, float32 [8]."""
    return np.array(observed.values, dtype=np.float32)
