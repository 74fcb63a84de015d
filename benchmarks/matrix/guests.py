"""Policies that fail, each in its own way, and one that keeps the cart moving. As installed plugins of the daemon."""

import ctypes
import time
from pathlib import Path

import numpy as np

from softarm.policies.base import Array, PolicySpec

AMPLITUDE_M_S, PERIOD_S, PRESSURE_KPA = 0.6, 1.2, 8.0
GOOD_S = 1.0  # before a policy fails
HELD_S = 0.4  # for which one keeps the interpreter's lock


class Sweep:
    """To and fro for ever, at up to 0.6 m/s."""

    spec = PolicySpec("sweep", "sweeps the cart to and fro", needs_target=False)

    def reset(self) -> None:
        """See `Policy.reset`."""
        self.ticks = 0

    def step(self, observation: Array, goal: Array) -> Array:
        """See `Policy.step`."""
        self.ticks += 1
        if self.ticks / 30 > GOOD_S:
            failing = self.fail()
            if failing is not None:
                return failing
        phase = 2 * np.pi * self.ticks / 30 / PERIOD_S
        return np.array([AMPLITUDE_M_S * np.cos(phase), PRESSURE_KPA], dtype=np.float32)

    def fail(self) -> Array | None:
        """Not this one."""
        return None


class Raises(Sweep):
    """Raises an error."""

    def fail(self) -> Array | None:
        """See the class."""
        raise RuntimeError("a policy's own error")


class NotANumber(Sweep):
    """Answers NaN."""

    def fail(self) -> Array | None:
        """See the class."""
        return np.full(2, np.nan, dtype=np.float32)


class WrongShape(Sweep):
    """Answers three numbers."""

    def fail(self) -> Array | None:
        """See the class."""
        return np.zeros(3, dtype=np.float32)


class Wild(Sweep):
    """Wants far more than the limits allow."""

    def fail(self) -> Array | None:
        """See the class."""
        return np.array([100.0, 1e6], dtype=np.float32)


class Slow(Sweep):
    """Takes longer than a tick."""

    def fail(self) -> Array | None:
        """See the class."""
        time.sleep(0.05)
        return None


class Stuck(Sweep):
    """Never answers."""

    def fail(self) -> Array | None:
        """See the class."""
        time.sleep(3600)
        return None


class HoldsTheLock(Sweep):
    """Keeps the interpreter's lock, once: nothing else in the process runs meanwhile."""

    def fail(self) -> Array | None:
        """See the class."""
        if self.ticks == int(GOOD_S * 30) + 1:
            ctypes.PyDLL(None).usleep(int(HELD_S * 1e6))  # PyDLL: calls without letting the lock go
        return None


NAMES = {
    "sweep": Sweep,
    "raises": Raises,
    "not-a-number": NotANumber,
    "wrong-shape": WrongShape,
    "wild": Wild,
    "slow": Slow,
    "stuck": Stuck,
    "holds-the-lock": HoldsTheLock,
}


def install(folder: Path) -> None:
    """Make a folder that, on PYTHONPATH, has them found as an installed package's plugins."""
    about = folder / "softarm_guests-0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: softarm-guests\nVersion: 0\n")
    points = [f"{name} = {__name__}:{policy.__name__}" for name, policy in NAMES.items()]
    (about / "entry_points.txt").write_text("\n".join(["[softarm.policies]", *points]) + "\n")
