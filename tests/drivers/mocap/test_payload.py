"""Wire format of motion capture: frames survive encoding, and nothing else is accepted."""

import json
import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from softarm.drivers.mocap.payload import LOST, check_schema, decode, encode
from softarm.schemas.messages import BODY_NAMES, Pose

POSES = tuple(Pose(0.1 * i, 0.9 - 0.1 * i, 0.01 * i) for i in range(len(BODY_NAMES)))
finite = st.floats(-1e6, 1e6)
poses = st.builds(Pose, finite, finite, finite) | st.just(LOST)


def message(**changes: Any) -> bytes:
    fields = {"sequence": 1, "t_capture_ns": 5, "bodies": {name: [0, 1, 2] for name in BODY_NAMES}}
    return json.dumps(fields | changes).encode()


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.tuples(*[poses] * len(BODY_NAMES)))
@example(2**63 - 1, 2**63 - 1, POSES)
def test_a_frame_survives_encoding(sequence: int, t_capture_ns: int, bodies: tuple[Pose, ...]) -> None:
    frame = decode(encode(sequence, t_capture_ns, bodies), t_receive_ns=9)
    assert (frame.sequence, frame.t_capture_ns, frame.t_receive_ns) == (sequence, t_capture_ns, 9)
    for sent, received in zip(bodies, frame.bodies, strict=True):
        assert received.tracked == sent.tracked
        assert received == sent or not sent.tracked


def test_a_missing_body_is_not_tracked() -> None:
    frame = decode(message(bodies={"cart": [0, 1, 2]}), 0)
    assert [body.tracked for body in frame.bodies] == [True, False, False, False, False, False]
    assert all(math.isnan(v) for v in frame.bodies[5][:3])


@pytest.mark.parametrize("bodies", [(Pose(math.nan, 0, 0), *POSES[1:]), POSES[:-1]], ids=["NaN", "five bodies"])
def test_an_invalid_frame_is_not_published(bodies: tuple[Pose, ...]) -> None:
    with pytest.raises(ValueError):
        encode(1, 1, bodies)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"\xff\x00", "not JSON"),
        (b"[" * 5000, "not JSON"),
        (message(sequence=True), "sequence must be an integer"),
        (message(sequence=2**63), r"sequence must be an integer from 0 to 2\^63 - 1"),
        (message(bodies=["cart"]), "the names of bodies must be among"),
        (message(bodies={"cart": 7}), r"cart must be \[y, z, angle\] or null"),
        (message(bodies={"cart": {"y": 0, "z": 0, "angle": 0}}), r"cart must be \[y, z, angle\] or null"),
        (message(bodies={"cart": [0, 0, "x"]}), r"cart must be \[y, z, angle\]"),
        (message(bodies={"cart": [0, 10**400, 0]}), "cart holds a number beyond"),
    ],
)
def test_an_error_names_the_malformed_field(payload: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        decode(payload, 0)


@given(
    st.binary(max_size=60) | st.lists(st.none() | st.floats(), max_size=4).map(lambda value: json.dumps(value).encode())
)
def test_noise_is_a_value_error(payload: bytes) -> None:
    with pytest.raises(ValueError):
        decode(payload, 0)


def test_another_schema_version_is_rejected_and_a_missing_one_accepted():
    for encoding in ("application/json;softarm.mocap.v1", "application/json", "zenoh/bytes", "text/plain;other"):
        check_schema(encoding)
    with pytest.raises(
        ValueError, match=r"the sample is softarm\.mocap\.v2, this software supports softarm\.mocap\.v1"
    ):
        check_schema("application/json;softarm.mocap.v2")
    with pytest.raises(ValueError, match=r"the sample is softarm\.mocap\.2{26}, this"):
        check_schema("application/json;softarm.mocap." + "2" * 100)
