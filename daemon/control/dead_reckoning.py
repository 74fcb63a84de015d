"""Dead reckoning: where cart and tip are while the cameras see nothing, carried on from what they saw last. Pure.

The cart goes on as the axis reads it. The tip hangs from it on a line whose angle swings as a damped pendulum, pulled
by the muscle and by the cart; the line is as long as angle and pressure make it. Axis and pressure are read while the
cameras are dark. The numbers are fitted to the simulator: `python -m softarm.benchmarks.bridging --fit` prints them.
One more is told by the robot itself in the second before the dark: how strong the arm's own torques are beside its
inertia. A payload shows there.
"""

import math
from collections import deque
from typing import NamedTuple

from softarm.daemon.control.alignment import Past
from softarm.daemon.control.plausibility import REACH_MAX_M, REACH_MIN_M
from softarm.daemon.control.workspace import HINGE_Z_M

SUBSTEP_S = 1 / 120  # what the numbers were fitted with
NOISE_M = 0.0015  # of what is carried on
TOLD_NS = 1_000_000_000  # that the arm's strength is told from
STEP_MAX_S = 0.08  # of its second differences
AS_FITTED = 200.0  # (rad/s^2)^2: the weight of the model's own strength beside what a swing tells
STRENGTHS = (0.5, 1.5)


class Sighting(NamedTuple):
    """Cart and tip at an instant: seen, or carried on to it."""

    t_ns: int
    cart_y_m: float
    tip_y_m: float
    tip_z_m: float


class TipModel(NamedTuple):
    """Angle (rad) of the line from hinge to tip, 0 hanging: its acceleration; and the line's length (m)."""

    offset_rad_s2: float = -0.9854
    stiffness_1_s2: float = 53.33
    damping_1_s: float = 0.6769
    muscle_rad_s2_kpa: float = 0.502  # towards -y
    cart_1_m: float = 2.523  # of the cart's acceleration, across the line
    bend_m: float = 0.01269  # shorter by so much times the angle's square
    bend_m_kpa: float = 0.0004988  # and longer by so much times angle and pressure
    unlike_m_s2: float = 1.2  # standard deviation of the tip's acceleration, on robots that it was not fitted to

    def own_rad_s2(self, angle_rad: float, rate_rad_s: float, kpa: float) -> float:
        """Acceleration of the angle by the arm's own torques and weight."""
        return (
            self.offset_rad_s2
            - self.stiffness_1_s2 * angle_rad
            - self.damping_1_s * rate_rad_s
            - self.muscle_rad_s2_kpa * kpa
        )

    def pulled_rad_s2(self, angle_rad: float, cart_m_s2: float) -> float:
        """And by the cart's."""
        return -self.cart_1_m * cart_m_s2 * math.cos(angle_rad)

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


class Strength:
    """How strong the arm's own torques are beside its inertia: 1 is as the simulator's.

    Told by least squares from the angle's second differences over ticks, of the last second in which it was seen.
    """

    def __init__(self) -> None:
        self._model = TipModel()
        self._before: deque[tuple[int, float, float]] = deque(maxlen=2)  # stamp, angle, axis (m)
        self._told: deque[tuple[int, float, float]] = (
            deque()
        )  # stamp, the model's acceleration: squared, times the seen

    def see(self, seen: Sighting, readings: Readings) -> None:
        """Take in a tick's newest sighting."""
        read = readings.at(seen.t_ns)
        if read is None:
            self._before.clear()
            return
        now = (seen.t_ns, _line(seen)[0], read[0])
        if len(self._before) == 2:
            self._tell(now, read[2])
        self._before.append(now)
        while self._told and seen.t_ns - self._told[0][0] > TOLD_NS:
            self._told.popleft()

    def _tell(self, now: tuple[int, float, float], kpa: float) -> None:
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
        self._told.append((now[0], own * own, own * seen))

    @property
    def value(self) -> float:
        """As far as it is told."""
        squared = sum(each[1] for each in self._told) + AS_FITTED
        product = sum(each[2] for each in self._told) + AS_FITTED
        return min(max(product / squared, STRENGTHS[0]), STRENGTHS[1])


class DeadReckoning:
    """Carries one sighting on."""

    def __init__(
        self,
        before: Sighting,
        seen: Sighting,
        readings: Readings,
        strength: float = 1.0,
        model: TipModel | None = None,
    ) -> None:
        """`seen` is carried on; `before` lies about a control step before it, for the angle's rate."""
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

    def at(self, t_ns: int) -> Sighting | None:
        """Where cart and tip are at an instant no earlier than the last; None once axis or pressure is silent too."""
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
        return Sighting(t_ns, cart_y_m, tip_y_m, HINGE_Z_M - length_m * math.cos(self._angle_rad))

    def _pull(self, for_s: float, kpa: float, cart_m_s2: float) -> None:
        own = self._strength * self._model.own_rad_s2(self._angle_rad, self._rate_rad_s, kpa)
        self._rate_rad_s += for_s * (own + self._model.pulled_rad_s2(self._angle_rad, cart_m_s2))


def _line(seen: Sighting) -> tuple[float, float]:
    """Angle and length of the line from hinge to tip."""
    y_m, down_m = seen.tip_y_m - seen.cart_y_m, HINGE_Z_M - seen.tip_z_m
    return math.atan2(y_m, down_m), math.hypot(y_m, down_m)
