"""Endpoints that list the policies and choose one. Their docstrings are the texts of /docs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Body, Request
from fastapi.openapi.models import Example
from fastapi.responses import Response

from softarm.common.words import did_you_mean
from softarm.daemon.api.refusals import Refused, answers, json_response
from softarm.daemon.api.requests import Requests
from softarm.daemon.api.status import RequestAnswer, StatusView
from softarm.daemon.api.workers import LISTING_S, LISTINGS_MAX, Workers
from softarm.policies import registry, trial, trusted
from softarm.policies.base import Policy, PolicyError
from softarm.policies.registry import PolicyEntry
from softarm.schemas.config import Config
from softarm.schemas.rest import PoliciesAnswer, PolicyAnswer, PolicyBody

LOADS_MAX, LOADING_S = 2, 120.0
OF_SPEC = ("needs_target", "episode_steps", "trained", "sha256", "shelf_depth_m")
# Built-in policies as an operator is likely to need them; others follow by name.
USEFUL = ("reach-robust", "reach", "reach-wide", "shelf", "trajectory", "mppi", "pid", "hold", "excite")
EXAMPLES: dict[str, Example] = {"reach": {"value": {"name": "reach"}}}


@dataclass(frozen=True, slots=True)
class Policies:
    """The installed, shipped and configured policies. Both calls may be slow and run in a worker thread."""

    config: Config

    def available(self) -> Mapping[str, PolicyEntry]:
        """Return all policies by name."""
        return registry.available(self.config.policies)

    def load(self, name: str) -> Policy:
        """Return a policy after a trial in a separate process, or raise PolicyError."""
        return trial.load(name, self.config.policies, trial.TRIAL_S)


class PolicyEndpoints:
    """Endpoints for the list of policies and for changing the policy."""

    def __init__(self, config: Config, policies: Policies, view: StatusView, requests: Requests) -> None:
        self._budget_s = config.failsafe.policy_budget_s
        self._policies, self._view, self._requests = policies, view, requests
        self._listing, self._loading = Workers(LISTINGS_MAX, LISTING_S), Workers(LOADS_MAX, LOADING_S)

    def router(self) -> APIRouter:
        """Return the routes of these endpoints."""
        router = APIRouter(tags=["Policies"], default_response_class=Response)
        router.get("/api/policies", responses=answers(PoliciesAnswer, 503, 504))(self.get_policies)
        router.put("/api/policy", responses=answers(RequestAnswer, 400, 404, 409, 422, 503, 504))(self.put_policy)
        return router

    async def get_policies(self) -> Response:
        """Return all policies: the active one, built-in ones, others, then those that cannot be used, with `error`."""
        self._view.policies = await self._listing.run("listing the policies", self._policies.available)
        snapshot = self._view.snapshot()
        active = snapshot.policy if snapshot else None
        listed = sorted(self._view.policies.values(), key=lambda entry: _place(entry, active))
        answer = PoliciesAnswer(active=active, policies=tuple(map(policy_answer, listed)))
        return json_response(answer.model_dump_json())

    async def put_policy(
        self, request: Request, body: Annotated[PolicyBody, Body(openapi_examples=EXAMPLES)]
    ) -> Response:
        """Change the policy. It is loaded and tried in the background, then swapped between two ticks."""
        policy = await self._loading.run(f"loading the policy '{body.name[:40]}'", lambda: self._load(body.name))
        runner = trusted.runner(policy, self._budget_s)
        try:
            return await self._requests.post(request, "policy", policy=body.name, runner=runner)
        except Refused as refused:
            if refused.status == 409:  # after 503 the control loop may still accept the request and use the runner
                runner.close()
            raise

    def _load(self, name: str) -> Policy:
        entries = self._policies.available()
        if name not in entries:
            hint = did_you_mean(name, entries)
            raise Refused(404, f"no policy '{name}'; {hint}available: {', '.join(entries) or 'none'}")
        self._view.policies = entries
        try:
            return self._policies.load(name)
        except PolicyError as error:
            raise Refused(422, str(error)) from error


def _place(entry: PolicyEntry, active: str | None) -> tuple[bool, bool, int, str]:
    place = USEFUL.index(entry.name) if entry.name in USEFUL else len(USEFUL)
    return entry.error is not None, entry.name != active, place, entry.name


def policy_answer(entry: PolicyEntry) -> PolicyAnswer:
    """Return a policy's entry in the answer of GET /api/policies."""
    known = {} if entry.spec is None else {name: getattr(entry.spec, name) for name in OF_SPEC}
    return PolicyAnswer(name=entry.name, plugin=entry.plugin, description=entry.description, error=entry.error, **known)
