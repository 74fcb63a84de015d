"""How every process here opens Zenoh: one peer that listens, everybody else a client, no discovery.

Peers do not relay between peers in Zenoh 1.9 and later, clients of one peer do see each other.
"""

import json

import zenoh

_COMMON = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    # A peer that hangs is dropped after a second, not after the default ten.
    "transport/link/tx/lease": 1000,
}


def listener(endpoint: str) -> zenoh.Config:
    """The daemon's side: a peer at `endpoint`, e.g. tcp/127.0.0.1:7447."""
    return _config({"mode": "peer", "listen/endpoints": [endpoint]})


def client(endpoint: str) -> zenoh.Config:
    """A bridge's, the twin's or a tool's side. `zenoh.open` raises ZError at once when nobody listens yet;
    once open, the session comes back by itself within 0.1 s of the listener's return.
    """
    return _config(
        {
            "mode": "client",
            "listen/endpoints": [],
            "connect/endpoints": [endpoint],
            "connect/retry": {"period_init_ms": 50, "period_max_ms": 100, "period_increase_factor": 1.5},
        }
    )


def _config(entries: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in (_COMMON | entries).items():
        config.insert_json5(key, json.dumps(value))
    return config
