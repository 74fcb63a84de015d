"""What a log file (MCAP) holds, by name. The devices' messages: `softarm.recordings.channels`; docs/logs.md has all."""

from collections.abc import Mapping

from pydantic import AwareDatetime

from softarm.schemas.base import Strict

MOCAP, PRESSURE, RAIL, REQUEST, EVENT, TICK = "/mocap", "/pressure", "/rail", "/request", "/event", "/tick"

FORMAT = 1  # of channels and metadata; a log says its own as FORMAT_KEY of `software`, none: 1
FORMAT_KEY = "log_format"

# Metadata records. A later record of the same name replaces the earlier one from there on.
CONFIGURATION, SOFTWARE, MACHINE, CLOCK, POLICY = "configuration", "software", "machine", "clock", "policy"
Metadata = Mapping[str, Mapping[str, str]]  # by name
RUN = "run"  # of the daemon, and which part of it the file is: "id", "part" from "1"


class LogEntry(Strict):
    """One log in the recorder's directory."""

    name: str
    bytes: int
    modified: AwareDatetime
    duration_s: float | None  # first to last message; None while unfinished
    finished: bool  # False: being written, or left by a daemon that was killed
    recording: bool = False  # by the daemon that answers
