"""The pressure regulator: a valve fills or vents a chamber, which a tube connects to the muscle."""

import math

import numpy as np

from softarm.reality.parameters import Regulator
from softarm.reality.wire import Wire


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
