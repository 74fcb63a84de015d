"""Addresses of servers on this computer."""

import ipaddress

ALL_NETWORKS = ("0.0.0.0", "::")  # of a server that listens on every network


def is_loopback(host: str) -> bool:
    """Return whether only this computer can reach an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def local_url(host: str, port: int) -> str:
    """Return the base URL at which this computer reaches its own server on a host and port, in brackets for IPv6."""
    reached = "127.0.0.1" if host in ALL_NETWORKS else host
    return f"http://[{reached}]:{port}" if ":" in reached else f"http://{reached}:{port}"
