"""Answers of the API: a JSON body, or the reasons why a request was refused."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import Request
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.routing import Match, Route

from softarm.common.words import did_you_mean
from softarm.daemon.control.workspace import allowed_y, allowed_z
from softarm.schemas.config import Config
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


EXAMPLES = {
    "/api/goal": '{"kind": "reach", "y_m": -0.2, "z_m": 0.65} or {"kind": "hold"}',
    "/api/policy": '{"name": "reach"}',
    "/api/jobs": '{"kind": "excite", "excitation": "seed"} or {"kind": "replay", "log": "NAME.mcap"}',
    "/api/login": '{"token": "the text in api.token_file"}',
}
KEYS = {
    "/api/goal": ("kind", "y_m", "z_m"),
    "/api/policy": ("name",),
    "/api/jobs": ("kind", "excitation", "logs", "log"),
    "/api/login": ("token",),
}
KINDS = {"/api/goal": ("reach", "hold", "run"), "/api/jobs": ("excite", "diagnose", "replay")}
ERRORS_MAX = 5
NAME_MAX = 40


def body_errors(errors: Sequence[Mapping[str, Any]], path: str, config: Config) -> tuple[str, ...]:
    """Return one sentence for each of pydantic's first errors; each states what is allowed."""
    # An unknown key explains why another one is missing.
    ordered = sorted(errors, key=lambda error: error["type"] != "extra_forbidden")
    reasons = tuple(_sentence(error, path, config) for error in ordered[:ERRORS_MAX])
    return reasons if len(errors) <= ERRORS_MAX else (*reasons, f"and {len(errors) - ERRORS_MAX} more errors")


def _sentence(error: Mapping[str, Any], path: str, config: Config) -> str:
    kind, place = str(error["type"]), error["loc"]
    if place[0] != "body":
        return f"{place[-1]}: {str(error['msg']).lower()}"
    example = f"send {EXAMPLES[path]}"
    parts = [part for part in place[1:] if isinstance(part, str) and part not in KINDS.get(path, ())]
    name = parts[-1] if parts else ""
    if kind == "json_invalid":
        return f"the body is not JSON ({error.get('ctx', {}).get('error', error['msg'])}); {example}"
    if kind.startswith("union_tag"):
        *kinds, last = map(repr, KINDS[path])
        return f"kind: must be {', '.join(kinds)} or {last}; {example}"
    if not name:
        return f"the body must be a JSON object with Content-Type: application/json; {example}"
    if kind == "extra_forbidden":
        shown = name if len(name) <= NAME_MAX else f"{name[:NAME_MAX]}..."
        return f"{shown}: unknown key; {did_you_mean(name[:NAME_MAX], KEYS[path], 0.5)}{example}"
    return f"{name}: {'missing; ' if kind == 'missing' else ''}must be {_allowed(name, config)}"


def _allowed(name: str, config: Config) -> str:
    match name:
        case "y_m":
            return f"a number; allowed {allowed_y(config)}"
        case "z_m":
            return f"a number; allowed {allowed_z(config)}"
        case "token":
            return "text: the token in the file of api.token_file, or the token of another role"
        case "excitation":
            return "text; GET /api/jobs lists the names"
        case "log" | "logs":
            return f"{'text' if name == 'log' else 'a list of one to 20 texts'}; GET /api/logs lists the names"
        case _:
            return "text; GET /api/policies lists the names"
