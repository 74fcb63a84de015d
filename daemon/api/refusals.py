"""Answers of the API: a body of JSON, or why there is none."""

from collections.abc import Mapping

from fastapi import Request
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.routing import Match, Route

from softarm.schemas.rest import Refusal

_FRAMEWORK = {
    400: "the body is not JSON that can be read: UTF-8, not nested deeply; see /docs for what to send",
    404: "nothing is here; /docs lists every path",
    405: "this path takes another method; /docs lists which",
}


class Refused(Exception):
    """A request that is answered with sentences instead."""

    def __init__(self, status: int, *reasons: str) -> None:
        super().__init__(*reasons)
        self.status, self.reasons = status, reasons


def json_response(data: bytes | str, status: int = 200) -> Response:
    """A body that is JSON already."""
    return Response(data, status, media_type="application/json")


def whole(name: str, said: str, least: int, most: int | None) -> int:
    """A whole number out of a query. Raises Refused, 422, for another; most: None for no end."""
    if (
        said.isascii()
        and said.isdigit()
        and len(said) < 20
        and least <= int(said)
        and (most is None or int(said) <= most)
    ):
        return int(said)
    allowed = f"a whole number from {least} on" if most is None else f"a whole number from {least} to {most}"
    raise Refused(422, f"{name}: is {said[:20]!r}; allowed {allowed}")


def refusal(status: int, reasons: tuple[str, ...], headers: Mapping[str, str] | None = None) -> Response:
    """Sentences, one by one and in one line."""
    body = Refusal(detail="; ".join(reasons), reasons=reasons).model_dump_json()
    return Response(body, status, headers, media_type="application/json")


async def on_refused(_: Request, error: Exception) -> Response:
    """The handler of `Refused`."""
    assert isinstance(error, Refused)  # registered for this type
    return refusal(error.status, error.reasons)


async def on_http_error(request: Request, error: Exception) -> Response:
    """The handler of what the framework itself refuses."""
    assert isinstance(error, HTTPException)  # registered for this type
    reason = _FRAMEWORK.get(error.status_code, str(error.detail))
    headers = error.headers
    if error.status_code == 405:  # the framework tells the methods of the first route alone
        headers = {"Allow": ", ".join(sorted(_methods(request)))}
    return refusal(error.status_code, (reason,), headers)


def _methods(request: Request) -> set[str]:
    """All that the path of a request takes."""
    routes = (route for route in request.app.routes if isinstance(route, Route))
    here = (route for route in routes if route.matches(request.scope)[0] is not Match.NONE)
    return {method for route in here for method in route.methods or ()}
