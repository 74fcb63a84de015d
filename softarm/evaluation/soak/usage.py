"""Resources of processes, read from Linux (proc(5))."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

_TICKS_HZ = os.sysconf("SC_CLK_TCK")


class Usage(NamedTuple):
    """Resources of one process, or of several together."""

    memory_mb: float  # proportional set size: shared pages count by their share
    descriptors: int
    threads: int
    cpu_s: float  # since it began


def of(pids: Iterable[int]) -> Usage:
    """Return the sum over processes. Raises OSError if one has ended."""
    each = [_of(Path(f"/proc/{pid}")) for pid in pids]
    return Usage(
        sum(one.memory_mb for one in each),
        sum(one.descriptors for one in each),
        sum(one.threads for one in each),
        sum(one.cpu_s for one in each),
    )


def children(pid: int) -> list[int]:
    """Return the living child processes."""
    found = (Path(f"/proc/{pid}/task") / task / "children" for task in os.listdir(f"/proc/{pid}/task"))
    return sorted(int(child) for file in found for child in file.read_text().split())


def command(pid: int) -> str:
    """Return the command line of a process. Raises OSError if it has ended."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")


def folder_mb(folder: Path) -> float:
    """Return the size of the files in a folder, MB; a file that disappears meanwhile does not count."""
    total = 0
    for path in folder.iterdir():
        try:
            total += path.stat().st_size
        except FileNotFoundError:
            continue
    return total / 1e6


def _of(process: Path) -> Usage:
    rollup = (process / "smaps_rollup").read_text()
    # The name may hold any character, so count after it: state is field 3, processor times 14 and 15, threads 20.
    fields = (process / "stat").read_text().rpartition(")")[2].split()
    return Usage(
        int(rollup.partition("\nPss:")[2].split(maxsplit=1)[0]) / 1024,
        len(os.listdir(process / "fd")),
        int(fields[17]),
        (int(fields[11]) + int(fields[12])) / _TICKS_HZ,
    )
