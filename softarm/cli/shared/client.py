"""Client of the daemon's REST API, for the verbs."""

import functools
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import click
import httpx

from softarm.cli.shared.console import given, token_of, token_option
from softarm.cli.shared.errors import Unreachable, fail, leaves
from softarm.common import http
from softarm.common.address import local_url
from softarm.schemas.rest import API_HEADER, API_VERSION

if TYPE_CHECKING:
    from softarm.schemas.config import Api

DEFAULT_URL = "http://127.0.0.1:8080"
TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 1.0  # of a stop on either port; the daemon answers within 0.5 s


def url_of(api: "Api") -> str:
    """Return the address at which a daemon of this configuration answers on this computer."""
    return local_url(api.host, api.port or 8080)


def options_for(api: "Api") -> str:
    """Return the options that other verbs need for a daemon of this configuration; empty with the default values."""
    url, token = url_of(api), api.token_file
    address = "" if url == DEFAULT_URL else f" --url {shlex.quote(url)}"
    return address + ("" if token is None else f" --token-file {shlex.quote(str(token))}")


class Remote:
    """A daemon at a URL. Every call that fails ends the command with a sentence."""

    def __init__(self, url: str, token: str | None = None, options: str = "") -> None:
        """Prepare requests; `options` are what another verb needs to find the same daemon."""
        self.url, self._options = url.rstrip("/"), options
        headers = {API_HEADER: str(API_VERSION)} | ({"Authorization": f"Bearer {token}"} if token else {})
        try:
            self._client = http.client(self.url, headers)
        except (httpx.InvalidURL, ValueError) as error:
            raise click.BadParameter(f"{url!r} is no URL ({error}); e.g. {DEFAULT_URL}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def command(self, text: str) -> str:
        """Return a command for the same daemon in backquotes, such as `softarm goal cancel --url http://10.0.0.2`."""
        return f"`softarm {text}{self._options}`"

    def get(self, path: str) -> Any:
        """Return the resource at a path, parsed from JSON."""
        return self.request("GET", path)

    def post(self, path: str, body: object = None) -> Any:
        """Send a request with an optional body and return the parsed answer."""
        return self.request("POST", path, body)

    def stop(self, port: int | None = None) -> bool:
        """Stop through the dedicated stop port, by default the API's plus one, and return whether it was confirmed."""
        url = self._client.base_url
        if url.scheme != "http":
            return False  # a TLS proxy forwards the API's port only
        stop_url = url.copy_with(port=port or (url.port or 80) + 1, path="/api/stop")
        try:
            return self._client.post(stop_url, timeout=STOP_TIMEOUT_S).json().get("stopped") is True
        except (httpx.HTTPError, ValueError, AttributeError):
            return False

    def request(self, method: str, path: str, body: object = None, timeout_s: float | None = None) -> Any:
        """Send a request and return the parsed answer."""
        return self._parsed(self._answer(method, path, body, timeout_s or TIMEOUT_S))

    def download(self, path: str) -> bytes:
        """Return the bytes at a path."""
        return self._answer("GET", path, None, TIMEOUT_S).content

    def _answer(self, method: str, path: str, body: object, timeout_s: float) -> httpx.Response:
        """Return a successful response; otherwise end the command with the daemon's own reason."""
        # A stop over a link that connects slowly is late, not lost.
        timeout = httpx.Timeout(timeout_s, connect=max(timeout_s, TIMEOUT_S))
        try:
            response = self._client.request(method, path, json=body, timeout=timeout)
        except httpx.UnsupportedProtocol:
            raise click.BadParameter(f"{self.url!r} lacks http:// or https://; e.g. {DEFAULT_URL}") from None
        except (httpx.ConnectError, httpx.ConnectTimeout) as error:
            raise Unreachable(
                f"no daemon at {self.url} ({error}): start one with `softarm run --config FILE`, or name its --url"
            ) from None
        except httpx.TimeoutException:
            fail(f"the daemon at {self.url} has not answered for {timeout_s:g} s: see its own output")
        except httpx.HTTPError as error:
            fail(f"the connection to {self.url} broke ({error}): see whether the daemon still runs")
        version = response.headers.get(API_HEADER, "")
        if path != "/api/stop" and version.isdecimal() and int(version) > API_VERSION:
            fail(
                f"the daemon at {self.url} uses version {version} of the API, this command version {API_VERSION}: "
                "update softarm here"
            )
        if response.status_code == 401:
            fail(f"the daemon at {self.url} requires a valid token: give it with --token-file FILE or $SOFTARM_TOKEN")
        if response.is_error:
            answer = self._parsed(response)
            detail = answer.get("detail") if isinstance(answer, dict) else None
            fail(detail if detail and isinstance(detail, str) else f"{method} {path}: HTTP {response.status_code}")
        return response

    def _parsed(self, response: httpx.Response) -> Any:
        try:
            return response.json()
        except ValueError:
            fail(f"{self.url} does not answer as a softarm daemon: another program may use this port")


def remote(function: Callable[..., None]) -> Callable[..., None]:
    """Add --url and --token-file to a command and pass it the daemon as its first argument."""

    @click.option(
        "--url",
        envvar="SOFTARM_URL",
        default=DEFAULT_URL,
        show_default=True,
        show_envvar=True,
        help="The daemon's address.",
    )
    @token_option
    @functools.wraps(function)
    def command(*args: Any, url: str, token_file: Path | None, **kwargs: Any) -> None:
        leaves("the daemon keeps running")
        with Remote(url, token_of(token_file), given("url", "token_file")) as daemon:
            function(daemon, *args, **kwargs)

    return command
