"""Driver of motion capture over Zenoh: the daemon listens, a bridge or the twin connects and publishes.

Samples are stamped, bounded, parsed and checked on Zenoh's thread; the control loop reads valid frames only.

State contract:

| state | entered when | `read` returns | left when |
|---|---|---|---|
| opening | `start`, or the endpoint could not be opened | no frames | the endpoint is open; retried every second |
| listening | the endpoint is open | the valid frames since the last call, perhaps none | `stop` |
| stopped | `stop` | no frames | never |

A source that stops, or sends invalid samples, changes no state: `problem` reports it, and the frames become stale.
The device commands nothing, so no state without the host is needed.
"""

import time
from collections.abc import Callable

import zenoh

from softarm.drivers.mocap import payload as mocap_payload
from softarm.drivers.mocap.reception import Reception
from softarm.drivers.mocap.zenoh_session import listener
from softarm.schemas.config import Mocap

RETRY_S = 1.0


class ZenohMocapSource(Reception):
    """Driver of motion capture over Zenoh, a `softarm.drivers.base.MocapSource`; see `Reception` for its counts."""

    def __init__(self, config: Mocap, clock: Callable[[], int] = time.monotonic_ns) -> None:
        place, remedy = f"{config.endpoint} {config.key}", "correct the bridge: docs/reference/wires.md"
        super().__init__(place, remedy, "start the bridge, or `softarm twin`", clock)
        self._config = config
        self._session: zenoh.Session | None = None
        self._link_problem: str | None = "the endpoint is being opened"

    def problem(self) -> str | None:
        """Return why there is no fresh frame, as one sentence with the next step, or None if all is well."""
        if self._link_problem is not None:
            return self.describe("listen", self._link_problem, "stop the other daemon, or correct drivers.mocap")
        return self.sample_problem()

    def _run(self) -> None:
        """Open the endpoint, which may block, and close it at the end: an open session may keep the process alive."""
        while not self._stopping.is_set():
            try:
                self._session = zenoh.open(listener(self._config.endpoint))
                self._session.declare_subscriber(self._config.key, self._receive)
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

    def _receive(self, sample: zenoh.Sample) -> None:
        """Check one sample; Zenoh's thread calls this for one sample at a time."""
        now_ns, size = self.clock(), len(sample.payload)
        try:
            if size > mocap_payload.MAX_BYTES:
                raise ValueError(f"{size} bytes, at most {mocap_payload.MAX_BYTES} are allowed")
            mocap_payload.check_schema(str(sample.encoding))
            frame = mocap_payload.decode(sample.payload.to_bytes(), now_ns)
        except ValueError as error:
            self.malformed += 1
            self.complain(now_ns, f"a sample is malformed: {error}")
            return
        self.accept(frame)
