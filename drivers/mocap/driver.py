"""Motion capture over Zenoh: the daemon listens, whatever sees the arm connects and publishes.

Samples are stamped, bounded, parsed and judged on Zenoh's thread; the control loop only takes what is good.
"""

import asyncio
import threading
import time
from collections.abc import Callable

import zenoh

from softarm.drivers.mocap import payload as mocap_payload
from softarm.drivers.mocap.reception import Reception
from softarm.drivers.mocap.zenoh_session import listener
from softarm.schemas.config import Mocap

RETRY_S = 1.0


class ZenohMocapSource(Reception):
    """A `softarm.drivers.base.MocapSource`; what it counts: `Reception`."""

    def __init__(self, config: Mocap, clock: Callable[[], int] = time.monotonic_ns) -> None:
        place, remedy = f"{config.endpoint} {config.key}", "correct the bridge: docs/wires.md"
        super().__init__(place, remedy, "start the bridge, or `softarm twin`", clock)
        self._config = config
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._session: zenoh.Session | None = None
        self._link_problem: str | None = "the endpoint is being opened"

    def start(self) -> None:
        """Open the endpoint in a thread: `zenoh.open` may take its time."""
        self._thread = threading.Thread(target=self._listen, name="mocap", daemon=True)
        self._thread.start()

    async def stop(self) -> None:
        """Close the session; a process that forgets to may never end."""
        self._stopping.set()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 0.9)
        self._good.clear()

    def problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        if self._link_problem is not None:
            return self.say("listen", self._link_problem, "stop the other daemon, or correct drivers.mocap")
        return self.heard()

    def _listen(self) -> None:
        while not self._stopping.is_set():
            try:
                self._session = zenoh.open(listener(self._config.endpoint))
                self._session.declare_subscriber(self._config.key, self._hear)
            except zenoh.ZError as error:
                self._link_problem = str(error).split(" at /")[0]
                self._close()
                self._stopping.wait(RETRY_S)
                continue
            self._link_problem = None
            self._stopping.wait()
        self._close()

    def _close(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _hear(self, sample: zenoh.Sample) -> None:
        """Zenoh's thread calls this for each sample, one at a time."""
        now_ns, size = self.clock(), len(sample.payload)
        if size > mocap_payload.MAX_BYTES:
            self.oversized += 1
            self.complain(now_ns, f"a sample of {size} bytes, at most {mocap_payload.MAX_BYTES}: not parsed")
            return
        try:
            mocap_payload.check_schema(str(sample.encoding))
            frame = mocap_payload.decode(sample.payload.to_bytes(), now_ns)
        except ValueError as error:
            self.malformed += 1
            self.complain(now_ns, f"a malformed sample: {error}")
            return
        self.accept(frame)
