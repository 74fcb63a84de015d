"""Service manager: notifications, watchdog and the limit of open files.

Each notification is one datagram to systemd (sd_notify(3)); without systemd every call has no effect.
"""

import contextlib
import os
import resource
import socket
from collections.abc import Mapping

DESCRIPTORS = 8192


def allow_descriptors(wanted: int = DESCRIPTORS) -> int:
    """Raise the limit of open files up to `wanted` if the system allows it; return the limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return soft
    new = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (new, hard))
    return new


class Notifier:
    """Sender of notifications to systemd that never blocks and never raises.

    Good ticks alone send the watchdog's messages, so that a hung loop is restarted.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the NUL byte of Linux's abstract sockets.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_ns = _period_ns(environment)
        self._fed_ns: int | None = None

    def send(self, *lines: str) -> None:
        """Send assignments such as READY=1 in one message."""
        if not self._address:
            return
        with contextlib.suppress(OSError, ValueError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as way:
            way.setblocking(False)
            way.sendto("\n".join(lines).encode(), self._address)

    def ready(self, status: str) -> None:
        """Report that the start is complete."""
        self.send("READY=1", f"STATUS={' '.join(status.split())}")

    def stopping(self) -> None:
        """Report that the shutdown has begun."""
        self.send("STOPPING=1", "STATUS=stopping")

    def good_tick(self, now_ns: int) -> None:
        """Report a good tick; send a message at most once per half watchdog period."""
        if self._period_ns is None:
            return
        if self._fed_ns is None or now_ns - self._fed_ns >= self._period_ns // 2:
            self._fed_ns = now_ns
            self.send("WATCHDOG=1")


def _period_ns(environment: Mapping[str, str]) -> int | None:
    """Return WATCHDOG_USEC in ns, unless it is meant for another process (sd_watchdog_enabled(3))."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    try:
        microseconds = int(environment.get("WATCHDOG_USEC", ""))
    except ValueError:
        return None
    return microseconds * 1000 if microseconds > 0 else None
