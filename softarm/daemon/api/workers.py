"""Runs slow work in threads that neither the next request nor the end of the service waits for."""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from softarm.daemon.api.refusals import Refused

Result = TypeVar("Result")
# Limits of listings and other short work on the disk.
LISTINGS_MAX, LISTING_S = 8, 30.0


class Workers:
    """Limited number of worker threads with a time limit; work that never ends keeps its thread and its place."""

    def __init__(self, at_once: int, limit_s: float) -> None:
        self._places, self._limit_s = threading.Semaphore(at_once), limit_s
        self._at_once = at_once

    async def run(self, name: str, work: Callable[[], Result]) -> Result:
        """Run `work` in a thread and return its result or raise its exception.

        Raises:
            Refused: 503 if all places are taken, 504 if the work exceeds the time limit.
        """
        if not self._places.acquire(blocking=False):
            reason = f"{name}: {self._at_once} of these are running already. Retry later, or restart the service"
            raise Refused(503, reason)
        answer: Future[Result] = Future()
        answer.set_running_or_notify_cancel()  # from now on the time limit cannot cancel it

        def execute() -> None:
            try:
                result = work()
            except BaseException as raised:  # includes a plug-in that calls sys.exit()
                self._places.release()
                error = raised if isinstance(raised, Exception) else RuntimeError(f"{type(raised).__name__}: {raised}")
                answer.set_exception(error)
            else:
                self._places.release()
                answer.set_result(result)

        threading.Thread(target=execute, name=f"worker: {name}", daemon=True).start()
        try:
            async with asyncio.timeout(self._limit_s):
                return await asyncio.wrap_future(answer)
        except TimeoutError as error:
            raise Refused(504, f"{name}: not finished within {self._limit_s:g} s; abandoned") from error
