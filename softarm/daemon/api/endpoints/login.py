"""Endpoints for the log-in of browsers. Their docstrings are the texts of /docs."""

import logging
from typing import Annotated

from fastapi import APIRouter, Body, Request
from fastapi.openapi.models import Example
from fastapi.responses import Response

from softarm.daemon.access.auth import TICKET_S, AccessControl, Role, Sessions
from softarm.daemon.api.bounds import SESSION, WHO
from softarm.daemon.api.refusals import Refused, answers, json_response
from softarm.schemas.rest import LoginAnswer, LoginBody, RoleName, TicketAnswer

log = logging.getLogger("softarm.events")

EXAMPLES: dict[str, Example] = {"token": {"value": {"token": "the text in api.token_file"}}}
ROLES: dict[Role, RoleName] = {Role.STOP: "stop", Role.VIEW: "view", Role.COMMAND: "command"}


class Login:
    """Endpoints that exchange a token for a session cookie or a stream ticket."""

    def __init__(self, access: AccessControl, sessions: Sessions) -> None:
        self._access, self._sessions = access, sessions
        self._wrong_tokens = 0

    def router(self) -> APIRouter:
        """Return the routes of these endpoints."""
        router = APIRouter(tags=["Login"], default_response_class=Response)
        router.get("/api/login", responses=answers(LoginAnswer))(self.role)
        router.post("/api/login", responses=answers(LoginAnswer, 400, 409, 422))(self.login)
        router.post("/api/logout", responses=answers(LoginAnswer))(self.logout)
        router.post("/api/ticket", responses=answers(TicketAnswer))(self.ticket)
        return router

    async def role(self, request: Request) -> Response:
        """Return whether this API requires a token, and the role of yours."""
        given = request.headers.get("authorization", "").removeprefix("Bearer ")
        return self._answer(request.scope[SESSION] or self._access.role_of(given))

    async def login(self, request: Request, body: Annotated[LoginBody, Body(openapi_examples=EXAMPLES)]) -> Response:
        """Exchange a token for a session cookie that is valid for 12 hours. For pages of this API only."""
        if not self._access.needs_token:
            raise Refused(409, "this API requires no token, so there is no log-in")
        role = self._access.role_of(body.token)
        if role is None:
            self._wrong_tokens += 1
            if self._wrong_tokens & (self._wrong_tokens - 1) == 0:  # the 1st, 2nd, 4th, ... protects the journal
                log.warning("wrong token at log-in, attempt %d: %s", self._wrong_tokens, request.scope[WHO])
            raise Refused(
                401, "the token is wrong: enter the text in the file of api.token_file, or the token of another role"
            )
        self._sessions.logins.revoke(self._sessions.of(dict(request.headers.raw)))
        log.info("logged in with the %s token: %s", role.name.lower(), request.scope[WHO])
        return self._answer(role, self._cookie(request, self._sessions.logins.issue(role)))

    async def logout(self, request: Request) -> Response:
        """End the session of the cookie."""
        self._sessions.logins.revoke(self._sessions.of(dict(request.headers.raw)))
        return self._answer(None, self._cookie(request, ""))

    async def ticket(self) -> Response:
        """Return a ticket that opens one stream as `?ticket=` within ten seconds. Browsers cannot send tokens there."""
        ticket = self._sessions.tickets.issue(Role.VIEW)
        return json_response(TicketAnswer(ticket=ticket, seconds=TICKET_S).model_dump_json())

    def _answer(self, role: Role | None, cookie: str | None = None) -> Response:
        needed = self._access.needs_token
        granted = role if needed else Role.COMMAND
        answer = LoginAnswer(needed=needed, role=None if granted is None else ROLES[granted])
        response = json_response(answer.model_dump_json())
        if cookie is not None:
            response.headers["Set-Cookie"] = cookie
        return response

    def _cookie(self, request: Request, secret: str) -> str:
        return self._sessions.cookie(secret, self._access.from_proxy(dict(request.headers.raw)))
