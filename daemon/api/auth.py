"""Who may use the API: on loopback this machine's own programs, elsewhere holders of a token, each in its role."""

import hmac
import ipaddress
from collections.abc import Mapping
from enum import IntEnum
from itertools import combinations
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from softarm.schemas.config import Api

TOKEN_MIN = 16  # characters


class Role(IntEnum):
    """What the holder of a token may do; each may do what those below it may."""

    STOP = 1  # POST /api/stop, and nothing else
    VIEW = 2  # status, stream, goal, policies, logs
    COMMAND = 3  # everything


# Which key of the configuration names whose token.
TOKEN_FILES = {Role.COMMAND: "token_file", Role.VIEW: "view_token_file", Role.STOP: "stop_token_file"}


class AuthError(Exception):
    """The API may not be opened like this; the text says what is missing and how to make it."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key  # of the section `api`


def is_loopback(host: str) -> bool:
    """Can only this machine reach the address?"""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def load_tokens(config: Api) -> dict[Role, str]:
    """The tokens that requests have to carry; none when the API listens on loopback and none is configured.

    Raises AuthError when another address has no token that commands, when a file is unreadable, too short or open to
    all, and when two hold the same.
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
    try:
        token = path.read_text(encoding="ascii").strip()
        mode = path.stat().st_mode
    except (OSError, UnicodeError) as error:
        raise AuthError(key, f"api.{key} {path}: cannot be read ({error}); make one with `openssl rand -hex 32`") from (
            error
        )
    if len(token) < TOKEN_MIN or any(c.isspace() for c in token):
        raise AuthError(
            key,
            f"api.{key} {path}: holds {len(token)} characters; allowed: one word, {TOKEN_MIN} or more; "
            "make one with `openssl rand -hex 32`",
        )
    if mode & 0o007:
        raise AuthError(key, f"api.{key} {path}: every user of this machine can open it; `chmod o= {path}`")
    return token


class Door:
    """Whether a request may come in, by its headers; of the REST API and of the stop's own way alike.

    On loopback a web page that a person happens to visit must not reach the robot: a foreign Host header
    gives DNS rebinding away, a foreign Origin a page of another site.
    """

    def __init__(self, config: Api) -> None:
        """Raises AuthError as `load_tokens` does."""
        self._roles = {f"Bearer {token}".encode("ascii"): role for role, token in load_tokens(config).items()}
        self._loopback = is_loopback(config.host)
        self._public = config.public_origin  # of a proxy with TLS before this API

    @property
    def needs_token(self) -> bool:
        """Does anybody have to show one?"""
        return bool(self._roles)

    def refusal(
        self,
        headers: Mapping[bytes, bytes],
        role: Role | None,
        page: str | None = None,
        session: Role | None = None,
    ) -> tuple[int, str] | None:
        """HTTP status and why not; None for one that may.

        headers: by their names in small letters. role: that it takes; None: none, only to come from the right place.
        page: an origin that may ask as well, see `own_page`. session: whose token somebody has shown before, who shows
        none now.
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
            return 401, "this API needs a token: send `Authorization: Bearer <the text in api.token_file>`"
        holds = session if given is None else self._holds(given)
        if holds is None:
            return (
                401,
                "the token is wrong: send the text in api.token_file as `Authorization: Bearer <token>`",
            )
        if holds < role:
            may = "look and stop" if holds is Role.VIEW else "stop"
            return 403, f"this token may {may}, nothing else: use that of api.{TOKEN_FILES[role]}"
        return None

    def _holds(self, given: bytes) -> Role | None:
        """Of the token in an Authorization header."""
        return max((mine for bearer, mine in self._roles.items() if hmac.compare_digest(given, bearer)), default=None)

    def role_of(self, token: str) -> Role | None:
        """Of the holder of a token; None for one that is wrong."""
        return self._holds(b"Bearer " + token.encode(errors="replace"))

    def from_proxy(self, headers: Mapping[bytes, bytes]) -> bool:
        """Does a page ask that came through the proxy with TLS?"""
        return self._public is not None and headers.get(b"origin") == self._public.encode()

    def from_own_page(self, headers: Mapping[bytes, bytes]) -> bool:
        """Does a page of this very API ask? Browsers name the page of whatever changes something."""
        return headers.get(b"origin") == b"http://" + headers.get(b"host", b"") or self.from_proxy(headers)

    def who(self, way: str, headers: Mapping[bytes, bytes], address: str | None, session: Role | None = None) -> str:
        """Who asks, as the history of events tells it: by which way, with whose token, from which other machine."""
        address = self._behind_proxy(headers, address)
        holds = session or self._holds(headers.get(b"authorization", b""))
        token = f" with the {holds.name.lower()} token" if holds is not None else ""
        return f"{way}{token}" + (f" from {address}" if address and not is_loopback(address) else "")

    def _behind_proxy(self, headers: Mapping[bytes, bytes], address: str | None) -> str | None:
        """Of whom our own proxy asks for, as it says itself; whatever stands before that anybody can say."""
        named = {b"https://" + headers.get(b"host", b""), headers.get(b"origin", b"")}
        if self._public is None or self._public.encode() not in named or not is_loopback(address or ""):
            return address
        last = headers.get(b"x-forwarded-for", b"").rpartition(b",")[2].decode("latin-1").strip()
        try:
            return str(ipaddress.ip_address(last))
        except ValueError:
            return address

    def own_page(self, headers: Mapping[bytes, bytes], port: int) -> str | None:
        """The Origin, if it is a page that the REST API on `port` of this same host has served; None for any other."""
        origin = headers.get(b"origin", b"").decode("latin-1")
        page, asked = _parts(origin), _parts(f"//{headers.get(b'host', b'').decode('latin-1')}")
        hosts = page.hostname or "", asked.hostname or ""
        if origin != f"http://{page.netloc}" or page.username is not None or _port(page) != port or not all(hosts):
            return None
        same = all(map(is_loopback, hosts)) if self._loopback else hosts[0] == hosts[1]
        return origin if same else None


def _parts(url: str) -> SplitResult:
    """An address that cannot be read, such as `http://[::1`, has none."""
    try:
        return urlsplit(url)
    except ValueError:
        return SplitResult("", "", "", "", "")


def _port(parts: SplitResult) -> int | None:
    try:
        return parts.port or 80
    except ValueError:
        return None
