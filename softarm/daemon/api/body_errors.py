"""Explains to a client why its request body was refused and what is allowed."""

from collections.abc import Mapping, Sequence
from typing import Any

from softarm.common.words import did_you_mean
from softarm.daemon.control.workspace import allowed_y, allowed_z
from softarm.schemas.config import Config

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
