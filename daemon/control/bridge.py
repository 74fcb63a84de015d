"""Where cart and tip are while the cameras see nothing: carried on from what they saw last. Pure.

The cart goes on as the axis reads it. The tip hangs from it on a line whose angle swings as a damped pendulum, pulled
by the muscle and by the cart; the line is as long as angle and pressure make it. Axis and pressure are read while the
cameras are dark. The numbers are fitted to the simulator: `python -m softarm.benchmarks.bridging --fit` prints them.
"""

import math
from typing import NamedTuple

from softarm.daemon.control.alignment import Past
from softarm.daemon.control.plausibility import REACH_MAX_M, REACH_MIN_M
from softarm.schemas.model import Arm

SUBSTEP_S = 1 / 120  # what the numbers were fitted with
NOISE_M = 0.001  # of what is carried on


class Sighting(NamedTuple):
    """Cart and tip at an instant: seen, or carried on to it."""

    t_ns: int
    cart_y_m: float
    tip_y_m: float
    tip_z_m: float


class TipModel(NamedTuple):
    """Angle (rad) of the line from hinge to tip, 0 hanging: its acceleration; and the line's length (m)."""

    offset_rad_s2: float = -1.1245
    stiffness_1_s2: float = 52.77
    damping_1_s: float = 0.7047
    muscle_rad_s2_kpa: float = 0.5118  # towards -y
    cart_1_m: float = 2.493  # of the cart's acceleration, across the line
    bend_m: float = 0.0149  # shorter by so much times the angle's square
    bend_m_kpa: float = 0.0005  # and longer by so much times angle and pressure
    unlike_m_s2: float = 3.0  # standard deviation of the tip's acceleration, on robots that it was not fitted to

    def acceleration_rad_s2(self, angle_rad: float, rate_rad_s: float, kpa: float, cart_m_s2: float) -> float:
        """Of the angle."""
        return (
            self.offset_rad_s2
            - self.stiffness_1_s2 * angle_rad
            - self.damping_1_s * rate_rad_s
            - self.muscle_rad_s2_kpa * kpa
            - self.cart_1_m * cart_m_s2 * math.cos(angle_rad)
        )

    def bent_m(self, angle_rad: float, kpa: float) -> float:
        """What the line's length changes by."""
        return -self.bend_m * angle_rad * angle_rad + self.bend_m_kpa * kpa * angle_rad

    def deviation_m(self, dark_s: float) -> float:
        """Standard deviation of a tip that was carried on for so long."""
        return NOISE_M + 0.5 * self.unlike_m_s2 * dark_s * dark_s


class Readings(NamedTuple):
    """What goes on being read: of the axis and of the regulator, at the instant that a frame's stamp names."""

    axis: Past  # m, m/s
    pressure: Past  # kPa
    lag_ns: int  # a frame shows the axis of so long before its stamp

    def at(self, t_ns: int) -> tuple[float, float, float] | None:
        """Axis (m, m/s) and pressure (kPa); None where one is not known."""
        axis, pressure = self.axis.at(t_ns - self.lag_ns), self.pressure.at(t_ns - self.lag_ns)
        return None if axis is None or pressure is None else (*axis, pressure[0])


class Bridge:
    """Carries one sighting on."""

    def __init__(self, before: Sighting, seen: Sighting, readings: Readings, model: TipModel | None = None) -> None:
        """`seen` is carried on; `before` lies about a control step before it, for the angle's rate."""
        self._model, self._readings = model or TipModel(), readings
        self._t_ns = seen.t_ns
        self._angle_rad, length_m = _line(seen)
        step_s = (seen.t_ns - before.t_ns) * 1e-9
        self._rate_rad_s = (self._angle_rad - _line(before)[0]) / step_s
        self._read, earlier = readings.at(seen.t_ns), readings.at(before.t_ns)
        if self._read is None or earlier is None:
            self._read = None
            return
        axis_m, axis_m_s, kpa = self._read
        self._cart_off_m = seen.cart_y_m - axis_m
        self._length_m = length_m - self._model.bent_m(self._angle_rad, kpa)
        # A difference is the rate in the middle of its step.
        pull = self._model.acceleration_rad_s2(self._angle_rad, self._rate_rad_s, kpa, (axis_m_s - earlier[1]) / step_s)
        self._rate_rad_s += 0.5 * step_s * pull

    def at(self, t_ns: int) -> Sighting | None:
        """Where cart and tip are at an instant no earlier than the last; None once axis or pressure is silent too."""
        before, now = self._read, self._readings.at(t_ns)
        if before is None or now is None:
            self._read = None
            return None
        model, step_s = self._model, (t_ns - self._t_ns) * 1e-9
        substeps = max(1, round(step_s / SUBSTEP_S))
        for substep in range(substeps):
            share = (substep + 0.5) / substeps
            kpa = before[2] + share * (now[2] - before[2])
            cart_m_s2 = (now[1] - before[1]) / step_s if step_s > 0.0 else 0.0
            pull = model.acceleration_rad_s2(self._angle_rad, self._rate_rad_s, kpa, cart_m_s2)
            self._rate_rad_s += pull * step_s / substeps
            self._angle_rad += self._rate_rad_s * step_s / substeps
        self._t_ns, self._read = t_ns, now
        length_m = self._length_m + model.bent_m(self._angle_rad, now[2])
        length_m = min(max(length_m, REACH_MIN_M), REACH_MAX_M)
        cart_y_m = now[0] + self._cart_off_m
        tip_y_m = cart_y_m + length_m * math.sin(self._angle_rad)
        return Sighting(t_ns, cart_y_m, tip_y_m, _HINGE_Z_M - length_m * math.cos(self._angle_rad))


_HINGE_Z_M = Arm().base_height_m


def _line(seen: Sighting) -> tuple[float, float]:
    """Angle and length of the line from hinge to tip."""
    y_m, down_m = seen.tip_y_m - seen.cart_y_m, _HINGE_Z_M - seen.tip_z_m
    return math.atan2(y_m, down_m), math.hypot(y_m, down_m)
