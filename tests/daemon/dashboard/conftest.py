"""A simulated daemon and a real browser before it: Debian's Chromium, or none, and then the tests say so."""

import contextlib
import re
import threading
import time
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import httpx
import pytest

from softarm.daemon.shell import daemon as shell
from softarm.schemas.config import Config

PATIENCE_MS = 20_000  # a busy machine is slow, not wrong
# A busy machine skips ticks, and reads late: no reason to stop an arm that is not there.
PATIENT = {"missed_ticks_max": 30, "policy_budget_s": 0.03} | dict.fromkeys(
    ("mocap_stale_s", "pressure_stale_s", "rail_stale_s"), 1.0
)
# A browser says so of every answer of 400 and more, and of every connection that fails.
SAID_OF_ANSWERS = re.compile(r"Failed to load resource|WebSocket connection to|net::ERR_|blocked by CORS policy")


@contextlib.contextmanager
def running(tmp_path, port: int = 0, **api) -> Iterator[shell.Daemon]:
    """A daemon with a robot simulated in this process."""
    there = {"port": port, "stop_port": 0, "reports": tmp_path / "reports"}
    settings = {
        "api": there | api,
        "recorder": {"directory": tmp_path},
        "control": {"realtime_priority": 0},  # or a browser that is started from now on would have it, too
        "failsafe": PATIENT,
    }
    made = shell.Daemon(Config.model_validate(settings), shell.simulated_devices())
    made.start()
    try:
        yield made
    finally:
        made.stop()


@pytest.fixture(scope="module")
def daemon(tmp_path_factory, browser):
    """One for all tests of a file. The browser is there first: without one none is started."""
    with running(tmp_path_factory.mktemp("logs")) as made:
        yield made


class Robot:
    """What the daemon itself says and does, asked without the page."""

    def __init__(self, url: str) -> None:
        self.client = httpx.Client(base_url=url, timeout=5)

    @property
    def status(self) -> dict:
        return self.client.get("/api/status").json()

    def ask(self, path: str, body: object = None) -> httpx.Response:
        return self.client.post(path, json=body)

    def until(self, met: Callable[[dict], bool], seconds: float = 10.0) -> dict:
        """The first status that meets it."""
        deadline = time.monotonic() + seconds
        while not met(status := self.status):
            assert time.monotonic() < deadline, status
            time.sleep(0.01)
        return status

    def calm(self) -> None:
        """Disarmed at once, whatever went before."""
        self.until(lambda status: status.get("arming_refusals") == [] or status.get("mode") == "stopped", seconds=30)
        self.ask("/api/stop")
        assert self.ask("/api/acknowledge").status_code == 200

    def arm(self) -> None:
        assert self.ask("/api/arm").status_code == 200
        self.until(lambda status: status["mode"] == "armed")


@pytest.fixture
def robot(daemon):
    """The daemon's robot, disarmed."""
    made = Robot(daemon.url)
    with made.client:
        made.calm()
        yield made


SIZE = {"width": 1280, "height": 860}


@pytest.fixture(scope="module")
def desk(browser):
    """A context of a browser for all pages of a file that need none of their own: it has the scripts already."""
    return browser.new_context(viewport=SIZE)


class Watched:
    """Opens pages and keeps what is wrong with them: errors, requests to elsewhere, files that are missing."""

    def __init__(self, browser, desk, url: str) -> None:
        self._browser, self._desk, self._url = browser, desk, url
        self._contexts, self._pages, self.wrong = [], [], []

    def __call__(
        self, look: bool = True, url: str | None = None, apart: bool = False, closed_streams: bool = False, **options
    ):
        """A page as soon as it is live.

        look: wait for that. url: of another daemon. apart: in a context of its own. closed_streams: no WebSocket opens.
        """
        context = self._context(options) if options or apart else self._desk
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        self._pages.append(page)
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        page.on("request", self._request)
        page.on("response", self._response)
        if closed_streams:
            page.route_web_socket("**/api/stream**", lambda socket: socket.close())
        page.goto(url or self._url)
        if look:
            page.locator("#link[data-link=live]").wait_for()
            page.locator("#drawing svg").wait_for()
        return page

    def _context(self, options):
        context = self._browser.new_context(**{"viewport": SIZE} | options)
        self._contexts.append(context)
        return context

    def _console(self, message) -> None:
        if message.type in ("error", "warning") and not SAID_OF_ANSWERS.search(message.text):
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
    """opened(**options of a browser context): the dashboard; nothing may have been wrong with it in the end."""
    watched = Watched(browser, desk, f"{daemon.url}/")
    yield watched
    watched.close()
    assert watched.wrong == []


@pytest.fixture
def page(robot, opened):
    """The dashboard of a disarmed robot."""
    return opened()


@pytest.fixture
def press():
    """press(page, y_m, z_m): click there in the drawing; how it is scaled is read off its axis."""
    return lambda page, y_m, z_m, tap=False: _press(page, y_m, z_m, tap)


def _press(page, y_m: float, z_m: float, tap: bool) -> None:
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
    at = {"x": where[0], "y": where[1]}
    drawing = page.locator("#drawing svg")
    if tap:
        drawing.tap(position=at)
    else:
        drawing.click(position=at)


@pytest.fixture(scope="session")
def started():
    """With started(tmp_path, port, **api) as daemon."""
    return running


@pytest.fixture
def asking():
    """asking(url): the robot of another daemon."""
    with contextlib.ExitStack() as made:

        def ask(url: str) -> Robot:
            robot = Robot(url)
            made.callback(robot.client.close)
            return robot

        yield ask


@pytest.fixture
def threads():
    """threads(function, number): run it in so many until the test ends; it is told by an event."""
    over, made = threading.Event(), []

    def start(function: Callable[[threading.Event], None], number: int) -> None:
        made.extend(threading.Thread(target=function, args=(over,)) for _ in range(number))
        for thread in made[-number:]:
            thread.start()

    yield start
    over.set()
    for thread in made:
        thread.join()
