"""Results of a soak test as an HTML page and as data."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from softarm.reporting import charts
from softarm.reporting.document import Section, document
from softarm.reporting.markup import Html, el, join, table, tiles
from validation.soak import lockstep, realtime
from validation.soak.clients import Unexpected
from validation.soak.growth import Slope, judge, warm_up

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


def html(real: realtime.Soaked | None, stepped: lockstep.Stepped | None, command: str) -> str:
    """Return the page, which shows the command that made it."""
    wrong = problems(real, stepped)
    verdict = "No growth and no unexpected event." if not wrong else f"{len(wrong)} findings."
    lead = [el("h1", "Soak"), el("div", el("p", verdict), class_="lead"), el("p", "Made by ", el("code", command), ".")]
    findings = el("ul", *(el("li", sentence) for sentence in wrong)) if wrong else el("p", "None.")
    sections = [Section("Findings", "findings", findings)]
    if real is not None:
        facts = [("hours", f"{real.hours:.2f}"), ("time armed", f"{real.armed_share:.0%}")]
        sections.append(Section("In real time", "real", _figures(real, facts, "hour", real.hours)))
    if stepped is not None:
        facts = [("simulated days", f"{stepped.days:.2f}")]
        sections.append(Section("In lockstep", "lockstep", _figures(stepped, facts, "simulated day", stepped.days)))
    return document("Soak", "python -m validation.soak", join(lead), sections)


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


def _figures(
    soaked: realtime.Soaked | lockstep.Stepped, facts: list[tuple[str, str]], unit: str, length: float
) -> Html:
    """Return facts, growth, curves and events of a run; `length` is in its unit of time."""
    counts = soaked.counts
    flown = [(name, f"{counts.get(name, 0):,}") for name in ("goals", "reached")]
    events = table(("event", "count"), [(what, f"{n:,}") for what, n in counts.items()], "Events", numbers=(1,))
    curves = _curves(soaked.samples, f"{unit}s", warm_up(length))
    farthest = ("farthest cart", f"{soaked.cart_max_m:.3f} m")
    return join([tiles([*facts, *flown, farthest]), _slopes(soaked.slopes, f"per {unit}"), *curves, events])


def _slopes(slopes: dict[str, Slope], per: str) -> Html:
    rows = [
        (NAMES[name], f"{s.value:.3g}", f"{s.low:.3g} to {s.high:.3g}", f"{s.allowed:g}", s.verdict)
        for name, s in slopes.items()
    ]
    head = ("quantity", f"growth {per}", "95 % interval", "allowed", "verdict")
    return table(head, rows, "Growth after the warm-up", numbers=(1, 2, 3))


def _curves(samples: Sequence[Any], unit: str, warm: float) -> list[Html]:
    if len(samples) < 2:
        return []
    time, *names = samples[0]._fields
    t = np.array([getattr(one, time) for one in samples])
    curves = {NAMES[name]: np.array([float(getattr(one, name)) for one in samples]) for name in names}
    caption = f"Samples over time; the first {warm:.2g} {unit} are warm-up and do not count."
    return [el("figure", el("figcaption", caption), charts.lanes(t, curves, f"usage over {unit}", unit))]
