"""Execution of cases, in this process or in a separate one that may hang or crash."""

import faulthandler
import functools
import multiprocessing
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from validation import apart
from validation.fuzz.parsers import PARSERS, Parser

# Processor time of one case, in units of `work_s`: 2 s on the machine of docs/evidence/results.md.
WORK_MAX = 40.0
QUICK_S = 0.2  # cases below this are not compared with the unit
MEMORY_MAX_MB = 300.0  # peak of one case
HANG_S = 20.0  # wall time
START = "spawn"  # start method of the other process
PERIOD_S = 60.0  # of one process
FINDINGS_MAX = 20  # per parser, each at another line of code


class Finding(NamedTuple):
    """Case that broke the promise of its parser."""

    parser: str
    case: int
    what: str


class Fuzzed(NamedTuple):
    """Result of fuzzing one parser."""

    cases: int
    findings: list[Finding]


@functools.cache
def made(name: str) -> Parser:
    """Return a parser, created once per process."""
    return PARSERS[name]()


def draw(name: str, number: int) -> object:
    """Return the case of a number as its parser takes it."""
    return made(name).draw(Random(f"{name}/{number}"))


def try_case(name: str, number: int) -> Finding | None:
    """Feed one case to its parser in this process and return the finding, or None."""
    parser = made(name)
    try:
        case = draw(name, number)
    except RecursionError:  # nested too deeply for Python to make it
        return None
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak memory, proc(5)
    before_mb, begun_s = _memory_mb("VmRSS"), time.process_time()
    try:
        parser.take(case)
    except parser.errors as error:
        if not str(error).strip():
            return Finding(name, number, f"{type(error).__name__} without a message")
    except Exception as error:
        return Finding(name, number, f"{type(error).__name__}: {str(error)[:200]} at {_where(error)}")
    taken_s, taken_mb = time.process_time() - begun_s, _memory_mb("VmHWM") - before_mb
    if taken_s > QUICK_S and (work := taken_s / work_s()) > WORK_MAX:
        return Finding(name, number, f"took {work:.0f} units of processor time, allowed {WORK_MAX:g}")
    if taken_mb > MEMORY_MAX_MB:
        return Finding(name, number, f"took {taken_mb:.0f} MB, allowed {MEMORY_MAX_MB:g}")
    return None


def work_s() -> float:
    """Return the processor time of a fixed amount of Python work, s: a unit that holds on slow machines, too."""
    begun_s = time.process_time()
    sum(hash(str(number)) % 7 for number in range(200_000))
    return time.process_time() - begun_s


def _where(error: Exception) -> str:
    """Return the innermost line of the project that the error passed."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "site-packages" not in frame.filename and "validation" not in frame.filename]
    frame = (ours or frames)[-1]
    return f"{Path(frame.filename).name}:{frame.lineno}"


def _memory_mb(field: str) -> float:
    """Return VmRSS (current) or VmHWM (peak) of this process in MB."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition(f"{field}:")[2].split(maxsplit=1)[0]) / 1024


def _try_cases(name: str, current: Any, seconds: float) -> list[Finding]:
    """Try cases for a time, at least one; `current` counts them. A case that hangs ends the process."""
    made(name)
    findings, until_s = [], time.monotonic() + seconds
    while True:
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        if (finding := try_case(name, current.value)) is not None:
            findings.append(finding)
        current.value += 1
        if time.monotonic() >= until_s or len(findings) == FINDINGS_MAX:
            return findings


def fuzz(name: str, seconds: float, first: int = 0) -> Iterator[Fuzzed]:
    """Feed a parser for `seconds` in other processes, and yield the state now and then."""
    deadline_s = time.monotonic() + seconds
    current = multiprocessing.get_context(START).Value("q", first)
    found: dict[str, Finding] = {}
    while (left_s := deadline_s - time.monotonic()) > 0 and len(found) < FINDINGS_MAX:
        period_s = min(PERIOD_S, left_s)
        try:
            findings = apart.call(START, period_s + 2 * HANG_S, _try_cases, name, current, period_s)
        except apart.ProcessDied as error:
            findings = [
                Finding(name, current.value, f"{error}, or a case took more than {HANG_S:g} s: see its traceback")
            ]
            current.value += 1
        for each in findings:
            found.setdefault(each.what.rpartition(" at ")[2], each)
        yield Fuzzed(current.value - first, list(found.values()))
