"""What happened, one entry each: as the API tells it, the log keeps it and `softarm events` prints it."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

EventKind = Literal["request", "mode", "stop", "goal", "lost", "found", "event"]

KINDS: Mapping[EventKind, str] = {
    "request": "somebody asked for something, and what came of it",
    "mode": "another mode",
    "stop": "an emergency stop",
    "goal": "the end of a goal",
    "lost": "a device no longer answers",
    "found": "a device answers",
    "event": "an event of the failsafe table begins to hold",
}


@dataclass(frozen=True, slots=True)
class Entry:
    """Something that happened in a tick."""

    number: int  # counted up from 1 in a run of the daemon; 0: read off the ticks of a log that has no entries
    t_ns: int  # start of the tick, CLOCK_MONOTONIC
    time: datetime  # the same in UTC
    tick: int
    kind: EventKind
    what: str  # the request's kind, the new mode, the goal's state, the device, the event's name
    text: str  # all of it in a sentence
    who: str | None = None  # asked
    accepted: bool | None = None  # of a request: was it carried out?
