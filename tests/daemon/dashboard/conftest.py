"""A simulated daemon and a real browser, Debian's Chromium; without it the tests are skipped with a reason."""

import contextlib
import re
import time
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import httpx
import pytest

from softarm.common import http
from softarm.daemon.assembly import Daemon
from softarm.daemon.runtime.devices import simulated_devices
from softarm.schemas.config import Config
from tests.daemon.rig import BUSY_MACHINE

TIMEOUT_MS = 60_000
# Longer than a configuration allows: a busy machine skips ticks for seconds, which must not stop a simulated arm.
FAILSAFE = BUSY_MACHINE | {"missed_ticks_max": 10_000, "policy_budget_s": 60.0}
# Messages of the browser for every answer of 400 and more and every failed connection.
EXPECTED_MESSAGES = re.compile(r"Failed to load resource|WebSocket connection to|net::ERR_|blocked by CORS policy")


@contextlib.contextmanager
def running(tmp_path, port: int = 0, **api) -> Iterator[Daemon]:
    """Run a daemon with a robot simulated in this process."""
    there = {"port": port, "stop_port": 0, "reports": tmp_path / "reports"}
    settings = {
        "api": there | api,
        "goals": {"time_limit_s": 2.0},  # a target is reached within half a second
        "recorder": {"directory": tmp_path},
        "control": {"realtime_priority": 0},  # a browser started later would inherit it
    }
    config = Config.model_validate(settings)
    config = config.model_copy(update={"failsafe": config.failsafe.model_copy(update=FAILSAFE)})
    with Daemon(config, simulated_devices()) as made:
        yield made


@pytest.fixture(scope="module")
def daemon(tmp_path_factory, browser):
    """Yield one daemon for all tests of a file, started only if there is a browser."""
    with running(tmp_path_factory.mktemp("logs")) as made:
        yield made


class Robot:
    """The daemon's REST API, without the page."""

    def __init__(self, url: str, headers: dict[str, str]) -> None:
        self.client = http.client(url, headers, timeout_s=60)

    @property
    def status(self) -> dict:
        return self.client.get("/api/status").json()

    def ask(self, path: str, body: object = None) -> httpx.Response:
        return self.client.post(path, json=body)

    def until(self, met: Callable[[dict], bool], seconds: float = 60.0) -> dict:
        """Return the first status that meets a condition."""
        deadline = time.monotonic() + seconds
        while not met(status := self.status):
            assert time.monotonic() < deadline, status
            time.sleep(0.01)
        return status

    def calm(self) -> None:
        """Disarm from any mode."""
        self.until(lambda status: status.get("arming_refusals") == [] or status.get("mode") == "stopped")
        self.ask("/api/stop")
        assert self.ask("/api/acknowledge").status_code == 200

    def arm(self) -> None:
        assert self.ask("/api/arm").status_code == 200
        self.until(lambda status: status["mode"] == "armed")


@pytest.fixture
def authorization():
    """Return the headers that the daemon requires."""
    return {}


@pytest.fixture
def robot(daemon, authorization):
    """Yield the daemon's robot, disarmed."""
    made = Robot(daemon.url, authorization)
    with made.client:
        made.calm()
        yield made


SIZE = {"width": 1280, "height": 860}
# A page draws every status, most of a test's processor time. Slow clients ask for fewer too; test_deadlines for all.
SLOWER = """
WebSocket = class extends WebSocket {
  constructor(url) { super(String(url).replace("hz=30", "hz=10")); }
};
"""


def slower(context):
    """Return the context, whose pages now ask for ten statuses a second."""
    context.add_init_script(SLOWER)
    return context


@pytest.fixture(scope="module")
def desk(browser):
    """Return a browser context shared by the pages of a file, with cached scripts."""
    return slower(browser.new_context(viewport=SIZE))


class Watched:
    """Opens pages and collects errors, requests to other hosts and missing files."""

    def __init__(self, browser, desk, url: str) -> None:
        self._browser, self._desk, self._url = browser, desk, url
        self._contexts, self._pages, self.wrong = [], [], []
        self._shared = None

    def __call__(self, look: bool = True, url: str | None = None, **options):
        """Open a page. look: wait until it is live. url: of another daemon. options: of a new context."""
        context = self._context(options) if options else self._desk
        context.set_default_timeout(TIMEOUT_MS)
        page = context.new_page()
        self._pages.append(page)
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        page.on("request", self._request)
        page.on("response", self._response)
        page.goto(url or self._url)
        if look:
            self._wait(page)
        return page

    def shared(self):
        """Return one page for several tests, loaded again."""
        if self._shared is None:
            self._shared = self()
        else:
            self._shared.goto(self._url)
            self._wait(self._shared)
        return self._shared

    def restore(self) -> None:
        """Leave the dashboard, whose requests end with it, and undo what a test has changed in the browser."""
        self._shared.goto("about:blank")
        self._desk.set_offline(False)
        self._shared.unroute_all(behavior="ignoreErrors")
        self._shared.emulate_media(color_scheme="null", reduced_motion="null")
        self._shared.set_viewport_size(SIZE)
        self._shared.mouse.move(0, 0)

    @staticmethod
    def _wait(page) -> None:
        page.locator("#link[data-link=live]").wait_for()
        page.locator("#drawing svg").wait_for()

    def _context(self, options):
        context = slower(self._browser.new_context(**{"viewport": SIZE} | options))
        self._contexts.append(context)
        return context

    def _console(self, message) -> None:
        if message.type in ("error", "warning") and not EXPECTED_MESSAGES.search(message.text):
            self.wrong.append(f"console: {message.text}")
        if "Content Security Policy" in message.text:
            self.wrong.append(message.text)

    def _request(self, request) -> None:
        if urlsplit(request.url).hostname != urlsplit(self._url).hostname and not request.url.startswith("data:"):
            self.wrong.append(f"elsewhere: {request.url}")

    def _response(self, response) -> None:
        if response.status >= 400 and not urlsplit(response.url).path.startswith("/api/"):
            self.wrong.append(f"{response.status}: {response.url}")

    def close(self) -> None:
        self._desk.set_offline(False)
        for one in (*self._pages, *self._contexts):
            one.close()


@pytest.fixture
def opened(browser, desk, daemon):
    """Yield opened(**options of a browser context); the test fails if a page had errors."""
    watched = Watched(browser, desk, f"{daemon.url}/")
    yield watched
    watched.close()
    assert watched.wrong == []


@pytest.fixture(scope="module")
def watched(browser, desk, daemon):
    """Return the owner of the page that the tests of a file share."""
    made = Watched(browser, desk, f"{daemon.url}/")
    yield made
    made.close()


@pytest.fixture
def page(robot, watched):
    """Yield the dashboard of a disarmed robot, loaded again; the test fails if it had errors."""
    yield watched.shared()
    watched.restore()
    wrong, watched.wrong = watched.wrong, []
    assert wrong == []


@pytest.fixture
def press(robot):
    """Return press(page, y_m, z_m, tap=False), which clicks or taps that point in the drawing.

    It waits until the page shows the robot's mode, since a change of it may move the drawing.
    """

    def after_the_mode(page, y_m: float, z_m: float, tap: bool = False) -> None:
        page.locator(f"#mode[data-mode={robot.status['mode']}]").wait_for()
        _press(page, y_m, z_m, tap)

    return after_the_mode


def _press(page, y_m: float, z_m: float, tap: bool = False) -> None:
    where = page.evaluate(
        """([y, z]) => {
          const box = document.querySelector("#drawing svg").getBoundingClientRect();
          const ends = [...document.querySelectorAll("#drawing .hard-limit")];
          const [left, right] = ends.map((end) => end.getBoundingClientRect());
          const scale = (right.left - left.right) / 0.6;
          const middle = (right.left + left.right) / 2;
          const rail = (left.top + left.bottom) / 2;
          return [middle + y * scale - box.left, rail + (0.965 - z) * scale - box.top];
        }""",
        [y_m, z_m],
    )
    drawing = page.locator("#drawing svg")
    (drawing.tap if tap else drawing.click)(position={"x": where[0], "y": where[1]})


@pytest.fixture(scope="session")
def started():
    """Return a context manager: started(tmp_path, port, **api) as daemon."""
    return running
