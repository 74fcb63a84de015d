"""Hands a request to the control loop and waits for the tick that answers it."""

import asyncio
import time
from collections.abc import Callable

from fastapi import Request
from fastapi.responses import Response

from softarm.daemon.api.bounds import WHO
from softarm.daemon.api.refusals import Refused, json_response
from softarm.daemon.api.status import POLL_S, StatusView
from softarm.daemon.control.inbox import ANSWER_S, Inbox, InboxFull, unanswered
from softarm.daemon.control.records import RequestKind, RequestResult
from softarm.policies.runner import PolicyRunner
from softarm.schemas.goals import Goal


class Requests:
    """Posts requests to the inbox and answers with the status after the tick that handled them."""

    def __init__(self, inbox: Inbox, view: StatusView, clock: Callable[[], int]) -> None:
        self._inbox, self._view, self._clock = inbox, view, clock

    async def post(
        self,
        request: Request,
        kind: RequestKind,
        *,
        goal: Goal | None = None,
        policy: str | None = None,
        runner: PolicyRunner | None = None,
        warnings: tuple[str, ...] = (),
    ) -> Response:
        """Post a request and return the status after its tick, or raise Refused: 409 with reasons, 503 unanswered."""
        try:
            number = self._inbox.post(kind, goal=goal, policy=policy, runner=runner, who=request.scope[WHO])
        except InboxFull as error:
            if runner is not None:
                runner.close()
            raise Refused(503, str(error)) from error
        result = await self._result(kind, number, self._clock())
        if result is None:
            raise Refused(503, *unanswered(kind))
        if not result.accepted:
            raise Refused(409, *result.reasons)
        answer = self._view.answer(warnings)
        if answer is None:
            raise Refused(503, *self._view.why_unhealthy())
        return json_response(answer)

    async def _result(self, kind: RequestKind, number: int, posted_ns: int) -> RequestResult | None:
        deadline = time.monotonic() + ANSWER_S
        late = False
        while not late:
            late = time.monotonic() >= deadline  # then look once more: the API itself may have been held up
            snapshot = self._view.snapshot()
            if snapshot is not None and (result := snapshot.answer(kind, number, posted_ns)) is not None:
                return result
            await asyncio.sleep(POLL_S)
        return None
