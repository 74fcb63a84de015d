"""Work that takes long, or for ever, on threads that neither the next request nor the end of the service waits for."""

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import TypeVar

from softarm.daemon.api.refusals import Refused

Result = TypeVar("Result")


class Aside:
    """So many pieces of work at once, each answered in time; one that never ends keeps its thread and its place."""

    def __init__(self, at_once: int, limit_s: float) -> None:
        self._places, self._limit_s = threading.Semaphore(at_once), limit_s
        self._at_once = at_once

    async def run(self, what: str, work: Callable[[], Result]) -> Result:
        """What `work` returns or raises. what: names it in a refusal.

        Raises Refused, 503 where as many are at work already, 504 for what takes longer than `limit_s`.
        """
        if not self._places.acquire(blocking=False):
            raise Refused(503, f"{what}: {self._at_once} of these run already; if they never end, restart the service")
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[Result] = loop.create_future()

        def tell(result: Result | None, error: BaseException | None) -> None:
            if answer.cancelled():
                return  # too late
            if error is None:
                answer.set_result(result)  # type: ignore[arg-type]
            else:
                answer.set_exception(error)

        def do() -> None:
            result, error = None, None
            try:
                result = work()
            except BaseException as raised:  # a plugin that calls sys.exit() included
                error = raised if isinstance(raised, Exception) else RuntimeError(f"{type(raised).__name__}: {raised}")
            finally:
                self._places.release()
            with contextlib.suppress(RuntimeError):  # the API has ended meanwhile
                loop.call_soon_threadsafe(tell, result, error)

        threading.Thread(target=do, name=f"aside: {what}", daemon=True).start()
        try:
            async with asyncio.timeout(self._limit_s):
                return await answer
        except TimeoutError as error:
            raise Refused(504, f"{what}: not done within {self._limit_s:g} s; it was given up") from error
