"""The daemon's driver and the firmware's core in a program of its own, connected by a real pseudo-terminal."""

import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from softarm.drivers.regulator.driver import TeensyRegulator
from softarm.schemas.config import SerialRegulator

pytestmark = pytest.mark.anyio
NATIVE = Path(__file__).parents[2] / "firmware" / "native" / "main.cpp"


class Program:
    """Process of firmware/native: a board on this computer, with its own clock."""

    def __init__(self, path: Path) -> None:
        self._process = subprocess.Popen([path], stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self._output = self._process.stdout
        self.port = self._output.readline().removeprefix("drivers.regulator.port: ").strip()

    def end(self) -> list[str]:
        """Return the changes of the valve so far, without the relay."""
        self._process.terminate()
        changes = [", ".join(line.split(", ")[:2]) for line in self._output.read().splitlines()]
        self._process.wait()
        self._output.close()
        return [state for state, before in zip(changes, ["", *changes], strict=False) if state != before]


@pytest.fixture
def program(build: Any) -> Iterator[Program]:
    program = Program(build("native", NATIVE))
    yield program
    with contextlib.suppress(ValueError):
        program.end()


async def test_the_native_program_acts_as_a_board(program: Program, until: Any, running: Any) -> None:
    regulator = TeensyRegulator(SerialRegulator(port=program.port, time_to_live_s=0.25))

    async with running(regulator):
        await until(lambda: regulator.read() is not None, lambda: regulator.write(False, 0.0))
        await until(lambda: regulator.read().armed, lambda: regulator.write(True, 7.5))  # type: ignore[union-attr]
    assert program.end() == ["disarmed, 0.00 kPa", "armed, 7.50 kPa", "disarmed, 0.00 kPa"]


@pytest.mark.prove
@pytest.mark.realtime
def test_the_steps_cover_the_valves_range(program: Program) -> None:
    """Run firmware/steps.py, in real time because of the time to live."""
    steps = (NATIVE.parents[1] / "steps.py").read_text(encoding="utf-8")
    steps, shorter = re.subn(
        r"(?m)^SECONDS = .*", "SECONDS = 0.3", re.sub(r'(?m)^PORT = ".*"', f'PORT = "{program.port}"', steps)
    )
    assert shorter == 1
    done = subprocess.run([sys.executable, "-c", steps], capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    assert re.findall(r"asked for\s+(\S+) kPa:\s+(\S+) kPa, armed: (\w+)", done.stdout) == [
        ("0.0", "0.00", "False"),
        *((kpa, f"{float(kpa):.2f}", "True") for kpa in ("0.0", "5.0", "10.0", "15.0", "20.0", "-0.7")),
    ]
    vented = "disarmed, 0.00 kPa"
    armed = [f"armed, {kpa:.2f} kPa" for kpa in (0, 5, 10, 15, 20, -0.7)]
    assert program.end() == [vented, *armed, vented]
