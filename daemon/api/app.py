"""The REST API: requests into the inbox, snapshots out. It never touches the control loop otherwise."""

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, Any

from fastapi import Body, FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from fastapi_offline import FastAPIOffline
from starlette.exceptions import HTTPException

from softarm import __version__
from softarm.common.words import did_you_mean
from softarm.daemon.api.aside import Aside
from softarm.daemon.api.auth import Door
from softarm.daemon.api.bounds import STREAMS_MAX, WHO, Guard
from softarm.daemon.api.endpoints import metrics
from softarm.daemon.api.endpoints.entrance import Entrance
from softarm.daemon.api.endpoints.files import LISTING_S, LISTINGS_MAX, Files
from softarm.daemon.api.endpoints.pages import Pages
from softarm.daemon.api.endpoints.policies import Installed, Policies, policy_answer, tried_out
from softarm.daemon.api.endpoints.robot import robot_answer
from softarm.daemon.api.login import Sessions
from softarm.daemon.api.refusals import Refused, json_response, on_http_error, on_refused, refusal, whole
from softarm.daemon.api.sentences import sentences
from softarm.daemon.api.status import RecorderState, RequestAnswer, Status, StatusView
from softarm.daemon.api.stream import POLL_S, stream
from softarm.daemon.control import workspace
from softarm.daemon.control.inbox import ANSWER_S, STOP_WAITS, Inbox, InboxFull
from softarm.daemon.control.records import Outputs, Problems, RequestKind, RequestResult
from softarm.daemon.logbook import folder
from softarm.daemon.logbook.history import KEPT, History
from softarm.daemon.logbook.recent import KEPT_S, Recent
from softarm.policies.base import Policy
from softarm.policies.runner import PolicyRunner, ThreadRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame
from softarm.schemas.rest import (
    EventsAnswer,
    GoalAnswer,
    GoalBody,
    Health,
    IncidentsAnswer,
    LogDeleted,
    LoginAnswer,
    LogsAnswer,
    PoliciesAnswer,
    PolicyBody,
    ReachBody,
    RecentAnswer,
    Refusal,
    ReplayAnswer,
    ReportsAnswer,
    RobotAnswer,
    TicketAnswer,
)
from softarm.schemas.robot import CONTROL_RATE_HZ

LOADS_MAX, LOADING_S = 2, 120.0  # policies at once, time for each
RECENT_S = 10.0  # to make the last minutes text
REFUSALS = {
    400: "a body that cannot be read as JSON at all",
    401: "the token is missing or wrong",
    403: "asked under a foreign host name, or by a page of another site",
    404: "no such policy, or no such file; says where those there are are listed",
    408: "the body did not come in time",
    409: "refused by the control loop, with its reasons; or a file that cannot be read or deleted now",
    413: "a body of more than 4096 bytes",
    422: "a wrong body or a target out of reach, says what is allowed; or a log that cannot be replayed, says why",
    503: "the control loop does not answer",
    504: "it was not done in time and was given up",
}
ZIP = {"content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}}
MCAP = {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}
TEXT = {"content": {"text/plain": {"schema": {"type": "string"}}}}
PAGE = {"content": {"text/html": {"schema": {"type": "string"}}}}
FILE = {"content": {"*/*": {"schema": {"type": "string", "format": "binary"}}}}
ANYWHERE = (401, 403, 408, 413)  # before a request is looked at


def _no_problems() -> Problems:
    return Problems()


@dataclass(frozen=True, slots=True)
class ApiContext:
    """All that the API shares with the rest of the daemon."""

    config: Config
    inbox: Inbox
    snapshot: Callable[[], Outputs | None]  # the newest one
    problems: Callable[[], Problems] = _no_problems  # of the devices, as they are now
    recorder: RecorderState | None = None
    history: History = field(default_factory=lambda: History("", time.monotonic_ns, time.time_ns))
    recent: Recent = field(default_factory=lambda: Recent(time.monotonic_ns, time.time_ns))
    policies: Policies | None = None  # None: `Installed`
    frame: Callable[[], MocapFrame | None] = lambda: None  # the newest good one
    simulated: bool = False  # the robot, in this process
    sessions: Sessions | None = None  # who is logged in, where the stop's own way shall know it too
    stop_port: Callable[[], int | None] = lambda: None  # of the stop's own way
    left_at: Callable[[], datetime | None] = lambda: None  # when the stop was that the daemon before this one left
    clock: Callable[[], int] = field(default=time.monotonic_ns)


def create_app(context: ApiContext) -> FastAPI:
    """The application.

    Raises AuthError when `api.host` is no loopback address and `api.token_file` gives no good token, or another role's
    file does not.
    """
    door = Door(context.config.api)
    sessions = context.sessions or Sessions(context.config.api.port)
    api, entrance, pages = _Api(context), Entrance(door, sessions), Pages(context.stop_port)
    files = Files(context.config, context.recorder)
    app = FastAPIOffline(  # a bench may have no internet; FastAPI's own page loads its scripts from there
        title="softarm",
        version=__version__,
        summary="Goals in, status out: the control daemon of a soft arm on a rail.",
        redoc_url=None,
    )
    app.add_middleware(Guard, door=door, sessions=sessions)
    app.add_exception_handler(Refused, on_refused)
    app.add_exception_handler(HTTPException, on_http_error)
    app.add_exception_handler(RequestValidationError, api.on_invalid)
    for method, path, endpoint, answer, statuses in (
        ("GET", "/", pages.index, PAGE, (404,)),
        ("GET", "/dashboard/{path:path}", pages.file, FILE, (404,)),
        ("GET", "/api/robot", api.robot, RobotAnswer, ()),
        ("GET", "/api/status", api.status, Status, (503,)),
        ("GET", "/api/recent", api.get_recent, RecentAnswer, (422, 503, 504)),
        ("GET", "/api/health", api.health, Health, ()),
        ("POST", "/api/arm", api.arm, RequestAnswer, (409, 503)),
        ("POST", "/api/disarm", api.disarm, RequestAnswer, (409, 503)),
        ("POST", "/api/stop", api.stop, RequestAnswer, (409, 503)),
        ("POST", "/api/acknowledge", api.acknowledge, RequestAnswer, (409, 503)),
        ("POST", "/api/goal", api.post_goal, RequestAnswer, (400, 409, 422, 503)),
        ("DELETE", "/api/goal", api.delete_goal, RequestAnswer, (409, 503)),
        ("GET", "/api/goal", api.get_goal, GoalAnswer, (503,)),
        ("GET", "/api/policies", api.get_policies, PoliciesAnswer, (503, 504)),
        ("PUT", "/api/policy", api.put_policy, RequestAnswer, (400, 404, 409, 422, 503, 504)),
        ("GET", "/api/logs", files.logs, LogsAnswer, (503, 504)),
        ("GET", "/api/logs/{name}", files.log, MCAP, (404, 409, 503, 504)),
        ("DELETE", "/api/logs/{name}", files.delete_log, LogDeleted, (404, 409, 503, 504)),
        ("POST", "/api/logs/{name}/replay", files.replay_log, ReplayAnswer, (404, 409, 422, 503, 504)),
        ("GET", "/api/incidents", files.incidents, IncidentsAnswer, (503, 504)),
        ("GET", "/api/incidents/{name}", files.incident, ZIP, (404, 503, 504)),
        ("GET", "/api/reports", files.reports, ReportsAnswer, (503, 504)),
        ("GET", "/api/reports/{name}", files.report, PAGE, (404, 409, 503, 504)),
        ("GET", "/metrics", api.get_metrics, TEXT, (503, 504)),
        ("GET", "/api/login", entrance.who, LoginAnswer, ()),
        ("POST", "/api/login", entrance.login, LoginAnswer, (400, 409, 422)),
        ("POST", "/api/logout", entrance.logout, LoginAnswer, ()),
        ("POST", "/api/ticket", entrance.ticket, TicketAnswer, ()),
        ("GET", "/api/events", api.get_events, EventsAnswer, (422,)),
    ):
        responses: dict[int | str, dict[str, Any]] = {200: answer if isinstance(answer, dict) else {"model": answer}}
        may_come = sorted({*ANYWHERE, *statuses})
        responses |= {code: {"model": Refusal, "description": REFUSALS[code]} for code in may_come}
        if answer is Health:
            responses[503] = {"model": Health, "description": "not healthy, and why"}
        summary = (endpoint.__doc__ or "").partition(".")[0]
        app.add_api_route(
            path, endpoint, methods=[method], summary=summary, responses=responses, response_class=Response
        )
    app.add_api_websocket_route("/api/stream", api.stream)
    return app


class _Api:
    """The endpoints. Their docstrings are the page at /docs."""

    def __init__(self, context: ApiContext) -> None:
        self._context = context
        self._policies = context.policies or Installed(context.config)
        self._loading = Aside(LOADS_MAX, LOADING_S)
        self._listing = Aside(LISTINGS_MAX, LISTING_S)
        self._charting, self._charts = Aside(1, RECENT_S), asyncio.Lock()
        self._streams = 0
        self._view = StatusView(
            context.snapshot,
            context.problems,
            context.recorder,
            self._policies.available(),
            context.clock,
            __version__,
            context.stop_port,
            frame=context.frame,
            left_at=context.left_at,
        )

    async def robot(self) -> Response:
        """What does not change while the daemon runs: sizes, limits, where a stop is taken."""
        context = self._context
        answer = robot_answer(
            context.config, run=context.history.run, simulated=context.simulated, stop_port=context.stop_port()
        )
        return json_response(answer.model_dump_json())

    async def get_recent(self, seconds: str = "60") -> Response:
        """The last `seconds` (1 to 600) as columns, a whole second at a time, for charts that survive a reload."""
        wanted = whole("seconds", seconds, 1, KEPT_S)
        async with self._charts:  # one after the other: whoever asks often waits for nobody but others like him
            text = await self._charting.run("the last minutes", lambda: self._context.recent.json(wanted))
        return json_response(text)

    async def status(self) -> Response:
        """Everything about the robot, as of the newest control tick."""
        return json_response(self._told(self._view.json()))

    async def health(self) -> Response:
        """200 when the robot can be used, else 503 with the reasons."""
        reasons = tuple(self._view.why_unhealthy())
        return json_response(Health(healthy=not reasons, reasons=reasons).model_dump_json(), 503 if reasons else 200)

    async def arm(self, request: Request) -> Response:
        """Switch the drive on and let the regulator follow. Refused with every reason why not."""
        return await self._ask(request, "arm")

    async def disarm(self, request: Request) -> Response:
        """Brake, vent, hold the cart until the arm is still, switch off. Always taken."""
        return await self._ask(request, "disarm")

    async def stop(self, request: Request) -> Response:
        """Emergency stop: latched until acknowledged. It does not replace the button on the wall."""
        return await self._ask(request, "stop")

    async def acknowledge(self, request: Request) -> Response:
        """Free the latch of an emergency stop whose cause is gone; the robot is disarmed then."""
        return await self._ask(request, "acknowledge")

    async def post_goal(
        self,
        request: Request,
        body: Annotated[
            GoalBody,
            Body(
                openapi_examples={
                    "reach": {"value": {"kind": "reach", "y_m": -0.2, "z_m": 0.65}},
                    "hold": {"value": {"kind": "hold"}},
                    "run": {"value": {"kind": "run"}},
                }
            ),
        ],
    ) -> Response:
        """Give the armed robot a goal; one that runs is cancelled by it. The answer may carry `warnings`."""
        goal = Goal(body.kind, body.y_m, body.z_m) if isinstance(body, ReachBody) else Goal(body.kind)
        if reasons := workspace.refusals(goal, self._context.config):
            raise Refused(422, *reasons)
        snapshot = self._view.snapshot()
        entry = self._view.policies.get(snapshot.policy) if snapshot else None
        trained = entry.spec.trained if entry and entry.spec else None
        warnings = workspace.warnings(goal, entry.name if entry else "", trained)
        return await self._ask(request, "goal", goal=goal, warnings=warnings)

    async def delete_goal(self, request: Request) -> Response:
        """Take the goal back: the robot holds."""
        return await self._ask(request, "cancel_goal")

    async def get_goal(self) -> Response:
        """The newest goal and how it went; state `none` when there was none."""
        snapshot = self._snapshot()
        status, goal = snapshot.goal, snapshot.goal.goal
        target = goal if goal is not None and goal.kind == "reach" else None
        answer = GoalAnswer(
            kind=goal.kind if goal else None,
            state=status.state,
            reason=status.reason,
            y_m=target.y_m if target else None,
            z_m=target.z_m if target else None,
            closest_m=status.closest_m,
            time_s=status.time_s,
            number=status.number,
        )
        return json_response(answer.model_dump_json())

    async def get_policies(self) -> Response:
        """All policies that can be chosen, and those that cannot, with the reason."""
        self._view.policies = await self._listing.run("listing the policies", self._policies.available)
        snapshot = self._view.snapshot()
        answer = PoliciesAnswer(
            active=snapshot.policy if snapshot else None,
            policies=tuple(map(policy_answer, self._view.policies.values())),
        )
        return json_response(answer.model_dump_json())

    async def put_policy(
        self,
        request: Request,
        body: Annotated[PolicyBody, Body(openapi_examples={"reach": {"value": {"name": "reach"}}})],
    ) -> Response:
        """Use another policy: loaded and tried out beside the control loop, swapped between two ticks."""
        policy = await self._loading.run(f"loading the policy '{body.name[:40]}'", lambda: self._load(body.name))
        runner = ThreadRunner(policy, self._context.config.failsafe.policy_budget_s)
        try:
            return await self._ask(request, "policy", policy=body.name, runner=runner)
        except Refused as refused:
            if refused.status == 409:  # at 503 the request, and so the runner, may still be taken
                runner.close()
            raise

    async def get_metrics(self) -> Response:
        """Figures for a Prometheus server, in its text format."""
        recorder, settings = self._context.recorder, self._context.config.recorder
        free = await self._listing.run("looking at the disk", lambda: folder.free_bytes(settings.directory))
        text = metrics.exposition(self._view, self._context.history, recorder.dropped if recorder else 0, free)
        return Response(text, media_type=metrics.TYPE)

    async def get_events(self, since: str | None = None, limit: str = "100") -> Response:
        """What happened: the newest, or with `since=` (a number) the oldest after that one; `limit` of them."""
        history = self._context.history
        after = None if since is None else whole("since", since, 0, None)
        found = history.after(after, whole("limit", limit, 1, KEPT))
        kept = history.entries
        ends = (kept[0].number, kept[-1].number) if kept else (None, None)
        answer = EventsAnswer(run=history.run, events=found, oldest=ends[0], newest=ends[1])
        return json_response(answer.model_dump_json())

    async def stream(self, socket: WebSocket, hz: str = str(CONTROL_RATE_HZ)) -> None:
        """Every status that is new, at most `hz` times a second; a slow client gets fewer of them."""
        try:
            rate = float(hz)
        except ValueError:
            rate = math.nan
        if not 0 < rate <= CONTROL_RATE_HZ:
            sentence = f"hz: is {hz[:20]!r}; allowed above 0, at most {CONTROL_RATE_HZ}"
            await socket.send_denial_response(refusal(422, (sentence,)))
        elif self._streams >= STREAMS_MAX:
            sentence = f"{STREAMS_MAX} clients have a stream already: close one, or GET /api/status"
            await socket.send_denial_response(refusal(503, (sentence,)))
        else:
            self._streams += 1
            try:
                await stream(self._view, socket, rate)
            finally:
                self._streams -= 1

    async def on_invalid(self, request: Request, error: Exception) -> Response:
        """A body of the wrong shape."""
        assert isinstance(error, RequestValidationError)  # registered for this type
        return refusal(422, sentences(error.errors(), request.url.path, self._context.config))

    def _snapshot(self) -> Outputs:
        snapshot = self._view.snapshot()
        if snapshot is None:
            raise Refused(503, *self._view.why_unhealthy())
        return snapshot

    def _told(self, status: bytes | None) -> bytes:
        if status is None:
            raise Refused(503, *self._view.why_unhealthy())
        return status

    async def _ask(
        self,
        request: Request,
        kind: RequestKind,
        *,
        goal: Goal | None = None,
        policy: str | None = None,
        runner: PolicyRunner | None = None,
        warnings: tuple[str, ...] = (),
    ) -> Response:
        """Leave a request and wait for the tick that answers it."""
        try:
            number = self._context.inbox.post(kind, goal=goal, policy=policy, runner=runner, who=request.scope[WHO])
        except InboxFull as error:
            raise Refused(503, str(error)) from error
        asked_ns = self._context.clock()
        result = await self._result(kind, number, asked_ns)
        if result is None:
            raise Refused(503, f"{kind}: the control loop did not answer within {ANSWER_S:g} s", *_meanwhile(kind))
        if not result.accepted:
            raise Refused(409, *result.reasons)
        return json_response(self._told(self._view.answer(warnings)))

    async def _result(self, kind: RequestKind, number: int, asked_ns: int) -> RequestResult | None:
        deadline = time.monotonic() + ANSWER_S
        late = False
        while not late:
            late = time.monotonic() >= deadline  # then once more: it may be the API itself that was held up
            snapshot = self._view.snapshot()
            if kind == "stop" and snapshot is not None and snapshot.has_stopped(number, asked_ns):
                return RequestResult(number, True)
            for result in reversed(snapshot.results if snapshot else ()):
                if result.number == number:
                    return result
            await asyncio.sleep(POLL_S)
        return None

    def _load(self, name: str) -> Policy:
        """Aside: a policy, tried out."""
        entries = self._policies.available()
        if name not in entries:
            hint = did_you_mean(name, entries)
            raise Refused(404, f"no policy '{name}'; {hint}there are: {', '.join(entries) or 'none'}")
        self._view.policies = entries
        return tried_out(self._policies, name)


def _meanwhile(kind: RequestKind) -> tuple[str, ...]:
    """What to do when the loop is silent."""
    if kind == "stop":
        return (STOP_WAITS,)
    return ("see GET /api/health; the request is still in the inbox",)
