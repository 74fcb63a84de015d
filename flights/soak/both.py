"""Real time and lockstep side by side: the second in a process of its own, which gives way to the first."""

import multiprocessing
import os
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from softarm.flights.soak import lockstep, realtime


def soak(
    hours: float, days: float, seed: int, policy: str, logs: Path, tell: Callable[[str, float], None]
) -> tuple[realtime.Soaked | None, lockstep.Stepped | None]:
    """So many hours in real time, so many simulated days in lockstep; None for what there was none of.

    tell(what is happening, share done). Raises SoftwareInTheLoopError and PolicyError.
    """
    if not days:
        return realtime.soak(hours, seed, logs, tell), None
    if not hours:
        return None, lockstep.soak(days, seed, policy, lambda share: tell("in lockstep", share))
    context = multiprocessing.get_context("spawn")
    said, says = context.Pipe(duplex=False)
    stepping = context.Process(target=_step, args=(days, seed, policy, says), daemon=True)
    stepping.start()
    says.close()
    try:
        real = realtime.soak(hours, seed, logs, tell)
        tell("waiting for lockstep", 1.0)
        stepped = said.recv()
    finally:
        stepping.kill()
        stepping.join()
    if isinstance(stepped, Exception):
        raise stepped
    return real, stepped


def _step(days: float, seed: int, policy: str, says: Connection) -> None:
    os.nice(19)
    try:
        says.send(lockstep.soak(days, seed, policy, lambda share: None))
    except Exception as error:
        says.send(error)
