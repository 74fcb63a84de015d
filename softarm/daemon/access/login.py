"""Log-in from a browser: a token is exchanged for a cookie that no script can read; a ticket opens one stream.

Sessions are in memory only: after a restart every user logs in again. The API's thread writes; the thread of the
dedicated stop port looks roles up.
"""

import secrets
import time
from collections.abc import Callable, Mapping

from softarm.daemon.access.auth import Role

# A new log-in beyond the maximum ends the oldest.
LOGIN_S, LOGINS_MAX = 12 * 3600.0, 64
TICKET_S, TICKETS_MAX = 10.0, 64


class SecretStore:
    """Store of issued secrets, each with a role and a lifetime; a new one beyond the maximum deletes the oldest."""

    def __init__(
        self, seconds: float, number_max: int, clock: Callable[[], float], afterwards: Role | None = None
    ) -> None:
        """Create an empty store; `afterwards` is the role of an expired secret until it is deleted."""
        self._seconds, self._number_max, self._clock = seconds, number_max, clock
        self._afterwards = afterwards
        self._held: dict[str, tuple[Role, float]] = {}  # oldest first; role and expiry in s

    def issue(self, role: Role) -> str:
        """Return a new secret for a role."""
        while len(self._held) >= self._number_max:
            del self._held[next(iter(self._held))]
        secret = secrets.token_urlsafe(32)
        self._held[secret] = role, self._clock() + self._seconds
        return secret

    def role(self, secret: str) -> Role | None:
        """Return the role of a secret, or None if it is invalid."""
        held = self._held.get(secret)  # read once: another thread may delete it meanwhile
        if held is None:
            return None
        role, until_s = held
        return role if self._clock() < until_s else self._afterwards

    def revoke(self, secret: str) -> Role | None:
        """Delete a secret and return its role, or None if it was invalid."""
        role = self.role(secret)
        self._held.pop(secret, None)
        return role


class Sessions:
    """Sessions of logged-in browsers and tickets for streams."""

    def __init__(self, port: int, clock: Callable[[], float] = time.monotonic) -> None:
        """Create the stores of the API at a port."""
        self._cookie = f"softarm-{port}"  # cookies are shared by all ports of a host
        # An expired log-in may still stop: the button of a page left open keeps working.
        self.logins = SecretStore(LOGIN_S, LOGINS_MAX, clock, Role.STOP)
        self.tickets = SecretStore(TICKET_S, TICKETS_MAX, clock)

    def of(self, headers: Mapping[bytes, bytes]) -> str:
        """Return the secret in a request's cookie, or an empty text without one."""
        pairs = (pair.strip().partition("=") for pair in headers.get(b"cookie", b"").decode("latin-1").split(";"))
        return next((value for name, _, value in pairs if name == self._cookie), "")

    def cookie(self, secret: str, secure: bool) -> str:
        """Return the Set-Cookie header for a secret; an empty secret deletes the cookie."""
        age_s = round(LOGIN_S) if secret else 0
        parts = (f"{self._cookie}={secret}", "Path=/", f"Max-Age={age_s}", "HttpOnly", "SameSite=Strict")
        return "; ".join((*parts, "Secure") if secure else parts)
