"""Everything that the API shares with the rest of the daemon."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime

from softarm.daemon.access.login import Sessions
from softarm.daemon.api.endpoints.policies import Policies
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import Outputs, Problems
from softarm.daemon.logbook.history import History
from softarm.daemon.logbook.recent import Recent
from softarm.daemon.logbook.recorder import Recorder
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame


@dataclass(frozen=True, slots=True)
class ApiContext:
    """State and callbacks of the daemon that the endpoints use.

    Attributes:
        config: the configuration in force.
        inbox: takes requests to the control loop.
        snapshot: returns the outputs of the newest tick, or None before the first.
        problems: returns the devices' present problems.
        recorder: the log recorder, or None without one.
        history: events of this run.
        recent: the last minutes as columns.
        policies: the policies on offer; None for the installed ones.
        frame: returns the newest valid motion capture frame, or None.
        simulated: True if the robot is simulated in this process.
        sessions: logged-in browsers, shared with the dedicated stop port.
        stop_port: returns the dedicated stop port, or None without one.
        left_at: returns the time of a stop that the previous daemon left latched.
        clock: CLOCK_MONOTONIC in ns.
        wall_ns: Unix time in ns.
    """

    config: Config
    inbox: Inbox
    snapshot: Callable[[], Outputs | None]
    problems: Callable[[], Problems] = Problems
    recorder: Recorder | None = None
    history: History = field(default_factory=lambda: History("", time.monotonic_ns, time.time_ns))
    recent: Recent = field(default_factory=lambda: Recent(time.monotonic_ns, time.time_ns))
    policies: Policies | None = None
    frame: Callable[[], MocapFrame | None] = lambda: None
    simulated: bool = False
    sessions: Sessions | None = None
    stop_port: Callable[[], int | None] = lambda: None
    left_at: Callable[[], datetime | None] = lambda: None
    clock: Callable[[], int] = time.monotonic_ns
    wall_ns: Callable[[], int] = time.time_ns
