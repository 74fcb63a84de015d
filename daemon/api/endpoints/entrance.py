"""The endpoints of who has logged in. Their docstrings are the page at /docs."""

import logging
from typing import Annotated

from fastapi import Body, Request
from fastapi.openapi.models import Example
from fastapi.responses import Response

from softarm.daemon.api.auth import Door, Role
from softarm.daemon.api.bounds import SESSION, WHO
from softarm.daemon.api.login import TICKET_S, Sessions
from softarm.daemon.api.refusals import Refused, json_response
from softarm.schemas.rest import LoginAnswer, LoginBody, RoleName, TicketAnswer

log = logging.getLogger("softarm.events")

EXAMPLE: dict[str, Example] = {"token": {"value": {"token": "the text in api.token_file"}}}
ROLES: dict[Role, RoleName] = {Role.STOP: "stop", Role.VIEW: "view", Role.COMMAND: "command"}


class Entrance:
    """Where browsers log in and out."""

    def __init__(self, door: Door, sessions: Sessions) -> None:
        self._door, self._sessions = door, sessions
        self._wrong = 0  # tokens shown

    async def who(self, request: Request) -> Response:
        """Whether this API asks for a token, and whose yours is."""
        given = request.headers.get("authorization", "").removeprefix("Bearer ")
        return self._answer(request.scope[SESSION] or self._door.role_of(given))

    async def login(
        self,
        request: Request,
        body: Annotated[LoginBody, Body(openapi_examples=EXAMPLE)],
    ) -> Response:
        """Show a token once, from a page of this API: the answer's cookie stands for it, for 12 hours."""
        if not self._door.needs_token:
            raise Refused(409, "this API asks for no token: nobody has to log in")
        role = self._door.role_of(body.token)
        if role is None:
            self._wrong += 1
            if self._wrong & (self._wrong - 1) == 0:  # the 1st, 2nd, 4th, ...: nobody fills the journal with them
                log.warning("a log-in with a wrong token, the %d. since the start: %s", self._wrong, request.scope[WHO])
            raise Refused(401, "the token is wrong: send the text in the file of api.token_file, or of another role's")
        self._sessions.logins.back(self._sessions.of(dict(request.headers.raw)))
        log.info("logged in with the %s token: %s", role.name.lower(), request.scope[WHO])
        return self._answer(role, self._cookie(request, self._sessions.logins.out(role)))

    async def logout(self, request: Request) -> Response:
        """End what the cookie stands for."""
        self._sessions.logins.back(self._sessions.of(dict(request.headers.raw)))
        return self._answer(None, self._cookie(request, ""))

    async def ticket(self) -> Response:
        """What opens one stream, as `?ticket=`, for ten seconds: browsers send no token with it."""
        ticket = self._sessions.tickets.out(Role.VIEW)
        return json_response(TicketAnswer(ticket=ticket, seconds=TICKET_S).model_dump_json())

    def _answer(self, role: Role | None, cookie: str | None = None) -> Response:
        needed = self._door.needs_token
        told = Role.COMMAND if not needed else role
        answer = LoginAnswer(needed=needed, role=None if told is None else ROLES[told])
        response = json_response(answer.model_dump_json())
        if cookie is not None:
            response.headers["Set-Cookie"] = cookie
        return response

    def _cookie(self, request: Request, secret: str) -> str:
        return self._sessions.cookie(secret, self._door.from_proxy(dict(request.headers.raw)))
