"""Why a request body was refused, in sentences a person can act on."""

from collections.abc import Mapping, Sequence
from typing import Any

from softarm.daemon.control.workspace import allowed_y, allowed_z
from softarm.schemas.config import Config

EXAMPLES = {
    "/api/goal": '{"kind": "reach", "y_m": -0.2, "z_m": 0.65} or {"kind": "hold"}',
    "/api/policy": '{"name": "reach"}',
    "/api/login": '{"token": "the text in api.token_file"}',
}


TOLD = 5  # so many mistakes of one body
NAME_MAX = 40  # characters of a key that is nobody's


def sentences(errors: Sequence[Mapping[str, Any]], path: str, config: Config) -> tuple[str, ...]:
    """One sentence for each of pydantic's first errors; each says what is allowed."""
    told = tuple(_sentence(error, f"send {EXAMPLES[path]}", config) for error in errors[:TOLD])
    return told if len(errors) <= TOLD else (*told, f"and {len(errors) - TOLD} mistakes more")


def _sentence(error: Mapping[str, Any], example: str, config: Config) -> str:
    kind, place = str(error["type"]), error["loc"]
    if place[0] != "body":
        return f"{place[-1]}: {str(error['msg']).lower()}"
    name = next((str(p) for p in reversed(place[1:]) if p not in ("reach", "hold", "run")), "")
    if kind == "json_invalid":
        return f"the body is not JSON ({error.get('ctx', {}).get('error', error['msg'])}); {example}"
    if kind.startswith("union_tag"):
        return f"kind: must be 'reach', 'hold' or 'run'; {example}"
    if not name or isinstance(place[-1], int):
        return f"the body must be a JSON object with Content-Type: application/json; {example}"
    if kind == "extra_forbidden":
        return f"{name if len(name) <= NAME_MAX else name[:NAME_MAX] + '...'}: is not known here; {example}"
    return f"{name}: {'is missing, it ' if kind == 'missing' else ''}must be {_allowed(name, config)}"


def _allowed(name: str, config: Config) -> str:
    match name:
        case "y_m":
            return f"a number; allowed {allowed_y(config)}"
        case "z_m":
            return f"a number; allowed {allowed_z(config)}"
        case "token":
            return "text; that in the file of api.token_file, or of another role's"
        case _:
            return "text; GET /api/policies lists the names"
