"""What stands between the control loop and a policy: the loop gets an outcome in time, whatever happens."""

import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from softarm.policies.base import Array, Policy

Clock = Callable[[], int]  # nanoseconds, monotonic


class PolicyOutcome(NamedTuple):
    """An action or, if there is none, a sentence that says why; never both."""

    action: Array | None  # float32 [2]: cart velocity (m/s), pressure (kPa); finite
    fault: str | None
    duration_ns: int  # as the caller saw it


class PolicyRunner(Protocol):
    """Runs one policy. No method raises, none waits for longer than the policy's budget."""

    @property
    def policy(self) -> Policy:
        """The policy that is run; callers read its `spec` and leave the rest alone."""

    def reset(self) -> None:
        """Have the policy forget the past before its next step."""

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        """One step on copies of observation and goal [2]; see `softarm.policies.base.Policy.step`."""

    def close(self) -> None:
        """Take no more steps."""


class _Guard:
    """Calls the policy on whatever thread it is asked to, and turns all that may go wrong into a sentence."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._name = policy.spec.name
        self._resets_wanted = 1  # a count, not a flag: a reset asked for during a late step is not lost
        self._resets_done = 0

    def ask_reset(self) -> None:
        self._resets_wanted += 1

    def call(self, observation: Array, goal: Array) -> tuple[Array | None, str | None]:
        """Reset if that is due, step, check. Lets KeyboardInterrupt through and nothing else."""
        doing = "reset"
        try:
            wanted = self._resets_wanted
            if self._resets_done != wanted:
                self._policy.reset()
                self._resets_done = wanted
            doing = "step"
            return self._checked(self._policy.step(observation, goal))
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


class InlineRunner:
    """On the caller's thread, without a budget: for lockstep runs that must come out the same every time."""

    def __init__(self, policy: Policy, clock: Clock = time.monotonic_ns) -> None:
        self.policy = policy
        self._guard = _Guard(policy)
        self._clock = clock

    def reset(self) -> None:
        """See PolicyRunner."""
        self._guard.ask_reset()

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        """See PolicyRunner; takes as long as the policy does."""
        start_ns = self._clock()
        action, fault = self._guard.call(np.array(observation, dtype=np.float32), np.array(goal, dtype=np.float32))
        return PolicyOutcome(action, fault, self._clock() - start_ns)

    def close(self) -> None:
        """Nothing to give back."""


class ThreadRunner:
    """On a thread of the policy's own; a step that takes more than `budget_s` is given up, not waited for.

    While a step that was given up still runs, further steps fail at once; its result is thrown away when it
    comes. One thread alone may call reset and step. A policy written in C that keeps the interpreter's lock
    cannot be shielded from; the service's watchdog is for that.
    """

    def __init__(self, policy: Policy, budget_s: float, clock: Clock = time.monotonic_ns) -> None:
        self.policy = policy
        self._name = policy.spec.name
        self._budget_s = budget_s
        self._clock = clock
        self._guard = _Guard(policy)
        self._late_since_ns: int | None = None  # start of a step that was given up and still runs
        self._closed = False
        self._request: tuple[Array, Array] | None = None
        self._result: tuple[Array | None, str | None] = (None, None)
        # Bare locks as one-shot signals: a hand-over and back costs a third of what threading.Event takes.
        self._go, self._done = threading.Lock(), threading.Lock()
        self._go.acquire()
        self._done.acquire()
        self._thread = threading.Thread(target=self._work, name=f"policy {self._name}", daemon=True)
        self._thread.start()

    def reset(self) -> None:
        """See PolicyRunner; takes place on the policy's thread, within the next step's budget."""
        self._guard.ask_reset()

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        """See PolicyRunner; returns within `budget_s` and a scheduler's delay."""
        start_ns = self._clock()
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
        return PolicyOutcome(action, fault, self._clock() - start_ns)

    def close(self) -> None:
        """Let the thread end; one that is stuck in its policy is left behind, it ends with the process."""
        self._closed = True
        if self._go.locked():
            self._go.release()
        if self._late_since_ns is None:
            self._thread.join(timeout=self._budget_s)

    def _late(self, since_ns: int, start_ns: int) -> PolicyOutcome:
        now_ns = self._clock()
        fault = (
            f"late: policy '{self._name}' has not answered for {(now_ns - since_ns) / 1e6:.0f} ms; "
            f"its budget is {self._budget_s * 1e3:.0f} ms"
        )
        return PolicyOutcome(None, fault, now_ns - start_ns)

    def _work(self) -> None:
        while True:
            self._go.acquire()
            if self._closed or self._request is None:
                return
            try:
                self._result = self._guard.call(*self._request)
            except KeyboardInterrupt:  # only a policy can have raised it: signals go to the main thread
                self._result = (None, f"policy '{self._name}': step raised KeyboardInterrupt")
            self._done.release()
