"""The policy that the daemon begins with: tried out where it can be killed, then loaded, in bounded time."""

import threading
import time
from collections.abc import Callable

from softarm.policies import trial
from softarm.policies.base import Policy, PolicyError
from softarm.schemas.config import Config

LOADING_S = 120.0  # for all of it: what passed its trial may still wedge here
POLL_S = 0.05


def first_policy(config: Config, over: threading.Event, loading_s: float = LOADING_S) -> Policy | None:
    """`control.policy`, ready to fly; None when `over` is set before it is: the thread that loads it is left behind.

    Raises PolicyError with what is wrong, within `loading_s`.
    """
    name = config.control.policy
    answers: list[Policy | PolicyError] = []

    def load() -> None:
        answers.append(_answer(lambda: trial.load(name, config.policies, min(trial.TRIAL_S, loading_s))))

    loader = threading.Thread(target=load, name=f"loading {name}", daemon=True)
    loader.start()
    deadline_s = time.monotonic() + loading_s
    while loader.is_alive():
        if over.is_set():
            return None
        if time.monotonic() > deadline_s:
            raise PolicyError(f"policy '{name}': was not loaded within {loading_s:g} s; mend it or choose another")
        loader.join(POLL_S)
    answer = answers[0]
    if isinstance(answer, PolicyError):
        raise answer
    return answer


def _answer(load: Callable[[], Policy]) -> Policy | PolicyError:
    try:
        return load()
    except PolicyError as error:
        return error
    except BaseException as error:  # a plugin that calls sys.exit() included
        return PolicyError(f"{type(error).__name__}: {error}")
