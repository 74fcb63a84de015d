"""Resources of processes, read from Linux (proc(5)), and a test for their growth: the slope of a straight line."""

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

_TICKS_HZ = os.sysconf("SC_CLK_TCK")
BLOCKS = 8
WINDOWS = 64  # after the warm-up; each gives one number
_T95 = 2.365  # Student's t, 97.5 %, BLOCKS - 1 degrees of freedom
WARM_UP_SHARE, WARM_UP_MAX_H = 0.25, 0.25  # of a run; filling caches and ten minutes of samples is no leak

Statistic = Callable[[np.ndarray], float]
Verdict = Literal["flat", "grows", "too short to decide"]


class Usage(NamedTuple):
    """Resources of one process, or of several together."""

    memory_mb: float  # proportional set size: shared pages count by their share
    descriptors: int
    threads: int
    cpu_s: float  # since it began


def usage_of(pids: Iterable[int]) -> Usage:
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


class Slope(NamedTuple):
    """Growth per unit of time with its 95 % interval and the allowed growth."""

    value: float
    low: float
    high: float
    allowed: float

    @property
    def verdict(self) -> Verdict:
        """Flat: the interval is at most the allowed growth. Grows: the interval is above it."""
        return "flat" if self.high <= self.allowed else "grows" if self.low > self.allowed else "too short to decide"


def slope(time: Sequence[float], values: Sequence[float], allowed: float, of: Statistic = np.median) -> Slope:
    """Fit a slope to the samples after the warm-up.

    Neighbouring windows are correlated, so the interval comes from a jackknife over blocks of windows, as in
    `softarm.diagnosis.engine.jackknife`. It is infinite for too few samples.

    `allowed` is the allowed growth per unit of time, `of` the statistic of a window: the minimum suits resources that
    are allocated and freed, as a leak raises it. A run too short for the whole warm-up shows no growth: its interval
    begins at minus infinity.
    """
    t, y = np.asarray(time, float), np.asarray(values, float)
    warming = warm_up(float(t[-1] - t[0])) if len(t) else 0.0
    warm = t - t[:1] >= warming
    t, y = t[warm], y[warm]
    if len(t) < 2 * BLOCKS:
        return Slope(math.nan, -math.inf, math.inf, allowed)
    parts = min(WINDOWS, len(t))
    t = np.array([part.mean() for part in np.array_split(t, parts)])
    y = np.array([of(part) for part in np.array_split(y, parts)])
    whole = _fit(t, y)
    block = np.arange(len(t)) * BLOCKS // len(t)
    moved = np.array([_fit(t[block != one], y[block != one]) for one in range(BLOCKS)]) - whole
    half = _T95 * math.sqrt((BLOCKS - 1) / BLOCKS * float(np.sum(moved**2)))
    # The samples of one hour span a little less.
    low = whole - half if math.isclose(warming, WARM_UP_MAX_H, rel_tol=0.05) else -math.inf
    return Slope(whole, low, whole + half, allowed)


def warm_up(length: float) -> float:
    """Return the part of a run that does not count."""
    return min(WARM_UP_SHARE * length, WARM_UP_MAX_H)


def judge(slopes: Mapping[str, Slope], per: str, *, with_undecided: bool = True) -> list[str]:
    """Return a sentence for each quantity that grows, or is undecided; `per` is the unit of time."""
    wrong = ("grows", "too short to decide") if with_undecided else ("grows",)
    return [
        f"{name} {one.verdict}: {one.value:.3g} per {per} ({one.low:.3g} to {one.high:.3g}), allowed {one.allowed:g}"
        for name, one in slopes.items()
        if one.verdict in wrong
    ]


def _fit(t: np.ndarray, y: np.ndarray) -> float:
    centred = t - t.mean()
    return float(centred @ y / (centred @ centred))
