"""Sockets to a NatNet server: one for commands and unicast frames, another for multicast frames."""

import selectors
import socket
import time
from collections.abc import Callable
from typing import Self

from softarm.drivers.base import DeviceError
from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.conversation import Conversation, StampedFrame
from softarm.schemas.bridge import Bridge

# Interval at which due messages are sent.
_POLL_S = 0.01


class Client:
    """Client of a NatNet server: `with Client(...) as client`, then `poll`.

    Entering raises DeviceError on an invalid address. `other_senders` counts datagrams from other senders.
    """

    def __init__(self, config: Bridge, server: str, report: Callable[[str], None]) -> None:
        self.conversation = Conversation(report, config.received_after_s)
        self.other_senders = 0
        self.place = f"{server}:{config.command_port}"
        self._config, self._host = config, server
        self._selector = selectors.DefaultSelector()
        self._commands: socket.socket | None = None
        self._data: socket.socket | None = None
        self._joined: tuple[str, int] | None = None
        self._problem: str | None = None
        self._server: tuple[str, int] = ("", 0)

    def __enter__(self) -> Self:
        local = self._config.local
        try:
            found = socket.getaddrinfo(self._host, self._config.command_port, socket.AF_INET, socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            remedy = "use the address of the computer that runs Motive"
            raise DeviceError(self.place, "find", str(getattr(error, "strerror", error)), remedy) from None
        self._server = (str(found[0][4][0]), self._config.command_port)
        self._commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._commands.bind((local, 0))
        except OSError as error:
            self._commands.close()
            remedy = "set `local` to an address of this computer, or to 0.0.0.0"
            raise DeviceError(self.place, f"listen at {local}", str(error.strerror or error), remedy) from None
        self._watch(self._commands)
        return self

    def __exit__(self, *_: object) -> None:
        self._send(natnet.message(natnet.DISCONNECT))
        for opened in (self._commands, self._data):
            if opened is not None:
                opened.close()
        self._selector.close()

    def poll(self, seconds: float = _POLL_S) -> list[StampedFrame]:
        """Send the due messages, wait for frames at most so many seconds, and return them, oldest first."""
        for datagram in self.conversation.due(time.monotonic_ns()):
            self._send(datagram)
        self._join()
        taken = []
        for key, _ in self._selector.select(min(seconds, _POLL_S)):
            taken += self._drain(key.fileobj)  # type: ignore[arg-type]
        return taken

    def problem(self) -> str | None:
        """Return why no frames arrive, with the next step, or None if they do."""
        conversation, now_ns = self.conversation, time.monotonic_ns()

        def sentence(command: str, problem: str, remedy: str) -> str:
            return str(DeviceError(self.place, command, problem, remedy))

        if conversation.server is None or (self._problem and conversation.is_silent(now_ns)):
            remedy = "start Motive, and its Data Streaming on the interface of this network (docs/hardware/bridge.md)"
            return sentence("connect", self._problem or "no answer", remedy)
        if conversation.complaint is not None and now_ns - conversation.complaint[0] < 1e9:
            return sentence("read", conversation.complaint[1], "see docs/hardware/bridge.md")
        if conversation.is_silent(now_ns):
            way = "let multicast through the network, or use unicast" if self._joined else "press Live in Motive"
            return sentence("read", "the server answers but streams no frames", way)
        if conversation.clock is None or not conversation.clock.is_ready:
            problem = "frames arrive, but no echoes of the server's clock"
            return sentence("read", problem, "let UDP through in both directions")
        return None

    def _send(self, datagram: bytes) -> None:
        if self._commands is None:
            return
        try:
            self._commands.sendto(datagram, self._server)
            self._problem = None
        # Without a network the next poll tries again.
        except OSError as error:
            self._problem = str(error.strerror or error)

    def _drain(self, inlet: socket.socket) -> list[StampedFrame]:
        taken: list[StampedFrame] = []
        while True:
            try:
                datagram, (host, _) = inlet.recvfrom(natnet.LONGEST)
            except BlockingIOError:
                return taken
            except OSError as error:
                self._problem = str(error.strerror or error)
                return taken
            if host != self._server[0]:
                self.other_senders += 1
            elif (frame := self.conversation.receive(datagram, time.monotonic_ns())) is not None:
                taken.append(frame)

    def _join(self) -> None:
        """Join the server's multicast group, or leave it if the server uses unicast."""
        server = self.conversation.server
        if server is None:
            return
        wanted = None if server.group is None else (server.group, server.data_port)
        if wanted == self._joined:
            return
        if self._data is not None:
            self._selector.unregister(self._data)
            self._data.close()
        self._data, self._joined = None, wanted
        if wanted is None:
            return
        self._data = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            # Other clients on this computer may join the group too.
            self._data.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._data.bind(wanted)
            membership = socket.inet_aton(wanted[0]) + socket.inet_aton(self._config.local)
            self._data.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError as error:
            self._problem = f"cannot join the multicast group {wanted[0]} ({error.strerror or error})"
            self._data.close()
            self._data, self._joined = None, None
            return
        self._watch(self._data)

    def _watch(self, inlet: socket.socket) -> None:
        inlet.setblocking(False)
        self._selector.register(inlet, selectors.EVENT_READ)
