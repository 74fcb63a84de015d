"""Switching of a running twin's faults over the daemon's Zenoh."""

import json
import time
from typing import Any

import zenoh

from softarm.drivers.base import DeviceError
from softarm.drivers.mocap.zenoh_session import client
from softarm.drivers.twin.cameras import FAULT_KEY, STATE_KEY

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
