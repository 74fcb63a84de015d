"""Translation of REST requests in the daemon's texts into verbs of this command.

The daemon's texts name a request as HTTP does (`POST /api/arm`); a terminal shows `softarm arm` instead.
"""

import logging
import re
from typing import Any

# REST request -> verb.
COMMANDS = {
    "GET /api/status": "softarm status",
    "GET /api/health": "softarm status",
    "POST /api/arm": "softarm arm",
    "POST /api/disarm": "softarm disarm",
    "POST /api/stop": "softarm stop",
    "POST /api/acknowledge": "softarm acknowledge",
    "POST /api/goal": "softarm goal",
    "GET /api/goal": "softarm status",
    "DELETE /api/goal": "softarm goal cancel",
    "GET /api/policies": "softarm policy list",
    "PUT /api/policy": "softarm policy use NAME",
    "GET /api/logs": "softarm logs",
    "GET /api/events": "softarm events",
    "GET /api/incidents": "softarm incidents",
}
REQUEST = re.compile(r"`?\b(GET|POST|PUT|DELETE) (/api/[\w-]+)(?:/NAME)?`?")


def in_commands(text: str) -> str:
    """Return a text of the daemon with its REST requests replaced by verbs where one exists."""
    return REQUEST.sub(_command, text)


def _command(found: re.Match[str]) -> str:
    method, path = found.groups()
    verb = COMMANDS.get(f"{method} {path}")
    return f"`{verb}`" if verb else f"the API's {path} ({method})"


def all_in_commands(answer: Any) -> Any:
    """Return a parsed JSON answer with `in_commands` applied to every text."""
    if isinstance(answer, str):
        return in_commands(answer)
    if isinstance(answer, list):
        return [all_in_commands(each) for each in answer]
    if isinstance(answer, dict):
        return {key: all_in_commands(value) for key, value in answer.items()}
    return answer


class Formatter(logging.Formatter):
    """Log formatter for a daemon started in a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the formatted line with verbs instead of REST requests."""
        return in_commands(super().format(record))
