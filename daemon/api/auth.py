"""Who may use the API: on loopback this machine's own programs, elsewhere holders of the token."""

import hmac
import ipaddress
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from softarm.schemas.config import Api

TOKEN_MIN = 16  # characters


class AuthError(Exception):
    """The API may not be opened like this; the text says what is missing and how to make it."""


def is_loopback(host: str) -> bool:
    """Can only this machine reach the address?"""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def load_token(config: Api) -> str | None:
    """The token that requests have to carry; None when the API listens on loopback and none is configured.

    Raises AuthError when another address has no token, or its file is unreadable, too short or open to all.
    """
    path = config.token_file
    if path is None:
        if is_loopback(config.host):
            return None
        raise AuthError(
            f"api.host {config.host} can be reached from other machines and needs api.token_file: "
            "write a long random token into a file that only the service can read, for example with "
            "`umask 077; openssl rand -hex 32 > /etc/softarm/token`, or set api.host to 127.0.0.1"
        )
    return _read(path)


def _read(path: Path) -> str:
    try:
        token = path.read_text(encoding="ascii").strip()
        mode = path.stat().st_mode
    except (OSError, UnicodeError) as error:
        raise AuthError(f"api.token_file {path}: cannot be read ({error}); make one with `openssl rand -hex 32`") from (
            error
        )
    if len(token) < TOKEN_MIN or any(c.isspace() for c in token):
        raise AuthError(
            f"api.token_file {path}: holds {len(token)} characters; allowed: one word, {TOKEN_MIN} or more; "
            "make one with `openssl rand -hex 32`"
        )
    if mode & 0o007:
        raise AuthError(f"api.token_file {path}: every user of this machine can open it; `chmod o= {path}`")
    return token


class Door:
    """Whether a request may come in, by its headers; of the REST API and of the stop's own way alike.

    On loopback a web page that a person happens to visit must not reach the robot: a foreign Host header
    gives DNS rebinding away, a foreign Origin a page of another site.
    """

    def __init__(self, config: Api) -> None:
        """Raises AuthError when `api.host` is no loopback address and `api.token_file` gives no good token."""
        token = load_token(config)
        self._bearer = None if token is None else f"Bearer {token}".encode("ascii")
        self._loopback = is_loopback(config.host)

    def refusal(self, headers: Mapping[bytes, bytes]) -> tuple[int, str] | None:
        """HTTP status and why not; None for one that may. headers: by their names in small letters."""
        if self._loopback:
            host = headers.get(b"host", b"").decode("latin-1")
            if not is_loopback(_parts(f"//{host}").hostname or ""):
                return 403, f"the Host header is {host!r}; ask for this machine as 127.0.0.1 or localhost"
            origin = headers.get(b"origin", b"").decode("latin-1")
            if origin and _parts(origin).netloc != host:
                return 403, f"a page of {origin!r} may not command this robot; use the daemon's own pages"
        if self._bearer is None:
            return None
        given = headers.get(b"authorization")
        if given is None:
            return 401, "this API needs a token: send `Authorization: Bearer <the text in api.token_file>`"
        if not hmac.compare_digest(given, self._bearer):
            return (
                401,
                "the token is wrong: send the text in api.token_file as `Authorization: Bearer <token>`",
            )
        return None


def _parts(url: str) -> SplitResult:
    """An address that cannot be read, such as `http://[::1`, has none."""
    try:
        return urlsplit(url)
    except ValueError:
        return SplitResult("", "", "", "", "")
