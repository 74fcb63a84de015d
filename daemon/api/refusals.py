"""Answers of the API: a body of JSON, or why there is none."""

from fastapi import Request
from fastapi.responses import Response

from softarm.schemas.rest import Refusal


class Refused(Exception):
    """A request that is answered with sentences instead."""

    def __init__(self, status: int, *reasons: str) -> None:
        super().__init__(*reasons)
        self.status, self.reasons = status, reasons


def json_response(data: bytes | str, status: int = 200) -> Response:
    """A body that is JSON already."""
    return Response(data, status, media_type="application/json")


def refusal(status: int, reasons: tuple[str, ...]) -> Response:
    """Sentences, one by one and in one line."""
    return json_response(Refusal(detail="; ".join(reasons), reasons=reasons).model_dump_json(), status)


async def on_refused(_: Request, error: Exception) -> Response:
    """The handler of `Refused`."""
    assert isinstance(error, Refused)  # registered for this type
    return refusal(error.status, error.reasons)
