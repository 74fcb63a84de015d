"""The web server in a separate thread."""

import asyncio
import socket
import threading
import time

import uvicorn
from starlette.types import ASGIApp

from softarm.daemon.access.sockets import ApiError, listen
from softarm.daemon.api import bounds
from softarm.schemas.config import Api

START_S = 30.0


class ApiServer:
    """Web server of an ASGI application. It leaves signals to the daemon."""

    def __init__(self, config: Api, app: ASGIApp) -> None:
        self._config = config
        self._server = uvicorn.Server(
            uvicorn.Config(
                app,
                log_config=None,
                access_log=False,
                lifespan="off",
                loop="asyncio",
                ws="websockets-sansio",
                ws_per_message_deflate=False,  # on loopback it costs more than it saves
                server_header=False,
                date_header=False,
                timeout_graceful_shutdown=1,
                http=bounds.BoundedHttp,
                backlog=bounds.CONNECTIONS_MAX,
                h11_max_incomplete_event_size=bounds.HEADER_MAX,
                ws_max_size=bounds.MESSAGE_MAX,
            )
        )
        self._thread: threading.Thread | None = None

    def start(self) -> int:
        """Bind, serve and return the port, which the system chooses for port 0, or raise ApiError."""
        listener = listen(self._config.host, self._config.port, "api.port", bounds.CONNECTIONS_MAX)
        port = int(listener.getsockname()[1])
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(listener)), name="api", daemon=True)
        self._thread.start()
        deadline = time.monotonic() + START_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise ApiError(f"the API on {self._config.host} port {port} did not start; see the log above")
            time.sleep(0.005)
        return port

    def stop(self) -> None:
        """Close every connection within a second, whatever the clients do."""
        if self._thread is None:
            return
        self._server.should_exit = True
        self._thread.join(timeout=0.5)
        self._server.force_exit = True  # for clients that do not close
        self._thread.join(timeout=0.5)

    async def _serve(self, listener: socket.socket) -> None:
        await self._server.serve(sockets=[listener])
        for connection in tuple(self._server.server_state.connections):
            connection.transport.abort()  # a client that does not read would never be closed
        await asyncio.sleep(0)
