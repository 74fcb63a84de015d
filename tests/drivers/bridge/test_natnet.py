"""NatNet's datagrams: known vectors, what our own Motive says in every version, an independent reader, and bytes that
are none.
"""

import contextlib
import itertools
import struct

import natnet as oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st
from natnet.data_frame import DataFrame
from natnet.packet_buffer import PacketBuffer
from natnet.version import Version as OracleVersion

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.natnet import Body, Echo, Frame, Models, Other, Server, decode
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import Extras

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
FULL = Extras({"cart": 3, "all": 0}, 2, (3, 0), 4, ((1, 2), ()))
BODIES = (
    Body(1, (0.5, -0.25, 2.0), (0.0, 0.0, 0.0, 1.0), 0.25, True),
    Body(7, (0.0, 0.0, 0.0), (0.5, 0.5, 0.5, 0.5), 0.0, False),
)


@pytest.mark.parametrize(("vector", "version"), [(V31, (3, 1)), (V31, (3, 0)), (V41, (4, 1)), (V41, (4, 4))])
def test_vectors_are_read(vector, version):
    read = decode(bytes.fromhex(vector), version)
    [body] = read.bodies
    assert read._replace(bodies=()) == Frame(42, (), 1000, 2000, 3000, natnet.MODELS_CHANGED)
    assert body.id == 1
    assert body.position_m == pytest.approx((0.1, 0.2, 0.3))
    assert body.orientation == (0.0, 0.0, 0.0, 1.0)
    assert body.error_m == pytest.approx(5e-4)
    assert body.tracked


def test_a_recorded_frames_contents_have_its_length():
    """Motive 2 of 2017, whose contents and 336 bytes are told by python_natnet's tests and SampleClient."""
    place, turn = (0.1744466, 1.4471314, -0.7343040), (-0.05459423, 0.5099482, 0.04370357, -0.8573577)
    stamps = (1416497730518, 1416497745808, 1416497748722)
    said = motive.frame(
        (3, 0), 162734, [Body(2, place, turn, 5.15e-4, True)], stamps, 0, Extras(unlabeled=5, labeled=6)
    )
    assert len(said) == 336
    read = decode(said, (3, 0))
    assert (read.number, read.exposed, read.received, read.sent) == (162734, *stamps)
    assert read.bodies[0].position_m == pytest.approx(place)
    assert (read.received - read.exposed) / 3_312_787 == pytest.approx(4.6e-3, abs=5e-5)  # as received_after_s


@pytest.mark.parametrize("precise", [False, True])
def test_a_frame_of_4_0_may_have_the_precise_stamp_or_not(precise):
    said = motive.frame((4, 0), 3, BODIES, (10, 20, 30), natnet.EDIT_MODE, FULL, precise)
    assert decode(said, (4, 0)) == Frame(3, BODIES, 10, 20, 30, natnet.EDIT_MODE)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("extras", [Extras(), FULL])
def test_whatever_else_a_frame_carries_its_bodies_are_read(version, extras):
    said = motive.frame(version, 3, BODIES, (10, 20, 30), 0, extras)
    assert decode(said, version) == Frame(3, BODIES, 10, 20, 30, 0)


@pytest.mark.parametrize("version", [(3, 0), (3, 1)])
@pytest.mark.parametrize("extras", [Extras(), FULL])
def test_an_independent_reader_reads_the_same(version, extras):
    """natnet 0.3.0 cannot read the end of a frame of 4.1; of 3.x it reads all."""
    said = motive.frame(version, 3, BODIES, (10, 20, 30), natnet.RECORDING, extras)
    buffer = PacketBuffer(said[4:])
    theirs = DataFrame.read_from_buffer(buffer, OracleVersion(*version))
    ours = decode(said, version)
    assert len(said) - 4 - buffer.pointer == 4
    assert theirs.prefix.frame_number == ours.number
    assert [(b.id_num, b.pos, b.rot, b.tracking_valid) for b in theirs.rigid_bodies] == [
        (b.id, b.position_m, b.orientation, b.tracked) for b in ours.bodies
    ]
    stamps = theirs.suffix
    assert (stamps.stamp_camera_mid_exposure, stamps.stamp_data_received, stamps.stamp_transmit) == ours[2:5]


@pytest.mark.parametrize("version", VERSIONS)
def test_names_are_read_here_and_by_an_independent_reader(version):
    said = motive.models(version, motive.IDS)
    assert decode(said, version) == Models(motive.IDS)
    theirs = oracle.DataDescriptions.read_from_buffer(PacketBuffer(said[4:]), OracleVersion(*version))
    assert {body.name: body.id_num for body in theirs.rigid_bodies} == motive.IDS


def test_other_models_are_passed_over():
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
    assert decode(motive.message(natnet.MODELS, content), (3, 1)) == Models({"cart": 9})
    with pytest.raises(ValueError, match=r"kind 6, which NatNet 3\.1 does not have"):
        decode(motive.message(natnet.MODELS, struct.pack("<II", 1, 6)), (3, 1))


@pytest.mark.parametrize("group", [None, "239.255.42.99"])
def test_a_servers_answer_is_read(group):
    said = motive.server_info((4, 1), 3_312_787, 1511, group)
    assert len(said) == 283
    assert decode(said, None) == Server("Motive", (3, 1, 0, 0), (4, 1, 0, 0), 3_312_787, 1511, group)
    theirs = oracle.ServerInfo.read_from_buffer(PacketBuffer(said[4:]), OracleVersion(3))
    assert theirs.application_name == "Motive"
    assert str(theirs.nat_net_protocol_version) == "4.1.0.0"


def test_an_echo_is_asked_for_and_read():
    asked = natnet.echo(2**63 + 5)
    assert asked.hex() == "0c00080005000000000000" + "80"
    assert decode(motive.message(natnet.ECHO_RESPONSE, asked[4:] + struct.pack("<Q", 77)), None) == Echo(2**63 + 5, 77)


def test_what_the_client_says_has_the_lengths_that_servers_take():
    assert [len(said) - 4 for said in (natnet.connect(), natnet.keep_alive(), natnet.request_models())] == [269, 0, 0]
    assert natnet.request_layout((4, 1))[4:] == b"Bitstream,4.1\0"
    assert decode(natnet.disconnect(), None) == Other(natnet.DISCONNECT)


@pytest.mark.parametrize(
    ("said", "version", "text"),
    [
        (b"\7", (3, 1), "a datagram of 1 bytes"),
        (bytes.fromhex(V31)[:-1], (3, 1), "message 7 says 116 bytes and brings 115"),
        (bytes.fromhex(V31), None, "before the server said its version"),
        (bytes.fromhex(V31), (2, 9), r"NatNet 2\.9 is not read; 3\.0 to 4\.x are"),
        (bytes.fromhex(V31), (5, 0), r"NatNet 5\.0 is not read"),
        (bytes.fromhex(V31), (4, 1), "3443379404 rigid bodies in 2587774156 bytes"),
        (bytes.fromhex(V41), (3, 1), "left"),
        (motive.message(7, bytes.fromhex(V31)[4:] + b"\0"), (3, 1), "a frame: 1 bytes are left over"),
        (
            motive.message(7, struct.pack("<5I", 1, 0, 0, 0, 0) + struct.pack("<2I", 3, 38)),
            (4, 1),
            "3 rigid bodies in 38",
        ),
        (motive.message(1, bytes(278)), None, "a server's answer of 278 bytes; it has 279"),
        (motive.server_info((3, 1), 0, 1511, None), None, "0 ticks a second"),
        (motive.message(13, bytes(15)), None, "an echo"),
        (motive.message(5, struct.pack("<I", 1) + struct.pack("<II", 1, 5) + b"link1\0"), (4, 1), "left"),
        (
            motive.message(5, struct.pack("<I", 1) + struct.pack("<II", 1, 5) + b"link1\0\1\0\0\0"),
            (4, 1),
            "is longer than",
        ),
    ],
)
def test_what_is_none_is_told_in_a_sentence(said, version, text):
    with pytest.raises(ValueError, match=text):
        decode(said, version)


WHOLE = [
    (version, said)
    for version in VERSIONS
    for said in (
        motive.frame(version, 3, BODIES, (10, 20, 30), 0, FULL),
        motive.models(version, {"cart": 1}),
        motive.server_info(version, 1000, 1511, None),
    )
]


@pytest.mark.parametrize(("version", "said"), WHOLE)
def test_every_truncation_is_refused(version, said):
    """Whether the head still says the old length, or the new one."""
    for size in range(4, len(said)):
        for head in (said[:4], struct.pack("<HH", struct.unpack_from("<H", said)[0], size - 4)):
            with pytest.raises(ValueError):
                decode(head + said[4:size], version)


@given(st.sampled_from([*VERSIONS, None]), st.sampled_from([1, 5, 7, 13]), st.binary(max_size=600))
def test_any_bytes_are_read_or_refused(version, kind, content):
    with contextlib.suppress(ValueError):
        decode(motive.message(kind, content), version)


@given(st.sampled_from(WHOLE), st.data())
def test_flipped_bytes_are_read_or_refused(whole, data):
    version, said = whole
    at = data.draw(st.lists(st.integers(4, len(said) - 1), min_size=1, max_size=4))
    changed = bytearray(said)
    for place in at:
        changed[place] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(ValueError):
        decode(bytes(changed), version)


def test_counts_that_no_datagram_holds_take_no_time():
    """A marker set of no name and no markers has five bytes; 2^32 of anything end with the datagram."""
    huge = struct.pack("<I", 2**32 - 1)
    for zeros in itertools.chain(range(0, 64, 4), [60_000]):
        with pytest.raises(ValueError):
            decode(motive.message(7, bytes(4) + huge + bytes(zeros)), (3, 1))
