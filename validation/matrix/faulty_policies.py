"""Policies that fail, each in its own way, and one that keeps the cart moving."""

import ctypes
import random
import time
from pathlib import Path

import numpy as np

from softarm.policies.base import Array, PolicySpec

AMPLITUDE_M_S, PERIOD_S, PRESSURE_KPA = 0.6, 1.2, 8.0
GOOD_S = 1.0  # a policy behaves for this long before it fails
HELD_S = 0.4  # how long one policy keeps the interpreter's lock


class Sweep:
    """Policy that moves the cart back and forth at up to 0.6 m/s."""

    spec = PolicySpec("sweep", "sweeps the cart back and forth", needs_target=False)

    def reset(self) -> None:
        """Start the sweep again."""
        self.ticks = 0

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the next command of the sweep, or the faulty answer once the policy fails."""
        self.ticks += 1
        if self.ticks / 30 > GOOD_S:
            answer = self._fail()
            if answer is not None:
                return answer
        phase = 2 * np.pi * self.ticks / 30 / PERIOD_S
        return np.array([AMPLITUDE_M_S * np.cos(phase), PRESSURE_KPA], dtype=np.float32)

    def _fail(self) -> Array | None:
        """Return the faulty answer, or None to go on."""
        return None


class Raises(Sweep):
    """Sweep that raises an error."""

    def _fail(self) -> Array | None:
        raise RuntimeError("a policy's own error")


class NotANumber(Sweep):
    """Sweep that answers NaN."""

    def _fail(self) -> Array | None:
        return np.full(2, np.nan, dtype=np.float32)


class WrongShape(Sweep):
    """Sweep that answers three numbers."""

    def _fail(self) -> Array | None:
        return np.zeros(3, dtype=np.float32)


class Excessive(Sweep):
    """Sweep that requests far more than the limits allow."""

    def _fail(self) -> Array | None:
        return np.array([100.0, 1e6], dtype=np.float32)


class Slow(Sweep):
    """Sweep that takes longer than a tick."""

    def _fail(self) -> Array | None:
        time.sleep(0.05)
        return None


class Stuck(Sweep):
    """Sweep that never answers."""

    def _fail(self) -> Array | None:
        time.sleep(3600)
        return None


class HoldsTheLock(Sweep):
    """Sweep that keeps the interpreter's lock once, so that no other thread runs meanwhile."""

    def _fail(self) -> Array | None:
        if self.ticks == int(GOOD_S * 30) + 1:
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


NAMES = {
    "sweep": Sweep,
    "raises": Raises,
    "not-a-number": NotANumber,
    "wrong-shape": WrongShape,
    "excessive": Excessive,
    "slow": Slow,
    "stuck": Stuck,
    "holds-the-lock": HoldsTheLock,
}

PLUGINS = {name: f"{__name__}:{policy.__name__}" for name, policy in NAMES.items()} | {"rush": f"{__name__}:Rush"}
