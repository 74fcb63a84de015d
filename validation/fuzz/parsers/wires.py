"""Data of devices: the regulator's serial line, the drive's telegrams, motion-capture frames, twin faults."""

import contextlib
import json
import socket
from random import Random
from typing import Any

from softarm.drivers.mocap import payload
from softarm.drivers.rail import dryve, pair
from softarm.drivers.rail.dryve_link import EXCHANGE_ERRORS, DryveLink
from softarm.drivers.regulator import teensy
from softarm.drivers.regulator.cobs import frame
from softarm.drivers.regulator.driver import Conversation
from softarm.drivers.twin.faults import Faults
from softarm.schemas.messages import BODY_NAMES, Pose
from validation.fuzz import mutate
from validation.fuzz.parsers.base import Parser, parser

_MESSAGES: tuple[teensy.Message, ...] = (
    teensy.Hello(),
    teensy.Welcome(0x12345678),
    teensy.RegulatorCommand(0x12345678, 0.1, True, 12.5),
    teensy.RegulatorState(7, True, teensy.Fault(0), 12.25),
    teensy.RegulatorState(8, False, teensy.Fault.TIME_TO_LIVE | teensy.Fault.TOKEN, -0.5),
)


@parser("regulator.stream")
def _regulator() -> Parser:
    def draw(random: Random) -> list[bytes]:
        """A stream in pieces: frames around bodies that are right, or wrong but framed, and noise."""
        bodies = [teensy.encode(each, random.choice((1, 2, 2**32 - 1)), 5) for each in _MESSAGES]
        stream = b""
        for _ in range(random.randint(1, 12)):
            match random.randrange(3):
                case 0:
                    stream += frame(random.choice(bodies))
                case 1:
                    stream += frame(mutate.of_bytes(random, bodies) or b"\1")
                case _:
                    stream += mutate.of_bytes(random, [frame(each) for each in bodies])
        cuts = sorted(random.randint(0, len(stream)) for _ in range(random.randint(0, 6)))
        return [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]

    def take(pieces: list[bytes]) -> None:
        talk = Conversation(0.1)
        for number, piece in enumerate(pieces):
            talk.greeting(number)
            state = talk.receive(piece)
            assert state is None or all(state.faults.sentences())
            talk.command(True, 5.0, number)
            assert len(talk._deframer._pending) <= 256

    return Parser(draw, take, ())


@parser("regulator.message")
def _message() -> Parser:
    bodies = [teensy.encode(each, 7, 5) for each in _MESSAGES]
    return Parser(lambda random: mutate.of_bytes(random, bodies), teensy.decode, (ValueError,))


_ENTRIES = (dryve.STATUSWORD, dryve.POSITION, dryve.VELOCITY, dryve.MODE_DISPLAY, dryve.ACCELERATION, dryve.CONTROLWORD)


def _answers() -> list[bytes]:
    asked = [dryve.ModbusRequest(7, entry.index, entry.sub, entry.size) for entry in _ENTRIES]
    values = [dryve.encode_value(request, bytes(range(request.count))) for request in asked]
    done = [dryve.encode_acknowledgement(request) for request in asked]
    return [*values, *done, dryve.encode_exception(7, 6), dryve.encode_abort(7, 0x06090030)]


@parser("rail.answer")
def _answer() -> Parser:
    answers = _answers()

    def draw(random: Random) -> tuple[bytes, dryve.Entry, bool]:
        return mutate.of_bytes(random, answers), random.choice(_ENTRIES), random.random() < 0.4

    def take(case: tuple[bytes, dryve.Entry, bool]) -> None:
        telegram, entry, write = case
        value = dryve.decode_answer(telegram, 7, entry, write)
        low = -(2 ** (8 * entry.size - 1)) if entry.signed else 0
        assert low <= value < 2 ** (8 * entry.size)

    return Parser(draw, take, (dryve.DryveRefusal, dryve.DryveMismatch))


@parser("rail.request")
def _request() -> Parser:
    requests = [dryve.encode_request(7, entry) for entry in _ENTRIES]
    requests += [dryve.encode_request(9, dryve.TARGET_VELOCITY, -5), dryve.encode_request(9, dryve.CONTROLWORD, 15)]
    return Parser(lambda random: mutate.of_bytes(random, requests), dryve.decode_request, (ValueError,))


@parser("rail.link")
def _link() -> Parser:
    """Return the parser of the rail's connection to a drive that sends anything and hangs up."""
    answers = [dryve.encode_acknowledgement(dryve.ModbusRequest(n, 0x60FF, 0, 4)) for n in (1, 2)] + _answers()

    def draw(random: Random) -> bytes:
        return b"".join(mutate.of_bytes(random, answers) for _ in range(random.randint(1, 20)))[:100_000]

    def take(said: bytes) -> None:
        ours, theirs = socket.socketpair()
        with ours, theirs:
            theirs.sendall(said)
            theirs.shutdown(socket.SHUT_WR)
            link = DryveLink(ours, lambda line, event, left_s: True, 0.5)
            for number in range(100):
                try:
                    link.write(dryve.TARGET_VELOCITY, 5) if number % 3 == 0 else link.read(dryve.POSITION)
                except EXCHANGE_ERRORS:
                    continue
            link.close()

    return Parser(draw, take, (EOFError, OSError))


@parser("rail.packets")
def _packets() -> Parser:
    """Return the parser of messages between the daemon and the rail's process."""
    reading = pair.Reading(5, 0.1, -0.2, True, True, 1, 2, ("E11 following error",))
    packets = [
        pair.encode_set_point(pair.SetPoint(7, 5, True, 0.5)),
        pair.encode_report(pair.Report(7, False, reading, "no answer")),
    ]

    def take(packet: bytes) -> None:
        for decode in (pair.decode_set_point, pair.decode_report):
            with contextlib.suppress(ValueError):
                decode(packet)

    return Parser(lambda random: mutate.of_bytes(random, packets), take, ())


@parser("mocap.payload")
def _mocap() -> Parser:
    bodies = [Pose(0.01 * i, 0.9, -0.1) if i != 3 else payload.LOST for i in range(len(BODY_NAMES))]
    encoded = payload.encode(7, 81_234_567_890, bodies)
    tree = json.loads(encoded)

    def draw(random: Random) -> bytes:
        if random.random() < 0.3:
            return mutate.of_bytes(random, [encoded])
        if random.random() < 0.1:
            return b"[" * random.randint(1, payload.MAX_BYTES)
        return mutate.to_json(random, mutate.of_tree(random, tree))

    return Parser(draw, lambda data: payload.decode(data[: payload.MAX_BYTES], 5), (ValueError,))


@parser("twin.fault")
def _fault() -> Parser:
    trees: list[Any] = [
        {"fault": "mocap_drop_body", "body": "link3", "seconds": 0.5},
        {"fault": "rail_fault"},
        {"fault": "clear"},
        {"fault": "serial_silence", "seconds": 2},
    ]

    def draw(random: Random) -> bytes:
        return mutate.to_json(random, mutate.of_tree(random, random.choice(trees)))

    return Parser(draw, lambda data: Faults(lambda: 0).apply(data), (ValueError,))
