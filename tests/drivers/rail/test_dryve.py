"""Telegrams of the D1, byte for byte as in the manual, the sample programs and recordings of real drives."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve import DryveMismatch, DryveRefusal, Entry

FEED = Entry("feed", 0x6092, 1, 4)

REQUESTS = [
    (dryve.STATUSWORD, None, "00000000000d002b0d00000060410000000002"),
    (dryve.CONTROLWORD, 0x000F, "00000000000f002b0d010000604000000000020f00"),
    (dryve.CONTROLWORD, 0x0100, "00000000000f002b0d010000604000000000020001"),
    (dryve.MODE, 3, "00000000000e002b0d0100006060000000000103"),
    (FEED, 7000, "000000000011002b0d01000060920100000004581b0000"),
    (dryve.TARGET_VELOCITY, -1000, "000000000011002b0d01000060ff000000000418fcffff"),
    (dryve.POSITION, None, "00000000000d002b0d00000060640000000004"),
]
ACKNOWLEDGED = "00000000000d002b0d01000060400000000000"
ABORTED = "00000000000b00abff00060dce00000206"


@pytest.mark.parametrize(("entry", "value", "telegram"), REQUESTS)
def test_requests_match_the_samples(entry: Entry, value: int | None, telegram: str) -> None:
    assert dryve.encode_request(0, entry, value).hex() == telegram


@pytest.mark.parametrize(
    ("telegram", "transaction", "entry", "value"),
    [
        ("0f0f0000000f002b0d000000604100000000024004", 0x0F0F, dryve.STATUSWORD, 0x0440),
        ("00000000000e002b0d0000006061000000000103", 0, dryve.MODE_DISPLAY, 3),
        ("000000000011002b0d00000060640000000004d08affff", 0, dryve.POSITION, -30000),
        ("000000000011002b0d00000060640000000004efff f6f9".replace(" ", ""), 0, dryve.POSITION, -101253137),
        ("00000000000f002b0d00000060830000000002e803", 0, dryve.ACCELERATION, 1000),  # 2 bytes of 4: no sign
    ],
)
def test_answers_match_the_samples(telegram: str, transaction: int, entry: Entry, value: int) -> None:
    assert dryve.decode_answer(bytes.fromhex(telegram), transaction, entry, write=False) == value


@pytest.mark.parametrize(
    ("telegram", "words"),
    [
        (ABORTED, r"the object does not exist \(SDO abort 0x06020000\)"),
        ("00000000000300ab02", r"illegal address \(Modbus exception 0x02\)"),
        ("00000000000b00abff00060dce78563412", "refused .SDO abort 0x12345678"),
    ],
)
def test_error_answers_become_sentences_that_name_the_object(telegram: str, words: str) -> None:
    with pytest.raises(DryveRefusal, match=rf"6041h:0 \(statusword\): {words}"):
        dryve.decode_answer(bytes.fromhex(telegram), 0, dryve.STATUSWORD, write=False)


@pytest.mark.parametrize(
    ("telegram", "entry", "words"),
    [
        ("00000000000f002b0d000000606c0000000002fbff", dryve.VELOCITY, "2 bytes for 606Ch:0"),
        ("00010000000f002b0d000000604100000000024006", dryve.STATUSWORD, "transaction 1, not 0"),
        ("00000000000f002b0d000000604000000000024006", dryve.STATUSWORD, "not an answer to a request for 6041h"),
        ("000000000010002b0d00000060410000000003400600", dryve.STATUSWORD, "3 bytes for 6041h"),
        ("00000000000f002b0d000000604100000000044006", dryve.STATUSWORD, "declared 4"),
        (ACKNOWLEDGED, dryve.CONTROLWORD, "not an answer to a request for 6040h"),
        ("00000000000e002b0d0000006041000000000140", dryve.STATUSWORD, "1 bytes for 6041h"),
    ],
)
def test_answers_that_do_not_fit_are_rejected(telegram: str, entry: Entry, words: str) -> None:
    with pytest.raises(DryveMismatch, match=words):
        dryve.decode_answer(bytes.fromhex(telegram), 0, entry, write=False)


@given(st.integers(0, 65535), st.integers(-(2**31), 2**31 - 1))
def test_requests_and_answers_survive_encoding(transaction: int, value: int) -> None:
    request = dryve.decode_request(dryve.encode_request(transaction, dryve.TARGET_VELOCITY, value))
    assert request == dryve.ModbusRequest(transaction, 0x60FF, 0, 4, value.to_bytes(4, "little", signed=True))
    assert dryve.decode_answer(dryve.encode_acknowledgement(request), transaction, dryve.TARGET_VELOCITY, True) == 0
    question = dryve.decode_request(dryve.encode_request(transaction, dryve.POSITION))
    answer = dryve.encode_value(question, value.to_bytes(4, "little", signed=True))
    assert dryve.decode_answer(answer, transaction, dryve.POSITION, write=False) == value


@given(st.binary(max_size=40))
def test_noise_raises_only_the_two_errors_of_an_exchange(telegram: bytes) -> None:
    with pytest.raises((DryveRefusal, DryveMismatch)):
        dryve.decode_answer(telegram, 0x7FFF, dryve.STATUSWORD, write=False)


def read_all(*pieces: bytes) -> list[str]:
    """Return the telegrams in a stream of pieces, with an error message in the place of a broken one."""
    telegrams, out = dryve.Telegrams(), []
    for piece in pieces:
        telegrams.feed(piece)
        try:
            telegram = telegrams.next()
        except ValueError as error:
            out.append(str(error))
        else:
            out += [] if telegram is None else [telegram.hex()]
    return out


def test_telegrams_are_split_by_their_length() -> None:
    assert read_all(bytes.fromhex(ABORTED + ACKNOWLEDGED), b"") == [ABORTED, ACKNOWLEDGED]


@given(st.integers(1, 18))
def test_a_telegram_in_two_pieces_is_complete(cut: int) -> None:
    whole = bytes.fromhex(ACKNOWLEDGED)
    assert read_all(whole[:cut], whole[cut:]) == [ACKNOWLEDGED]


@pytest.mark.parametrize("head", ["0000000004ff", "000000000002", "00000001000d"])
def test_an_invalid_header_is_rejected_and_the_next_telegram_is_read(head: str) -> None:
    broken, whole = read_all(bytes.fromhex(head) + bytes(1279), bytes.fromhex(ACKNOWLEDGED))
    assert f"{head} is not a telegram's header" in broken
    assert whole == ACKNOWLEDGED
