"""Check the firmware against every vector of the section Regulator in docs/reference/wires.md."""

import ctypes
import re
from typing import Any

import pytest

from tests.drivers.wires_page import table, vectors


def bodies(library: ctypes.CDLL, line: bytes) -> list[bytes]:
    """Return the bodies that the firmware's deframer finds."""
    deframer = library.deframer_new()
    found = [
        bytes(library.deframer_body(deframer)[:length])
        for byte in line
        if (length := library.deframer_take(deframer, byte))
    ]
    library.deframer_delete(deframer)
    return found


@pytest.mark.parametrize(("data", "stuffed"), table("data", "stuffed"))
def test_stuffing_matches_the_page(library: ctypes.CDLL, data: str, stuffed: str) -> None:
    plain, out = bytes.fromhex(data), ctypes.create_string_buffer(64)
    length = library.frames_stuff(plain, len(plain), out)
    assert out.raw[:length].hex() == stuffed
    assert library.frames_unstuff(out, length) == len(plain)
    assert out.raw[: len(plain)] == plain


@pytest.mark.parametrize(("body", "crc", "line"), table("body", "CRC-16", "on the line"))
def test_framing_matches_the_page(library: ctypes.CDLL, body: str, crc: str, line: str) -> None:
    plain = bytes.fromhex(body)
    assert f"{library.frames_crc16(plain, len(plain)):04X}h" == crc
    assert bodies(library, bytes.fromhex(line)) == [plain]


@pytest.mark.parametrize(("line", "why"), table("on the line", "dropped because"))
def test_invalid_lines_are_dropped(library: ctypes.CDLL, line: str, why: str) -> None:
    good = bytes.fromhex(table("body", "CRC-16", "on the line")[0][2])
    assert bodies(library, bytes.fromhex(line)) == [], why
    assert len(bodies(library, bytes.fromhex(line) + good)) == 1


@pytest.mark.parametrize("at_once", [1, 7, 64])
def test_the_conversation_matches_the_page_in_any_pieces(make_board: Any, at_once: int) -> None:
    rows = vectors("regulator.csv")
    board = make_board()
    assert len(rows) == 24
    for (_, asked, time_us, _, line), (_, answered, _, _, expected) in zip(rows[::2], rows[1::2], strict=True):
        kpa = re.search(r"(\S+) kPa", answered)
        data, said = bytes.fromhex(line), b""
        for i in range(0, len(data), at_once):
            said += board.receive(data[i : i + at_once], int(time_us) * 1000, float(kpa[1]) if kpa else 0.0)
        assert said.hex() == expected, asked
