"""NatNet, the UDP protocol of OptiTrack's Motive: rigid bodies and clocks of versions 3.0 to 4.x.

Little-endian: message u16, bytes of payload u16, payload. The layouts are those of the SDK's samples;
docs/hardware/bridge.md states which were tested. `decode` raises ValueError, and nothing else, for invalid datagrams.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

# Bytes of the longest UDP datagram.
LONGEST = 65_507
# A newer 4.x is decoded as 4.1; the total length then confirms the layout.
SUPPORTED = ((3, 0), (4, 4))

CONNECT, SERVER_INFO, REQUEST, REQUEST_MODELS, MODELS = 0, 1, 2, 4, 5
FRAME, DISCONNECT, KEEP_ALIVE, ECHO_REQUEST, ECHO_RESPONSE = 7, 9, 10, 12, 13
# Flag of a rigid body.
TRACKED = 1
# Flags of a frame.
MODELS_CHANGED, EDIT_MODE = 2, 4

Version = tuple[int, int]
Vector = tuple[float, float, float]
# x, y, z, w
Quaternion = tuple[float, float, float, float]

_HEAD, _COUNT, _SHORT = struct.Struct("<HH"), struct.Struct("<I"), struct.Struct("<h")
_BODY = struct.Struct("<i3f4ffh")
_STAMPS, _PRECISION, _END = struct.Struct("<IIdQQQ"), 8, 4
_SERVER = struct.Struct("<256s4B4BQHB4s")
_ECHO = struct.Struct("<QQ")
_MARKER, _LABELED = 12, 26


class Body(NamedTuple):
    """Streamed rigid body: position, m, and unit quaternion in the cameras' coordinates."""

    id: int
    position_m: Vector
    orientation: Quaternion
    tracked: bool


class Frame(NamedTuple):
    """One frame. Stamps are ticks of the server's clock, 0 if the cameras do not provide them.

    `exposed` is the middle of the exposure, `received` the arrival of the data in the server. `parameters` holds
    MODELS_CHANGED and EDIT_MODE.
    """

    number: int
    bodies: tuple[Body, ...]
    exposed: int
    received: int
    sent: int
    parameters: int


class Server(NamedTuple):
    """Description of a server; `group` is its multicast group, None for unicast."""

    name: str
    application: tuple[int, int, int, int]
    natnet: tuple[int, int, int, int]
    clock_hz: int
    data_port: int
    group: str | None

    @property
    def version(self) -> Version:
        """Version of the layout of its frames."""
        return self.natnet[:2]


class Models(NamedTuple):
    """Streaming ids of the rigid bodies by name."""

    ids: Mapping[str, int]


class Echo(NamedTuple):
    """Answer to `echo`: the stamp of the request, and the server's clock."""

    stamp: int
    ticks: int


Message = Frame | Server | Models | Echo


def connect() -> bytes:
    """Return a request for the stream: the server answers with `Server` and, in unicast, with frames."""
    sender = struct.pack("<256s4B4B", b"softarm", 1, 0, 0, 0, 4, 1, 0, 0)
    # The zero options request all data, in the server's own version.
    return message(CONNECT, sender + bytes(5))


def request_layout(version: Version) -> bytes:
    """Return a request to a unicast server (4.0 or newer) for frames in an older layout than its own."""
    return message(REQUEST, f"Bitstream,{version[0]}.{version[1]}".encode() + b"\0")


def echo(stamp: int) -> bytes:
    """Return a request for the server's clock; the stamp may be 0 to 2^64 - 1."""
    return message(ECHO_REQUEST, struct.pack("<Q", stamp))


def decode(datagram: bytes, version: Version | None) -> Message | None:
    """Return the message in a datagram of a server, or None for a type that the bridge does not use.

    Frames and models need the server's `Server.version`. Raises ValueError on an invalid datagram.
    """
    if len(datagram) < _HEAD.size:
        raise ValueError(f"a datagram of {len(datagram)} bytes; a NatNet message has {_HEAD.size} or more")
    number, size = _HEAD.unpack_from(datagram)
    if size != len(datagram) - _HEAD.size:
        raise ValueError(f"message {number} declares {size} bytes and has {len(datagram) - _HEAD.size}")
    if number not in _READ:
        return None
    if number in (FRAME, MODELS):
        if version is None:
            raise ValueError("frames arrived before the server's version")
        if not (3, 0) <= version < (5, 0):
            raise ValueError(
                f"NatNet {version[0]}.{version[1]} is not read; 3.0 to 4.x are: see docs/hardware/bridge.md"
            )
    return _READ[number](_Reader(datagram, _HEAD.size), version or (0, 0))


def message(number: int, payload: bytes = b"") -> bytes:
    """Return a message of a type.

    Without content are DISCONNECT, REQUEST_MODELS, and KEEP_ALIVE, which a unicast server expects and does not answer.
    """
    return _HEAD.pack(number, len(payload)) + payload


class _Reader:
    """Reader of a datagram; reading beyond its end raises ValueError with the name of the item."""

    def __init__(self, data: bytes, at: int) -> None:
        self.data, self.at = data, at

    @property
    def left(self) -> int:
        return len(self.data) - self.at

    def skip(self, size: int, what: str) -> None:
        if size > self.left:
            raise ValueError(f"{what}: {size} bytes, where {self.left} are left of the datagram")
        self.at += size

    def take(self, layout: struct.Struct, what: str) -> tuple[int, ...]:
        begin = self.at
        self.skip(layout.size, what)
        return layout.unpack_from(self.data, begin)

    def count(self, what: str) -> int:
        return self.take(_COUNT, f"the number of {what}")[0]

    def text(self, what: str) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise ValueError(f"{what}: no end of the text within the datagram")
        text, self.at = self.data[self.at : end], end + 1
        return text.decode("utf-8", "replace")

    def all_read(self, what: str, *may_be_left: int) -> None:
        if self.left not in (0, *may_be_left):
            raise ValueError(f"{what}: {self.left} bytes are left over: the layout is not that of the server's version")


def _frame(reader: _Reader, version: Version) -> Frame:
    number = reader.count("the frame")
    sized = version >= (4, 1)
    _section(reader, sized, "marker sets", _skip_marker_set)
    _section(reader, sized, "unlabeled markers", _skipping(_MARKER, "a marker"))
    bodies = _bodies(reader, sized)
    _section(reader, sized, "skeletons", _skip_skeleton)
    if sized:
        _section(reader, sized, "assets", _skip_skeleton)
    _section(reader, sized, "labeled markers", _skipping(_LABELED, "a labeled marker"))
    _section(reader, sized, "force plates", _skip_channels)
    _section(reader, sized, "devices", _skip_channels)
    *_, exposed, received, sent = reader.take(_STAMPS, "stamps")
    # The vendor's samples disagree on whether 4.0 has a precise stamp; the datagram's length decides.
    if sized or (version == (4, 0) and reader.left == _PRECISION + _SHORT.size + _END):
        reader.skip(_PRECISION, "the precise stamp")
    (parameters,) = reader.take(_SHORT, "parameters")
    reader.skip(_END, "the frame's end")
    reader.all_read("a frame")
    return Frame(number, bodies, exposed, received, sent, parameters)


def _section(reader: _Reader, sized: bool, what: str, skip_one: Callable[[_Reader], None]) -> None:
    """Skip a section of counted items."""
    count = reader.count(what)
    if sized:
        reader.skip(reader.count(f"bytes of {what}"), what)
        return
    # Each item has a byte or more, so the end of the datagram bounds a wrong count.
    for _ in range(count):
        skip_one(reader)


def _bodies(reader: _Reader, sized: bool) -> tuple[Body, ...]:
    count = reader.count("rigid bodies")
    if sized and (size := reader.count("bytes of rigid bodies")) != count * _BODY.size:
        raise ValueError(f"{count} rigid bodies in {size} bytes; each has {_BODY.size}")
    begin = reader.at
    reader.skip(count * _BODY.size, f"{count} rigid bodies")
    read = _BODY.iter_unpack(reader.data[begin : reader.at])
    return tuple(Body(id, (x, y, z), (a, b, c, d), bool(p & TRACKED)) for id, x, y, z, a, b, c, d, _, p in read)


def _skipping(size: int, what: str) -> Callable[[_Reader], None]:
    return lambda reader: reader.skip(size, what)


def _skip_marker_set(reader: _Reader) -> None:
    reader.text("a marker set's name")
    reader.skip(_MARKER * reader.count("a set's markers"), "a set's markers")


def _skip_skeleton(reader: _Reader) -> None:
    reader.skip(4, "a skeleton")
    reader.skip(_BODY.size * reader.count("a skeleton's bones"), "a skeleton's bones")


def _skip_channels(reader: _Reader) -> None:
    reader.skip(4, "a device")
    for _ in range(reader.count("channels")):
        reader.skip(4 * reader.count("a channel's values"), "a channel's values")


def _server(reader: _Reader, _: Version) -> Server:
    # A later version may append fields.
    if reader.left < _SERVER.size:
        raise ValueError(f"a server's answer of {reader.left} bytes; it has {_SERVER.size}")
    name, *rest = _SERVER.unpack_from(reader.data, reader.at)
    clock_hz, data_port, is_multicast, group = rest[8:]
    if clock_hz == 0:
        raise ValueError("the server's clock has 0 ticks a second; NatNet 3.0 or newer is needed")
    return Server(
        name.split(b"\0")[0].decode("utf-8", "replace"),
        (rest[0], rest[1], rest[2], rest[3]),
        (rest[4], rest[5], rest[6], rest[7]),
        clock_hz,
        data_port,
        ".".join(map(str, group)) if is_multicast else None,
    )


def _echo(reader: _Reader, _: Version) -> Echo:
    stamp, ticks = reader.take(_ECHO, "an echo")
    reader.all_read("an echo")
    return Echo(stamp, ticks)


_RIGID_BODY = 1


def _models(reader: _Reader, version: Version) -> Models:
    ids: dict[str, int] = {}
    for _ in range(reader.count("models")):
        kind = reader.count("a model")
        end = None
        if version >= (4, 1):
            size = reader.count("bytes of a model")
            end = reader.at + size
            if size > reader.left:
                raise ValueError(f"a model of {size} bytes, where {reader.left} are left of the datagram")
        if kind == _RIGID_BODY:
            name, id = reader.text("a rigid body's name"), reader.count("a rigid body's id")
            ids[name] = id
            if end is None:
                _skip_rigid_body(reader, version)
        elif end is None:
            if kind not in _OTHER_MODELS:
                raise ValueError(f"a model of kind {kind}, unknown in NatNet {version[0]}.{version[1]}")
            _skip_model(reader, kind, version)
        if end is not None:
            if reader.at > end:
                raise ValueError(f"a model is longer than its declared {size} bytes")
            reader.at = end
    reader.all_read("models", _END)
    return Models(ids)


def _skip_rigid_body(reader: _Reader, version: Version) -> None:
    """Skip the fields after name and id."""
    reader.skip(16, "a rigid body's parent and offset")
    count = reader.count("a rigid body's markers")
    reader.skip(16 * count, "a rigid body's markers")
    if version >= (4, 0):
        _skip_texts(reader, count)


def _skip_texts(reader: _Reader, count: int) -> None:
    for _ in range(count):
        reader.text("a name")


def _skip_model(reader: _Reader, kind: int, version: Version) -> None:
    for size, what in _OTHER_MODELS[kind]:
        if size == _TEXT:
            reader.text(what)
        elif size == _TEXTS:
            _skip_texts(reader, reader.count(what))
        else:
            reader.skip(size, what)
    if kind == _SKELETON:
        for _ in range(reader.count("bones")):
            reader.text("a bone's name")
            reader.skip(4, "a bone's id")
            _skip_rigid_body(reader, version)


_TEXT, _TEXTS = -1, -2
_SKELETON = 2
# Fields of other models by kind: their bytes, a text, or a number of texts.
_OTHER_MODELS: Mapping[int, Sequence[tuple[int, str]]] = {
    0: ((_TEXT, "a marker set's name"), (_TEXTS, "names")),
    _SKELETON: ((_TEXT, "a skeleton's name"), (4, "a skeleton's id")),
    3: ((4, "a force plate's id"), (_TEXT, "a force plate's number"), (652, "a force plate"), (_TEXTS, "channels")),
    4: (
        (4, "a device's id"),
        (_TEXT, "a device's name"),
        (_TEXT, "a device's number"),
        (8, "a device"),
        (_TEXTS, "channels"),
    ),
    5: ((_TEXT, "a camera's name"), (28, "a camera")),
}
_READ: Mapping[int, Callable[[_Reader, Version], Message]] = {
    SERVER_INFO: _server,
    MODELS: _models,
    FRAME: _frame,
    ECHO_RESPONSE: _echo,
}
