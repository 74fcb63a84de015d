"""Endpoints that command the robot. Their docstrings are the texts of /docs."""

from typing import Annotated

from fastapi import APIRouter, Body, Request
from fastapi.openapi.models import Example
from fastapi.responses import Response

from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.refusals import Refused, answers, json_response
from softarm.daemon.api.requests import Requests
from softarm.daemon.api.status import RequestAnswer, StatusView
from softarm.daemon.control import workspace
from softarm.schemas.goals import Goal
from softarm.schemas.rest import GoalAnswer, GoalBody, ReachBody

EXAMPLES: dict[str, Example] = {
    "reach": {"value": {"kind": "reach", "y_m": -0.2, "z_m": 0.65}},
    "hold": {"value": {"kind": "hold"}},
    "run": {"value": {"kind": "run"}},
}


class Commands:
    """Endpoints for arming, stopping and goals."""

    def __init__(self, context: ApiContext, view: StatusView, requests: Requests) -> None:
        self._context, self._view, self._requests = context, view, requests

    def router(self) -> APIRouter:
        """Return the routes of these endpoints."""
        router = APIRouter(tags=["Commands"], default_response_class=Response)
        commanded = answers(RequestAnswer, 409, 503)
        router.post("/api/arm", responses=commanded)(self.arm)
        router.post("/api/disarm", responses=commanded)(self.disarm)
        router.post("/api/stop", responses=commanded)(self.stop)
        router.post("/api/acknowledge", responses=commanded)(self.acknowledge)
        router.post("/api/goal", responses=answers(RequestAnswer, 400, 409, 422, 503))(self.post_goal)
        router.delete("/api/goal", responses=commanded)(self.delete_goal)
        router.get("/api/goal", responses=answers(GoalAnswer, 503))(self.get_goal)
        return router

    async def arm(self, request: Request) -> Response:
        """Enable the drive and the regulator. A refusal lists every reason."""
        return await self._requests.post(request, "arm")

    async def disarm(self, request: Request) -> Response:
        """Brake, vent, hold the cart until the arm is still, then disable the drive. Always accepted."""
        return await self._requests.post(request, "disarm")

    async def stop(self, request: Request) -> Response:
        """Stop at once and latch until acknowledged. This does not replace the emergency-stop button."""
        return await self._requests.post(request, "stop")

    async def acknowledge(self, request: Request) -> Response:
        """Release the latch of an emergency stop whose cause is gone. The robot is then disarmed."""
        return await self._requests.post(request, "acknowledge")

    async def post_goal(self, request: Request, body: Annotated[GoalBody, Body(openapi_examples=EXAMPLES)]) -> Response:
        """Give the armed robot a goal, which cancels the running one. The answer may carry `warnings`."""
        goal = Goal(body.kind, body.y_m, body.z_m) if isinstance(body, ReachBody) else Goal(body.kind)
        if reasons := workspace.refusals(goal, self._context.config):
            raise Refused(422, *reasons)
        snapshot = self._view.snapshot()
        entry = self._view.policies.get(snapshot.policy) if snapshot else None
        trained = entry.spec.trained if entry and entry.spec else None
        warnings = workspace.warnings(goal, entry.name if entry else "", trained)
        return await self._requests.post(request, "goal", goal=goal, warnings=warnings)

    async def delete_goal(self, request: Request) -> Response:
        """Cancel the goal. The robot holds."""
        return await self._requests.post(request, "cancel_goal")

    async def get_goal(self) -> Response:
        """Return the newest goal and its state, `none` before the first goal."""
        snapshot = self._view.snapshot()
        if snapshot is None:
            raise Refused(503, *self._view.why_unhealthy())
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
