"""This computer's clocks: does the wall's step, does anybody set it, is the monotonic one quick to read?"""

import ctypes
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.daemon.doctor.finding import Finding, ok, warning

MEASURED_S = 0.5
STEP_FINE_S = 0.001  # slewing gives 0.5 ms a second
SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
SLOW = ("hpet", "acpi_pm", "jiffies")  # a read takes microseconds, or is too coarse
UNSYNCHRONISED = 5  # adjtimex(2): TIME_ERROR


class _Timex(ctypes.Structure):
    """The head of struct timex; the kernel writes no more than the room behind it."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("rest", ctypes.c_byte * 512),
    )


@dataclass(frozen=True, slots=True)
class Clocks:
    """What was read of them."""

    moved_s: float  # the wall's against the monotonic one, while it was watched
    watched_s: float
    synchronised: bool | None  # None: the system does not tell
    error_s: float  # at most, by the kernel's estimate
    source: str | None


def look(seconds: float = MEASURED_S) -> Clocks:
    """Takes so many seconds."""
    before = time.time_ns() - time.monotonic_ns()
    time.sleep(seconds)
    moved_s = (time.time_ns() - time.monotonic_ns() - before) * 1e-9
    state = _Timex()
    said = ctypes.CDLL(None).adjtimex(ctypes.byref(state))
    source = SOURCE.read_text().strip() if SOURCE.is_file() else None
    return Clocks(moved_s, seconds, None if said < 0 else said != UNSYNCHRONISED, state.maxerror * 1e-6, source)


def judge(facts: Clocks) -> Iterator[Finding]:
    """Findings on steps, who sets the wall's clock, its source."""
    moved_ms = abs(facts.moved_s) * 1e3
    figure = f"the wall's moved by {moved_ms:.2f} ms against the monotonic one in {facts.watched_s:g} s"
    if abs(facts.moved_s) > STEP_FINE_S:
        advice = "it is being stepped, which the loop does not mind but times in logs do: wait until it is set"
        yield warning("clock", figure, advice)
    else:
        yield ok("clock", figure)
    if facts.synchronised is None:
        yield ok("time of day", "the system does not tell whether it is set")
    elif facts.synchronised:
        yield ok("time of day", f"set by the network, wrong by {facts.error_s:.3g} s at most")
    else:
        advice = "logs would not agree with other machines' times: `timedatectl set-ntp true`, or install chrony"
        yield warning("time of day", "nobody sets it (NTP)", advice)
    if facts.source in SLOW:
        advice = "the kernel distrusts the processor's own counter: see its log, or boot with tsc=reliable"
        yield warning("clock source", str(facts.source), advice)
    elif facts.source is not None:
        yield ok("clock source", facts.source)
