"""The wire to a NatNet server: one socket for commands and unicast frames, one more where frames are multicast."""

import selectors
import socket
import time
from collections.abc import Callable
from typing import Self

from softarm.drivers.base import DeviceError
from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.conversation import Conversation, Taken
from softarm.schemas.bridge import Bridge

_LOOK_S = 0.01  # what is to be said is looked for so often


class Client:
    """Use as `with Client(...) as client`, and poll. Raises DeviceError on entry when the address makes no sense."""

    def __init__(
        self,
        config: Bridge,
        server: str,
        tell: Callable[[str], None],
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.conversation = Conversation(tell, config.received_after_s)
        self.strangers = 0  # datagrams from elsewhere
        self.place = f"{server}:{config.command_port}"
        self._config, self._host, self._clock = config, server, clock
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
        except OSError as error:
            remedy = "name the address of the computer that runs Motive"
            raise DeviceError(self.place, "find", str(error.strerror), remedy) from None
        self._server = (str(found[0][4][0]), self._config.command_port)
        self._commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._commands.bind((local, 0))
        except OSError as error:
            self._commands.close()
            remedy = "name an address of this computer as `local`, or 0.0.0.0"
            raise DeviceError(self.place, f"listen at {local}", str(error.strerror or error), remedy) from None
        self._watch(self._commands)
        return self

    def __exit__(self, *_: object) -> None:
        self._send(natnet.disconnect())
        for opened in (self._commands, self._data):
            if opened is not None:
                opened.close()
        self._selector.close()

    def poll(self, seconds: float = _LOOK_S) -> list[Taken]:
        """Say what is due, then wait so long for frames; all that have come, oldest first."""
        for datagram in self.conversation.due(self._clock()):
            self._send(datagram)
        self._join()
        taken = []
        for key, _ in self._selector.select(min(seconds, _LOOK_S)):
            taken += self._drain(key.fileobj)  # type: ignore[arg-type]
        return taken

    def problem(self) -> str | None:
        """Why no frames come, with the next step; None: they do."""
        talk, now_ns = self.conversation, self._clock()

        def say(command: str, problem: str, remedy: str) -> str:
            return str(DeviceError(self.place, command, problem, remedy))

        if talk.server is None or (self._problem and talk.is_silent(now_ns)):
            remedy = "is Motive running, its Data Streaming on, on the interface of this network? (docs/bridge.md)"
            return say("connect", self._problem or "no answer", remedy)
        if talk.complaint is not None and now_ns - talk.complaint[0] < 1e9:
            return say("read", talk.complaint[1], "see docs/bridge.md")
        if talk.is_silent(now_ns):
            way = (
                "the network has to let multicast through; unicast is surer" if self._joined else "is it in Live mode?"
            )
            return say("read", "it answers, and streams no frames", way)
        if talk.clock is None or not talk.clock.is_ready:
            return say("read", "frames come, and no echoes of the server's clock", "let UDP through both ways")
        return None

    def _send(self, datagram: bytes) -> None:
        if self._commands is None:
            return
        try:
            self._commands.sendto(datagram, self._server)
            self._problem = None
        except OSError as error:  # no network yet: it is tried again
            self._problem = str(error.strerror or error)

    def _drain(self, inlet: socket.socket) -> list[Taken]:
        taken: list[Taken] = []
        while True:
            try:
                datagram, (host, _) = inlet.recvfrom(natnet.LONGEST)
            except BlockingIOError:
                return taken
            except OSError as error:
                self._problem = str(error.strerror or error)
                return taken
            if host != self._server[0]:
                self.strangers += 1
            elif (frame := self.conversation.hear(datagram, self._clock())) is not None:
                taken.append(frame)

    def _join(self) -> None:
        """Be where the server streams to: in its group, or nowhere else."""
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
            self._data.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # other clients may listen here, too
            self._data.bind(wanted)
            membership = socket.inet_aton(wanted[0]) + socket.inet_aton(self._config.local)
            self._data.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError as error:
            self._problem = f"the group {wanted[0]} cannot be joined ({error.strerror or error})"
            self._data.close()
            self._data, self._joined = None, None
            return
        self._watch(self._data)

    def _watch(self, inlet: socket.socket) -> None:
        inlet.setblocking(False)
        self._selector.register(inlet, selectors.EVENT_READ)
