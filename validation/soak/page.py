"""Results of a soak test as sentences and as data."""

from typing import Any

from validation.soak import lockstep, realtime
from validation.soak.clients import Unexpected
from validation.soak.growth import judge

NAMES = {
    "memory_mb": "memory (MB)",
    "descriptors": "open descriptors",
    "threads": "threads",
    "cpu_percent": "processor (% of a core)",
    "late_ms": "lateness of a tick, median (ms)",
    "missed": "ticks missed since the start",
    "logs_mb": "folder of recordings (MB)",
}


def problems(
    real: realtime.Soaked | None, stepped: lockstep.Stepped | None, *, with_undecided: bool = True
) -> list[str]:
    """Return a sentence per quantity that grows, or is undecided, and per unexpected event; empty if all is well."""
    found: list[str] = []
    for where, per, soaked in (("in real time", "hour", real), ("in lockstep", "simulated day", stepped)):
        if soaked is not None:
            found += [f"{where}: {_named(line)}" for line in judge(soaked.slopes, per, with_undecided=with_undecided)]
            found += [f"{where}: {_described(one)}" for one in soaked.unexpected]
    return found


def figures(real: realtime.Soaked | None, stepped: lockstep.Stepped | None) -> dict[str, Any]:
    """Return the results as plain data."""
    return {
        name: None if soaked is None else _plain(soaked)
        for name, soaked in (("real_time", real), ("lockstep", stepped))
    }


def _plain(soaked: realtime.Soaked | lockstep.Stepped) -> dict[str, Any]:
    slopes = {name: one._asdict() | {"verdict": one.verdict} for name, one in soaked.slopes.items()}
    samples = {"fields": soaked.samples[0]._fields if soaked.samples else (), "rows": soaked.samples}
    unexpected = [one._asdict() for one in soaked.unexpected]
    return soaked._asdict() | {"slopes": slopes, "samples": samples, "unexpected": unexpected}


def _named(sentence: str) -> str:
    key, _, rest = sentence.partition(" ")
    return f"{NAMES[key]} {rest}"


def _described(one: Unexpected) -> str:
    return f"after {one.time_s:.0f} s: {one.what}" + (f" (log: {one.log})" if one.log else "")
