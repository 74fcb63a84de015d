"""The same tick over a recorded log: it must give the same commands, bit for bit."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from softarm.daemon.control.records import Inputs, Outputs
from softarm.daemon.tick import Controller
from softarm.policies.base import Array, Policy
from softarm.policies.runner import InlineRunner, PolicyOutcome, PolicyRunner
from softarm.schemas.config import Config


@dataclass(frozen=True, slots=True)
class Difference:
    """A tick that came out otherwise than it was recorded."""

    tick: int
    field: str
    recorded: object
    replayed: object


class _RecordedFaults:
    """Runs the policy again, but fails where the recorded one failed: lateness is not in the numbers."""

    def __init__(self, policy: Policy) -> None:
        self._inline = InlineRunner(policy)
        self.policy = policy
        self.recorded: Outputs | None = None

    def reset(self) -> None:
        self._inline.reset()

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        outcome = self._inline.step(observation, goal)
        recorded = self.recorded
        if recorded is None:
            return outcome
        if recorded.policy_fault is not None:
            return PolicyOutcome(None, recorded.policy_fault, recorded.policy_ns)
        return outcome._replace(duration_ns=recorded.policy_ns)

    def close(self) -> None:
        self._inline.close()


COMPARED = ("mode", "estop", "sent", "action", "clamps", "observed", "goal", "events")


def replay(
    ticks: Iterable[tuple[Inputs, Outputs]], config: Config, load: Callable[[str], Policy]
) -> tuple[int, list[Difference]]:
    """Run a log through a new controller; returns the number of ticks and every difference.

    `load` makes a policy by name. The log has to begin with the daemon's first tick.
    """
    runners: dict[str, _RecordedFaults] = {}

    def runner(name: str) -> _RecordedFaults:
        if name not in runners:
            runners[name] = _RecordedFaults(load(name))
        return runners[name]

    controller: Controller | None = None
    differences: list[Difference] = []
    number = 0
    for inputs, recorded in ticks:
        if controller is None:
            controller = Controller(config, runner(config.control.policy))
        changes: dict[int, PolicyRunner] = {
            r.number: runner(r.policy) for r in inputs.requests if r.kind == "policy" and r.policy is not None
        }
        for known in runners.values():
            known.recorded = recorded
        replayed = controller.tick(inputs, changes)
        number += 1
        differences += [
            Difference(recorded.tick, name, was, now)
            for name in COMPARED
            if not _same(was := getattr(recorded, name), now := getattr(replayed, name))
        ]
    return number, differences


def _same(one: object, other: object) -> bool:
    """Equal, with NaN equal to NaN (a hold has no target)."""
    return one == other or repr(one) == repr(other)
