"""Listening TCP sockets of the daemon."""

import contextlib
import errno
import os
import shlex
import socket
from collections.abc import Collection, Iterator
from pathlib import Path


def holders(targets: Collection[str]) -> Iterator[Path]:
    """Yield the /proc folders of the visible processes that have a target open: a path or `socket:[INODE]`."""
    for link in Path("/proc").glob("[0-9]*/fd/*") if targets else ():
        # A process of another user, or one that has ended.
        with contextlib.suppress(OSError):
            if os.readlink(link) in targets:
                yield link.parents[1]


LISTENS = "0A"  # state of a socket in /proc/net/tcp


class ApiError(Exception):
    """The API or the dedicated stop port cannot be opened; the text has the address and the next step."""


def listen(host: str, port: int, key: str, backlog: int | None) -> socket.socket:
    """Return a listening TCP socket.

    Args:
        host: address of this computer.
        port: TCP port; 0 for any free one.
        key: configuration key of the port, for the error's text.
        backlog: connections that may wait; None leaves the socket bound without listening.

    Raises:
        ApiError: if the address cannot be bound.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        opened = socket.socket(family, kind, protocol)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(address)
            if backlog is not None:
                opened.listen(backlog)
        except OSError:
            opened.close()
            raise
    except (OSError, UnicodeError) as error:  # UnicodeError: of a host name
        where = f"api.host {host}, {key} {port}" if key.startswith("api.") else f"{key} {host}:{port}"
        where = f"{where}: cannot listen there"
        if not isinstance(error, OSError) or error.errno != errno.EADDRINUSE:
            advice = f"name an address of this machine and a free {key}, 1024 to 65535 without root"
            raise ApiError(f"{where} ({getattr(error, 'strerror', error)}); {advice}") from error
        raise ApiError(
            f"{where}, {holder(port) or 'a program of another user'} does; stop that one (`softarm status` asks a "
            f"daemon), or choose another {key}, 0 for any"
        ) from error
    return opened


def try_out(host: str, port: int, key: str) -> None:
    """Check that `listen` would succeed without blocking the port; raise ApiError otherwise."""
    listen(host, port, key, None).close()


def holder(port: int) -> str | None:
    """Return a description of the process that listens at a TCP port, or None if none is visible."""
    rows = [*entries(Path("/proc/net/tcp")), *entries(Path("/proc/net/tcp6"))]
    listening = [row for row in rows if row[3] == LISTENS and int(row[1].rpartition(":")[2], 16) == port]
    for process in holders({f"socket:[{row[9]}]" for row in listening}):
        with contextlib.suppress(OSError):  # the process has ended meanwhile
            command = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
            return f"process {process.name} ({shlex.join(command[:-1])[:80]})"
    return None


def entries(table: Path) -> list[list[str]]:
    """Return the columns of each socket in a table such as /proc/net/tcp (proc(5)); none if it cannot be read."""
    try:
        return [line.split() for line in table.read_text().splitlines()[1:]]
    except OSError:
        return []
