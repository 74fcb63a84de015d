"""A log as a page that plays it: one file, nothing fetched, the arm on a time slider with charts and what happened."""

import math
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.pages import plot
from softarm.pages.document import Section, document
from softarm.pages.markup import Html, el, join, prose, tiles
from softarm.recordings import flight
from softarm.recordings.flight import Sight
from softarm.recordings.log_file import LogFile
from softarm.schemas import log as names
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.flights import BOARD_BELOW_M
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Arm
from softarm.schemas.robot import RAIL_TRAVEL_M

TICKS_MAX = 120_000  # on a page, some 7 MB; of a log that holds more every second is shown, every fourth, ...
EVENTS_MAX = 5000

_BODIES = tuple(f"{name}_{axis}" for axis in "yz" for name in BODY_NAMES)
_LATENESS = ("late_ms", "mocap_age_ms", "policy_ms")  # of ticks that are left out the worst is shown
SERIES = (
    *_BODIES,
    *("cart_wanted", "cart_sent", "cart_measured", "pressure_wanted", "pressure_sent", "pressure_measured"),
    *_LATENESS,
)
_WORST = np.isin(SERIES, _LATENESS)


class Samples:
    """Rows of numbers with their stamps, never more than so many: when there are, every second one goes."""

    def __init__(self, most: int = TICKS_MAX) -> None:
        self._rows = np.empty((most, len(SERIES)))
        self._stamps = np.empty(most, dtype=np.int64)
        self.every, self._kept, self._skipped = 1, 0, 0

    def add(self, stamp_ns: int, row: Sequence[float]) -> None:
        """One more."""
        if self._skipped == 0:
            if self._kept == len(self._rows):
                self._halve()
            self._rows[self._kept], self._stamps[self._kept] = row, stamp_ns
            self._kept += 1
        else:
            last = self._rows[self._kept - 1]
            last[_WORST] = np.fmax(last[_WORST], np.asarray(row)[_WORST])
        self._skipped = (self._skipped + 1) % self.every

    def _halve(self) -> None:
        even, odd = self._rows[0::2], self._rows[1::2]
        even[: len(odd), _WORST] = np.fmax(even[: len(odd), _WORST], odd[:, _WORST])
        count = len(even)
        self._rows[:count], self._stamps[:count] = even.copy(), self._stamps[0::2].copy()
        self.every, self._kept = 2 * self.every, count

    @property
    def columns(self) -> dict[str, NDArray[np.float64]]:
        """The numbers, by name."""
        return dict(zip(SERIES, self._rows[: self._kept].T, strict=True))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Starts of the ticks."""
        return self._stamps[: self._kept]


class _Runs:
    """What holds for a while: since when, and what, one entry a change."""

    def __init__(self) -> None:
        self.entries: list[list[Any]] = []
        self._last: str | None = None

    def add(self, stamp_ns: int, *what: Any) -> None:
        if (text := repr(what)) != self._last:  # NaN equals nothing
            self._last = text
            self.entries.append([stamp_ns, *what])


def page(log: LogFile, entries: Iterable[Entry], advance: Callable[[], None] = lambda: None) -> str:
    """The page of a log as text.

    entries: what happened. advance: called for every message that was read. Raises LogError, also where there are no
    ticks to show.
    """
    offset_ns = flight.wall_minus_monotonic_ns(log.path, log.metadata)
    samples = Samples()
    runs = {name: _Runs() for name in ("mode", "policy", "goal", "wrong")}
    config = log.config
    for one in flight.sights(log.path):
        advance()
        if one is not None:
            out = one.tick.outputs
            samples.add(out.t_ns, _row(one))
            runs["mode"].add(out.t_ns, out.mode)
            runs["policy"].add(out.t_ns, out.policy)
            runs["goal"].add(out.t_ns, *_goal(one, config))
            runs["wrong"].add(out.t_ns, " ".join(event.name for event in out.events))
    stamps = samples.stamps_ns
    if not len(stamps):
        raise flight.nothing_in(log.path)
    begin_ns = int(stamps[0])

    def seconds(stamp_ns: int) -> float:
        return round((stamp_ns - begin_ns) * 1e-9, 4)

    told = list(entries)
    data = {
        "begin_ms": (begin_ns + offset_ns) // 1_000_000,
        "stamps": plot.packed_integers((stamps - begin_ns) // 100_000),  # of 0.1 ms
        "series": {name: plot.packed_levels(values) for name, values in samples.columns.items()},
        "runs": {name: [[seconds(at), *what] for at, *what in each.entries] for name, each in runs.items()},
        "events": [[seconds(one.t_ns), one.kind, one.text] for one in told[:EVENTS_MAX]],
        "robot": _robot(config),
    }
    notes = _notes(samples.every, len(told))
    about = Section("The log", "log", _about(log))
    return document(
        log.path.name,
        "softarm log",
        _lead(log, begin_ns + offset_ns, notes),
        [Section("Flight", "flight", _stage()), about],
        player=data,
    )


def _row(sight: Sight) -> tuple[float, ...]:
    nan = math.nan
    out, frame, seen = sight.tick.outputs, sight.frame, sight.tick.outputs.observed
    bodies = frame.bodies if frame and seen else ()
    spots = [(b.y_m, b.z_m) if b.tracked else (nan, nan) for b in bodies] or [(nan, nan)] * len(BODY_NAMES)
    wanted = out.action or (nan, nan)
    return (
        *(y for y, _ in spots),
        *(z for _, z in spots),
        wanted[0],
        out.sent.cart_velocity_m_s,
        sight.rail.velocity_m_s if sight.rail else nan,
        wanted[1],
        out.sent.pressure_kpa,
        sight.pressure.pressure_kpa if sight.pressure else nan,
        out.late_ns * 1e-6,
        seen.mocap_age_ns * 1e-6 if seen else nan,
        out.policy_ns * 1e-6,
    )


def _goal(sight: Sight, config: Config) -> tuple[Any, ...]:
    """Number, kind, state, target and shelf (y of its front edge, z of its board); None: there is none."""
    out = sight.tick.outputs
    status, goal = out.goal, out.goal.goal
    if goal is None:
        return 0, "", "", None, None
    if not (math.isfinite(goal.y_m) and math.isfinite(goal.z_m)):
        return status.number, goal.kind, status.state, None, None
    depth_m = flight.shelf_depth_m(out.policy, config)
    shelf = None if depth_m is None else (round(goal.y_m + depth_m, 4), round(goal.z_m - BOARD_BELOW_M, 4))
    return status.number, goal.kind, status.state, (goal.y_m, goal.z_m), shelf


def _robot(config: Config) -> dict[str, Any]:
    rail, pressure = config.limits.rail, config.limits.pressure
    return {
        "soft_m": [rail.position_min_m, rail.position_max_m],
        "hard_m": [-RAIL_TRAVEL_M, RAIL_TRAVEL_M],
        "hinge_z_m": Arm().base_height_m,
        "arm_m": sum(Arm().link_length_m),
        "radius_m": config.goals.success_radius_m,
        "pressure_kpa": [pressure.min_kpa, pressure.max_kpa],
        "period_s": 1 / config.control.rate_hz,
    }


def _notes(every: int, events: int) -> list[str]:
    notes = []
    if every > 1:
        notes.append(f"It is long: of {every} ticks one is shown, with the worst lateness of them all.")
    if events > EVENTS_MAX:
        notes.append(f"The first {EVENTS_MAX} of {events} events are listed; `softarm events LOG` has all.")
    return notes


def _lead(log: LogFile, wall_ns: int, notes: Sequence[str]) -> Html:
    began = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC)
    policies = ", ".join(dict.fromkeys(policy["name"] for policy in log.policies)) or "none"
    software = log.metadata.get(names.SOFTWARE, {})
    facts = tiles(
        (
            ("began, UTC", f"{began:%Y-%m-%d %H:%M:%S}"),
            ("length", _length(log.duration_s)),
            ("policy", policies),
            ("softarm", software.get("softarm", "unknown")),
        )
    )
    return join([el("h1", el("code", log.path.name)), facts, *(el("p", prose(note)) for note in notes)])


def _length(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"


_BUTTONS = (
    ("event-back", "«", "the event before (P)"),
    ("back", "−1", "a tick back (left arrow)"),
    ("play", "▶", "play or pause (space)"),
    ("on", "+1", "a tick on (right arrow)"),
    ("event-on", "»", "the next event (N)"),
)
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5", "20")
_WINDOWS = (("0", "all of it"), ("60", "a minute"), ("20", "20 s"), ("5", "5 s"))


def _stage() -> Html:
    """Where player.js draws, and what steers it."""
    buttons = [
        el("button", text, type="button", data_do=do, title=told, aria_label=told) for do, text, told in _BUTTONS
    ]
    speeds = [el("option", f"{speed}×", value=speed, selected="" if speed == "1" else None) for speed in _SPEEDS]
    windows = [el("option", text, value=value) for value, text in _WINDOWS]
    slider = el("input", type="range", id="time", min="0", max="1", step="any", value="0", aria_label="time")
    transport = el(
        "div",
        slider,
        el("div", *buttons, class_="keys"),
        el("label", "speed ", el("select", *speeds, id="speed")),
        el("label", "charts show ", el("select", *windows, id="window")),
        el("output", id="clock"),
        class_="transport",
    )
    scene = el("canvas", id="scene", tabindex="0", role="img", aria_label="the arm at the moment that is shown")
    stage = el("div", scene, el("p", id="now", class_="now", aria_live="off"), class_="stage")
    happened = el("div", el("h3", "What happened"), el("ol", id="events"), class_="happened")
    charts = el("canvas", id="charts", tabindex="0", role="img", aria_label="charts on the same time")
    hint = (
        "Click or drag in the charts, or click what happened. Keys: space plays, arrows go by a tick, with Shift by a "
        "second, N and P to the next event and the one before, + and − for the speed, Home and End."
    )
    missing = el("noscript", el("p", "A script inside this page plays the log; this browser does not run it."))
    return join([el("div", stage, happened, class_="player"), transport, charts, el("p", hint, class_="hint"), missing])


def _about(log: LogFile) -> Html:
    said = log.metadata
    rows = [
        *((f"software: {key}", value) for key, value in said.get(names.SOFTWARE, {}).items()),
        *((f"machine: {key}", value) for key, value in said.get(names.MACHINE, {}).items()),
        *((f"policy {policy['name']}", policy.get("description", "")) for policy in log.policies),
    ]
    facts = el("dl", *(join([el("dt", key), el("dd", value)]) for key, value in rows), class_="about")
    configuration = el("pre", log.config.model_dump_json(indent=1))
    folded = el("details", el("summary", "Configuration in effect"), configuration)
    return join([el("p", log.ending.removeprefix(f"{log.path}: ").capitalize()), facts, folded])
