"""Live to Foxglove: the recorder's ticks down a pipe, to a process that serves them.

A guest of the daemon that nobody waits for. The control loop does not know of it, the recorder's thread leaves it ticks
in a bounded queue, its own thread writes them as a log into the pipe; whoever cannot keep up loses the oldest.
"""

import logging
import subprocess
import sys
import threading
import time
from collections import deque
from typing import IO, BinaryIO, cast

from softarm.daemon.logbook import ticks
from softarm.daemon.logbook.thinning import Tick
from softarm.daemon.logbook.tick_file import TickFile
from softarm.schemas.config import Config
from softarm.schemas.events import Entry

log = logging.getLogger(__name__)

PORT = 8765  # where Foxglove looks by itself
QUEUE_MAX = 150  # ticks, five seconds
START_S, STOP_S, POLL_S = 15.0, 2.0, 0.02


class FoxgloveError(Exception):
    """It cannot be served; says why and the next step."""


class _Pipe(TickFile):
    """A log that goes to another process: nothing of it is kept, so there is nothing to put on a disk."""

    def flush(self) -> None:
        """Hand over what there is."""
        self._file.flush()


class _Counted:
    """A pipe that knows how much went through, where a file knows its place: MCAP's writer asks."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe, self._count = pipe, 0

    def write(self, data: bytes) -> int:
        self._count += len(data)
        return self._pipe.write(data)

    def tell(self) -> int:
        return self._count

    def flush(self) -> None:
        self._pipe.flush()


class FoxgloveGuest:
    """Serves the ticks that it is left, until it is stopped."""

    def __init__(self, config: Config, host: str = "127.0.0.1", port: int = PORT) -> None:
        """port: 0 for any."""
        self._config, self._host, self.port = config, host, port
        self._queue: deque[tuple[Tick, tuple[Entry, ...]]] = deque(maxlen=QUEUE_MAX)
        self._stopping = threading.Event()
        self._server: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """What Foxglove opens as a connection."""
        return f"ws://{self._host}:{self.port}"

    def start(self) -> None:
        """Begin to serve. Raises FoxgloveError; nothing is left running then."""
        command = (sys.executable, "-m", "softarm.recordings.foxglove.server", self._host, str(self.port))
        self._server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._server.stdin is not None
        said = self._first_line()
        if not said.isdecimal():
            self.stop()
            raise FoxgloveError(f"Foxglove {said or 'did not come up; see above'}")
        self.port = int(said)
        self._thread = threading.Thread(target=self._send, args=(self._server.stdin,), name="foxglove", daemon=True)
        self._thread.start()

    def take(self, tick: Tick, entries: list[Entry]) -> None:
        """Leave a tick here, with what happened in it. Never blocks."""
        self._queue.append((tick, tuple(entries)))

    def stop(self) -> None:
        """End it: within two seconds, whatever its clients do."""
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

    def _first_line(self) -> str:
        """What the server says of itself; nothing, when it does not in time."""
        assert self._server is not None
        assert self._server.stdout is not None
        late = threading.Timer(START_S, self._server.kill)
        late.start()
        try:
            return self._server.stdout.readline().decode().strip()
        finally:
            late.cancel()

    def _send(self, pipe: IO[bytes]) -> None:
        """The guest's thread; a full pipe holds up nothing else."""
        try:
            live = _Pipe(cast(BinaryIO, _Counted(pipe)))
            live.head(self._config, None, time.monotonic_ns(), time.time_ns())
            while not self._stopping.wait(POLL_S):
                while self._queue:
                    self._put(live, *self._queue.popleft())
                live.flush()
        except (OSError, ValueError) as error:  # a pipe that nobody reads, or that is closed
            if not self._stopping.is_set():
                log.warning(
                    "Foxglove's server has ended (%s): the daemon goes on without, until it is started anew", error
                )

    def _put(self, live: _Pipe, tick: Tick, entries: tuple[Entry, ...]) -> None:
        for entry in entries:
            live.entry(entry)
        try:
            live.write(tick)
        except ticks.EncodingError as error:
            log.debug("%s: not shown", error)
