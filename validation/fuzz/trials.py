"""Execution of cases, in this process or in a separate one that may hang or crash."""

import contextlib
import functools
import multiprocessing
import time
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from validation.fuzz.parsers import PARSERS, Parser

# Processor time of one case, in units of `work_s`: 2 s on the machine of docs/evidence/results.md.
WORK_MAX = 40.0
QUICK_S = 0.2  # cases below this are not compared with the unit
MEMORY_MAX_MB = 300.0  # peak of one case
START = "spawn"  # start method of the other process
HANG_S = 20.0  # wall time
FINDINGS_MAX = 20  # per parser, each at another line of code


class Finding(NamedTuple):
    """Case that broke the promise of its parser."""

    parser: str
    case: int
    what: str


@functools.cache
def made(name: str) -> Parser:
    """Return a parser, created once per process."""
    return PARSERS[name]()


def draw(name: str, number: int) -> object:
    """Return the case of a number as its parser takes it."""
    return made(name).draw(Random(f"{name}/{number}"))


def try_case(name: str, number: int) -> Finding | None:
    """Feed one case to its parser in this process and return the finding, or None."""
    parser, case = made(name), draw(name, number)
    _forget_peak()
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


def _forget_peak() -> None:
    """Reset the peak memory of this process (proc(5), clear_refs)."""
    Path("/proc/self/clear_refs").write_text("5")


def _memory_mb(field: str) -> float:
    """Return VmRSS (current) or VmHWM (peak) of this process in MB."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition(f"{field}:")[2].split(maxsplit=1)[0]) / 1024


class Fuzzed(NamedTuple):
    """Result of fuzzing one parser."""

    cases: int
    findings: list[Finding]


def fuzz(name: str, seconds: float, first: int = 0) -> Iterator[Fuzzed]:
    """Feed a parser for `seconds` in another process, and yield the state now and then."""
    deadline_s, next_case = time.monotonic() + seconds, first
    found: dict[str, Finding] = {}
    while time.monotonic() < deadline_s and len(found) < FINDINGS_MAX:
        with _worker(name, next_case) as (process, receiver):
            while (left_s := deadline_s - time.monotonic()) > 0 and len(found) < FINDINGS_MAX:
                is_ready = receiver.poll(min(HANG_S, left_s))
                if not is_ready and left_s > HANG_S:
                    what, next_case = f"hangs: no answer within {HANG_S:g} s", next_case + 1
                    found.setdefault(what, Finding(name, next_case - 1, what))
                    break
                if not is_ready:
                    break
                try:
                    next_case, finding = receiver.recv()
                except EOFError:
                    process.join()
                    what, next_case = f"the process died ({process.exitcode})", next_case + 1
                    found.setdefault(what, Finding(name, next_case - 1, what))
                    break
                if finding is not None:
                    found.setdefault(finding.what.rpartition(" at ")[2], finding)
                yield Fuzzed(next_case - first, list(found.values()))
    yield Fuzzed(next_case - first, list(found.values()))


@contextlib.contextmanager
def _worker(name: str, first: int) -> Iterator[tuple[Any, Connection]]:
    context: Any = multiprocessing.get_context(START)
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(name, first, sender), daemon=True)
    process.start()
    sender.close()
    try:
        yield process, receiver
    finally:
        process.kill()
        process.join()
        receiver.close()


def _work(name: str, number: int, sender: Connection) -> None:
    while True:
        finding = try_case(name, number)
        number += 1
        sender.send((number, finding))
