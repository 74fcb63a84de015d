"""Playback of an excitation by the running control loop, in a log of its own."""

import threading
import time
from collections.abc import Callable

from softarm.daemon.control.inbox import ANSWER_S, Inbox, InboxFull, unanswered
from softarm.daemon.control.records import Outputs, RequestKind
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.jobs import Done, JobError, Progress
from softarm.policies import registry, trusted
from softarm.policies.base import Policy, PolicyError
from softarm.policies.runner import PolicyRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal, GoalStatus

_POLL_S = 0.02
_LOG_S = 10.0  # longest wait for a new log
_AFTER_S = 1.0  # of the arm at rest at the end of the log
_FRESH_S = 10.0  # a younger log is not replaced: another excitation has just begun it


class _Refused(JobError):
    """The control loop has refused a request and will not carry it out."""


class Excitation:
    """Work of a job that plays an excitation on the armed robot.

    The excitation is a policy that runs as a goal: arming, limits and failsafe apply as to any goal. The policy that
    was in use before is loaded again at the end.
    """

    def __init__(
        self,
        name: str,
        inbox: Inbox,
        snapshot: Callable[[], Outputs | None],
        recorder: Recorder,
        load: Callable[[str], Policy],
        config: Config,
        who: str,
    ) -> None:
        """Prepare the excitation.

        Args:
            name: an excitation.
            inbox: of the control loop.
            snapshot: returns the newest outputs of the loop.
            recorder: writes the log.
            load: returns the policy of a name, or raises PolicyError.
            config: of the daemon.
            who: source of the requests.
        """
        self._policy = f"{registry.EXCITE}{name}"
        self._inbox, self._snapshot, self._recorder = inbox, snapshot, recorder
        self._load, self._config, self._who = load, config, who
        self._ended = threading.Event()

    def run(self, progress: Progress) -> Done:
        """Play the excitation to its end and return the name of its log, or raise JobError."""
        before = self._now().policy
        progress("preparing the policy and a new log", None)
        policy = registry.load(self._policy)
        length_s = (policy.spec.episode_steps or 0) / self._config.control.rate_hz
        self._use(policy)
        try:
            log = self._new_log(_FRESH_S)
            goal = self._play(length_s, progress)
        finally:
            progress(f"using {before} again", None)
            self._restore(before)
        self._ended.wait(_AFTER_S)
        self._new_log()
        if goal.state != "reached":
            raise JobError(f"{goal.state} after {goal.time_s:.1f} s: {goal.reason}")
        return Done((f"played {goal.time_s:.1f} s", f"recorded {log}"), log)

    def end(self) -> None:
        """Cancel the goal of the excitation."""
        self._ended.set()

    def _play(self, length_s: float, progress: Progress) -> GoalStatus:
        """Run the goal and return its end."""
        if self._ended.is_set():
            raise JobError("cancelled before it began")
        self._ask("goal", goal=Goal("run"))
        number, is_asked = self._now().goal.number, False
        while (goal := self._now().goal).number == number and goal.state == "running":
            progress(f"{goal.time_s:.0f} of {length_s:.0f} s", min(1.0, goal.time_s / length_s))
            if self._ended.is_set() and not is_asked:
                self._ask("cancel_goal")
                is_asked = True
            time.sleep(_POLL_S)
        if goal.number != number:
            raise JobError("another goal has replaced the excitation")
        return goal

    def _use(self, policy: Policy) -> None:
        runner = trusted.runner(policy, self._config.failsafe.policy_budget_s)
        try:
            self._ask("policy", policy=policy.spec.name, runner=runner)
        except _Refused:  # after no answer the control loop may still accept the request and use the runner
            runner.close()
            raise

    def _restore(self, name: str) -> None:
        """Use the earlier policy again, unless another client has changed it meanwhile."""
        if self._now().policy != self._policy:
            return
        try:
            self._use(self._load(name))
        except PolicyError as error:
            raise JobError(str(error)) from error

    def _new_log(self, fresh_s: float = 0.0) -> str:
        """Begin a new log, unless the present one is younger than `fresh_s`, and return its name."""
        before = self._recorder.path
        if before is not None and time.monotonic_ns() - self._recorder.begun_ns < fresh_s * 1e9:
            return before.name
        self._recorder.split()
        deadline_s = time.monotonic() + _LOG_S
        while (path := self._recorder.path) == before or path is None:
            if time.monotonic() > deadline_s:
                raise JobError(
                    f"no new log within {_LOG_S:g} s: {self._recorder.problem or 'recording is switched off'}"
                )
            time.sleep(_POLL_S)
        return path.name

    def _ask(
        self,
        kind: RequestKind,
        *,
        goal: Goal | None = None,
        policy: str | None = None,
        runner: PolicyRunner | None = None,
    ) -> None:
        """Send a request to the control loop and wait for its answer, or raise JobError with the reasons."""
        try:
            number = self._inbox.post(kind, goal=goal, policy=policy, runner=runner, who=self._who)
        except InboxFull as error:
            raise _Refused(str(error)) from error
        posted_ns = time.monotonic_ns()
        while (result := self._now().answer(kind, number, posted_ns)) is None:
            if time.monotonic_ns() - posted_ns > ANSWER_S * 1e9:
                raise JobError(*unanswered(kind))
            time.sleep(_POLL_S)
        if not result.accepted:
            raise _Refused(*result.reasons)

    def _now(self) -> Outputs:
        outputs = self._snapshot()
        if outputs is None:
            raise JobError("the control loop has not ticked yet")
        return outputs
