"""Log-in from a browser: the token once, then a cookie that no script can read; a ticket opens one stream.

In memory alone: a daemon that is started anew has everybody log in again. The API's thread writes; the thread of the
stop's own way looks roles up.
"""

import secrets
import time
from collections.abc import Callable, Mapping

from softarm.daemon.api.auth import Role

LOGIN_S, LOGINS_MAX = 12 * 3600.0, 64  # since the log-in; of more the oldest ends
TICKET_S, TICKETS_MAX = 10.0, 64


class Handed:
    """Secrets that were handed out: so many at once, each good for a role and for so long."""

    def __init__(
        self, seconds: float, number_max: int, clock: Callable[[], float], afterwards: Role | None = None
    ) -> None:
        """afterwards: what one that has lasted its time is good for, until it gives way to another."""
        self._seconds, self._number_max, self._clock = seconds, number_max, clock
        self._afterwards = afterwards
        self._held: dict[str, tuple[Role, float]] = {}  # oldest first; the role, until when

    def out(self, role: Role) -> str:
        """A new one."""
        while len(self._held) >= self._number_max:
            del self._held[next(iter(self._held))]
        secret = secrets.token_urlsafe(32)
        self._held[secret] = role, self._clock() + self._seconds
        return secret

    def role(self, secret: str) -> Role | None:
        """That it stands for; None for one that was never good, or is no longer."""
        held = self._held.get(secret)  # once: another thread may be asking while it is taken back
        if held is None:
            return None
        role, until_s = held
        return role if self._clock() < until_s else self._afterwards

    def back(self, secret: str) -> Role | None:
        """Take one back; what it stood for."""
        role = self.role(secret)
        self._held.pop(secret, None)
        return role


class Sessions:
    """Who is logged in, and who may open a stream in a moment."""

    def __init__(self, port: int, clock: Callable[[], float] = time.monotonic) -> None:
        """port: of the API; a cookie is for all ports of a host, so its name has it. clock: seconds."""
        self._cookie = f"softarm-{port}"
        self.logins = Handed(LOGIN_S, LOGINS_MAX, clock, Role.STOP)  # a stop button on a page left open works on
        self.tickets = Handed(TICKET_S, TICKETS_MAX, clock)

    def of(self, headers: Mapping[bytes, bytes]) -> str:
        """The secret in a request's cookie; empty without one."""
        pairs = (pair.strip().partition("=") for pair in headers.get(b"cookie", b"").decode("latin-1").split(";"))
        return next((value for name, _, value in pairs if name == self._cookie), "")

    def cookie(self, secret: str, secure: bool) -> str:
        """What tells a browser to keep a secret, and to send it to nobody else; an empty one, to forget it."""
        age_s = round(LOGIN_S) if secret else 0
        parts = (f"{self._cookie}={secret}", "Path=/", f"Max-Age={age_s}", "HttpOnly", "SameSite=Strict")
        return "; ".join((*parts, "Secure") if secure else parts)
