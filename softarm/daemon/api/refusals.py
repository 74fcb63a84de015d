"""Answers of the API: a JSON body, or the reasons why a request was refused."""

import math
import re
from collections.abc import Mapping
from typing import Any

from fastapi import Request
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.routing import Match, Route

from softarm.schemas.rest import Refusal

DESCRIPTIONS = {
    400: "the body is not readable JSON",
    401: "the token is missing or wrong",
    403: "the Host header is foreign, or a page of another site sent the request",
    404: "no such policy, job or file; the answer names the list",
    408: "the body did not arrive in time",
    409: "refused by the control loop, with its reasons; another job runs; or the file cannot be read or deleted",
    413: "the body has more than 4096 bytes",
    422: "wrong body, target out of reach, or a log that cannot be shown; the answer states what is allowed",
    503: "the control loop does not answer",
    504: "not finished in time and abandoned",
}
ALWAYS_POSSIBLE = (401, 403, 408, 413)  # decided before an endpoint is called
_FRAMEWORK = {
    400: "the body is not readable JSON: UTF-8 without deep nesting is allowed; see /docs for the bodies",
    404: "no such path; /docs lists every path",
    405: "this path does not support the method; /docs lists the methods",
}


class Refused(Exception):
    """A request that is answered with reasons."""

    def __init__(self, status: int, *reasons: str) -> None:
        super().__init__(*reasons)
        self.status, self.reasons = status, reasons


def answers(success: Any, *statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI responses of an endpoint.

    Args:
        success: model of the body, or its OpenAPI content where the body is no JSON.
        statuses: refusals that are possible in addition to `ALWAYS_POSSIBLE`.
    """
    responses: dict[int | str, dict[str, Any]] = {200: success if isinstance(success, dict) else {"model": success}}
    for status in sorted({*ALWAYS_POSSIBLE, *statuses}):
        responses[status] = {"model": Refusal, "description": DESCRIPTIONS[status]}
    return responses


def content(kind: str, text: bool = False) -> dict[str, Any]:
    """Return the OpenAPI content of a body with this media type, binary unless `text`."""
    schema = {"type": "string"} if text else {"type": "string", "format": "binary"}
    return {"content": {kind: {"schema": schema}}}


def json_response(data: bytes | str, status: int = 200) -> Response:
    """Return a response with a body that is JSON already."""
    return Response(data, status, media_type="application/json")


def query_integer(name: str, text: str, least: int, most: float = math.inf) -> int:
    """Return a whole number from a query string, or raise Refused if the text is anything else."""
    if re.fullmatch("[0-9]{1,19}", text) and least <= int(text) <= most:
        return int(text)
    span = f"from {least} on" if most == math.inf else f"from {least} to {most}"
    raise Refused(422, f"{name}: is {text[:20]!r}; allowed a whole number {span}")


def refusal(status: int, reasons: tuple[str, ...], headers: Mapping[str, str] | None = None) -> Response:
    """Return a response with the reasons, one by one and joined in one line."""
    body = Refusal(detail="; ".join(reasons), reasons=reasons).model_dump_json()
    return Response(body, status, headers, media_type="application/json")


async def on_refused(_: Request, error: Exception) -> Response:
    """Answer a request that raised `Refused`."""
    assert isinstance(error, Refused)  # registered for this type
    return refusal(error.status, error.reasons)


async def on_http_error(request: Request, error: Exception) -> Response:
    """Answer a request that the framework itself refused."""
    assert isinstance(error, HTTPException)  # registered for this type
    reason = _FRAMEWORK.get(error.status_code, str(error.detail))
    headers = error.headers
    if error.status_code == 405:  # the framework names the methods of the first route only
        headers = {"Allow": ", ".join(sorted(_methods(request)))}
    return refusal(error.status_code, (reason,), headers)


def _methods(request: Request) -> set[str]:
    routes = (route for route in request.app.routes if isinstance(route, Route))
    matching = (route for route in routes if route.matches(request.scope)[0] is not Match.NONE)
    return {method for route in matching for method in route.methods or ()}
