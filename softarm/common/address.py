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


def is_shared(host: str, other: str) -> bool:
    """Return whether servers of this computer on two hosts could not have the same port."""
    both = host, other
    return host == other or any(each in ALL_NETWORKS for each in both) or all(map(is_loopback, both))


def local_url(host: str, port: int) -> str:
    """Return the base URL at which this computer reaches its own server on a host and port, in brackets for IPv6."""
    reached = "127.0.0.1" if host in ALL_NETWORKS else host
    return f"http://[{reached}]:{port}" if ":" in reached else f"http://{reached}:{port}"
