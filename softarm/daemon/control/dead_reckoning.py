"""Dead reckoning of cart and tip during a dropout of motion capture. Pure.

The cart follows the axis read-back. The line from hinge to tip swings like a damped pendulum, driven by the muscle and
by the cart; its length depends on angle and pressure. Axis and pressure are still read during the dropout. The numbers
are fitted to the simulator (`python -m benchmarks.bridging --fit` prints them), except one that is estimated on the
robot in the second before the dropout: the strength of the arm's own torques relative to its inertia, which a payload
reduces.
"""

import math
from collections import deque
from typing import NamedTuple

from softarm.daemon.control.alignment import ReadingHistory
from softarm.daemon.control.plausibility import REACH_MAX_M, REACH_MIN_M
from softarm.daemon.control.workspace import HINGE_Z_M

SUBSTEP_S = 1 / 120  # as used for the fit
NOISE_M = 0.0015  # standard deviation at the start of a dropout
STRENGTH_WINDOW_NS = 1_000_000_000  # window of the estimate of the arm's strength
STEP_MAX_S = 0.08  # longest step of its second differences
PRIOR_WEIGHT = 200.0  # (rad/s^2)^2: weight of the nominal strength in the estimate
STRENGTHS = (0.5, 1.5)


class TrackedPose(NamedTuple):
    """Positions of cart and tip at an instant, seen or estimated."""

    t_ns: int
    cart_y_m: float
    tip_y_m: float
    tip_z_m: float


class TipModel(NamedTuple):
    """Model of the line from hinge to tip: acceleration of its angle (rad, 0 hanging) and its length (m)."""

    offset_rad_s2: float = -0.9854
    stiffness_1_s2: float = 53.33
    damping_1_s: float = 0.6769
    muscle_rad_s2_kpa: float = 0.502  # towards -y
    cart_1_m: float = 2.523  # per acceleration of the cart across the line
    bend_m: float = 0.01269  # shortening per squared angle
    bend_m_kpa: float = 0.0004988  # lengthening per angle and pressure
    unlike_m_s2: float = 1.2  # standard deviation of the tip's acceleration on other robots than the fitted one

    def own_rad_s2(self, angle_rad: float, rate_rad_s: float, kpa: float) -> float:
        """Return the acceleration of the angle due to weight, damping, stiffness and muscle."""
        return (
            self.offset_rad_s2
            - self.stiffness_1_s2 * angle_rad
            - self.damping_1_s * rate_rad_s
            - self.muscle_rad_s2_kpa * kpa
        )

    def pulled_rad_s2(self, angle_rad: float, cart_m_s2: float) -> float:
        """Return the acceleration of the angle due to the cart."""
        return -self.cart_1_m * cart_m_s2 * math.cos(angle_rad)

    def bent_m(self, angle_rad: float, kpa: float) -> float:
        """Return the change of the line's length, m."""
        return -self.bend_m * angle_rad * angle_rad + self.bend_m_kpa * kpa * angle_rad

    def deviation_m(self, bridged_s: float) -> float:
        """Return the standard deviation of the tip after a dropout of this duration, m."""
        return NOISE_M + 0.5 * self.unlike_m_s2 * bridged_s * bridged_s


class Readings(NamedTuple):
    """Readings of axis and regulator, aligned with the stamps of frames."""

    axis: ReadingHistory  # m, m/s
    pressure: ReadingHistory  # kPa
    lag_ns: int  # a frame shows the axis this long before its stamp

    def at(self, t_ns: int) -> tuple[float, float, float] | None:
        """Return position (m), velocity (m/s) and pressure (kPa), or None if one is unknown."""
        axis, pressure = self.axis.at(t_ns - self.lag_ns), self.pressure.at(t_ns - self.lag_ns)
        return None if axis is None or pressure is None else (*axis, pressure[0])


class Strength:
    """Strength of the arm's own torques relative to its inertia; 1 for the simulated arm.

    Estimated by least squares from the angle's second differences over the last second with tracking.
    """

    def __init__(self) -> None:
        self._model = TipModel()
        self._before: deque[tuple[int, float, float]] = deque(maxlen=2)  # stamp, angle, axis (m)
        # Stamp, squared acceleration of the model, product of the model's and the observed acceleration.
        self._samples: deque[tuple[int, float, float]] = deque()

    def update(self, seen: TrackedPose, readings: Readings) -> None:
        """Process the newest tracked pose of a tick."""
        read = readings.at(seen.t_ns)
        if read is None:
            self._before.clear()
            return
        now = (seen.t_ns, _line(seen)[0], read[0])
        if len(self._before) == 2:
            self._add_sample(now, read[2])
        self._before.append(now)
        while self._samples and seen.t_ns - self._samples[0][0] > STRENGTH_WINDOW_NS:
            self._samples.popleft()

    def _add_sample(self, now: tuple[int, float, float], kpa: float) -> None:
        one, two = self._before
        first_s, second_s = (two[0] - one[0]) * 1e-9, (now[0] - two[0]) * 1e-9
        if max(first_s, second_s) > STEP_MAX_S:
            return

        def second_difference(place: int) -> float:
            rates = (two[place] - one[place]) / first_s, (now[place] - two[place]) / second_s
            return 2.0 * (rates[1] - rates[0]) / (first_s + second_s)

        angle_rad = float(two[1])
        rate_rad_s = (now[1] - one[1]) / (first_s + second_s)
        own = self._model.own_rad_s2(angle_rad, rate_rad_s, kpa)
        seen = second_difference(1) - self._model.pulled_rad_s2(angle_rad, second_difference(2))
        self._samples.append((now[0], own * own, own * seen))

    @property
    def value(self) -> float:
        """Return the estimate; 1 without data."""
        squared = sum(each[1] for each in self._samples) + PRIOR_WEIGHT
        product = sum(each[2] for each in self._samples) + PRIOR_WEIGHT
        return min(max(product / squared, STRENGTHS[0]), STRENGTHS[1])


class DeadReckoning:
    """Extrapolation of one tracked pose during a dropout."""

    def __init__(
        self,
        before: TrackedPose,
        seen: TrackedPose,
        readings: Readings,
        strength: float = 1.0,
        model: TipModel | None = None,
    ) -> None:
        """Start from the last seen pose and one about a control step earlier, for the angle's rate."""
        self._model, self._readings, self._strength = model or TipModel(), readings, strength
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
        self._pull(0.5 * step_s, kpa, (axis_m_s - earlier[1]) / step_s)

    def at(self, t_ns: int) -> TrackedPose | None:
        """Return the pose at an instant not before the last, or None once axis or pressure is missing too."""
        before, now = self._read, self._readings.at(t_ns)
        if before is None or now is None:
            self._read = None
            return None
        step_s = (t_ns - self._t_ns) * 1e-9
        substeps = max(1, round(step_s / SUBSTEP_S))
        cart_m_s2 = (now[1] - before[1]) / step_s if step_s > 0.0 else 0.0
        for substep in range(substeps):
            kpa = before[2] + (substep + 0.5) / substeps * (now[2] - before[2])
            self._pull(step_s / substeps, kpa, cart_m_s2)
            self._angle_rad += self._rate_rad_s * step_s / substeps
        self._t_ns, self._read = t_ns, now
        length_m = self._length_m + self._model.bent_m(self._angle_rad, now[2])
        length_m = min(max(length_m, REACH_MIN_M), REACH_MAX_M)
        cart_y_m = now[0] + self._cart_off_m
        tip_y_m = cart_y_m + length_m * math.sin(self._angle_rad)
        return TrackedPose(t_ns, cart_y_m, tip_y_m, HINGE_Z_M - length_m * math.cos(self._angle_rad))

    def _pull(self, for_s: float, kpa: float, cart_m_s2: float) -> None:
        own = self._strength * self._model.own_rad_s2(self._angle_rad, self._rate_rad_s, kpa)
        self._rate_rad_s += for_s * (own + self._model.pulled_rad_s2(self._angle_rad, cart_m_s2))


def _line(seen: TrackedPose) -> tuple[float, float]:
    """Return angle and length of the line from hinge to tip."""
    y_m, down_m = seen.tip_y_m - seen.cart_y_m, HINGE_Z_M - seen.tip_z_m
    return math.atan2(y_m, down_m), math.hypot(y_m, down_m)
