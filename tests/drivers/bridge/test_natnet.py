"""NatNet datagrams: known vectors, every version of the twin's server, an independent reader, and random bytes."""

import struct

import natnet as oracle
import pytest
from natnet.data_frame import DataFrame
from natnet.packet_buffer import PacketBuffer
from natnet.version import Version as OracleVersion

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.natnet import Body, Echo, Frame, Models, Server, decode
from softarm.drivers.twin import motive

# One body, made by hand, and read by the package natnet 0.3.0 as well.
V31 = (
    "070074002a00000000000000000000000100000001000000cdcccc3dcdcc4c3e9a99993e0000000000000000000000000000803f6f12033a"
    "01000000000000000000000000000000000000000000000000000000000000002940e803000000000000d007000000000000b80b00000000"
    "0000020000000000"
)
V41 = (
    "0700a0002a00000000000000000000000000000000000000010000002600000001000000cdcccc3dcdcc4c3e9a99993e0000000000000000"
    "000000000000803f6f12033a0100000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
    "0000000000000000000000002940e803000000000000d007000000000000b80b00000000000001f1536507000000020000000000"
)
VERSIONS = [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2), (4, 4)]
# Two sets, skeletons and plates each, the second of them empty.
FULL = {
    "marker sets": (2, b"cart\0\3\0\0\0" + bytes(3 * 12) + b"all\0" + bytes(4)),
    "markers": (2, bytes(2 * 12)),
    "skeletons": (2, struct.pack("<II", 7, 3) + bytes(3 * 38) + struct.pack("<II", 7, 0)),
    "labeled markers": (4, bytes(4 * 26)),
    "force plates": (2, struct.pack("<IIIII2I", 1, 2, 1, 0, 2, 0, 0) + struct.pack("<II", 1, 0)),
}
BODIES = (
    Body(1, (0.5, -0.25, 2.0), (0.0, 0.0, 0.0, 1.0), True),
    Body(7, (0.0, 0.0, 0.0), (0.5, 0.5, 0.5, 0.5), False),
)


@pytest.mark.parametrize(("vector", "version"), [(V31, (3, 1)), (V31, (3, 0)), (V41, (4, 1)), (V41, (4, 4))])
def test_known_datagrams_are_decoded(vector, version):
    read = decode(bytes.fromhex(vector), version)
    [body] = read.bodies
    assert read._replace(bodies=()) == Frame(42, (), 1000, 2000, 3000, natnet.MODELS_CHANGED)
    assert body.id == 1
    assert body.position_m == pytest.approx((0.1, 0.2, 0.3))
    assert body.orientation == (0.0, 0.0, 0.0, 1.0)
    assert body.tracked


@pytest.mark.parametrize("precise", [False, True])
def test_a_frame_of_4_0_may_have_the_precise_stamp_or_not(precise):
    content = motive.frame((4, 0), 3, BODIES, (10, 20, 30), natnet.EDIT_MODE, FULL)[4:]
    datagram = natnet.message(natnet.FRAME, content[:-6] + bytes(8 * precise) + content[-6:])
    assert decode(datagram, (4, 0)) == Frame(3, BODIES, 10, 20, 30, natnet.EDIT_MODE)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("others", [{}, FULL])
def test_bodies_are_decoded_among_other_contents(version, others):
    datagram = motive.frame(version, 3, BODIES, (10, 20, 30), 0, others)
    assert decode(datagram, version) == Frame(3, BODIES, 10, 20, 30, 0)


@pytest.mark.parametrize("version", [(3, 0), (3, 1)])
@pytest.mark.parametrize("others", [{}, FULL])
def test_an_independent_reader_agrees(version, others):
    """Compare with natnet 0.3.0, which cannot read the end of a frame of 4.1."""
    datagram = motive.frame(version, 3, BODIES, (10, 20, 30), natnet.EDIT_MODE, others)
    buffer = PacketBuffer(datagram[4:])
    theirs = DataFrame.read_from_buffer(buffer, OracleVersion(*version))
    ours = decode(datagram, version)
    assert len(datagram) - 4 - buffer.pointer == 4
    assert theirs.prefix.frame_number == ours.number
    assert [(b.id_num, b.pos, b.rot, b.tracking_valid) for b in theirs.rigid_bodies] == [
        (b.id, b.position_m, b.orientation, b.tracked) for b in ours.bodies
    ]
    stamps = theirs.suffix
    assert (stamps.stamp_camera_mid_exposure, stamps.stamp_data_received, stamps.stamp_transmit) == ours[2:5]


@pytest.mark.parametrize("version", VERSIONS)
def test_names_are_decoded_as_by_an_independent_reader(version):
    datagram = motive.models(version, motive.IDS)
    assert decode(datagram, version) == Models(motive.IDS)
    theirs = oracle.DataDescriptions.read_from_buffer(PacketBuffer(datagram[4:]), OracleVersion(*version))
    assert {body.name: body.id_num for body in theirs.rigid_bodies} == motive.IDS


def test_other_models_are_skipped():
    text = b"a\0"
    bone = text + struct.pack("<ii3fI", 1, -1, 0, 0, 0, 1) + bytes(16)
    kinds = {
        2: text + struct.pack("<iI", 1, 1) + bone,
        3: struct.pack("<i", 1) + text + bytes(4 * 163) + struct.pack("<I", 2) + text + text,
        4: struct.pack("<i", 1) + text + text + bytes(8) + struct.pack("<I", 1) + text,
        5: text + bytes(28),
        1: b"cart\0" + struct.pack("<ii3fI", 9, -1, 0, 0, 0, 0),
    }
    content = struct.pack("<I", 5) + b"".join(struct.pack("<I", kind) + each for kind, each in kinds.items())
    assert decode(natnet.message(natnet.MODELS, content), (3, 1)) == Models({"cart": 9})
    with pytest.raises(ValueError, match=r"kind 6, unknown in NatNet 3\.1"):
        decode(natnet.message(natnet.MODELS, struct.pack("<II", 1, 6)), (3, 1))


@pytest.mark.parametrize("group", [None, "239.255.42.99"])
def test_a_servers_answer_is_decoded(group):
    datagram = motive.server_info((4, 1), 3_312_787, 1511, group)
    assert len(datagram) == 283
    assert decode(datagram, None) == Server("Motive", (3, 1, 0, 0), (4, 1, 0, 0), 3_312_787, 1511, group)
    theirs = oracle.ServerInfo.read_from_buffer(PacketBuffer(datagram[4:]), OracleVersion(3))
    assert theirs.application_name == "Motive"
    assert str(theirs.nat_net_protocol_version) == "4.1.0.0"


def test_an_echo_is_requested_and_decoded():
    asked = natnet.echo(2**63 + 5)
    assert asked.hex() == "0c00080005000000000000" + "80"
    assert decode(natnet.message(natnet.ECHO_RESPONSE, asked[4:] + struct.pack("<Q", 77)), None) == Echo(2**63 + 5, 77)


def test_the_clients_messages_have_the_expected_lengths():
    assert len(natnet.connect()) == 4 + 269
    assert natnet.request_layout((4, 1))[4:] == b"Bitstream,4.1\0"
    assert decode(natnet.message(natnet.DISCONNECT), None) is None


@pytest.mark.parametrize(
    ("datagram", "version", "text"),
    [
        (b"\7", (3, 1), "a datagram of 1 bytes"),
        (bytes.fromhex(V31)[:-1], (3, 1), "message 7 declares 116 bytes and has 115"),
        (bytes.fromhex(V31), None, "before the server's version"),
        (bytes.fromhex(V31), (2, 9), r"NatNet 2\.9 is not read; 3\.0 to 4\.x are"),
        (bytes.fromhex(V31), (4, 1), "3443379404 rigid bodies in 2587774156 bytes"),
        (bytes.fromhex(V41), (3, 1), "left"),
        (natnet.message(7, bytes.fromhex(V31)[4:] + b"\0"), (3, 1), "a frame: 1 bytes are left over"),
        (natnet.message(1, bytes(278)), None, "a server's answer of 278 bytes; it has 279"),
        (motive.server_info((3, 1), 0, 1511, None), None, "0 ticks a second"),
        (natnet.message(13, bytes(15)), None, "an echo"),
        (natnet.message(5, struct.pack("<I", 1) + struct.pack("<II", 1, 5) + b"link1\0"), (4, 1), "left"),
        (
            natnet.message(5, struct.pack("<I", 1) + struct.pack("<II", 1, 5) + b"link1\0\1\0\0\0"),
            (4, 1),
            "is longer than",
        ),
    ],
)
def test_an_invalid_datagram_raises_a_sentence(datagram, version, text):
    with pytest.raises(ValueError, match=text):
        decode(datagram, version)


WHOLE = [
    (version, datagram)
    for version in VERSIONS
    for datagram in (
        motive.frame(version, 3, BODIES, (10, 20, 30), 0, FULL),
        motive.models(version, {"cart": 1}),
        motive.server_info(version, 1000, 1511, None),
    )
]


@pytest.mark.parametrize(("version", "datagram"), WHOLE)
def test_every_truncation_is_rejected(version, datagram):
    """Truncate with the old and with the new length in the header."""
    for size in range(4, len(datagram)):
        for head in (datagram[:4], struct.pack("<HH", struct.unpack_from("<H", datagram)[0], size - 4)):
            with pytest.raises(ValueError):
                decode(head + datagram[4:size], version)
