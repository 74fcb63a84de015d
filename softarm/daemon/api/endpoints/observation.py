"""Endpoints that report the robot's state. Their docstrings are the texts of /docs."""

import asyncio
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from itertools import accumulate
from typing import Any

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from fastapi.responses import Response

from softarm import __version__
from softarm.daemon.api.bounds import STREAMS_MAX
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.refusals import Refused, answers, content, json_response, query_integer, refusal
from softarm.daemon.api.status import POLL_S, Status, StatusView
from softarm.daemon.api.workers import LISTING_S, LISTINGS_MAX, Workers
from softarm.daemon.control.records import EStop, Mode, Outputs
from softarm.daemon.control.workspace import HINGE_Z_M
from softarm.daemon.logbook import folder
from softarm.daemon.logbook.history import KEPT, LATE_NS, History
from softarm.daemon.logbook.recent import KEPT_S
from softarm.schemas.flights import BOARD_BELOW_M
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Arm
from softarm.schemas.rest import EventsAnswer, Health, RecentAnswer, RobotAnswer
from softarm.schemas.robot import CONTROL_RATE_HZ, RAIL_TRAVEL_M

# Of GET /metrics: https://prometheus.io/docs/instrumenting/exposition_formats/
PROMETHEUS = "text/plain; version=0.0.4"
Samples = Iterable[tuple[str, float]]  # written labels and value
RECENT_S = 10.0  # time limit for encoding the last minutes
RATE_MIN_HZ = 0.01  # of a stream
UNHEALTHY: dict[int | str, dict[str, Any]] = {
    503: {"model": Health, "description": "the robot cannot be used; the answer states why"}
}


class Observation:
    """Endpoints for status, events, charts and metrics."""

    def __init__(self, context: ApiContext, view: StatusView) -> None:
        self._context, self._view = context, view
        self._disk = Workers(LISTINGS_MAX, LISTING_S)
        self._charting, self._charts = Workers(1, RECENT_S), asyncio.Lock()
        self._streams = 0

    def router(self) -> APIRouter:
        """Return the routes of these endpoints."""
        router = APIRouter(tags=["Observation"], default_response_class=Response)
        router.get("/api/robot", responses=answers(RobotAnswer))(self.robot)
        router.get("/api/status", responses=answers(Status, 503))(self.status)
        router.get("/api/recent", responses=answers(RecentAnswer, 422, 503, 504))(self.get_recent)
        router.get("/api/health", responses=answers(Health) | UNHEALTHY)(self.health)
        router.get("/api/events", responses=answers(EventsAnswer, 422))(self.get_events)
        router.get("/metrics", responses=answers(content("text/plain", text=True), 503, 504))(self.get_metrics)
        router.websocket("/api/stream")(self.stream)
        return router

    async def robot(self) -> Response:
        """Return the constants of this run: dimensions, limits and the dedicated stop port."""
        config = self._context.config
        rail, pressure, goals = config.limits.rail, config.limits.pressure, config.goals
        links = Arm().link_length_m
        answer = RobotAnswer(
            version=__version__,
            run=self._context.history.run,
            simulated=self._context.simulated,
            stop_port=self._context.stop_port(),
            rate_hz=config.control.rate_hz,
            bodies=BODY_NAMES,
            hinge_z_m=HINGE_Z_M,
            link_length_m=links,
            reach_m=sum(links) + goals.success_radius_m,
            rail_travel_m=(-RAIL_TRAVEL_M, RAIL_TRAVEL_M),
            rail_limit_m=(rail.position_min_m, rail.position_max_m),
            rail_margin_m=rail.margin_m,
            cart_velocity_max_m_s=rail.velocity_max_m_s,
            pressure_limit_kpa=(pressure.min_kpa, pressure.max_kpa),
            workspace=goals.workspace,
            success_radius_m=goals.success_radius_m,
            time_limit_s=goals.time_limit_s,
            shelf_board_below_m=BOARD_BELOW_M,
        )
        return json_response(answer.model_dump_json())

    async def get_recent(self, seconds: str = "60") -> Response:
        """Return the last `seconds` (1 to 600) as columns for charts, in whole seconds."""
        count = query_integer("seconds", seconds, 1, KEPT_S)
        async with self._charts:  # one at a time, so frequent clients wait only for each other
            text = await self._charting.run("the last minutes", lambda: self._context.recent.json(count))
        return json_response(text)

    async def status(self) -> Response:
        """Return the robot's complete status as of the newest control tick."""
        status = self._view.json()
        if status is None:
            raise Refused(503, *self._view.why_unhealthy())
        return json_response(status)

    async def health(self) -> Response:
        """Return 200 if the robot can be used, otherwise 503 with the reasons."""
        reasons = tuple(self._view.why_unhealthy())
        return json_response(Health(healthy=not reasons, reasons=reasons).model_dump_json(), 503 if reasons else 200)

    async def get_events(self, since: str | None = None, limit: str = "100") -> Response:
        """Return `limit` events: the newest, or with `since` the oldest after that number."""
        history = self._context.history
        kept = history.entries  # read once, since the control loop appends meanwhile
        after = None if since is None else query_integer("since", since, 0)
        count = query_integer("limit", limit, 1, KEPT)
        found = kept[-count:] if after is None else tuple(each for each in kept if each.number > after)[:count]
        ends = (kept[0].number, kept[-1].number) if kept else (None, None)
        answer = EventsAnswer(run=history.run, events=found, oldest=ends[0], newest=ends[1])
        return json_response(answer.model_dump_json())

    async def get_metrics(self) -> Response:
        """Return figures for a Prometheus server in its text format."""
        recorder, settings = self._context.recorder, self._context.config.recorder
        free = await self._disk.run("reading the free disk space", lambda: folder.free_bytes(settings.directory))
        text = exposition(self._view, self._context.history, recorder.dropped if recorder else 0, free)
        return Response(text, media_type=PROMETHEUS)

    async def stream(self, socket: WebSocket, hz: str = str(CONTROL_RATE_HZ)) -> None:
        """Send every new status, at most `hz` times a second. A slow client gets fewer."""
        try:
            rate = float(hz)
        except ValueError:
            rate = math.nan
        if not RATE_MIN_HZ <= rate <= CONTROL_RATE_HZ:
            reason = f"hz: is {hz[:20]!r}; allowed {RATE_MIN_HZ:g} to {CONTROL_RATE_HZ}"
            await socket.send_denial_response(refusal(422, (reason,)))
        elif self._streams >= STREAMS_MAX:
            reason = f"{STREAMS_MAX} clients already have a stream: close one, or GET /api/status"
            await socket.send_denial_response(refusal(503, (reason,)))
        else:
            self._streams += 1
            try:
                await send_statuses(self._view, socket, rate)
            finally:
                self._streams -= 1


class Pace:
    """Rate limit of a stream: on average at most `hz` a second, without skipping ticks."""

    def __init__(self, hz: float) -> None:
        self._period_s = 1 / hz
        self._due_s = float("-inf")

    def wait_s(self, now_s: float) -> float:
        """Return the time until the next status may be sent; 0 or less means now."""
        return self._due_s - now_s

    def sent(self, now_s: float) -> None:
        """Count a sent status. The next one is due a period after this one was due, or now if that has passed."""
        self._due_s = max(self._due_s + self._period_s, now_s)


async def send_statuses(view: StatusView, socket: WebSocket, hz: float) -> None:
    """Send every status that is new, at most `hz` times a second, until the client leaves."""
    await socket.accept()
    sender = asyncio.create_task(_send(view, socket, Pace(hz)))
    try:
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass  # messages of the client are ignored
    except WebSocketDisconnect:
        pass
    finally:
        sender.cancel()
        await asyncio.gather(sender, return_exceptions=True)


async def _send(view: StatusView, socket: WebSocket, pace: Pace) -> None:
    sent = None
    while True:
        wait_s = pace.wait_s(time.monotonic())
        data = view.json() if wait_s <= 0 else None
        if data is not None and data is not sent:
            sent = data
            pace.sent(time.monotonic())
            await socket.send({"type": "websocket.send", "text": data.decode()})
        else:
            await asyncio.sleep(max(wait_s, POLL_S))


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
    if outputs.tick >= 0:  # else the control loop has failed, and its counts are lost
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
