"""Twin with the independent robot as its body, behind the same interfaces."""

import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from softarm.drivers.bodies.independent import IndependentBody
from softarm.drivers.mocap.driver import ZenohMocapSource
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.drivers.regulator.driver import TeensyRegulator
from softarm.drivers.twin.main import Twin
from softarm.schemas.config import Config, Drivers, DryveRail, Mocap, SerialRegulator


@pytest.fixture
def config(tmp_path: Path) -> Config:
    with socket.socket() as one, socket.socket() as two:
        one.bind(("127.0.0.1", 0))
        two.bind(("127.0.0.1", 0))
        mocap_port, rail_port = one.getsockname()[1], two.getsockname()[1]
    return Config(
        drivers=Drivers(
            mocap=Mocap(endpoint=f"tcp/127.0.0.1:{mocap_port}"),
            regulator=SerialRegulator(port=str(tmp_path / "teensy"), time_to_live_s=0.25),
            rail=DryveRail(host="127.0.0.1", port=rail_port, timeout_s=1.0),
        )
    )


def test_the_daemons_drivers_move_the_independent_robot(config: Config, run: Any, until: Any, running: Any) -> None:
    async def play() -> None:
        mocap, regulator = ZenohMocapSource(config.drivers.mocap), TeensyRegulator(config.drivers.regulator)
        rail = DryveRailAxis(config.drivers.rail)
        frames: list[Any] = []
        command = [False, 0.0, 0.0]

        def each() -> None:
            regulator.write(bool(command[0]), command[2])
            rail.write(bool(command[0]), command[1])
            frames.extend(mocap.read(mocap.clock()))

        async with Twin(config, body=IndependentBody()) as twin, running(mocap, regulator, rail):
            await until(lambda: not any((mocap.problem(), regulator.problem(), rail.problem())), each)
            await until(lambda: regulator.read() and rail.read() and frames, each)
            start = frames[-1].bodies
            command[0] = True
            await until(lambda: rail.read().enabled and regulator.read().armed, each)
            command[1:] = -0.3, 15.0
            await until(lambda: regulator.read().pressure_kpa > 5.0 and frames[-1].bodies[0].y_m < -0.03, each)
            assert frames[-1].bodies[5].y_m < start[5].y_m
            assert rail.read().position_m == pytest.approx(twin.state.cart_position_m, abs=0.05)
            command[:] = False, 0.0, 0.0
            await until(lambda: twin.state.vented and abs(twin.state.cart_velocity_m_s) < 0.05, each)
            assert twin.state.crashes == 0

    run(play())


def test_the_ordinary_twin_needs_no_mujoco() -> None:
    program = (
        "import sys, softarm.cli.operate.twin, softarm.drivers.twin.main;"
        "print('mujoco' in sys.modules, 'softarm.reality' in sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (answer.stdout.strip(), answer.returncode) == ("False False", 0), answer.stderr
