"""The WebSocket that says every new status."""

import asyncio

from fastapi import WebSocket, WebSocketDisconnect

from softarm.daemon.api.status import StatusView

POLL_S = 0.005


async def stream(view: StatusView, socket: WebSocket, hz: float) -> None:
    """Send every status that is new, at most `hz` times a second, until the client leaves."""
    await socket.accept()
    sender = asyncio.create_task(_send(view, socket, 1 / hz))
    try:
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass  # a client has nothing to say here
    except WebSocketDisconnect:
        pass
    finally:
        sender.cancel()
        await asyncio.gather(sender, return_exceptions=True)


async def _send(view: StatusView, socket: WebSocket, period_s: float) -> None:
    sent = None
    while True:
        data = view.json()
        if data is not None and data is not sent:
            sent = data
            await socket.send({"type": "websocket.send", "text": data.decode()})
            await asyncio.sleep(0.8 * period_s)  # the rest in small steps, so that no tick slips by
        else:
            await asyncio.sleep(POLL_S)
