"""The sketch around the core, compiled and run on this computer with a Teensy's pins as variables."""

import configparser
import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from softarm.drivers.regulator.cobs import Deframer, frame
from softarm.drivers.regulator.teensy import Fault, Hello, RegulatorCommand, RegulatorState, Welcome, decode, encode

HERE = Path(__file__).parent
FIRMWARE = HERE.parents[1] / "firmware"
SKETCH = FIRMWARE / "regulator"
DECLARED = ("-x", "c++", "-include", "Arduino.h", f"-I{HERE / 'teensyduino'}", f"-I{SKETCH}")
RELAY, LED, DAC = 2, 13, 66  # of board.h, and A21
OUTPUT, HIGH, LOW = 1, 1, 0
VENT_COUNTS = round(0.1 / 0.4 / 3.3 * 4095)  # 5 V through the amplifier of board.h
_u8, _u32, _size, _int, _bytes = ctypes.c_uint8, ctypes.c_uint32, ctypes.c_size_t, ctypes.c_int, ctypes.c_char_p
FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "sketch_setup": (None,),
    "sketch_loop": (None,),
    "pin_mode": (_int, _u8),
    "pin_value": (_int, _u8),
    "pin_value_as_output": (_int, _u8),
    "clock_set": (None, _u32),
    "sensor_set": (None, _int),
    "line_room": (None, _int),
    "watchdog_time_ms": (_u32,),
    "watchdog_fed": (_u32,),
    "line_say": (None, _bytes, _size),
    "line_waiting": (_size,),
    "line_hear": (_size, _bytes),
}


def complaints(compiler: str, *arguments: str | Path, said: str | None = None) -> str:
    """Return the compiler's errors for a file of the sketch, or for a text in its place."""
    strict = ("-std=gnu++14", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-fsyntax-only")
    command = [compiler, *strict, *DECLARED, *map(str, arguments)]
    return subprocess.run(command, input=said, capture_output=True, text=True, timeout=60).stderr


@pytest.mark.parametrize("name", ["regulator.ino", "teensy36.cpp", "core.cpp", "frames.cpp"])
def test_the_sketch_compiles_against_teensyduinos_declarations(compiler: str, name: str) -> None:
    assert complaints(compiler, SKETCH / name) == ""


@pytest.mark.parametrize(
    ("right", "wrong", "why"),
    [
        ("kValve = kVppiMinus1To1Bar", "kValve = kVppi0To2Bar", "reach v_vent"),
        ("kAmplifier = {4.9F, 0.4F}", "kAmplifier = {5.2F, 0.4F}", "in reset would inflate the muscle"),
        ("kAmplifier = {4.9F, 0.4F}", "kAmplifier = {4.9F, 0.3F}", "does not reach 20 kPa"),
        ("0.0F, 10.0F, 5.0F}", "0.0F, 10.0F, 5.2F}", "v_vent is not the voltage of 0 kPa"),
        ("4.0F, 8.0F, 1.0F / 3.0F", "0.0F, 8.0F, 1.0F / 3.0F", "a broken wire or a short circuit would read as valid"),
        ("kWatchdogMs = 20U", "kWatchdogMs = 2000U", "a hung loop must vent"),
    ],
)
def test_an_inconsistent_bench_does_not_compile(compiler: str, right: str, wrong: str, why: str) -> None:
    text = (SKETCH / "board.h").read_text(encoding="utf-8")
    assert text.count(right) == 1
    assert why in complaints(compiler, "-", said=text.replace(right, wrong).replace("#pragma once", ""))


def test_the_core_needs_no_heap_and_no_board(compiler: str, tmp_path: Path) -> None:
    nm = shutil.which("nm")
    assert nm is not None, "nm comes with g++"
    needed, ours = set(), set()
    for name in ("core", "frames"):
        made = tmp_path / f"{name}.o"
        flags = ("-std=c++14", "-Os", "-fno-exceptions", "-fno-rtti", "-ffreestanding", "-fno-stack-protector")
        subprocess.run([compiler, *flags, "-c", str(SKETCH / f"{name}.cpp"), "-o", str(made)], check=True)
        symbols = subprocess.run([nm, str(made)], capture_output=True, text=True, check=True).stdout.splitlines()
        needed |= {line.split()[-1] for line in symbols if line.split()[-2] == "U"}
        ours |= {line.split()[-1] for line in symbols if line.split()[-2] == "T"}
    assert needed - ours <= {"memcpy", "memset", "_GLOBAL_OFFSET_TABLE_"}
    assert "Arduino.h" not in "".join((SKETCH / name).read_text() for name in ("core.h", "core.cpp", "board.h"))


def test_platformio_builds_the_existing_files() -> None:
    plan = configparser.ConfigParser()
    plan.read(FIRMWARE / "platformio.ini")
    assert dict(plan["env:teensy36"]) == {"platform": "teensy", "board": "teensy36", "framework": "arduino"}
    assert (FIRMWARE / plan["platformio"]["src_dir"] / "regulator.ino").is_file()
    named = re.findall(r"\+<([^>]+)>", plan["env:native"]["build_src_filter"])
    assert all(list(SKETCH.glob(name)) or list(FIRMWARE.glob(name.removeprefix("../"))) for name in named)


class Teensy:
    """Sketch with simulated pins, and a host at its line."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self.sketch, self.now_us, self.sequence, self.token = library, 0, 0, 0
        self._deframer = Deframer()

    def loop(self, milliseconds: float = 1.0) -> None:
        self.now_us += round(1000 * milliseconds)
        self.sketch.clock_set(self.now_us)
        self.sketch.sketch_loop()

    def say(self, message: Any) -> list[Any]:
        """Send a message and return the answers."""
        self.sequence += 1
        data = frame(encode(message, self.sequence, 0))
        self.sketch.line_say(data, len(data))
        self.loop()
        received = ctypes.create_string_buffer(4096)
        length = self.sketch.line_hear(received)
        return [decode(body)[0] for body in self._deframer.feed(received.raw[:length])]

    def command(self, armed: bool, kpa: float = 5.0) -> RegulatorState:
        [answer] = self.say(RegulatorCommand(self.token, 0.1, armed, kpa))
        assert isinstance(answer, RegulatorState)
        return answer

    def arm(self, kpa: float = 20.0) -> None:
        [welcome] = self.say(Hello())
        assert isinstance(welcome, Welcome)
        self.token = welcome.token
        for _ in range(25):
            self.command(False)
            self.loop(50)
        assert self.command(True, kpa).armed


@pytest.fixture(scope="module")
def built(build: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    sketch = tmp_path_factory.mktemp("sketch") / "sketch.cpp"
    sketch.write_text(f'#include "{SKETCH / "regulator.ino"}"\n')
    made: Path = build("sketch.so", "-shared", "-fPIC", *DECLARED[4:], sketch, HERE / "pins.cpp")
    return made


@pytest.fixture
def teensy(built: Path, load: Any, tmp_path: Path) -> Teensy:
    """Start a new copy of the sketch, because a copy has one set of pins."""
    library = load(Path(shutil.copy(built, tmp_path)), FUNCTIONS)
    library.sensor_set(round(5.0 / 3 / 3.3 * 4095))
    library.sketch_setup()
    return Teensy(library)


def test_the_sketch_starts_vented_with_an_open_relay_and_a_watchdog(teensy: Teensy) -> None:
    sketch = teensy.sketch
    assert (sketch.pin_mode(RELAY), sketch.pin_value_as_output(RELAY)) == (OUTPUT, LOW)
    assert (sketch.pin_value(RELAY), sketch.pin_value(DAC), sketch.pin_value(LED)) == (LOW, VENT_COUNTS, LOW)
    assert sketch.watchdog_time_ms() == 20
    for loops in range(1, 5):
        teensy.loop()
        assert sketch.watchdog_fed() == loops


def test_the_pins_follow_the_core_and_silence_resets_them(teensy: Teensy) -> None:
    sketch = teensy.sketch
    teensy.arm(20.0)
    twenty = round((6.0 - 4.9) / 0.4 / 3.3 * 4095)
    assert (sketch.pin_value(RELAY), sketch.pin_value(DAC), sketch.pin_value(LED)) == (HIGH, twenty, HIGH)
    teensy.loop(99)
    assert sketch.pin_value(DAC) == twenty
    teensy.loop(2)
    assert (sketch.pin_value(RELAY), sketch.pin_value(DAC), sketch.pin_value(LED)) == (LOW, VENT_COUNTS, LOW)


@pytest.mark.parametrize(
    ("volts", "kpa", "valid"), [(5.0, 0.0, True), (6.0, 20.0, True), (0.0, -100.0, False), (9.0, 80.0, False)]
)
def test_the_sensor_is_read_through_its_divider(teensy: Teensy, volts: float, kpa: float, valid: bool) -> None:
    teensy.arm()
    teensy.sketch.sensor_set(round(volts / 3 / 3.3 * 4095))
    state = teensy.command(True)
    assert state.pressure_kpa == pytest.approx(kpa, abs=0.05)  # half a count
    assert state.faults == (Fault(0) if valid else Fault.SENSOR)


def test_a_host_that_does_not_read_delays_nothing(teensy: Teensy) -> None:
    teensy.arm()
    teensy.sketch.line_room(24)  # a state takes 25
    for _ in range(3):
        assert teensy.say(RegulatorCommand(teensy.token, 0.1, True, 5.0)) == []
    teensy.loop(101)
    assert teensy.sketch.pin_value(RELAY) == LOW
    teensy.sketch.line_room(64)
    assert teensy.command(False).accepted_sequence == teensy.sequence


def test_the_outputs_are_updated_on_a_flooded_line(teensy: Teensy) -> None:
    teensy.arm()
    teensy.sketch.line_say(b"\x07" * 1000, 1000)
    teensy.loop(101)
    assert teensy.sketch.line_waiting() == 1000 - 64
    assert teensy.sketch.pin_value(DAC) == VENT_COUNTS


# The mapping


@pytest.mark.parametrize(("vacuum", "vent", "low", "high"), [(True, 5.0, 4.965, 6.0), (False, 0.0, 0.0, 1.0)])
def test_each_valve_receives_its_own_voltage_also_to_vent(
    library: ctypes.CDLL, vacuum: bool, vent: float, low: float, high: float
) -> None:
    for armed, kpa, volts in ((True, 0.0, vent), (True, -0.7, low), (True, 20.0, high), (False, 20.0, vent)):
        assert library.board_output(vacuum, armed, kpa) / 4095 * 10 == pytest.approx(volts, abs=10 / 4095)


def test_no_count_of_the_dac_exceeds_the_range_of_board_h(library: ctypes.CDLL) -> None:
    assert library.board_own_volts(0) == pytest.approx(4.9)
    assert library.board_own_volts(4095) == pytest.approx(6.22)
    assert [library.board_own_output(True, kpa) for kpa in (-1e9, 1e9)] == [0, 4095]
