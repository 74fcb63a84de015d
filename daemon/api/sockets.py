"""Where the daemon listens."""

import contextlib
import errno
import shlex
import socket
from collections.abc import Callable
from pathlib import Path

from softarm.common.holders import holders

LISTENS = "0A"  # a state in /proc/net/tcp


class ApiError(Exception):
    """The API, or the stop's own way, cannot be opened; names the address and the next step."""


def listen(host: str, port: int, key: str, backlog: int) -> socket.socket:
    """A listening TCP socket. key: of the configuration, where the port stands.

    Raises ApiError when the address cannot be bound.
    """
    return _opened(host, port, key, lambda opened: opened.listen(backlog))


def try_out(host: str, port: int, key: str) -> None:
    """Could `listen` be called? Keeps nobody else from it meanwhile. Raises ApiError as it does."""
    _opened(host, port, key, lambda _: None).close()


def bound(host: str, port: int) -> socket.socket:
    """A socket at an address, which does not listen yet. Raises OSError."""
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    made = socket.socket(family, kind, protocol)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
    except OSError:
        made.close()
        raise
    return made


def _opened(host: str, port: int, key: str, begin: Callable[[socket.socket], None]) -> socket.socket:
    try:
        opened = bound(host, port)
        try:
            begin(opened)
        except OSError:
            opened.close()
            raise
    except OSError as error:
        where = f"api.host {host}, {key} {port}: cannot listen there"
        if error.errno != errno.EADDRINUSE:
            raise ApiError(f"{where} ({error.strerror}); name an address of this machine and a free {key}") from error
        raise ApiError(
            f"{where}, {holder(port) or 'a program of another user'} does; stop that one (`softarm status` asks a "
            f"daemon), or choose another {key}, 0 for any"
        ) from error
    return opened


def holder(port: int) -> str | None:
    """Which process listens at a TCP port of this machine, in words; None where nobody does, or it may not be seen."""
    inodes = {f"socket:[{inode}]" for table in ("tcp", "tcp6") for inode in _listening(Path("/proc/net", table), port)}
    for process in holders(inodes):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            command = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
            return f"process {process.name} ({shlex.join(command[:-1])[:80]})"
    return None


def _listening(table: Path, port: int) -> list[str]:
    """The sockets' numbers."""
    try:
        rows = [line.split() for line in table.read_text().splitlines()[1:]]
    except OSError:
        return []
    return [row[9] for row in rows if row[3] == LISTENS and int(row[1].rpartition(":")[2], 16) == port]
