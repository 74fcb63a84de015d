"""Soak test in real time and in lockstep at once; lockstep runs in a separate process at low priority."""

import multiprocessing
import os
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

from softarm.evaluation.soak import lockstep, realtime

POLL_S = 1.0


def soak(
    hours: float, days: float, seed: int, policy: str, logs: Path, on_progress: Callable[[str, float], None]
) -> tuple[realtime.Soaked | None, lockstep.Stepped | None]:
    """Fly `hours` in real time and `days` of simulated time in lockstep; a result is None if its time is 0.

    `seed` determines goals, faults and clients. `policy` flies in lockstep. `logs` is an empty folder.

    Raises:
        SoftwareInTheLoopError: Twin or daemon does not start.
        PolicyError: The policy cannot be loaded.
    """
    if not days:
        return realtime.soak(hours, seed, logs, on_progress), None
    if not hours:
        return None, lockstep.soak(days, seed, policy, lambda share: on_progress("in lockstep", share))
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    stepped_share = context.Value("d", 0.0)
    stepping = context.Process(target=_step, args=(days, seed, policy, sender, stepped_share), daemon=True)
    stepping.start()
    sender.close()
    try:
        real = realtime.soak(hours, seed, logs, on_progress)
        while not receiver.poll(POLL_S):
            on_progress("in lockstep", stepped_share.value)
        stepped = receiver.recv()
    finally:
        stepping.kill()
        stepping.join()
    if isinstance(stepped, Exception):
        raise stepped
    return real, stepped


def _step(days: float, seed: int, policy: str, sender: Connection, done: "Synchronized[float]") -> None:
    def progress(share: float) -> None:
        done.value = share

    os.nice(19)
    try:
        sender.send(lockstep.soak(days, seed, policy, progress))
    except Exception as error:
        sender.send(error)
