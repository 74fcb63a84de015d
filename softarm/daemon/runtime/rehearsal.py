"""Rehearsal of the next tick, so that its code and data are in the processor's caches when it is due.

After 30 ms of sleep the caches hold other data, and a tick takes three times as long as in a row. A second controller
therefore repeats the previous tick shortly before the next one. It shares no state with the first, and its outputs are
discarded.
"""

import logging
from collections.abc import Mapping

from softarm.daemon.control.records import Inputs, Outputs
from softarm.daemon.tick import Controller
from softarm.policies import trusted
from softarm.policies.runner import PolicyRunner
from softarm.schemas.config import Config

log = logging.getLogger(__name__)


class Rehearsal:
    """Second controller, one tick behind the first."""

    def __init__(self, config: Config, policy: PolicyRunner) -> None:
        self._controller: Controller | None = Controller(config, trusted.rehearsal(policy))

    def tick(self, inputs: Inputs, outputs: Outputs, runners: Mapping[int, PolicyRunner]) -> None:
        """Repeat a tick of the first controller. Never raises: after an error there are no more rehearsals."""
        if self._controller is None:
            return
        try:
            self._controller.tick(inputs, {number: trusted.rehearsal(each) for number, each in runners.items()})
            self._controller.resume(outputs)
        except Exception:
            log.exception("a rehearsal of the control tick failed: ticks take longer from now on")
            self._controller = None
