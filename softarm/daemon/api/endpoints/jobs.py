"""Endpoints for jobs: an excitation, a diagnosis or a replay. Their docstrings are the texts of /docs."""

from datetime import UTC, datetime
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Body, Request
from fastapi.openapi.models import Example
from fastapi.responses import Response

from softarm.common.words import did_you_mean
from softarm.daemon.api.bounds import WHO
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.endpoints.files import existing_log
from softarm.daemon.api.endpoints.policies import Policies
from softarm.daemon.api.refusals import Refused, answers, json_response
from softarm.daemon.api.status import StatusView
from softarm.daemon.api.workers import LISTING_S, LISTINGS_MAX, Workers
from softarm.daemon.control.records import Mode
from softarm.daemon.runtime.excitation import Excitation
from softarm.daemon.runtime.jobs import Busy, Work
from softarm.daemon.runtime.verb_process import VerbProcess
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.rest import DiagnoseBody, ExcitationEntry, ExciteBody, JobBody, JobEntry, JobsAnswer, ReplayBody

JOB_S = 3600.0
EXAMPLES: dict[str, Example] = {
    "excite": {"value": {"kind": "excite", "excitation": "seed"}},
    "diagnose": {"value": {"kind": "diagnose", "logs": ["softarm-20260101T120000Z.mcap"]}},
    "replay": {"value": {"kind": "replay", "log": "softarm-20260101T120000Z.mcap"}},
}
ARM_FIRST = "arm it first (`softarm arm`, or Arm on the dashboard)"


class JobEndpoints:
    """Endpoints that start, list and cancel jobs."""

    def __init__(self, context: ApiContext, policies: Policies, view: StatusView) -> None:
        self._context, self._policies, self._view = context, policies, view
        self._logs = context.config.recorder.directory.absolute()
        self._reports = context.config.api.reports.absolute()
        self._disk = Workers(LISTINGS_MAX, LISTING_S)

    def router(self) -> APIRouter:
        """Return the routes of these endpoints."""
        router = APIRouter(tags=["Jobs"], default_response_class=Response)
        router.get("/api/jobs", responses=answers(JobsAnswer))(self.jobs)
        router.post("/api/jobs", responses=answers(JobEntry, 400, 404, 409, 422, 503, 504))(self.start)
        router.delete("/api/jobs/{number}", responses=answers(JobEntry, 404, 422))(self.cancel)
        return router

    async def jobs(self) -> Response:
        """Return the newest jobs since the start of the daemon, newest first, and the excitations."""
        excitations = tuple(
            ExcitationEntry(name=name, duration_s=each.duration_s, description=each.description)
            for name, each in EXCITATIONS.items()
        )
        return json_response(JobsAnswer(jobs=self._context.jobs.entries, excitations=excitations).model_dump_json())

    async def start(self, request: Request, body: Annotated[JobBody, Body(openapi_examples=EXAMPLES)]) -> Response:
        """Start a job, one at a time. It runs beside the control loop in a process of low priority.

        An excitation is played by the control loop itself, under the same conditions as a goal.
        """
        report = None
        match body:
            case ExciteBody():
                text, work = f"excitation {body.excitation}", self._excitation(body.excitation, request.scope[WHO])
            case DiagnoseBody():
                report = f"diagnosis-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.html"
                text = f"diagnosis of {', '.join(body.logs)}"
                work = await self._disk.run("preparing a diagnosis", partial(self._diagnosis, body.logs, report))
            case ReplayBody():
                path = await self._disk.run("opening a log", partial(existing_log, self._logs, body.log))
                text, work = f"replay of {body.log}", self._verb("logs", "replay", str(path))
        try:
            entry = self._context.jobs.start(body.kind, text, work, report)
        except Busy as error:
            raise Refused(409, str(error)) from error
        if self._context.recorder is not None:
            self._context.recorder.done("job", f"job {entry.number}: {text}", request.scope[WHO])
        return json_response(entry.model_dump_json())

    async def cancel(self, number: int) -> Response:
        """Cancel the job. An excitation ends as a cancelled goal: the robot holds."""
        entry = self._context.jobs.cancel(number)
        if entry is None:
            raise Refused(404, f"no job {number}; GET /api/jobs lists them")
        return json_response(entry.model_dump_json())

    def _excitation(self, name: str, who: str) -> Work:
        """Return the work of an excitation, or raise Refused: the control loop would refuse its goal."""
        context = self._context
        if name not in EXCITATIONS:
            hint = did_you_mean(name[:40], EXCITATIONS)
            raise Refused(404, f"no excitation '{name[:40]}'; {hint}GET /api/jobs lists them")
        outputs = context.snapshot()
        if outputs is None:
            raise Refused(503, *self._view.why_unhealthy())
        if outputs.mode is not Mode.ARMED:
            raise Refused(409, f"the arm is {outputs.mode}: {ARM_FIRST}")
        goal = outputs.goal
        if goal.state == "running" and goal.goal is not None and goal.goal.kind != "hold":
            advice = "wait for its end or cancel it (`softarm goal cancel`, or Cancel goal on the dashboard)"
            raise Refused(409, f"a goal is running: {advice}")
        if context.recorder is None or context.recorder.path is None:
            raise Refused(409, "recording is switched off: set recorder.enabled to true, then restart the daemon")
        return Excitation(
            name, context.inbox, context.snapshot, context.recorder, self._policies.load, context.config, who
        )

    def _diagnosis(self, logs: tuple[str, ...], report: str) -> Work:
        paths = [str(existing_log(self._logs, name)) for name in logs]
        try:
            self._reports.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = f"api.reports {self._reports}: no report can be written there ({error.strerror})"
            raise Refused(409, f"{reason}; name a directory that the daemon's user may write, and restart") from error
        return self._verb("diagnose", *paths, "--report", str(self._reports / report))

    def _verb(self, *arguments: str) -> Work:
        return VerbProcess(*arguments, limit_s=JOB_S)
