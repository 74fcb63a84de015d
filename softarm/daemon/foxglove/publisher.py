"""Live data for Foxglove: sends the recorder's ticks through a pipe to a server process.

The recorder's thread puts ticks into a bounded queue, and a separate thread writes them to the pipe as a log. A slow
server loses the oldest ticks and delays neither the recorder nor the control loop.
"""

import contextlib
import logging
import subprocess
import sys
import threading
import time
from collections import deque
from typing import IO, BinaryIO, cast

from softarm.common.address import local_url
from softarm.daemon.control.records import Tick
from softarm.daemon.logbook import ticks
from softarm.daemon.logbook.ticks import TickFile
from softarm.schemas.config import Config
from softarm.schemas.events import Entry

log = logging.getLogger(__name__)

PORT = 8765  # Foxglove's default
QUEUE_MAX = 150  # ticks, about five seconds
START_S, STOP_S, POLL_S = 15.0, 2.0, 0.02


class FoxgloveError(Exception):
    """The server cannot start; states why and the next step."""


class _Pipe(TickFile):
    """Log that goes to a pipe, so nothing is flushed to a disk."""

    def flush(self) -> None:
        """Flush the pipe's own buffer."""
        self._file.flush()


class _Counted:
    """Pipe that counts its bytes, since MCAP's writer asks for the position."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe, self._count = pipe, 0

    def write(self, data: bytes) -> int:
        self._count += len(data)
        return self._pipe.write(data)

    def tell(self) -> int:
        return self._count

    def flush(self) -> None:
        self._pipe.flush()


class FoxglovePublisher:
    """Sends ticks to Foxglove clients until it is stopped."""

    def __init__(self, config: Config, host: str = "127.0.0.1", port: int = PORT) -> None:
        """Prepare the server; port 0 lets the system choose."""
        self._config, self._host, self.port = config, host, port
        self._queue: deque[tuple[Tick, tuple[Entry, ...]]] = deque(maxlen=QUEUE_MAX)
        self._stopping = threading.Event()
        self._server: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Return the address that Foxglove connects to on this computer."""
        return local_url(self._host, self.port).replace("http", "ws", 1)

    def start(self) -> None:
        """Start the server, or raise FoxgloveError and leave nothing running."""
        command = (sys.executable, "-m", "softarm.recordings.foxglove.server", self._host, str(self.port))
        self._server = server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert server.stdin is not None
        assert server.stdout is not None
        live = _Pipe(cast(BinaryIO, _Counted(server.stdin)))
        late = threading.Timer(START_S, server.kill)
        late.start()
        with contextlib.suppress(OSError):  # a server that has ended has printed why
            live.head(self._config, None, time.monotonic_ns(), time.time_ns())
        line = server.stdout.readline().decode().strip()
        late.cancel()
        if not line.isdecimal():
            self.stop()
            raise FoxgloveError(f"Foxglove {line or 'did not start; see above'}")
        self.port = int(line)
        self._thread = threading.Thread(target=self._send, args=(live,), name="foxglove", daemon=True)
        self._thread.start()

    def take(self, tick: Tick, entries: list[Entry]) -> None:
        """Queue a tick with its events. Never blocks."""
        self._queue.append((tick, tuple(entries)))

    def stop(self) -> None:
        """Stop the server within two seconds, whatever its clients do."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(timeout=STOP_S / 2)
        if self._server is None:
            return
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        try:
            if self._thread is None or not self._thread.is_alive():
                self._server.stdin.close()
            self._server.wait(timeout=STOP_S / 2)
        except (OSError, subprocess.TimeoutExpired):
            self._server.kill()
            self._server.wait()
        self._server.stdout.close()

    def _send(self, live: _Pipe) -> None:
        """Write queued ticks in a separate thread, which a full pipe may block."""
        try:
            while not self._stopping.wait(POLL_S):
                while self._queue:
                    self._put(live, *self._queue.popleft())
                live.flush()
        except (OSError, ValueError) as error:  # the pipe's reader has ended, or the pipe is closed
            if not self._stopping.is_set():
                log.warning(
                    "Foxglove's server has ended (%s): the daemon continues without it until its next start", error
                )

    def _put(self, live: _Pipe, tick: Tick, entries: tuple[Entry, ...]) -> None:
        for entry in entries:
            live.entry(entry)
        try:
            live.write(tick)
        except ticks.EncodingError as error:
            log.debug("%s: not shown", error)
