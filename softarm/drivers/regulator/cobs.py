"""Framing of a serial line: Consistent Overhead Byte Stuffing (Cheshire and Baker 1999), CRC-16, a zero byte.

After lost or garbled bytes a receiver resynchronises at the next zero byte.
"""

import binascii

DELIMITER = b"\x00"
# Longer than any valid frame; more bytes without a zero are noise.
FRAME_MAX_BYTES = 256
_RUN_MAX = 254


def stuff(data: bytes) -> bytes:
    """Encode `data` without zero bytes."""
    blocks: list[bytes] = []
    for run in data.split(b"\x00"):
        *full, rest = (run[at : at + _RUN_MAX] for at in range(0, len(run) + 1, _RUN_MAX))
        blocks += [b"\xff" + each for each in full]
        blocks.append(bytes((len(rest) + 1,)) + rest)
    # A full run implies no zero after it, so nothing follows one at the end.
    if full and not rest:
        blocks.pop()
    return b"".join(blocks)


def unstuff(data: bytes) -> bytes:
    """Decode the output of `stuff`. Raises ValueError on anything else."""
    out = bytearray()
    position = 0
    while position < len(data):
        code = data[position]
        run = data[position + 1 : position + code]
        if code == 0 or len(run) != code - 1 or 0 in run:
            raise ValueError(f"broken COBS run at byte {position} of {len(data)}")
        out += run
        position += code
        if code != 0xFF and position < len(data):
            out.append(0)
    if not data:
        raise ValueError("an empty COBS block")
    return bytes(out)


def crc16(data: bytes) -> int:
    """Return the CRC-16/IBM-3740 (CCITT-FALSE): polynomial 0x1021, initial 0xFFFF; check value 0x29B1."""
    return binascii.crc_hqx(data, 0xFFFF)


def frame(body: bytes) -> bytes:
    """Return the bytes on the line: COBS of the body and its CRC (little-endian), then a zero."""
    return stuff(body + crc16(body).to_bytes(2, "little")) + DELIMITER


class Deframer:
    """Splitter of a byte stream into the bodies of valid frames; `dropped` counts the invalid ones."""

    def __init__(self) -> None:
        self.dropped = 0
        self._pending = bytearray()
        # Too many bytes arrived without a zero: all bytes up to the next zero are dropped.
        self._lost = False

    def feed(self, data: bytes) -> list[bytes]:
        """Return the bodies that `data` completes, oldest first. Never raises."""
        self._pending += data
        *blocks, rest = self._pending.split(DELIMITER)
        if self._lost and blocks:
            self._lost, blocks = False, blocks[1:]
        if not self._lost and len(rest) > FRAME_MAX_BYTES:
            self._lost = True
            self.dropped += 1
        self._pending = bytearray() if self._lost else bytearray(rest)
        return [body for block in blocks if block and (body := self._open(bytes(block))) is not None]

    def _open(self, block: bytes) -> bytes | None:
        try:
            content = unstuff(block)
        except ValueError:
            content = b""
        body, check = content[:-2], content[-2:]
        if not body or len(block) > FRAME_MAX_BYTES or crc16(body) != int.from_bytes(check, "little"):
            self.dropped += 1
            return None
        return body
