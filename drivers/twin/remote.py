"""Faults of a twin that runs elsewhere, switched over the daemon's Zenoh."""

import json
import time
from typing import Any

import zenoh

from softarm.drivers.base import DeviceError
from softarm.drivers.mocap.zenoh_session import client
from softarm.drivers.twin.cameras import FAULT_KEY, STATE_KEY

ANSWER_S = 2.0  # the twin tells its state 30 times a second
SETTLED_NS = 200_000_000  # by then it has heard


def switch(endpoint: str, message: bytes, answer_s: float = ANSWER_S) -> dict[str, Any]:
    """Send what `Faults.apply` takes to the twin behind an endpoint; returns its state as it is a moment later.

    Raises DeviceError when nobody listens there, or no twin answers.
    """
    try:
        session = zenoh.open(client(endpoint))
    except zenoh.ZError:
        remedy = "a twin hears over the daemon's Zenoh: start `softarm run` with the same --config"
        raise DeviceError(endpoint, "connect", "nobody listens there", remedy) from None
    with session:
        states = session.declare_subscriber(STATE_KEY, zenoh.handlers.RingChannel(1))
        _next(states, endpoint, answer_s)  # it is there, and this session has been joined with it
        session.put(FAULT_KEY, message)
        asked_ns = time.monotonic_ns()
        while (state := _next(states, endpoint, answer_s))["t_ns"] < asked_ns + SETTLED_NS:
            pass
        return state


def _next(states: Any, endpoint: str, answer_s: float) -> dict[str, Any]:
    over_s = time.monotonic() + answer_s
    while time.monotonic() < over_s:
        if (sample := states.try_recv()) is not None:
            return dict(json.loads(sample.payload.to_bytes()))
        time.sleep(0.01)
    remedy = "start `softarm twin` with the same --config"
    raise DeviceError(endpoint, STATE_KEY, f"no twin has told its state for {answer_s:g} s", remedy)
