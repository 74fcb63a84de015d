"""Cases tried: here, or in a process of its own that may hang or die."""

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

from softarm.benchmarks.prove.fuzz.parsers import PARSERS, Parser

TIME_MAX_S = 2.0  # of the processor, for one case
MEMORY_MAX_MB = 300.0  # for one case, at any moment
START = "spawn"  # how a process of its own begins
HANG_S = 20.0  # by the wall: nobody waits so long for a refusal
TOLD = 20  # findings of one parser, each another place of the code


class Finding(NamedTuple):
    """A case that broke the promise."""

    parser: str
    case: int
    what: str


@functools.cache
def made(name: str) -> Parser:
    """A parser, once in this process."""
    return PARSERS[name]()


def draw(name: str, number: int) -> object:
    """The case of this number, as its parser takes it."""
    return made(name).draw(Random(f"{name}/{number}"))


def try_case(name: str, number: int) -> Finding | None:
    """Feed one case to its parser, in this process."""
    parser, case = made(name), draw(name, number)
    _forget_peak()
    before_mb, begun_s = _memory_mb("VmRSS"), time.process_time()
    try:
        parser.take(case)
    except parser.errors as error:
        if not str(error).strip():
            return Finding(name, number, f"{type(error).__name__} without a sentence")
    except Exception as error:
        return Finding(name, number, f"{type(error).__name__}: {str(error)[:200]} at {_where(error)}")
    taken_s, taken_mb = time.process_time() - begun_s, _memory_mb("VmHWM") - before_mb
    if taken_s > TIME_MAX_S:
        return Finding(name, number, f"took {taken_s:.1f} s of the processor, allowed {TIME_MAX_S:g}")
    if taken_mb > MEMORY_MAX_MB:
        return Finding(name, number, f"took {taken_mb:.0f} MB, allowed {MEMORY_MAX_MB:g}")
    return None


def _where(error: Exception) -> str:
    """The innermost line of ours that the error went through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "site-packages" not in frame.filename and "benchmarks" not in frame.filename]
    frame = (ours or frames)[-1]
    return f"{Path(frame.filename).name}:{frame.lineno}"


def _forget_peak() -> None:
    """From here on the process's peak of memory counts anew (proc(5), clear_refs)."""
    Path("/proc/self/clear_refs").write_text("5")


def _memory_mb(field: str) -> float:
    """VmRSS: what this process has; VmHWM: what it had at most."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition(f"{field}:")[2].split(maxsplit=1)[0]) / 1024


class Fuzzed(NamedTuple):
    """What came of one parser."""

    cases: int
    findings: list[Finding]


def fuzz(name: str, seconds: float, first: int = 0) -> Iterator[Fuzzed]:
    """Feed a parser for so long, in a process of its own; where it stands, every now and then."""
    deadline_s, next_case = time.monotonic() + seconds, first
    found: dict[str, Finding] = {}
    while time.monotonic() < deadline_s and len(found) < TOLD:
        with _worker(name, next_case) as (process, said):
            while (left_s := deadline_s - time.monotonic()) > 0 and len(found) < TOLD:
                heard = said.poll(min(HANG_S, left_s))
                if not heard and left_s > HANG_S:
                    what, next_case = f"hangs: no answer in {HANG_S:g} s", next_case + 1
                    found.setdefault(what, Finding(name, next_case - 1, what))
                    break
                if not heard:
                    break
                try:
                    next_case, finding = said.recv()
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
    said, says = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(name, first, says), daemon=True)
    process.start()
    says.close()
    try:
        yield process, said
    finally:
        process.kill()
        process.join()
        said.close()


def _work(name: str, number: int, says: Connection) -> None:
    while True:
        finding = try_case(name, number)
        number += 1
        says.send((number, finding))
