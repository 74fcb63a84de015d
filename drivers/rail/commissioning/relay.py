"""The regulator board's relay in the line of the drive's enable input, held closed by a tool while no daemon speaks.

Disarmed commands do (docs/wires.md, Regulator, rule 9): the muscle stays vented. They are said from where the drive is
spoken with, so a tool that stands still says nothing, and the relay opens: the drive brakes by itself.
"""

import asyncio
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from softarm.drivers.regulator.driver import TeensyRegulator
from softarm.schemas.config import SerialRegulator

APART_S = 0.02  # commands; they live for `drivers.regulator.time_to_live_s`


class Relay:
    """Use as `with Relay(config) as relay`, and call `hold` often."""

    def __init__(self, config: SerialRegulator, clock: Callable[[], float] = time.monotonic) -> None:
        self._regulator, self._clock = TeensyRegulator(config), clock
        self._said_s = -APART_S

    def __enter__(self) -> Self:
        self._regulator.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        asyncio.run(self._regulator.stop())

    def hold(self) -> None:
        """Say a disarmed command, if it is time for one."""
        now_s = self._clock()
        if now_s - self._said_s >= APART_S:
            self._said_s = now_s
            self._regulator.write(False, 0.0)

    def problem(self) -> str | None:
        """Why the board does not hear; None: it does."""
        return self._regulator.problem()
