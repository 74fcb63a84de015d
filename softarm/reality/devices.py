"""Regulator and rail drive: from a delayed command to the pressure in the muscle and to the force on the cart.

The regulator's valve fills or vents a chamber, which a tube connects to the muscle. The rail's servo ramps a reference
and closes a proportional loop on the motor's velocity. Its mechanism may have play between motor and cart, friction, a
cable that pulls and force ripple of the gear. The finite gain of the loop lets the swinging arm move the cart.
"""

import math
from collections import deque

import numpy as np

from softarm.reality.parameters import MOTOR_KG, Rail, Regulator


class Wire:
    """Delayed queue: a constant delay plus an exponential jitter; a late command also delays the next one."""

    def __init__(self, delay_s: float, jitter_s: float, random: np.random.Generator) -> None:
        self._delay_s, self._jitter_s, self._random = delay_s, jitter_s, random
        self._queue: deque[tuple[float, float]] = deque()
        self._received = 0.0

    def send(self, t_s: float, value: float) -> None:
        """Send a command at a time, s."""
        arrival = t_s + self._delay_s
        if self._jitter_s:
            arrival += float(self._random.exponential(self._jitter_s))
        self._queue.append((arrival, value))

    def receive(self, t_s: float) -> float:
        """Return the newest command that has arrived by a time, or 0 before the first."""
        while self._queue and self._queue[0][0] <= t_s:
            self._received = self._queue.popleft()[1]
        return self._received


class PressureRegulator:
    """Model of the pressure regulator; `pressure_kpa` is the gauge pressure in the muscle."""

    def __init__(self, parameters: Regulator, dt_s: float, random: np.random.Generator) -> None:
        self._p, self._dt_s = parameters, dt_s
        self.wire = Wire(parameters.dead_time_s, parameters.dead_time_jitter_s, random)
        self.pressure_kpa = 0.0
        self._chamber_kpa = 0.0
        self._in_force_kpa = 0.0
        self._kept = math.exp(-parameters.leak_1_s * dt_s)
        # The tube is in series and causes part of the lag: subtract it, so that the total lag is the declared one.
        self._fill = _share(dt_s, max(0.0, parameters.inflate_s - parameters.tube_s))
        self._vent = _share(dt_s, max(0.0, parameters.deflate_s - parameters.tube_s))
        self._tube = _share(dt_s, parameters.tube_s)

    def step(self, t_s: float) -> float:
        """Advance from `t_s` by one step and return the new pressure in the muscle, kPa."""
        p = self._p
        command = self.wire.receive(t_s)
        if abs(command - self._in_force_kpa) > p.deadband_kpa or p.deadband_kpa == 0:
            self._in_force_kpa = command
        wanted = min(self._in_force_kpa * (1 + p.gain) + p.offset_kpa, p.ceiling_kpa)
        gap = wanted - self._chamber_kpa
        if not (abs(gap) < p.stick_kpa and self._chamber_kpa <= p.stick_below_kpa):
            flow = gap * (self._fill if gap > 0 else self._vent)
            limit = p.flow_limit_kpa_s * self._dt_s
            self._chamber_kpa += min(max(flow, -limit), limit)
        self._chamber_kpa *= self._kept
        self.pressure_kpa += (self._chamber_kpa - self.pressure_kpa) * self._tube
        return self.pressure_kpa


def _share(dt_s: float, time_s: float) -> float:
    """Return the share of an error that a first-order lag removes in a step."""
    return -math.expm1(-dt_s / time_s) if time_s > 0 else 1.0


# With play, the motor is a separate body whose mass is part of the cart's; beyond the play, the belt is a stiff spring.
BELT_N_M = 2e4
BELT_N_S_M = 40.0


class Servo:
    """Servo drive of the rail; `position_m` and `velocity_m_s` are its read-back, with its assumed feed constant."""

    def __init__(self, parameters: Rail, dt_s: float, cart_position_m: float, random: np.random.Generator) -> None:
        self._p, self._dt_s = parameters, dt_s
        self.wire = Wire(parameters.delay_s, parameters.delay_jitter_s, random)
        self.motor_kg = MOTOR_KG if parameters.backlash_m else 0.0
        # Dry friction on the cart; the mechanics apply it.
        self.friction_n = 0.0
        # The drive is homed here and counts from here with its assumed feed constant.
        self._start_m = cart_position_m
        self._motor_m, self._motor_m_s = cart_position_m, 0.0
        self._ramp_m_s = self._reference_m_s = 0.0
        self._lag = -math.expm1(-dt_s / parameters.lag_s) if parameters.lag_s else 1.0

    @property
    def position_m(self) -> float:
        """Return the position that the drive measures, m."""
        return self._start_m + (self._motor_m - self._start_m) / (1 + self._p.feed_error)

    @property
    def velocity_m_s(self) -> float:
        """Return the velocity that the drive measures, m/s."""
        return self._motor_m_s / (1 + self._p.feed_error)

    def sense(self, cart_position_m: float, cart_velocity_m_s: float) -> None:
        """Read the encoder: without play, motor and cart move together."""
        if not self.motor_kg:
            self._motor_m, self._motor_m_s = cart_position_m, cart_velocity_m_s

    def step(self, t_s: float, cart_position_m: float, cart_velocity_m_s: float) -> float:
        """Return the force on the cart for the step that begins at `t_s`, without dry friction."""
        self.sense(cart_position_m, cart_velocity_m_s)
        force = self._motor_force(t_s)
        if self.motor_kg:
            force = self._through_the_play(force, cart_position_m, cart_velocity_m_s)
        return force + self._mechanism(cart_position_m, cart_velocity_m_s)

    def _motor_force(self, t_s: float) -> float:
        p = self._p
        step = p.acceleration_m_s2 * self._dt_s
        gap = self.wire.receive(t_s) - self._ramp_m_s
        self._ramp_m_s += min(max(gap, -step), step)
        change = (self._ramp_m_s - self._reference_m_s) * self._lag
        self._reference_m_s += change
        error = self._reference_m_s - self.velocity_m_s
        force = p.velocity_gain_n_s_m * error + p.feedforward_kg * change / self._dt_s
        return min(max(force, -p.force_limit_n), p.force_limit_n)

    def _through_the_play(self, motor_force_n: float, cart_m: float, cart_m_s: float) -> float:
        """Advance the motor by a step and return the force of the belt on the cart."""
        ahead = self._motor_m - cart_m
        half = self._p.backlash_m / 2
        stretch = ahead - min(max(ahead, -half), half)
        belt = 0.0
        if stretch:
            belt = BELT_N_M * stretch + BELT_N_S_M * (self._motor_m_s - cart_m_s)
            # The contact pushes and cannot pull.
            belt = belt if belt * stretch > 0 else 0.0
        self._motor_m_s += (motor_force_n - belt) / MOTOR_KG * self._dt_s
        self._motor_m += self._motor_m_s * self._dt_s
        return belt

    def _mechanism(self, cart_m: float, cart_m_s: float) -> float:
        p = self._p
        if p.coulomb_n or p.stiction_n:
            self.friction_n = p.coulomb_n + p.stiction_n * math.exp(-((cart_m_s / p.stribeck_m_s) ** 2))
        force = -p.viscous_n_s_m * cart_m_s
        if p.cable_n_m and cart_m > p.cable_taut_m:
            force -= p.cable_n_m * (cart_m - p.cable_taut_m)
        if p.ripple_n:
            force += p.ripple_n * math.sin(2 * math.pi * cart_m / p.ripple_period_m)
        return force
