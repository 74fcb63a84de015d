"""Policies that fail, each in its own way, and one that keeps the cart moving."""

import ctypes
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from softarm.policies.base import Array, PolicySpec
from validation.daemon_process import write_plugin

AMPLITUDE_M_S, PERIOD_S, PRESSURE_KPA = 0.6, 1.2, 8.0
GOOD_S = 1.0  # a policy behaves for this long before it fails
HELD_S = 0.4  # how long one policy keeps the interpreter's lock


class Sweep:
    """Policy that moves the cart back and forth at up to 0.6 m/s."""

    spec = PolicySpec("sweep", "sweeps the cart back and forth", needs_target=False)
    fail: Callable[[int], Array | None] = staticmethod(lambda tick: None)

    def reset(self) -> None:
        """Start the sweep again."""
        self.ticks = 0

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the next command of the sweep, or the faulty answer once the policy fails."""
        self.ticks += 1
        if self.ticks / 30 > GOOD_S:
            answer = self.fail(self.ticks)
            if answer is not None:
                return answer
        phase = 2 * np.pi * self.ticks / 30 / PERIOD_S
        return np.array([AMPLITUDE_M_S * np.cos(phase), PRESSURE_KPA], dtype=np.float32)


def _raise(_: int) -> Array:
    raise RuntimeError("a policy's own error")


def _answer_nan(_: int) -> Array:
    return np.full(2, np.nan, dtype=np.float32)


def _answer_three_numbers(_: int) -> Array:
    return np.zeros(3, dtype=np.float32)


def _exceed_the_limits(_: int) -> Array:
    return np.array([100.0, 1e6], dtype=np.float32)


def _take_longer_than_a_tick(_: int) -> None:
    time.sleep(0.05)


def _never_answer(_: int) -> None:
    time.sleep(3600)


def _hold_the_lock_once(tick: int) -> None:
    if tick == int(GOOD_S * 30) + 1:
        # PyDLL calls without releasing the lock.
        ctypes.PyDLL(None).usleep(int(HELD_S * 1e6))


class Raises(Sweep):
    """Sweep that raises an error."""

    fail = staticmethod(_raise)


class NotANumber(Sweep):
    """Sweep that answers NaN."""

    fail = staticmethod(_answer_nan)


class WrongShape(Sweep):
    """Sweep that answers three numbers."""

    fail = staticmethod(_answer_three_numbers)


class Excessive(Sweep):
    """Sweep that requests far more than the limits allow."""

    fail = staticmethod(_exceed_the_limits)


class Slow(Sweep):
    """Sweep that takes longer than a tick."""

    fail = staticmethod(_take_longer_than_a_tick)


class Stuck(Sweep):
    """Sweep that never answers."""

    fail = staticmethod(_never_answer)


class HoldsTheLock(Sweep):
    """Sweep that keeps the interpreter's lock once, so that no other thread runs meanwhile."""

    fail = staticmethod(_hold_the_lock_once)


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


def install(folder: Path) -> None:
    """Write the policies' metadata to a folder, so that a daemon with it on PYTHONPATH finds them as plug-ins."""
    write_plugin(folder, "faulty_policies", {name: f"{__name__}:{each.__name__}" for name, each in NAMES.items()})
