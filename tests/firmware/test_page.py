"""Check the firmware against every vector of the section Regulator in docs/reference/wires.md."""

import csv
import ctypes
import re
from pathlib import Path
from typing import Any

import pytest

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
PAGE = (REFERENCE / "wires.md").read_text(encoding="utf-8")


def table(*columns: str) -> list[list[str]]:
    """Return the cells of the only table of the page with these columns."""
    [rows] = re.findall(rf"^\| {re.escape(' | '.join(columns))} \|\n\|[-|]+\n((?:\|.*\n)+)", PAGE, re.MULTILINE)
    return [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in rows.splitlines()]


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
    with (REFERENCE / "vectors" / "regulator.csv").open(newline="") as lines:
        rows = list(csv.reader(lines))[1:]
    board = make_board()
    assert len(rows) == 24
    for (_, asked, time_us, _, line), (_, answered, _, _, expected) in zip(rows[::2], rows[1::2], strict=True):
        kpa = re.search(r"(\S+) kPa", answered)
        data, said = bytes.fromhex(line), b""
        for i in range(0, len(data), at_once):
            said += board.receive(data[i : i + at_once], int(time_us) * 1000, float(kpa[1]) if kpa else 0.0)
        assert said.hex() == expected, asked
