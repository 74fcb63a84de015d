"""The WebSocket that sends every new status."""

import asyncio
import time

from fastapi import WebSocket, WebSocketDisconnect

from softarm.daemon.api.status import StatusView

POLL_S = 0.005


class Pace:
    """Rate limit of a stream: on average at most `hz` a second, without skipping ticks."""

    def __init__(self, hz: float) -> None:
        self._period_s = 1 / hz
        self._due_s = float("-inf")

    def wait_s(self, now_s: float) -> float:
        """Return the time until the next status may be sent; 0 or less means now."""
        return self._due_s - now_s

    def sent(self, now_s: float) -> None:
        """Count a sent status. The next one is due a period after this one was due, or now if that has passed."""
        self._due_s = max(self._due_s + self._period_s, now_s)


async def stream(view: StatusView, socket: WebSocket, hz: float) -> None:
    """Send every status that is new, at most `hz` times a second, until the client leaves."""
    await socket.accept()
    sender = asyncio.create_task(_send(view, socket, Pace(hz)))
    try:
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass  # messages of the client are ignored
    except WebSocketDisconnect:
        pass
    finally:
        sender.cancel()
        await asyncio.gather(sender, return_exceptions=True)


async def _send(view: StatusView, socket: WebSocket, pace: Pace) -> None:
    sent = None
    while True:
        wait_s = pace.wait_s(time.monotonic())
        data = view.json() if wait_s <= 0 else None
        if data is not None and data is not sent:
            sent = data
            pace.sent(time.monotonic())
            await socket.send({"type": "websocket.send", "text": data.decode()})
        else:
            await asyncio.sleep(max(wait_s, POLL_S))
