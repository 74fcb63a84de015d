"""The daemon's REST API as the verbs use it."""

import http.client
import json
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import click
import httpx

from softarm.cli.errors import Unreachable, fail
from softarm.cli.words import all_in_commands
from softarm.schemas.rest import API_HEADER, API_VERSION

if TYPE_CHECKING:
    from softarm.schemas.config import Api

DEFAULT_URL = "http://127.0.0.1:8080"
TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 1.0  # by the stop's own way: the daemon has 0.5 s


def url_of(api: "Api") -> str:
    """Where a daemon of this configuration answers on this computer."""
    return f"http://{'127.0.0.1' if api.host in ('0.0.0.0', '::') else api.host}:{api.port or 8080}"


class Remote:
    """A daemon at a URL. Every call ends the command with a sentence when it does not succeed."""

    def __init__(self, url: str, token: str | None = None) -> None:
        self.url = url.rstrip("/")
        headers = {API_HEADER: str(API_VERSION)} | ({"Authorization": f"Bearer {token}"} if token else {})
        try:
            # No proxy from the environment: a robot is on this machine or on its own network.
            self._client = httpx.Client(base_url=self.url, headers=headers, trust_env=False)
        except (httpx.InvalidURL, ValueError) as error:
            raise click.BadParameter(f"{url!r} is no URL ({error}); e.g. {DEFAULT_URL}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()

    def get(self, path: str) -> Any:
        """Return what is at a path, as parsed JSON."""
        return self.request("GET", path)

    def post(self, path: str, body: object = None) -> Any:
        """Ask for something."""
        return self.request("POST", path, body)

    def stop(self, port: int | None = None) -> bool:
        """Stop by the stop's own way; False where that did not say so. port: default the API's plus one."""
        url = self._client.base_url
        if url.scheme != "http":
            return False  # a proxy, which knows nothing of another port
        headers = {name: value for name, value in self._client.headers.items() if name == "authorization"}
        way = http.client.HTTPConnection(url.host, port or (url.port or 80) + 1, timeout=STOP_TIMEOUT_S)
        try:
            way.request("POST", "/api/stop", headers=headers)
            return json.loads(way.getresponse().read(4096)).get("stopped") is True
        except (OSError, http.client.HTTPException, ValueError, AttributeError):
            return False
        finally:
            way.close()

    def request(self, method: str, path: str, body: object = None, timeout_s: float | None = None) -> Any:
        """Return the answer as parsed JSON, its sentences in the words of this command."""
        return all_in_commands(self._parsed(self._answer(method, path, body, timeout_s or TIMEOUT_S)))

    def download(self, path: str) -> bytes:
        """Return what is at a path, as it is."""
        return self._answer("GET", path, None, TIMEOUT_S).content

    def _answer(self, method: str, path: str, body: object, timeout_s: float) -> httpx.Response:
        """Whatever is no error; the server's own sentence when it refuses."""
        try:
            response = self._client.request(method, path, json=body, timeout=timeout_s)
        except httpx.UnsupportedProtocol:
            raise click.BadParameter(f"{self.url!r} lacks http:// or https://; e.g. {DEFAULT_URL}") from None
        except httpx.ConnectError:
            raise Unreachable(
                f"no daemon at {self.url}: start one with `softarm run --config FILE`, or name its --url"
            ) from None
        except httpx.TimeoutException:
            fail(f"the daemon at {self.url} has not answered for {timeout_s:g} s: see its own output")
        except httpx.HTTPError as error:
            fail(f"the connection to {self.url} broke ({error}): see whether the daemon still runs")
        version = response.headers.get(API_HEADER, "1")  # daemons up to 0.2 say none
        if path != "/api/stop" and not (version.isdecimal() and int(version) <= API_VERSION):
            fail(
                f"the daemon at {self.url} speaks version {version} of the API, this command version {API_VERSION}: "
                "update softarm here"
            )
        if response.is_error:
            fail(_detail(self._parsed(response)) or f"{method} {path}: HTTP {response.status_code}")
        return response

    def _parsed(self, response: httpx.Response) -> Any:
        try:
            return response.json()
        except ValueError:
            fail(f"{self.url} answers, but not as a softarm daemon: it may be another program's port")


def _detail(answer: object) -> str | None:
    detail = answer.get("detail") if isinstance(answer, dict) else None
    return detail if isinstance(detail, str) else None
