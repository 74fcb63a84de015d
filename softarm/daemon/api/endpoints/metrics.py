"""The answer of GET /metrics in Prometheus' text format 0.0.4.

Format: https://prometheus.io/docs/instrumenting/exposition_formats/
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import accumulate

from softarm import __version__
from softarm.daemon.api.status import StatusView
from softarm.daemon.control.records import EStop, Mode, Outputs
from softarm.daemon.logbook.history import LATE_NS, History

TYPE = "text/plain; version=0.0.4"
Samples = Iterable[tuple[str, float]]  # written labels and value


def exposition(view: StatusView, history: History, dropped: int, free_bytes: int | None) -> str:
    """Return all metrics available now, from the ticks dropped by the recorder and the disk's free space if known."""
    outputs = view.snapshot()
    events = [(f'{{kind="{kind}",what="{what}"}}', n) for (kind, what), n in history.counts.items()]
    free = [] if free_bytes is None else [("", free_bytes)]
    families = [
        _family("info", "gauge", "Version of softarm.", [(f'{{version="{__version__}"}}', 1)]),
        _family("healthy", "gauge", "1 if GET /api/health reports healthy.", [("", not view.why_unhealthy())]),
        _family("recorder_dropped_total", "counter", "Ticks missing from the log.", [("", dropped)]),
        _family("log_disk_free_bytes", "gauge", "Free space for logs.", free),
        _family("events_total", "counter", "Events as in GET /api/events.", events),
        _family("tick_late_seconds", "histogram", "Lateness of control ticks.", _lateness(history)),
        *([] if outputs is None else _tick_families(view, outputs)),
    ]
    return "".join(f"{line}\n" for family in families for line in family)


def _tick_families(view: StatusView, outputs: Outputs) -> Iterator[Iterator[str]]:
    ages = {"tick": view.age_ns(outputs)}
    if (seen := outputs.observed) is not None:
        ages |= {"mocap": seen.mocap_age_ns, "pressure": seen.pressure_age_ns, "rail": seen.rail_age_ns}
    yield _family("age_seconds", "gauge", "Age of the newest tick and of its readings.", _labelled("of", ages, 1e-9))
    yield _family("mode", "gauge", "1 for the present mode.", _labelled("mode", {m: m is outputs.mode for m in Mode}))
    stops: dict[str, float] = {state: state is outputs.estop for state in EStop}
    yield _family("estop", "gauge", "1 for the present state.", _labelled("state", stops))
    yield _family("ticks_total", "counter", "Control ticks.", [("", outputs.tick)])
    yield _family("ticks_missed_total", "counter", "Skipped control ticks.", [("", outputs.missed_total)])
    yield _family("policy_seconds", "gauge", "Duration of the policy step.", [("", outputs.policy_ns * 1e-9)])


def _lateness(history: History) -> Samples:
    *within, count = accumulate(history.lateness)
    buckets = [(f'_bucket{{le="{late_ns * 1e-9:g}"}}', n) for late_ns, n in zip(LATE_NS, within, strict=True)]
    return [*buckets, ('_bucket{le="+Inf"}', count), ("_sum", history.late_ns * 1e-9), ("_count", count)]


def _labelled(label: str, values: Mapping[str, float], unit: float = 1) -> Samples:
    return [(f'{{{label}="{name}"}}', value * unit) for name, value in values.items()]


def _family(name: str, kind: str, about: str, samples: Samples) -> Iterator[str]:
    yield f"# HELP softarm_{name} {about}"
    yield f"# TYPE softarm_{name} {kind}"
    yield from (f"softarm_{name}{labels} {float(value)!r}" for labels, value in samples)
