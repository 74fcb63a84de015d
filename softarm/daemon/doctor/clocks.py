"""Checks of this computer's clocks: steps, synchronisation and source."""

import ctypes
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.common.finding import Finding, by, graded, ok, warning

MEASURED_S = 0.5
STEP_FINE_S = 0.001  # slewing gives 0.5 ms a second
SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
SLOW = ("hpet", "acpi_pm", "jiffies")  # a read takes microseconds, or is too coarse
UNSYNCHRONISED = 5  # adjtimex(2): TIME_ERROR


class _Timex(ctypes.Structure):
    """First fields of struct timex, with space for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("rest", ctypes.c_byte * 512),
    )


@dataclass(frozen=True, slots=True)
class Clocks:
    """Facts about the clocks."""

    moved_s: float  # of the wall clock against the monotonic clock
    watched_s: float
    synchronised: bool | None  # None if the system does not report it
    error_s: float  # largest error by the kernel's estimate
    source: str | None


def look(seconds: float = MEASURED_S) -> Clocks:
    """Observe the clocks for some seconds."""
    before = time.time_ns() - time.monotonic_ns()
    time.sleep(seconds)
    moved_s = (time.time_ns() - time.monotonic_ns() - before) * 1e-9
    state = _Timex()
    result = ctypes.CDLL(None).adjtimex(ctypes.byref(state))
    source = SOURCE.read_text().strip() if SOURCE.is_file() else None
    return Clocks(moved_s, seconds, None if result < 0 else result != UNSYNCHRONISED, state.maxerror * 1e-6, source)


def judge(facts: Clocks) -> Iterator[Finding]:
    """Yield findings on steps, synchronisation and source."""
    moved_ms = abs(facts.moved_s) * 1e3
    figure = f"wall clock moved by {moved_ms:.2f} ms against the monotonic clock in {facts.watched_s:g} s"
    advice = "the wall clock is being stepped, which affects times in logs: wait until it is set"
    yield graded("clock", by(abs(facts.moved_s), STEP_FINE_S, math.inf), figure, advice)
    if facts.synchronised is None:
        yield ok("time of day", "the system does not report whether it is synchronised")
    elif facts.synchronised:
        yield ok("time of day", f"synchronised, error at most {facts.error_s:.3g} s")
    else:
        advice = "times in logs differ from other machines: run `timedatectl set-ntp true`, or install chrony"
        yield warning("time of day", "not synchronised (NTP)", advice)
    if facts.source in SLOW:
        advice = "the kernel does not use the processor's counter: see its log, or boot with tsc=reliable"
        yield warning("clock source", str(facts.source), advice)
    elif facts.source is not None:
        yield ok("clock source", facts.source)
