"""Test vectors of docs/reference/wires.md, through the encoder and decoder of both ends."""

import itertools
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from softarm.drivers.mocap import payload as mocap_payload
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState, decode_state
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.rail.dryve import DryveRefusal, Entry
from softarm.drivers.regulator import cobs, teensy
from softarm.drivers.regulator.driver import Conversation
from softarm.drivers.regulator.teensy import Fault, Hello, RegulatorCommand, RegulatorState, Welcome
from softarm.drivers.twin.dryve import DryveDevice
from softarm.drivers.twin.faults import Faults
from softarm.drivers.twin.teensy import TeensyDevice
from softarm.schemas.config import DryveRail
from softarm.schemas.messages import BODY_NAMES, Pose
from tests.drivers.rail.conftest import Drive, Server
from tests.drivers.wires_page import PAGE, table, vectors


def number(text: str) -> int:
    """Parse a number as the page writes it: 7, -25000 or 0640h."""
    return int(text[:-1], 16) if text.endswith("h") else int(text)


# The regulator


@pytest.mark.parametrize(("data", "stuffed"), table("data", "stuffed"))
def test_stuffing_matches_the_page(data: str, stuffed: str) -> None:
    assert cobs.stuff(bytes.fromhex(data)) == bytes.fromhex(stuffed)
    assert cobs.unstuff(bytes.fromhex(stuffed)) == bytes.fromhex(data)


@pytest.mark.parametrize(("body", "crc", "line"), table("body", "CRC-16", "on the line"))
def test_framing_matches_the_page(body: str, crc: str, line: str) -> None:
    assert cobs.crc16(bytes.fromhex(body)) == number(crc)
    assert cobs.frame(bytes.fromhex(body)) == bytes.fromhex(line)
    assert cobs.Deframer().feed(bytes.fromhex(line)) == [bytes.fromhex(body)]


@pytest.mark.parametrize(("line", "why"), table("on the line", "dropped because"))
def test_invalid_lines_are_dropped(line: str, why: str) -> None:
    deframer = cobs.Deframer()
    assert deframer.feed(bytes.fromhex(line)) == []
    assert deframer.dropped == 1, why


@dataclass(frozen=True)
class Row:
    """Row of the conversation on the page."""

    device: bool
    message: teensy.Message
    sequence: int
    t_ns: int
    body: bytes
    line: bytes


def conversation() -> Iterator[Row]:
    """Yield the rows of the conversation in their order."""
    for who, text, time_us, body, line in vectors("regulator.csv"):
        kind, sequence, fields = re.fullmatch(r"(\w+) (\d+)(?:: (.*))?", text).groups()  # type: ignore[union-attr]
        field = fields.split(", ") if fields else []
        message: teensy.Message
        if kind == "hello":
            message = Hello()
        elif kind == "welcome":
            message = Welcome(number(field[0].removeprefix("token ")))
        elif kind == "command":
            token, live, armed, kpa = field
            milliseconds = int(live.removesuffix(" ms"))
            message = RegulatorCommand(
                number(token.removeprefix("token ")), milliseconds / 1000, armed == "armed", kilopascal(kpa)
            )
        else:
            accepted, armed, faults, kpa = field
            bits = Fault(number(faults.removeprefix("faults ")))
            message = RegulatorState(int(accepted.removeprefix("accepted ")), armed == "armed", bits, kilopascal(kpa))
        yield Row(
            who == "device", message, int(sequence), int(time_us) * 1000, bytes.fromhex(body), bytes.fromhex(line)
        )


def kilopascal(text: str) -> float:
    return float(text.removesuffix(" kPa"))


def same(one: teensy.Message, other: teensy.Message) -> bool:
    """Compare two messages; NaN equals NaN."""
    return repr(one) == repr(other)


@pytest.mark.parametrize("row", list(conversation()))
def test_each_message_survives_encoding(row: Row) -> None:
    assert teensy.encode(row.message, row.sequence, row.t_ns // 1000) == row.body
    assert cobs.frame(row.body) == row.line
    message, sequence = teensy.decode(row.body)
    assert same(message, row.message)
    assert sequence == row.sequence


def test_the_simulated_device_answers_as_on_the_page() -> None:
    device = TeensyDevice(lambda: 0xA1B2C3D4)
    rows = list(conversation())
    for asked, answered in zip(rows[::2], rows[1::2], strict=True):
        assert (asked.device, answered.device) == (False, True)
        pressure_kpa = answered.message.pressure_kpa if isinstance(answered.message, RegulatorState) else 0.0
        assert device.receive(asked.line, asked.t_ns, pressure_kpa).hex() == answered.line.hex(), asked


def test_the_driver_sends_the_pages_messages_and_accepts_its_answers() -> None:
    talk, spoken = Conversation(0.1), []
    for row in conversation():
        if row.device:
            state = talk.receive(row.line)
            assert state is None if isinstance(row.message, Welcome) else same(state, row.message)  # type: ignore[arg-type]
            if talk.known is False:
                break
        elif isinstance(row.message, Hello):
            spoken.append((talk.greeting(row.t_ns), row.line))
        elif isinstance(row.message, RegulatorCommand):
            spoken.append((talk.command(row.message.armed, row.message.pressure_kpa, row.t_ns), row.line))
    assert len(spoken) > 5
    assert all(line == shown for line, shown in spoken[:4])


def test_a_hello_keeps_the_fault_bits_and_a_rejection_replaces_the_last() -> None:
    device, count = TeensyDevice(lambda: 5), itertools.count(1)

    def send(message: teensy.Message) -> None:
        device.receive(cobs.frame(teensy.encode(message, next(count), 0)), 0, 0.0)

    send(RegulatorCommand(4, 0.1, True, 1.0))
    assert device.faults == Fault.TOKEN
    send(Hello())
    assert device.faults == Fault.TOKEN
    send(RegulatorCommand(5, 0.1, True, 21.0))
    assert device.faults == Fault.RANGE


@pytest.mark.parametrize(("bit", "name"), [row[:2] for row in table("fault bit", "name", "rule")])
def test_fault_bits_have_the_numbers_of_the_page(bit: str, name: str) -> None:
    assert Fault[name.upper().replace(" ", "_")] == 1 << int(bit)


def test_the_bounds_are_those_of_the_page() -> None:
    assert f"more than {cobs.FRAME_MAX_BYTES} bytes without a zero" in PAGE
    assert f"outside 1 to {round(teensy.TIME_TO_LIVE_MAX_S * 1000)} ms" in PAGE
    assert f"set-point {teensy.VENT_KPA:.0f} kPa gauge" in PAGE


# The rail

ENTRIES = {(entry.index, entry.sub): entry for entry in vars(dryve).values() if isinstance(entry, Entry)}
RAIL = DryveRail(host="127.0.0.1")


@dataclass(frozen=True)
class Exchange:
    """Row of the rail's session: a request and its answer, or, without telegrams, an event at the drive."""

    says: str
    request: bytes
    answers: str
    answer: bytes

    @property
    def transaction(self) -> int:
        return int(self.says.split(":")[0])

    @property
    def entry(self) -> Entry:
        index, sub = re.search(r"([0-9A-F]{4})h:(\d)", self.says).groups()  # type: ignore[union-attr]
        return ENTRIES.get((int(index, 16), int(sub)), Entry("unknown here", int(index, 16), int(sub), 1))

    @property
    def value(self) -> int | None:
        _, is_write, value = self.says.partition(" = ")
        return number(value) if is_write else None


def exchanges(name: str) -> list[Exchange]:
    return [
        Exchange(says, bytes.fromhex(request), answers, bytes.fromhex(answer))
        for says, request, answers, answer in vectors(name)
    ]


SESSION = exchanges("rail.csv")
EXCHANGES = [row for row in SESSION if row.request]


@pytest.mark.parametrize("row", EXCHANGES)
def test_telegrams_of_the_session_survive_encoding(row: Exchange) -> None:
    entry, write = row.entry, row.value is not None
    assert dryve.encode_request(row.transaction, entry, row.value) == row.request
    request = dryve.decode_request(row.request)
    assert (request.transaction, request.index, request.sub) == (row.transaction, entry.index, entry.sub)
    value = dryve.decode_answer(row.answer, row.transaction, entry, write)
    if write:
        assert row.answers == "done"
        assert dryve.encode_acknowledgement(request) == row.answer
    else:
        assert value == number(row.answers)
        assert dryve.encode_value(request, value.to_bytes(entry.size, "little", signed=entry.signed)) == row.answer


@pytest.mark.parametrize("row", exchanges("rail-refused.csv"))
def test_refusals_survive_encoding(row: Exchange) -> None:
    kind, code = row.answers.split()[:2]
    made = dryve.encode_abort if kind == "abort" else dryve.encode_exception
    assert made(row.transaction, number(code)) == row.answer
    if "no request" not in row.says:
        assert dryve.encode_request(row.transaction, row.entry, row.value) == row.request
        with pytest.raises(DryveRefusal, match=number(code).to_bytes(4, "big").hex().upper().lstrip("0")):
            dryve.decode_answer(row.answer, row.transaction, row.entry, row.value is not None)
    assert DryveDevice(RAIL).answer(row.request, 0) == row.answer


@pytest.mark.parametrize("row", table("word", "in", "leads to", "and"), ids=lambda row: " ".join(row[:3]))
def test_each_controlword_leads_to_the_state_on_the_page(row: list[str]) -> None:
    word, after = (number(row[cell].split()[0]) for cell in (0, 2))
    for before in row[1].split(", "):
        drive = DryveDevice(RAIL)
        drive.state = decode_state(number(before))
        drive.answer(dryve.encode_request(1, dryve.CONTROLWORD, word), 0)
        assert drive.state is decode_state(after)
        assert drive.state.value == row[2].split(" ", 1)[1]


def test_the_simulated_drive_answers_as_on_the_page() -> None:
    drive = DryveDevice(RAIL)
    drive.sense(0.0, 0.0)
    for row in SESSION:
        if row.request:
            assert drive.answer(row.request, 0).hex() == row.answer.hex(), row.says
        elif motion := re.fullmatch(r"\*the cart is at (\S+) m, moving at (\S+) m/s\*", row.says):
            drive.sense(*map(float, motion.groups()))
        elif trip := re.fullmatch(r"\*the drive trips: (\w+)\*", row.says):
            drive.trip(number(trip[1]))
        else:
            assert row.says == "*a new connection*"


@pytest.mark.anyio
async def test_the_driver_sends_the_pages_telegrams_and_no_others(until: Any, running: Any) -> None:
    drive, faults = Drive(RAIL), Faults(lambda: 0)
    server = Server("127.0.0.1", 0, drive, faults, lambda: 0)
    faults.start("rail_keeps_going")
    drive.sense(0.0, 0.0)
    await server.open()
    axis = DryveRailAxis(RAIL.model_copy(update={"port": server.port, "timeout_s": 1.0}), 20)

    async def fly(condition: Any, enable: bool = False, velocity_m_s: float = 0.0) -> None:
        await until(condition, lambda: axis.write(enable, velocity_m_s) or server.step())

    try:
        async with running(axis):
            await fly(lambda: axis.problem() is None and axis.read() is not None)
            for velocity_m_s in (0.25, -0.25):
                await fly(lambda v=velocity_m_s: drive.target_velocity_m_s == v, True, velocity_m_s)
            drive.sense(0.1, 0.25)
            faults.start("rail_drop_connection")
            await fly(lambda: drive.target_velocity_m_s == 0.0)
            drive.sense(0.12, 0.0)
            await fly(lambda: axis.problem() is None and drive.state is DriveState.READY)
            drive.trip(0x8611)
            await fly(lambda: axis.read().faults)  # type: ignore[union-attr]
            axis.reset_fault()
            await fly(lambda: drive.state is DriveState.SWITCH_ON_DISABLED)
    finally:
        await server.close()
    sent = [request for request, _ in drive.requests]
    shown = [dryve.decode_request(row.request) for row in EXCHANGES]
    assert sent[:12] == shown[:12]
    assert {request[1:] for request in sent} == {request[1:] for request in shown}


# Motion capture


def test_the_longest_sample_is_that_of_the_page() -> None:
    assert f"whole sample has at most {mocap_payload.MAX_BYTES:,} bytes" in PAGE


def test_the_mocap_payload_matches_the_page() -> None:
    [shown] = re.findall(r"```json\n(\{\"sequence\".*)\n```", PAGE)
    [coded] = re.findall(r"```text\n((?:[0-9a-f]+\n)+)```", PAGE)
    payload = bytes.fromhex(coded)
    assert payload.decode() == json.dumps(json.loads(shown), separators=(",", ":"))
    frame = mocap_payload.decode(payload, t_receive_ns=9)
    assert (frame.sequence, frame.t_capture_ns) == (7, 81234567890)
    assert frame.bodies[0] == Pose(0.1, 0.965, 0.0)
    assert [name for name, body in zip(BODY_NAMES, frame.bodies, strict=True) if not body.tracked] == ["link2"]
    assert mocap_payload.encode(7, 81234567890, frame.bodies) == payload
    assert all(math.isnan(value) for value in frame.bodies[2][:3])


@pytest.mark.parametrize(("payload", "why"), vectors("mocap-refused.csv"))
def test_invalid_mocap_payloads_are_rejected(payload: str, why: str) -> None:
    with pytest.raises(ValueError, match=re.escape(why)):
        mocap_payload.decode(payload.encode(), 0)
