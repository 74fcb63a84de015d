"""Policies that keep the cart moving, and fail in one of several ways."""

import ctypes
import math
import random
import time
from pathlib import Path

import numpy as np

from softarm.policies.base import Array, PolicySpec

AMPLITUDE_M_S, PERIOD_S, PRESSURE_KPA = 0.6, 1.2, 8.0
GOOD_S = 1.0  # a policy behaves for this long before it fails
HELD_S = 0.4  # how long one policy keeps the interpreter's lock


class Sweep:
    """Policy that moves the cart back and forth at up to 0.6 m/s until its fault, if it has one."""

    spec = PolicySpec("sweep", "sweeps the cart back and forth", needs_target=False)

    def __init__(self, fault: str | None = None) -> None:
        """Set the fault to one of FAULTS, or None."""
        self._fault = fault

    def reset(self) -> None:
        """Start the sweep again."""
        self.ticks = 0

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the next command of the sweep, or the faulty answer once the policy fails."""
        self.ticks += 1
        answer = self._fail() if self.ticks / 30 > GOOD_S else None
        if answer is not None:
            return np.array(answer, dtype=np.float32)
        phase = 2 * np.pi * self.ticks / 30 / PERIOD_S
        return np.array([AMPLITUDE_M_S * np.cos(phase), PRESSURE_KPA], dtype=np.float32)

    def _fail(self) -> tuple[float, ...] | None:
        """Return the faulty answer, or None to go on."""
        match self._fault:
            case "raises":
                raise RuntimeError("a policy's own error")
            case "not-a-number":
                return math.nan, math.nan
            case "wrong-shape":
                return 0.0, 0.0, 0.0
            case "excessive":
                return 100.0, 1e6
            case "slow":
                time.sleep(0.05)
            case "stuck":
                time.sleep(3600)
            case "holds-the-lock" if self.ticks == int(GOOD_S * 30) + 1:
                hold_lock(HELD_S)
        return None


class Rush:
    """Policy that drives from end to end at full speed, and holds the interpreter's lock once a file appears."""

    spec = PolicySpec("rush", "sweeps from end to end at full speed", needs_target=False)

    def __init__(self, trigger: str, lock_s: float) -> None:
        self._trigger, self._lock_s = Path(trigger), lock_s
        self._draw, self._left = random.Random(0), 0

    def reset(self) -> None:
        """Draw a new command at the next step."""
        self._left = 0

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the current command, or a new one after 3 to 24 ticks."""
        if self._left <= 0:
            self._left = self._draw.randint(3, 24)
            self._command = np.array((self._draw.choice((-1.0, 1.0)), self._draw.uniform(0, 20)), dtype=np.float32)
        self._left -= 1
        if self._trigger.exists():
            self._trigger.unlink()
            hold_lock(self._lock_s)
        return self._command


def hold_lock(seconds: float) -> None:
    """Keep the interpreter's lock: PyDLL calls without releasing it."""
    ctypes.PyDLL(None).usleep(int(seconds * 1e6))


FAULTS = ("raises", "not-a-number", "wrong-shape", "excessive", "slow", "stuck", "holds-the-lock")
PLUGINS = {"sweep": f"{__name__}:Sweep", "rush": f"{__name__}:Rush"}
