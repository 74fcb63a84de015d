"""Log player: one HTML file with the arm on a time slider, charts and events."""

import math
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.recordings import flight
from softarm.recordings.flight import Moment
from softarm.recordings.log_file import LogFile
from softarm.reporting import plot
from softarm.reporting.document import Section, document
from softarm.reporting.markup import Html, el, join, prose, tiles
from softarm.schemas import log as names
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Arm
from softarm.schemas.robot import RAIL_TRAVEL_M

TICKS_MAX = 120_000  # about 7 MB; longer logs show every second tick, every fourth, and so on
EVENTS_MAX = 5000

_BODIES = tuple(f"{name}_{axis}" for axis in "yz" for name in BODY_NAMES)
_LATENESS = ("late_ms", "mocap_age_ms", "policy_ms")  # the worst value of omitted ticks is shown
# Curve -> its name in `flight.figures`.
_CURVES = {
    "cart_requested": "action_cart_velocity_m_s",
    "cart_sent": "sent_cart_velocity_m_s",
    "cart_measured": "rail_velocity_m_s",
    "pressure_requested": "action_pressure_kpa",
    "pressure_sent": "sent_pressure_kpa",
    "pressure_measured": "measured_pressure_kpa",
    **{name: name for name in _LATENESS},
}
SERIES = (*_BODIES, *_CURVES)
_WORST = np.isin(SERIES, _LATENESS)


class Samples:
    """Rows of numbers with stamps; every second row is dropped when there are too many."""

    def __init__(self, most: int = TICKS_MAX) -> None:
        self._rows = np.empty((most, len(SERIES)))
        self._stamps = np.empty(most, dtype=np.int64)
        self.every, self._kept, self._skipped = 1, 0, 0

    def add(self, stamp_ns: int, row: Sequence[float]) -> None:
        """Add one row of numbers."""
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
        """Return the numbers by name."""
        return dict(zip(SERIES, self._rows[: self._kept].T, strict=True))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Return the start times of the ticks."""
        return self._stamps[: self._kept]


class _Runs:
    """Values that hold for a while, stored as one entry per change."""

    def __init__(self) -> None:
        self.entries: list[list[Any]] = []
        self._last: str | None = None

    def add(self, stamp_ns: int, *what: Any) -> None:
        if (text := repr(what)) != self._last:  # as text, since NaN does not equal itself
            self._last = text
            self.entries.append([stamp_ns, *what])


def page(log: LogFile, entries: Iterable[Entry], advance: Callable[[], None] = lambda: None) -> str:
    """Return the player page of a log and its events; `advance` is called for every message read.

    Raises:
        LogError: The log cannot be read or has no ticks.
    """
    offset_ns = flight.wall_minus_monotonic_ns(log.path, log.metadata)
    samples = Samples()
    runs = {name: _Runs() for name in ("mode", "policy", "goal", "wrong")}
    config = log.config
    for one in flight.moments(log.path):
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
        return (stamp_ns - begin_ns) // 1_000_000 / 1000  # in whole ms, as the stamps of the ticks

    listed = list(entries)
    data = {
        "begin_ms": (begin_ns + offset_ns) // 1_000_000,
        "stamps": plot.packed_integers((stamps - begin_ns) // 1_000_000),  # in ms
        "series": {name: plot.packed_levels(values) for name, values in samples.columns.items()},
        "runs": {name: [[seconds(at), *what] for at, *what in each.entries] for name, each in runs.items()},
        "events": [[seconds(one.t_ns), one.kind, one.text] for one in listed[:EVENTS_MAX]],
        "robot": _robot(config),
    }
    notes = _notes(samples.every, len(listed))
    about = Section("The log", "log", _about(log))
    return document(
        log.path.name,
        "softarm log",
        _lead(log, begin_ns + offset_ns, notes),
        [Section("Flight", "flight", _stage()), about],
        player=data,
    )


def _row(moment: Moment) -> tuple[float, ...]:
    nan, figures = math.nan, flight.figures(moment)
    bodies = moment.frame.bodies if moment.frame and moment.tick.outputs.observed else ()
    spots = [(b.y_m, b.z_m) if b.tracked else (nan, nan) for b in bodies] or [(nan, nan)] * len(BODY_NAMES)
    return (*(y for y, _ in spots), *(z for _, z in spots), *(figures[name] for name in _CURVES.values()))


def _goal(moment: Moment, config: Config) -> tuple[Any, ...]:
    """Return number, kind, state, target and shelf (y of its front edge, z of its board) of the goal."""
    out = moment.tick.outputs
    status, goal = out.goal, out.goal.goal
    if goal is None:
        return 0, "", "", None, None
    if not (math.isfinite(goal.y_m) and math.isfinite(goal.z_m)):
        return status.number, goal.kind, status.state, None, None
    shelf_m = flight.shelf_m(goal, out.policy, config)
    shelf = None if shelf_m is None else (round(shelf_m[0], 4), round(shelf_m[1], 4))
    return status.number, goal.kind, status.state, (goal.y_m, goal.z_m), shelf


def _robot(config: Config) -> dict[str, Any]:
    rail = config.limits.rail
    return {
        "soft_m": [rail.position_min_m, rail.position_max_m],
        "hard_m": [-RAIL_TRAVEL_M, RAIL_TRAVEL_M],
        "hinge_z_m": Arm().base_height_m,
        "arm_m": sum(Arm().link_length_m),
        "radius_m": config.goals.success_radius_m,
    }


def _notes(every: int, events: int) -> list[str]:
    notes = []
    if every > 1:
        notes.append(f"It is long: of {every} ticks one is shown, with the worst lateness of them all.")
    if events > EVENTS_MAX:
        notes.append(f"The first {EVENTS_MAX} of {events} events are listed; `softarm logs show LOG` has all.")
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
    """Return the drawing area of player.js and its controls."""
    buttons = [
        el("button", text, type="button", data_do=do, title=label, aria_label=label) for do, text, label in _BUTTONS
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
    stage = el("div", scene, el("p", id="now", class_="now", aria_live="off"))
    happened = el("div", el("h3", "What happened"), el("ol", id="events"), class_="happened")
    charts = el("div", id="charts", class_="plots", tabindex="0", role="img", aria_label="charts on the same time")
    hint = (
        "Click or drag in the charts, or click what happened. Keys: space plays, arrows go by a tick, with Shift by a "
        "second, N and P to the next event and the one before, + and − for the speed, Home and End."
    )
    missing = el("noscript", el("p", "The player needs JavaScript. Enable scripts for this page in the browser."))
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
