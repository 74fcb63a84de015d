"""Names of the channels and metadata records of an MCAP log (docs/reference/logs.md)."""

from collections.abc import Mapping

from pydantic import AwareDatetime

from softarm.schemas.base import Strict

MOCAP, PRESSURE, RAIL, REQUEST, EVENT, TICK = "/mocap", "/pressure", "/rail", "/request", "/event", "/tick"

FORMAT = 1  # of channels and metadata; a log states it as FORMAT_KEY of `software`; without the key it is 1
FORMAT_KEY = "log_format"

# Metadata records. A later record of the same name replaces the earlier one from there on.
CONFIGURATION, SOFTWARE, MACHINE, CLOCK, POLICY = "configuration", "software", "machine", "clock", "policy"
Metadata = Mapping[str, Mapping[str, str]]  # by name
RUN = "run"  # the daemon's run and the file's part of it: "id", "part" from "1"


class LogEntry(Strict):
    """One log in the recorder's directory."""

    name: str
    bytes: int
    modified: AwareDatetime
    duration_s: float | None  # first to last message; None while unfinished
    finished: bool  # False: being written, or the daemon was killed
    recording: bool = False  # being written by the daemon that answers
