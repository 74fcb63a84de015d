"""GET /metrics: what a Prometheus server asks for, in its text format 0.0.4
(https://prometheus.io/docs/instrumenting/exposition_formats/).
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import accumulate

from softarm import __version__
from softarm.daemon.api.status import StatusView
from softarm.daemon.control.records import EStop, Mode, Outputs
from softarm.daemon.logbook.history import LATE_NS, History

TYPE = "text/plain; version=0.0.4"
Samples = Iterable[tuple[str, float]]  # labels as they are written, value


def exposition(view: StatusView, history: History, dropped: int, free_bytes: int | None) -> str:
    """All figures; before the first tick those that there are. free_bytes: of the logs' disk; None: not known."""
    outputs = view.snapshot()
    told = [(f'{{kind="{kind}",what="{what}"}}', n) for (kind, what), n in history.counts.items()]
    families = [
        _family("info", "gauge", "The version that runs.", [(f'{{version="{__version__}"}}', 1)]),
        _family("healthy", "gauge", "1: GET /api/health says so.", [("", not view.why_unhealthy())]),
        _family("recorder_dropped_total", "counter", "Ticks that the log lacks.", [("", dropped)]),
        _family("log_disk_free_bytes", "gauge", "Free for logs.", [] if free_bytes is None else [("", free_bytes)]),
        _family("events_total", "counter", "What happened, as in GET /api/events.", told),
        _family("tick_late_seconds", "histogram", "How late ticks began.", _lateness(history)),
        *([] if outputs is None else _of_a_tick(view, outputs)),
    ]
    return "".join(f"{line}\n" for family in families for line in family)


def _of_a_tick(view: StatusView, outputs: Outputs) -> Iterator[Iterator[str]]:
    ages = {"tick": view.age_ns(outputs)}
    if (seen := outputs.observed) is not None:
        ages |= {"mocap": seen.mocap_age_ns, "pressure": seen.pressure_age_ns, "rail": seen.rail_age_ns}
    yield _family("age_seconds", "gauge", "Of the newest tick; of what it was fed.", _labelled("of", ages, 1e-9))
    yield _family("mode", "gauge", "1: the mode it is in.", _labelled("mode", {m: m is outputs.mode for m in Mode}))
    yield _family("estop", "gauge", "1: its state.", _labelled("state", {s: s is outputs.estop for s in EStop}))
    yield _family("ticks_total", "counter", "Control ticks.", [("", outputs.tick)])
    yield _family("ticks_missed_total", "counter", "Ticks skipped.", [("", outputs.missed_total)])
    yield _family("policy_seconds", "gauge", "That the policy took.", [("", outputs.policy_ns * 1e-9)])


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
