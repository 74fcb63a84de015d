"""Stand-in for the control loop, and clients for the tests of the API and of access."""

import asyncio
import math
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partialmethod
from types import SimpleNamespace

import httpx
import pytest

from softarm.daemon.api.app import create_app
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.server import ApiServer
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import EStop, Mode, Observed, Outputs, Problems, RequestResult
from softarm.daemon.runtime import verb_process
from softarm.policies import trial
from softarm.policies.base import PolicyError, PolicySpec
from softarm.policies.registry import PolicyEntry
from softarm.schemas.config import Api, Config
from softarm.schemas.messages import Command
from softarm.schemas.policy import Observation, TrainingRange
from tests.daemon.rig import Steady

LOCAL = "http://127.0.0.1"


class Shelf:
    """Return the policies of this test."""

    def __init__(self) -> None:
        trained = TrainingRange(target_y_m=(-0.4, 0.0), target_z_m=(0.55, 0.70), cart_start_m=(-0.025, 0.25))
        self.entries = {
            "broken": PolicyEntry("broken", "test", spec=PolicySpec("broken", "raises")),
            "lost": PolicyEntry("lost", "test", error="its file is gone; train it again"),
            "pid": PolicyEntry("pid", "test", spec=PolicySpec("pid", "the seed's gains")),
            "reach": PolicyEntry("reach", "test", spec=PolicySpec("reach", "swings", True, 100, trained, "ab")),
        }
        self.loaded: list[tuple[Steady, str]] = []

    def available(self):
        return self.entries

    def load(self, name):
        if name == "lost":
            raise PolicyError("policy 'lost': its file is gone; available: pid, reach")
        policy = Steady(ValueError("no weights") if name == "broken" else (0.0, 0.0), PolicySpec(name, "swings"))
        self.loaded.append((policy, threading.current_thread().name))
        return trial.ready(policy)


class Loop:
    """Stand-in for the control loop that empties the inbox and answers chosen requests."""

    def __init__(self) -> None:
        self.inbox = Inbox()
        self.refuse: tuple[str, ...] = ()
        self.problems = Problems()
        self.taken = []
        self.outputs: Outputs | None = Outputs(
            time.monotonic_ns(),
            0,
            0,
            0,
            0,
            Mode.ARMED,
            EStop.CLEAR,
            sent=Command(True, 0.25, math.nan),
            policy="reach",
            observed=Observed(Observation(*[0.0] * 8), 7, 5_000_000, 6_000_000, 7_000_000),
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def tick(self) -> None:
        """Answer all requests in the inbox."""
        now_ns, posts = time.monotonic_ns(), self.inbox.take()
        self.taken += posts
        results = tuple(RequestResult(p.request.number, not self.refuse, self.refuse) for p in posts)
        before = self.outputs
        self.outputs = replace(before, t_ns=now_ns, tick=before.tick + 1, results=(*before.results, *results)[-32:])

    def _run(self) -> None:
        while not self._stop.wait(1 / 100):
            self.tick()

    @contextmanager
    def running(self):
        self._thread.start()
        try:
            yield self
        finally:
            self._stop.set()
            self._thread.join()
            for post in self.taken:
                if post.runner is not None:
                    post.runner.close()


class Client:
    """Client that calls an application in this thread without a socket."""

    def __init__(self, app, url: str = LOCAL) -> None:
        self._app, self._url = app, url

    def request(self, method: str, path: str, **kwargs) -> httpx.Response:
        async def ask() -> httpx.Response:
            async with httpx.AsyncClient(transport=httpx.ASGITransport(self._app), base_url=self._url) as client:
                return await client.request(method, path, **kwargs)

        return asyncio.run(ask())

    get = partialmethod(request, "GET")
    post = partialmethod(request, "POST")
    put = partialmethod(request, "PUT")


def context(loop: Loop, config: Config | None = None, **kwargs) -> ApiContext:
    shared = {"policies": Shelf(), "problems": lambda: loop.problems, "snapshot": lambda: loop.outputs} | kwargs
    return ApiContext(config or Config(), loop.inbox, **shared)


@pytest.fixture
def loop():
    with Loop().running() as running:
        yield running


@pytest.fixture(scope="module")
def shared_app():
    """Return one application for the tests of a file, since each takes 0.1 s, and where to put their loops."""
    present = SimpleNamespace(loop=None)  # of the present test
    inbox = SimpleNamespace(post=lambda *args, **kwargs: present.loop.inbox.post(*args, **kwargs))
    reads = {"policies": Shelf(), "problems": lambda: present.loop.problems}
    return create_app(ApiContext(Config(), inbox, lambda: present.loop.outputs, **reads)), present


@pytest.fixture
def plain(loop, shared_app):
    """Return the application of the file, with the default configuration, on the loop of this test."""
    made, present = shared_app
    present.loop = loop
    return made


@pytest.fixture
def client(plain):
    return Client(plain, LOCAL)


@pytest.fixture
def stalled():
    """Return a control loop that does not tick."""
    return Loop()


@pytest.fixture
def silent(stalled, shared_app):
    """Return a client of a daemon whose control loop is stalled."""
    made, present = shared_app
    present.loop = stalled
    return Client(made, LOCAL), stalled


@pytest.fixture
def shelf():
    return Shelf()


@pytest.fixture
def tokens(tmp_path):
    """Return tokens(token_file=TEXT, ...), which writes these files and returns them by their configuration keys."""

    def write(**texts: str):
        for key, text in texts.items():
            (tmp_path / key).touch(0o600)
            (tmp_path / key).write_text(text)
        return {key: tmp_path / key for key in texts}

    return write


@pytest.fixture
def verb_runs(monkeypatch):
    """Return verb_runs(code), which replaces the work of each verb's process but not its set-up."""
    setup = verb_process._PROGRAM.partition("from softarm")[0]
    return lambda code: monkeypatch.setattr(verb_process, "_PROGRAM", setup + code)


TOKENS = {"token_file": "c" * 32, "view_token_file": "v" * 32, "stop_token_file": "s" * 32}


@pytest.fixture
def roles(tokens):
    """Return the files of three tokens by their configuration keys."""
    return tokens(**TOKENS)


@pytest.fixture
def strict(loop, app, client_of, roles):
    """Return a client on another address, of an API that requires one of these tokens."""
    return client_of(app(loop, Config(api={"host": "0.0.0.0"} | roles)), "http://robot.example")


@pytest.fixture
def app():
    """Return app(loop, config, **context), the application on this loop."""
    return lambda *args, **kwargs: create_app(context(*args, **kwargs))


@pytest.fixture
def client_of():
    """Return client_of(app, url), a client of an application."""
    return Client


@pytest.fixture
def serving():
    """Return serving(app, config), which serves on a real socket in its own thread and yields the port."""
    return _serving


@contextmanager
def _serving(app, config: Api | None = None):
    server = ApiServer(config or Api(port=0), app)
    others = set(threading.enumerate())  # a daemon of this session may serve its own API
    began = time.monotonic()
    port = server.start()
    start_s = time.monotonic() - began
    try:
        yield port
    finally:
        began = time.monotonic()
        server.stop()
        assert time.monotonic() - began < 1.2 + 10 * start_s
        assert not any(thread.name == "api" for thread in set(threading.enumerate()) - others)
