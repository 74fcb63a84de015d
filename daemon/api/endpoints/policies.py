"""Which policies the API offers, and how one is made ready beside the control loop."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from softarm.daemon.api.refusals import Refused
from softarm.policies import registry, trial
from softarm.policies.base import Policy, PolicyError
from softarm.policies.registry import PolicyEntry
from softarm.schemas.config import Config
from softarm.schemas.rest import PolicyAnswer


class Policies(Protocol):
    """Which policies there are, and how one is made; both may take long and are called in a worker thread."""

    def available(self) -> Mapping[str, PolicyEntry]:
        """All, by name."""

    def load(self, name: str) -> Policy:
        """One that has done its first step. Raises PolicyError."""


@dataclass(frozen=True, slots=True)
class Installed:
    """The installed, shipped and configured policies."""

    config: Config

    def available(self) -> Mapping[str, PolicyEntry]:
        """See Policies."""
        return registry.available(self.config.policies)

    def load(self, name: str) -> Policy:
        """See Policies; tried out in a process of its own before."""
        return trial.load(name, self.config.policies, trial.TRIAL_S)


def tried_out(policies: Policies, name: str) -> Policy:
    """Make a policy. Raises Refused."""
    try:
        return policies.load(name)
    except PolicyError as error:
        raise Refused(422, str(error)) from error


def policy_answer(entry: PolicyEntry) -> PolicyAnswer:
    """A policy as GET /api/policies shows it."""
    spec = entry.spec
    if spec is None:
        return PolicyAnswer(name=entry.name, plugin=entry.plugin, description=entry.description, error=entry.error)
    return PolicyAnswer(
        name=entry.name,
        plugin=entry.plugin,
        description=spec.description,
        error=entry.error,
        needs_target=spec.needs_target,
        episode_steps=spec.episode_steps,
        trained=spec.trained,
        sha256=spec.sha256,
        shelf_depth_m=spec.shelf_depth_m,
    )
