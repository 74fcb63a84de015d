"""Holding of the regulator board's relay, which lies in the line of the drive's enable input, while no daemon runs.

Disarmed commands close the relay (docs/reference/wires.md, Regulator, rule 9), and the muscle stays vented.
They are sent at each exchange with the drive: a tool that hangs sends none, the relay opens, and the drive
brakes by itself.
"""

import asyncio
import time
from collections.abc import Callable
from typing import Self

from softarm.drivers.regulator.driver import TeensyRegulator
from softarm.schemas.config import SerialRegulator

# Between commands, which live for `drivers.regulator.time_to_live_s`.
PERIOD_S = 0.02


class Relay:
    """Context manager that keeps the relay closed while `hold` is called often."""

    def __init__(self, config: SerialRegulator, clock: Callable[[], float] = time.monotonic) -> None:
        self._regulator, self._clock = TeensyRegulator(config), clock
        self._sent_s = -PERIOD_S

    def __enter__(self) -> Self:
        self._regulator.start()
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.run(self._regulator.stop())

    def hold(self) -> None:
        """Send a disarmed command if one is due."""
        now_s = self._clock()
        if now_s - self._sent_s >= PERIOD_S:
            self._sent_s = now_s
            self._regulator.write(False, 0.0)

    def problem(self) -> str | None:
        """Return why the board does not answer, or None if it does."""
        return self._regulator.problem()
