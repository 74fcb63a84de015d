"""Everything that the API shares with the rest of the daemon."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime

from softarm.daemon.access.auth import Sessions
from softarm.daemon.api.endpoints.policies import Policies
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import Outputs, Problems
from softarm.daemon.logbook.history import History
from softarm.daemon.logbook.recent import Recent
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.jobs import Jobs
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame


@dataclass(frozen=True, slots=True)
class ApiContext:
    """State and callbacks of the daemon that the endpoints use."""

    config: Config
    inbox: Inbox
    snapshot: Callable[[], Outputs | None]  # of the newest tick; None before the first
    problems: Callable[[], Problems] = Problems  # of the devices, at present
    recorder: Recorder | None = None
    history: History = field(default_factory=lambda: History("", time.monotonic_ns, time.time_ns))
    recent: Recent = field(default_factory=lambda: Recent(time.monotonic_ns, time.time_ns))
    jobs: Jobs = field(default_factory=Jobs)
    policies: Policies | None = None  # None for the installed ones
    frame: Callable[[], MocapFrame | None] = lambda: None  # newest valid one
    simulated: bool = False  # the robot is simulated in this process
    sessions: Sessions | None = None  # shared with the dedicated stop port
    stop_port: Callable[[], int | None] = lambda: None
    left_at: Callable[[], datetime | None] = lambda: None  # time of a stop that the previous daemon left latched
    clock: Callable[[], int] = time.monotonic_ns
    wall_ns: Callable[[], int] = time.time_ns  # Unix time
