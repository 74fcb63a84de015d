"""Motion capture of the twin: a Zenoh client that publishes frames and state and receives faults."""

import contextlib
import dataclasses
import json
import time
from typing import Any

import zenoh

from softarm.drivers.base import DeviceError
from softarm.drivers.mocap import payload as mocap_payload
from softarm.drivers.mocap.zenoh_session import ClientThread, client
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import Mocap
from softarm.schemas.messages import BODY_NAMES, Pose

FAULT_KEY, STATE_KEY = "softarm/twin/fault", "softarm/twin/state"


@dataclasses.dataclass(frozen=True, slots=True)
class TwinState:
    """True state of the twin, published on `STATE_KEY` as JSON.

    A `since` stamp is null while its condition is false. `drive` is the name of the CiA 402 state. `halted_after_s` is
    the time from the last set-point that moved the cart to the command that stopped it; null while it moves. `faults`
    are the lasting faults that are active.
    """

    t_ns: int
    cart_position_m: float
    cart_velocity_m_s: float
    pressure_kpa: float
    tip_y_m: float
    tip_z_m: float
    vented: bool
    vented_since_ns: int | None
    drive: str
    braked_since_ns: int | None
    halted_after_s: float | None
    cart_max_abs_m: float
    crashes: int
    faults: tuple[str, ...] = ()


class Cameras(ClientThread):
    """Publisher of the twin. A missing daemon is no error; an invalid fault message is printed."""

    def __init__(self, config: Mocap, faults: Faults) -> None:
        super().__init__(config.endpoint, "cameras")
        self._config, self._faults = config, faults
        self._session: zenoh.Session | None = None
        self._subscriber: zenoh.Subscriber[Any] | None = None
        self._stuck: tuple[Pose, ...] | None = None

    def publish_frame(self, sequence: int, t_capture_ns: int, poses: tuple[Pose, ...]) -> None:
        """Publish a frame with the active faults applied."""
        if self._session is None or self._faults.active("mocap_freeze"):
            return
        self._stuck = (self._stuck or poses) if self._faults.active("mocap_stuck") else None
        poses = self._stuck or poses
        if self._faults.active("mocap_drop_body"):
            lost = BODY_NAMES.index(self._faults.lost_body or "")
            poses = (*poses[:lost], mocap_payload.LOST, *poses[lost + 1 :])
        garbage = self._faults.take("mocap_garbage")
        payload = b'{"sequence":' if garbage else mocap_payload.encode(sequence, t_capture_ns, poses)
        self._put(self._config.key, payload, mocap_payload.SCHEMA)

    def publish_state(self, state: TwinState) -> None:
        """Publish the true state."""
        self._put(STATE_KEY, json.dumps(dataclasses.asdict(state)).encode(), "softarm.twin.v1")

    def receive_faults(self) -> None:
        """Start the requested faults."""
        subscriber = self._subscriber
        while subscriber is not None and (sample := subscriber.try_recv()) is not None:
            try:
                print(f"{FAULT_KEY}: {self._faults.apply(sample.payload.to_bytes())}", flush=True)
            except ValueError as error:
                print(f"{FAULT_KEY}: {error}", flush=True)

    def _put(self, key: str, payload: bytes, schema: str) -> None:
        if self._session is None:
            return
        with contextlib.suppress(zenoh.ZError):
            self._session.put(
                key,
                payload,
                encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(schema),
                congestion_control=zenoh.CongestionControl.DROP,
            )

    def _use(self, session: zenoh.Session) -> None:
        self._subscriber = session.declare_subscriber(FAULT_KEY, zenoh.handlers.RingChannel(16))
        self._session = session
        self._stopping.wait()
        self._session = self._subscriber = None


# The twin publishes its state 30 times a second.
ANSWER_S = 2.0
# After this time the twin has received the message.
SETTLED_NS = 200_000_000


def switch(endpoint: str, message: bytes) -> dict[str, Any]:
    """Send a message for `Faults.apply` to the twin of the daemon at an endpoint; return its state 0.2 s later.

    Raises:
        DeviceError: The daemon or the twin does not run.
    """
    try:
        session = zenoh.open(client(endpoint))
    except zenoh.ZError:
        remedy = "start `softarm run` with the same --config: the twin is reached through the daemon"
        raise DeviceError(endpoint, "connect", "no daemon listens there", remedy) from None
    with session:
        states = session.declare_subscriber(STATE_KEY, zenoh.handlers.RingChannel(1))
        # The first state shows that the twin runs and this session is connected to it.
        _next(states, endpoint)
        session.put(FAULT_KEY, message)
        sent_ns = time.monotonic_ns()
        while (state := _next(states, endpoint))["t_ns"] < sent_ns + SETTLED_NS:
            pass
        return state


def _next(states: Any, endpoint: str) -> dict[str, Any]:
    over_s = time.monotonic() + ANSWER_S
    while time.monotonic() < over_s:
        if (sample := states.try_recv()) is not None:
            return dict(json.loads(sample.payload.to_bytes()))
        time.sleep(0.01)
    remedy = "start `softarm twin` with the same --config"
    raise DeviceError(endpoint, STATE_KEY, f"no twin has published its state for {ANSWER_S:g} s", remedy)
