"""Runners of policies: the control loop receives an outcome in time, even if the policy fails or hangs."""

import math
import threading
from time import monotonic_ns
from typing import NamedTuple

import numpy as np

from softarm.policies.base import Array, Policy


class PolicyOutcome(NamedTuple):
    """Action of a policy, or a sentence that states why it is missing."""

    action: Array | None  # float32 [2]: cart velocity (m/s), pressure (kPa); finite
    fault: str | None
    duration_ns: int  # as the caller saw it


def late(name: str, did: str, budget_s: float) -> str:
    """Return the fault of a late step; `did` states what the policy did instead."""
    return f"late: policy '{name}' {did}; its budget is {budget_s * 1e3:.0f} ms"


class PolicyRunner:
    """Runner of one policy. No method raises.

    Callers may only read the `spec` of `policy`.
    """

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._name = policy.spec.name
        self._resets_wanted = 1  # a count, so that a request during a late step is not lost
        self._resets_done = 0

    def reset(self) -> None:
        """Reset the policy before its next step, in the thread of that step."""
        self._resets_wanted += 1

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        """Run one step on copies of observation and goal [2]; see `softarm.policies.base.Policy.step`."""
        raise NotImplementedError

    def close(self) -> None:
        """End the runner; it runs no further steps."""

    def _call(self, observation: Array, goal: Array) -> tuple[Array | None, str | None]:
        """Reset if requested, step and check the action, in this thread. Raises nothing but KeyboardInterrupt."""
        doing = "reset"
        try:
            wanted = self._resets_wanted
            if self._resets_done != wanted:
                self.policy.reset()
                self._resets_done = wanted
            doing = "step"
            return self._checked(self.policy.step(observation, goal))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a policy that calls sys.exit() must not end the daemon either
            text = str(error).strip().partition("\n")[0]
            return None, f"policy '{self._name}': {doing} raised {type(error).__name__}" + (f": {text}" if text else "")

    def _checked(self, action: object) -> tuple[Array | None, str | None]:
        if not isinstance(action, np.ndarray):
            return None, self._wrong(f"{type(action).__name__} instead of a numpy array")
        if action.shape != (2,):
            return None, self._wrong(f"an array of shape {list(action.shape)} instead of [2]")
        if action.dtype.kind not in "fiu":
            return None, self._wrong(f"an array of {action.dtype} instead of float32")
        with np.errstate(over="ignore", invalid="ignore"):
            result = np.array(action, dtype=np.float32)
        # Two float compares are a tenth of np.isfinite(...).all(); NaN fails both.
        if not (abs(result[0]) < np.inf and abs(result[1]) < np.inf):
            return None, self._wrong(f"[{result[0]}, {result[1]}], which is not finite")
        return result, None

    def _wrong(self, what: str) -> str:
        return f"policy '{self._name}': step returned {what}; it must return [cart velocity m/s, pressure kPa]"


class InlineRunner(PolicyRunner):
    """Runner in the caller's thread: a step that took longer than `budget_s` counts as late afterwards.

    Without a budget it serves repeatable lockstep runs.
    """

    def __init__(self, policy: Policy, budget_s: float = math.inf) -> None:
        super().__init__(policy)
        self._budget_s = budget_s

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        """Run one step, which takes as long as the policy needs."""
        start_ns = monotonic_ns()
        action, fault = self._call(np.array(observation, dtype=np.float32), np.array(goal, dtype=np.float32))
        duration_ns = monotonic_ns() - start_ns
        if fault is None and duration_ns > self._budget_s * 1e9:
            took = f"answered after {duration_ns / 1e6:.0f} ms"
            return PolicyOutcome(None, late(self._name, took, self._budget_s), duration_ns)
        return PolicyOutcome(action, fault, duration_ns)


class ThreadRunner(PolicyRunner):
    """Runner with a separate thread; a step that takes longer than `budget_s` is abandoned.

    While an abandoned step still runs, further steps fail at once, and its result is discarded. Only one thread may
    call reset and step. The runner cannot interrupt a policy in C that holds the interpreter's lock; the service's
    watchdog covers that case.
    """

    def __init__(self, policy: Policy, budget_s: float) -> None:
        super().__init__(policy)
        self._budget_s = budget_s
        self._late_since_ns: int | None = None  # start of an abandoned step that still runs
        self._closed = False
        self._request: tuple[Array, Array] | None = None
        self._result: tuple[Array | None, str | None] = (None, None)
        # Bare locks as one-shot signals take a third of the time of threading.Event.
        self._go, self._done = threading.Lock(), threading.Lock()
        self._go.acquire()
        self._done.acquire()
        self._thread = threading.Thread(target=self._work, name=f"policy {self._name}", daemon=True)
        self._thread.start()

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        """Run one step and return within `budget_s` plus the scheduler's delay."""
        start_ns = monotonic_ns()
        if self._closed:
            return PolicyOutcome(None, f"policy '{self._name}': its runner is closed", 0)
        if self._late_since_ns is not None:
            if not self._done.acquire(blocking=False):
                return self._late(self._late_since_ns, start_ns)
            self._late_since_ns = None
        self._request = (np.array(observation, dtype=np.float32), np.array(goal, dtype=np.float32))
        self._go.release()
        if not self._done.acquire(timeout=self._budget_s):
            self._late_since_ns = start_ns
            return self._late(start_ns, start_ns)
        action, fault = self._result
        return PolicyOutcome(action, fault, monotonic_ns() - start_ns)

    def close(self) -> None:
        """End the thread; a thread that hangs in its policy ends with the process."""
        self._closed = True
        if self._go.locked():
            self._go.release()
        if self._late_since_ns is None:
            self._thread.join(timeout=self._budget_s)

    def _late(self, since_ns: int, start_ns: int) -> PolicyOutcome:
        now_ns = monotonic_ns()
        did = f"has not answered for {(now_ns - since_ns) / 1e6:.0f} ms"
        return PolicyOutcome(None, late(self._name, did, self._budget_s), now_ns - start_ns)

    def _work(self) -> None:
        while True:
            self._go.acquire()
            if self._closed or self._request is None:
                return
            try:
                self._result = self._call(*self._request)
            except KeyboardInterrupt:  # raised by the policy: signals go to the main thread
                self._result = (None, f"policy '{self._name}': step raised KeyboardInterrupt")
            self._done.release()
