"""Events of the daemon, as the API, the log and `softarm events` report them."""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

# Lost and found: a device stopped or started answering. Event: of the failsafe table, became active.
EventKind = Literal["request", "mode", "stop", "goal", "lost", "found", "event"]


@dataclass(frozen=True, slots=True)
class Entry:
    """One event of a control tick."""

    number: int  # counted from 1 in a run of the daemon; 0: derived from the ticks of a log without entries
    t_ns: int  # start of the tick, CLOCK_MONOTONIC
    time: datetime  # the same in UTC
    tick: int
    kind: EventKind
    what: str  # the request's kind, the new mode, the goal's state, the device, the event's name
    text: str  # the whole event as a sentence
    who: str | None = None  # the client that sent the request
    accepted: bool | None = None  # of a request: whether it was carried out
