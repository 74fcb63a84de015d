"""The robot of validation/outside: it shares no code with softarm and follows the page."""

import ast
import re
import sys
from pathlib import Path

import pytest

from softarm.schemas.robot import PHYSICS_RATE_HZ
from softarm.simulator.simulator import Simulator
from tests.drivers.wires_page import table, vectors
from validation import outside
from validation.outside import regulator
from validation.outside.body import Body
from validation.outside.drive import Drive
from validation.outside.robot import STEP_S, Robot

FOLDER = Path(outside.__file__).parent
OTHERS = {"numpy", "zenoh"}
UNRELIED = 1 << 10 | 1 << 12  # of 6041h: the page's vectors show the twin's


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.py")), ids=lambda file: file.name)
def test_the_outside_robot_imports_nothing_of_softarm(file: Path) -> None:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            named = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level < 2, "above its own folder"
            named = [] if node.level else [node.module or ""]
        else:
            continue
        assert {name.partition(".")[0] for name in named} <= sys.stdlib_module_names | OTHERS


def test_the_outside_regulator_follows_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regulator.os, "urandom", lambda _: 0xA1B2C3D4.to_bytes(4, "little"))
    firmware, said = regulator.Firmware(), vectors("regulator.csv")
    assert len(said) > 20
    for (_, _, time_us, _, line), (_, answer, _, _, answered) in zip(said[::2], said[1::2], strict=True):
        kpa = re.search(r"(\S+) kPa", answer)
        assert firmware.receive(bytes.fromhex(line), int(time_us), float(kpa[1]) if kpa else 0.0).hex() == answered


def without_unrelied(telegram: bytes) -> bytes:
    """A read statusword's bits that no client may rely on, taken out."""
    if telegram[9:10] == b"\0" and telegram[12:14] == b"\x60\x41" and len(telegram) == 21:
        word = int.from_bytes(telegram[19:], "little") & ~UNRELIED
        return telegram[:19] + word.to_bytes(2, "little")
    return telegram


def test_the_outside_drive_follows_the_page() -> None:
    """Up to the new connection: what a drive shows after it has braked by itself is its own."""
    drive, answered = Drive(0.0, keep=False), 0
    drive.step(STEP_S, 0.0, 0.0, 0.0)
    for says, *telegrams in vectors("rail.csv"):
        if says == "*a new connection*":
            break
        if motion := re.search(r"at (\S+) m, moving at (\S+) m/s", says):
            drive.step(STEP_S, 0.1, float(motion[1]), float(motion[2]))
        else:
            request, answer = bytes.fromhex(telegrams[0]), bytes.fromhex(telegrams[2])
            assert without_unrelied(drive.answer(request, 0.1)).hex() == without_unrelied(answer).hex(), says
            answered += 1
    assert answered == 28


@pytest.mark.parametrize("row", table("word", "in", "leads to", "and"), ids=lambda row: " ".join(row[:3]))
def test_each_controlword_leads_to_the_state_of_the_page(row: list[str]) -> None:
    word, after = (int(row[cell].split("h")[0], 16) for cell in (0, 2))
    for before in row[1].split(", "):
        drive = Drive(0.0, keep=False)
        drive.state = int(before.removesuffix("h"), 16)
        drive.answer(telegram(0x6040, word, 2), 0.0)
        assert drive.state == after


def telegram(index: int, value: int, size: int) -> bytes:
    """A write."""
    data = value.to_bytes(size, "little", signed=value < 0)
    head = bytes((0, 1, 0, 0, 0, 13 + size, 0, 0x2B, 0x0D, 1, 0, 0)) + index.to_bytes(2, "big")
    return head + bytes((0, 0, 0, 0, size)) + data


@pytest.mark.parametrize(
    ("angle_rad", "friction_n", "held_s", "rolled_mm"),
    [(1.0, 0.0, 0, 130), (1.0, 3.0, 0, 1), (1.5, 0.0, 0, 155), (1.5, 3.0, 0, 7), (1.5, 1.0, 0, 72), (1.5, 1.0, 3, 1)],
)
def test_a_cart_without_power_is_rolled_by_the_arm(
    angle_rad: float, friction_n: float, held_s: int, rolled_mm: int
) -> None:
    """docs/operate/safety.md says so."""
    body = Body(friction_n=friction_n)
    body.q[1:] = angle_rad
    for _ in range(round(held_s / STEP_S)):
        body.step(STEP_S, 0.0, 0.0, servo_ns_m=1e5)
    begin_m = body.cart_m
    robot = Robot(body, Drive(0.0, keep=False), bound_m=1.0)
    for step in range(2000):
        robot.step(step * STEP_S)
    assert abs(begin_m) < 0.001
    assert 1e3 * robot.max_cart_m == pytest.approx(rolled_mm, abs=1)


def test_the_outside_arm_agrees_with_the_simulator() -> None:
    """The same pressures on a cart that gives way: two formulations of one robot, tips within 2 mm."""
    body, simulator = Body(friction_n=0.0), Simulator(physics_rate_hz=PHYSICS_RATE_HZ)
    servo_ns_m = simulator.model.cart.velocity_gain_n_s_m
    apart_mm = []
    for tick in range(90):
        kpa = 16.0 if tick % 20 < 10 else 2.0
        for _ in range(33):
            body.step(STEP_S, kpa, -servo_ns_m * body.cart_m_s, servo_ns_m)
        simulator.step(0.0, kpa, 33 * STEP_S)
        y, z, _ = body.poses()["link5"]
        true_y, true_z = simulator.tip_m()[0].tolist()
        apart_mm.append(1e3 * ((y - true_y) ** 2 + (z - true_z) ** 2) ** 0.5)
    assert max(apart_mm) < 2.0
