"""The firmware's core, built for this computer, as a replacement of the twin's device."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from softarm.drivers.regulator.teensy import Fault
from tests.drivers import conftest as _benches

HERE = Path(__file__).parent
SOURCES = HERE.parents[1] / "firmware" / "regulator"

# Clocks that stand still, and waiting with an end, as the drivers' tests have them.
anyio_backend, clock, until, running = _benches.anyio_backend, _benches.clock, _benches.until, _benches._running

STRICT = ("-std=c++14", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror")
UNDEFINED = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
DRAW = ctypes.CFUNCTYPE(ctypes.c_uint32)
_u8, _u16, _u32 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32
_core, _size, _bool, _float = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_bool, ctypes.c_float
# Result type, then argument types.
FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "core_new": (_core, DRAW),
    "core_delete": (None, _core),
    "core_watch": (None, _core, _u32),
    "core_take": (_size, _core, ctypes.c_char_p, _size, _u32, _float, _bool, ctypes.c_char_p),
    "core_armed": (_bool, _core),
    "core_relay_closed": (_bool, _core),
    "core_set_point_kpa": (_float, _core),
    "core_accepted_sequence": (_u32, _core),
    "core_faults": (_u16, _core),
    "frames_crc16": (_u16, ctypes.c_char_p, _size),
    "frames_stuff": (_size, ctypes.c_char_p, _size, ctypes.c_char_p),
    "frames_unstuff": (_size, ctypes.c_char_p, _size),
    "deframer_new": (_core,),
    "deframer_delete": (None, _core),
    "deframer_take": (_size, _core, _u8),
    "deframer_body": (ctypes.POINTER(_u8), _core),
    "board_output": (_u16, _bool, _bool, _float),
    "board_own_output": (_u16, _bool, _float),
    "board_own_volts": (_float, _u16),
    "board_reading_kpa": (_float, _u16),
    "board_reading_in_span": (_bool, _u16),
}


@pytest.fixture(scope="session")
def compiler() -> str:
    """Return the C++ compiler, or skip the test without one."""
    found = shutil.which("g++")
    if found is None:
        pytest.skip("there is no g++: the firmware is not tried (apt-get install g++)")
    return found


@pytest.fixture(scope="session")
def build(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Compile sources and the core into one file that aborts on undefined behaviour."""

    def built(name: str, *arguments: str | Path) -> Path:
        path = tmp_path_factory.mktemp("firmware") / name
        sources = [*arguments, SOURCES / "core.cpp", SOURCES / "frames.cpp"]
        command = [compiler, *STRICT, "-O1", "-g", "-o", str(path), *map(str, sources)]
        if subprocess.run([*command, *UNDEFINED], capture_output=True).returncode:
            subprocess.run(command, check=True)
        return path

    return built


@pytest.fixture(scope="session")
def load() -> Callable[[Path, dict[str, tuple[Any, ...]]], ctypes.CDLL]:
    """Load a shared library and declare the types of its functions."""

    def loaded(path: Path, functions: dict[str, tuple[Any, ...]]) -> ctypes.CDLL:
        library = ctypes.CDLL(str(path))
        for name, (returns, *takes) in functions.items():
            function = getattr(library, name)
            function.restype, function.argtypes = returns, takes
        return library

    return loaded


@pytest.fixture(scope="session")
def library(build: Callable[..., Path], load: Callable[..., ctypes.CDLL]) -> ctypes.CDLL:
    """Build and load the core."""
    return load(build("core.so", "-shared", "-fPIC", HERE / "host.cpp"), FUNCTIONS)


class Board:
    """Board with the interface of `softarm.drivers.twin.teensy.TeensyDevice`, and a relay."""

    def __init__(self, library: ctypes.CDLL, new_token: Callable[[], int]) -> None:
        self._library = library
        # ctypes needs the callback alive.
        self._draw = DRAW(new_token)
        self._core = library.core_new(self._draw)

    def close(self) -> None:
        self._library.core_delete(self._core)

    def watch(self, now_ns: int) -> None:
        self._library.core_watch(self._core, now_ns // 1000 % 2**32)

    def receive(self, data: bytes, now_ns: int, pressure_kpa: float, in_span: bool = True) -> bytes:
        self.watch(now_ns)
        answers = ctypes.create_string_buffer(25 * (data.count(0) + 1))
        now_us = now_ns // 1000 % 2**32
        said = self._library.core_take(self._core, data, len(data), now_us, pressure_kpa, in_span, answers)
        return answers.raw[:said]

    armed = property(lambda self: self._library.core_armed(self._core))
    relay_closed = property(lambda self: self._library.core_relay_closed(self._core))
    set_point_kpa = property(lambda self: self._library.core_set_point_kpa(self._core))
    accepted_sequence = property(lambda self: self._library.core_accepted_sequence(self._core))
    faults = property(lambda self: Fault(self._library.core_faults(self._core)))


@pytest.fixture
def make_board(library: ctypes.CDLL) -> Iterator[Callable[..., Board]]:
    """Return a function that makes boards with the firmware, started at time zero."""
    made: list[Board] = []

    def make(new_token: Callable[[], int] = lambda: 0xA1B2C3D4) -> Board:
        made.append(Board(library, new_token))
        return made[-1]

    yield make
    for board in made:
        board.close()
