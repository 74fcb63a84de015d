"""Messages of the rail's process: which of several problems is reported, and in which words."""

from collections.abc import Callable

from softarm.drivers.rail.dryve_link import describe_error
from softarm.drivers.rail.feedback import Feedback
from softarm.drivers.rail.settings import Settings

# How long a past failure is reported while the drive is not requested.
PAST_S = 2.0


class Problems:
    """Problems of the connection, of the drive's configuration, and the newest past failure."""

    def __init__(self, settings: Settings, clock: Callable[[], int]) -> None:
        self.connection: str | None
        self.configuration: str | None = None
        self._where, self._clock = f"{settings.host}:{settings.port}", clock
        self._past: tuple[int, str] | None = None
        self.connection = self._sentence("connect", "not connected yet", "wait a second")

    def connection_failed(self, error: Exception, connected: bool) -> None:
        """Report one of `dryve_link.LINK_ERRORS` until an exchange succeeds."""
        self.connection = self._sentence(*describe_error(error, connected, then="; connecting again"))

    def configured(self, difference: str | None) -> None:
        """Report a setting that the drive did not accept; None if it accepted all."""
        remedy = "set it on the drive's web page, or correct drivers.rail, then restart; the drive is not enabled"
        self.configuration = None if difference is None else self._sentence("configure", difference, remedy)

    def failed(self, command: str, problem: str, remedy: str) -> None:
        """Report a failure for a while, and as long as the drive is requested."""
        self._past = (self._clock(), self._sentence(command, problem, remedy))

    def clear_failure(self) -> None:
        """Forget the past failure."""
        self._past = None

    def current(self, feedback: Feedback | None, enable: bool) -> str | None:
        """Return the gravest problem as a sentence, or None; `enable` is whether the daemon requests operation."""
        if self.connection is not None or feedback is None:
            return self.connection
        if self.configuration is not None:
            return self.configuration
        if feedback.faults():
            remedy = "remove the cause, then acknowledge; an invalid boot state needs a power cycle"
            return self._sentence("read 6041h", f"the drive reports {', '.join(feedback.faults())}", remedy)
        if not feedback.remote:
            return self._sentence("read 6041h", "the enable input DI7 is low", "release the hardware e-stop")
        if self._past is None:
            return None
        age_s = (self._clock() - self._past[0]) / 1e9
        return self._past[1] if enable or age_s < PAST_S else None

    def _sentence(self, command: str, problem: str, remedy: str) -> str:
        # The format of `softarm.drivers.base.DeviceError`, which is slow to import.
        return f"{self._where}: {command}: {problem}; {remedy}"
