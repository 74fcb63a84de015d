"""What the daemon says, in the words of this command.

The daemon's sentences name a request as HTTP does (`POST /api/arm`), in its answers and its logs. Whoever shows them to
people puts that as those people would ask.
"""

import logging
import re
from typing import Any

# What a person types instead.
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
    """A sentence of the daemon with its requests as verbs; one that has no verb is named as the API's."""
    return REQUEST.sub(_command, text)


def _command(found: re.Match[str]) -> str:
    method, path = found.groups()
    verb = COMMANDS.get(f"{method} {path}")
    return f"`{verb}`" if verb else f"the API's {path} ({method})"


def all_in_commands(answer: Any) -> Any:
    """The same for every text of an answer that was JSON."""
    if isinstance(answer, str):
        return in_commands(answer)
    if isinstance(answer, list):
        return [all_in_commands(each) for each in answer]
    if isinstance(answer, dict):
        return {key: all_in_commands(value) for key, value in answer.items()}
    return answer


class Formatter(logging.Formatter):
    """For a daemon that logs to the terminal of who started it."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        return in_commands(super().format(record))
