"""Loading of the first policy in bounded time, after a trial in a process that can be killed."""

import threading
import time
from concurrent.futures import Future, wait

from softarm.policies import trial
from softarm.policies.base import Policy, PolicyError
from softarm.schemas.config import Config

LOADING_S = 120.0  # trial and loading together: a policy may hang even after its trial
POLL_S = 0.05


def first_policy(config: Config, over: threading.Event, loading_s: float = LOADING_S) -> Policy | None:
    """Return the configured policy, or None if `over` was set before it was loaded.

    A loading thread that is abandoned is left behind.

    Raises:
        PolicyError: The policy cannot be used or was not loaded in time.
    """
    name = config.control.policy
    answer: Future[Policy] = Future()

    def load() -> None:
        try:
            answer.set_result(trial.load(name, config.policies, min(trial.TRIAL_S, loading_s)))
        except PolicyError as error:
            answer.set_exception(error)
        except BaseException as error:  # including sys.exit() in a plug-in
            answer.set_exception(PolicyError(f"{type(error).__name__}: {error}"))

    threading.Thread(target=load, name=f"loading {name}", daemon=True).start()
    deadline_s = time.monotonic() + loading_s
    while not wait((answer,), POLL_S).done:
        if over.is_set():
            return None
        if time.monotonic() > deadline_s:
            raise PolicyError(f"policy '{name}': was not loaded within {loading_s:g} s; repair it or choose another")
    return answer.result()
