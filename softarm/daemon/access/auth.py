"""Access rules of the API: programs of this machine on loopback, otherwise holders of a token by role.

In a browser a token is exchanged for a cookie that no script can read; a ticket opens one stream. Sessions are in
memory only: after a restart every user logs in again. The API's thread writes; the stop port's thread looks roles up.
"""

import hmac
import ipaddress
import secrets
import time
from collections.abc import Callable, Mapping
from enum import IntEnum
from itertools import combinations
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from softarm.common.address import is_loopback
from softarm.schemas.config import Api

TOKEN_MIN = 16  # characters
# A new log-in beyond the maximum ends the oldest.
LOGIN_S, LOGINS_MAX = 12 * 3600.0, 64
TICKET_S, TICKETS_MAX = 10.0, 64


class Role(IntEnum):
    """Role of a token; each role includes the lower ones."""

    STOP = 1  # POST /api/stop, and nothing else
    VIEW = 2  # status, stream, goal, policies, logs
    COMMAND = 3  # everything


# Configuration key of each role's token file.
TOKEN_FILES = {Role.COMMAND: "token_file", Role.VIEW: "view_token_file", Role.STOP: "stop_token_file"}


class AuthError(Exception):
    """The API's access settings are unsafe or invalid; the text has the next step."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key  # in the section `api`


def load_tokens(config: Api) -> dict[Role, str]:
    """Return the token of each role; empty if the API listens on loopback and no token is configured.

    Raises:
        AuthError: if an address beyond loopback has no command token, if a file is unreadable, too short or open to
            every user, or if two files hold the same token.
    """
    files = {role: getattr(config, key) for role, key in TOKEN_FILES.items()}
    tokens = {role: _read(TOKEN_FILES[role], path) for role, path in files.items() if path is not None}
    if Role.COMMAND not in tokens and not is_loopback(config.host):
        raise AuthError(
            "host",
            f"api.host {config.host} can be reached from other machines and needs api.token_file: "
            "write a long random token into a file that only the service can read, for example with "
            "`umask 077; openssl rand -hex 32 > /etc/softarm/token`, or set api.host to 127.0.0.1",
        )
    for one, other in combinations(tokens, 2):
        if tokens[one] == tokens[other]:
            raise AuthError(
                TOKEN_FILES[other],
                f"api.{TOKEN_FILES[other]} {files[other]}: holds the token of api.{TOKEN_FILES[one]}, which may do "
                "more; make another with `openssl rand -hex 32`",
            )
    return tokens


def _read(key: str, path: Path) -> str:
    advice = "make one with `openssl rand -hex 32`"
    try:
        token = path.read_text(encoding="ascii").strip()
        mode = path.stat().st_mode
    except (OSError, UnicodeError) as error:
        raise AuthError(key, f"api.{key} {path}: cannot be read ({error}); {advice}") from error
    if len(token) < TOKEN_MIN or any(c.isspace() for c in token):
        held = f"holds {len(token)} characters; allowed: one word, {TOKEN_MIN} or more"
        raise AuthError(key, f"api.{key} {path}: {held}; {advice}")
    if mode & 0o007:
        raise AuthError(key, f"api.{key} {path}: every user of this machine can open it; `chmod o= {path}`")
    return token


class AccessControl:
    """Access control by request headers, for the REST API and the dedicated stop port.

    On loopback no foreign web page may reach the robot: a foreign Host header reveals DNS rebinding, a foreign Origin
    a page of another site.
    """

    def __init__(self, config: Api) -> None:
        """Load the tokens; raise AuthError as `load_tokens` does."""
        self._roles = {f"Bearer {token}".encode("ascii"): role for role, token in load_tokens(config).items()}
        self._loopback = is_loopback(config.host)
        self._public = config.public_origin  # of a TLS proxy in front of this API

    @property
    def needs_token(self) -> bool:
        """Whether requests need a token."""
        return bool(self._roles)

    def refusal(
        self,
        headers: Mapping[bytes, bytes],
        role: Role | None,
        page: str | None = None,
        session: Role | None = None,
    ) -> tuple[int, str] | None:
        """Return HTTP status and reason of a refusal, or None if the request is allowed.

        Args:
            headers: by lower-case name.
            role: required role; None checks Host and Origin only.
            page: another allowed origin, see `own_page`.
            session: role of the log-in, used if the request has no Authorization header.
        """
        if self._loopback:
            host = headers.get(b"host", b"").decode("latin-1")
            if not is_loopback(_parts(f"//{host}").hostname or "") and f"https://{host}" != self._public:
                return 403, f"the Host header is {host!r}; ask for this machine as 127.0.0.1 or localhost"
            origin = headers.get(b"origin", b"").decode("latin-1")
            if origin and origin not in (page, self._public) and _parts(origin).netloc != host:
                return 403, f"a page of {origin!r} may not command this robot; use the daemon's own pages"
        if not self._roles or role is None:
            return None
        given = headers.get(b"authorization")
        if given is None and session is None:
            return 401, "this API requires a token: send the text in api.token_file as `Authorization: Bearer TOKEN`"
        holds = session if given is None else self._holds(given)
        if holds is None:
            return 401, "the token is wrong: send the text in api.token_file as `Authorization: Bearer TOKEN`"
        if holds < role:
            may = "view and stop" if holds is Role.VIEW else "stop"
            return 403, f"this token may only {may}: use the token of api.{TOKEN_FILES[role]}"
        return None

    def _holds(self, given: bytes) -> Role | None:
        """Return the role of the token in an Authorization header."""
        return max((mine for bearer, mine in self._roles.items() if hmac.compare_digest(given, bearer)), default=None)

    def role_of(self, token: str) -> Role | None:
        """Return the role of a token, or None if it is wrong."""
        return self._holds(b"Bearer " + token.encode(errors="replace"))

    def from_proxy(self, headers: Mapping[bytes, bytes]) -> bool:
        """Return whether the request comes from a page served through the TLS proxy."""
        return self._public is not None and headers.get(b"origin") == self._public.encode()

    def from_own_page(self, headers: Mapping[bytes, bytes]) -> bool:
        """Return whether the request comes from a page of this API; browsers send Origin with every change."""
        return headers.get(b"origin") == b"http://" + headers.get(b"host", b"") or self.from_proxy(headers)

    def who(self, way: str, headers: Mapping[bytes, bytes], address: str | None, session: Role | None = None) -> str:
        """Return the source of a request for the event history: way in, token role and other machine."""
        address = self._behind_proxy(headers, address)
        holds = session or self._holds(headers.get(b"authorization", b""))
        details = [f"{holds.name.lower()} token"] if holds is not None else []
        if address and not is_loopback(address):
            details.append(address)
        return f"{way} ({', '.join(details)})" if details else way

    def _behind_proxy(self, headers: Mapping[bytes, bytes], address: str | None) -> str | None:
        """Return the client's address as our own proxy reports it; earlier entries of the header are not trusted."""
        named = {b"https://" + headers.get(b"host", b""), headers.get(b"origin", b"")}
        if self._public is None or self._public.encode() not in named or not is_loopback(address or ""):
            return address
        last = headers.get(b"x-forwarded-for", b"").rpartition(b",")[2].decode("latin-1").strip()
        try:
            return str(ipaddress.ip_address(last))
        except ValueError:
            return address

    def own_page(self, headers: Mapping[bytes, bytes], port: int) -> str | None:
        """Return the Origin if the REST API on `port` of this host served the page, or None."""
        origin = headers.get(b"origin", b"").decode("latin-1")
        page, asked = _parts(origin), _parts(f"//{headers.get(b'host', b'').decode('latin-1')}")
        hosts = page.hostname or "", asked.hostname or ""
        if origin != f"http://{page.netloc}" or page.username is not None or _port(page) != port or not all(hosts):
            return None
        same = all(map(is_loopback, hosts)) if self._loopback else hosts[0] == hosts[1]
        return origin if same else None


def _parts(url: str) -> SplitResult:
    """Return the parts of a URL; empty parts for a malformed one such as `http://[::1`."""
    try:
        return urlsplit(url)
    except ValueError:
        return SplitResult("", "", "", "", "")


def _port(parts: SplitResult) -> int | None:
    try:
        return parts.port or 80
    except ValueError:
        return None


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
