"""Debian's Firefox without a window, driven by WebDriver BiDi, since Playwright drives only its own build."""

import contextlib
import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from tests.processes import WAIT_S, until

NAMES = ("firefox-esr", "firefox")
EVENTS = ("log.entryAdded", "network.beforeRequestSent")


def found() -> str | None:
    """Return the path of Firefox, or None if it is not installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Firefox:
    """One page, with its console messages and the addresses that it has asked for."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._number = socket, 0
        self.messages: list[str] = []
        self.asked: list[str] = []
        self.call("session.new", capabilities={})
        self.call("session.subscribe", events=EVENTS)
        self._page = self.call("browsingContext.getTree")["contexts"][0]["context"]

    def call(self, method: str, **parameters: Any) -> Any:
        """Send a command and return its result; events that arrive meanwhile are kept."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=WAIT_S))
            if answer["type"] == "event":
                self._take(answer)
            elif answer["id"] == self._number:
                assert answer["type"] == "success", answer
                return answer["result"]

    def _take(self, event: dict[str, Any]) -> None:
        if event["method"] == "network.beforeRequestSent":
            self.asked.append(event["params"]["request"]["url"])
        elif event["params"]["level"] in ("warn", "error"):
            self.messages.append(event["params"]["text"])

    def open(self, url: str, width: int, height: int) -> None:
        self.call("browsingContext.setViewport", context=self._page, viewport={"width": width, "height": height})
        self.call("browsingContext.navigate", context=self._page, url=url, wait="complete")

    def evaluate(self, expression: str) -> Any:
        """Return the value of a text, a number or a truth value."""
        target = {"context": self._page}
        result = self.call("script.evaluate", expression=expression, target=target, awaitPromise=True)
        assert result["type"] == "success", result
        return result["result"].get("value")

    def until(self, expression: str) -> None:
        until(lambda: self.evaluate(expression), expression)

    def press(self, key: str) -> None:
        actions = [{"type": kind, "value": key} for kind in ("keyDown", "keyUp")]
        self._act({"type": "key", "id": "keyboard", "actions": actions})

    def click(self, selector: str) -> None:
        """Click the middle of an element, also of a frame."""
        element = f"document.querySelector({selector!r})"
        self.evaluate(f"{element}.scrollIntoView({{block: 'center'}})")
        x, y = (
            round(self.evaluate(f"(({{{edge}: a, {size}: b}}) => a + b / 2)({element}.getBoundingClientRect())"))
            for edge, size in (("left", "width"), ("top", "height"))
        )
        actions = [{"type": "pointerMove", "x": x, "y": y}]
        actions += [{"type": kind, "button": 0} for kind in ("pointerDown", "pointerUp")]
        self._act({"type": "pointer", "id": "mouse", "actions": actions})

    def _act(self, actions: dict[str, Any]) -> None:
        self.call("input.performActions", context=self._page, actions=[actions])


@contextlib.contextmanager
def opened(profile: Path) -> Iterator[Firefox]:
    """Run Firefox with an empty profile while the context lasts."""
    path = found()
    assert path is not None
    profile.mkdir()
    command = [path, "--headless", "--no-remote", "--profile", str(profile), "--remote-debugging-port", "0"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            url = next(line.split()[-1] for line in process.stderr if "BiDi listening on" in line)
            with connect(f"{url}/session", max_size=None) as socket:
                yield Firefox(socket)
        finally:
            process.kill()
