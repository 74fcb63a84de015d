"""The way of a drive through the CiA 402 states, towards operation and back.

Pure: feedback goes in, the next controlword or a failure comes out.
"""

from typing import NamedTuple

from softarm.drivers.rail.cia402 import DriveState, next_controlword
from softarm.drivers.rail.feedback import Feedback

# From switch-on disabled to operation enabled.
ENABLE_MAX_S = 2.0
# From 1 m/s at 6 m/s^2 braking takes 0.17 s.
BRAKE_MAX_S = 1.0


class Step(NamedTuple):
    """State that the drive shows, and the controlword that leads on from it."""

    state: DriveState
    controlword: int


class Enabling:
    """Enabling and disabling of the drive. `last_step` is the step that was taken last: each is taken once."""

    def __init__(self) -> None:
        self.last_step: Step | None = None
        self._reached_operation = False
        self._braking_since_ns: int | None = None

    def restart(self) -> None:
        """Forget that the drive has reached operation: the permission to move begins or ends."""
        self._reached_operation = False

    def failure(self, feedback: Feedback, permitted_for_ns: int) -> tuple[str, str, str] | None:
        """Return why an otherwise healthy drive does not follow the permission to move, or None.

        A failure has the operation, the cause and the next step.
        """
        if feedback.state is DriveState.OPERATION_ENABLED:
            self._reached_operation = True
        elif self._reached_operation:
            return "write 60FFh", f"the drive fell back to {feedback.state_text()} by itself", "disarm, then arm"
        elif permitted_for_ns > ENABLE_MAX_S * 1e9:
            remedy = "check DI7, load supply and the drive's web page, then disarm and arm"
            return "enable", f"the drive stays in {feedback.state_text()}", remedy
        return None

    def next_step(self, feedback: Feedback, enable: bool) -> Step | None:
        """Return the step that is due, or None. A drive in operation brakes for `BRAKE_MAX_S` at most."""
        braked = feedback.at_rest or self._braking_for_s(feedback, enable) > BRAKE_MAX_S
        word = next_controlword(feedback.state, enable, braked) if feedback.remote else None
        return None if word is None else Step(feedback.state, word)

    def _braking_for_s(self, feedback: Feedback, enable: bool) -> float:
        if enable or feedback.state is not DriveState.OPERATION_ENABLED:
            self._braking_since_ns = None
            return 0.0
        self._braking_since_ns = self._braking_since_ns or feedback.t_ns
        return (feedback.t_ns - self._braking_since_ns) / 1e9
