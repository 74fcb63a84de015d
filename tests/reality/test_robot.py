"""The independent robot: its parameters and their checks, its time, commands and readings."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest

from softarm.common.quantity import UNITS
from softarm.reality.parameters import GROUPS, Mocap, Rail, RobotParameters, of, of_model, table
from softarm.reality.robot import Robot, UnstableError
from softarm.schemas.model import Arm, Cart, Model
from softarm.schemas.model import Arm as ModelArm

FIELDS = [(group, field) for group in GROUPS for field in dataclasses.fields(group)]
NAMES = [f"{group.__name__}.{field.name}" for group, field in FIELDS]


def test_every_quantity_declares_itself_and_rejects_a_value_below_its_range() -> None:
    for group, field in FIELDS:
        declared = of(group)[field.name]
        assert declared.takes(field.default)
        assert declared.unit in UNITS
        assert len(declared.meaning) > 3
        with pytest.raises(ValueError, match=rf"{group.__name__}\.{field.name} is .*; allowed "):
            group(**{field.name: type(field.default)(declared.low - 1)})
    with pytest.raises(ValueError, match=r"Mocap.loose_link is 2.5; allowed 0 to 5, a whole number"):
        Mocap(loose_link=2.5)  # type: ignore[arg-type]


def test_the_nominal_robot_equals_the_model() -> None:
    assert of_model(Model()) == RobotParameters()


def test_a_model_without_effects_has_neither_lag_nor_delay() -> None:
    parameters = of_model(Model(effects={}))
    assert (parameters.regulator.inflate_s, parameters.regulator.deflate_s, parameters.rail.delay_s) == (0, 0, 0)
    assert parameters.rail.acceleration_m_s2 == 40


def test_an_arm_of_other_than_five_links_is_refused() -> None:
    short = ModelArm(**{name: value[:2] for name, value in ModelArm() if isinstance(value, tuple)})
    with pytest.raises(ValueError, match="body has 2 links; a mocap frame carries 5"):
        RobotParameters(body=short)


def test_effects_that_the_robot_does_not_take_are_refused() -> None:
    with pytest.raises(
        ValueError, match=r"does not take the model's arm\.payload; allowed are pressure\.lag, .* --fault"
    ):
        of_model(Model(effects={"arm.payload": {"mass": 0.1}}))


def test_a_cart_lighter_than_its_motor_has_no_backlash() -> None:
    light = Cart(mass_kg=0.1)
    with pytest.raises(ValueError, match=r"cart.mass_kg is 0.1; with backlash the motor is 0.1 kg of it: give more"):
        RobotParameters(cart=light, rail=Rail(backlash_m=0.001))
    Robot(RobotParameters(cart=light))


def test_the_table_for_the_page_has_a_row_for_every_parameter() -> None:
    rows = table(*GROUPS).splitlines()[2:]
    assert [row.split("`")[1] for row in rows] == NAMES


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda: Robot(cart_position_m=0.4), r"cart_position_m is 0.4; the travel is \+-0.3 m: start within it"),
        (lambda: Robot(seed=-1), "seed is -1; give a whole number from 0"),
        (lambda: Robot().command(0.0, math.nan, 1.0), "the command is nan m/s, 1.0 kPa; give two finite numbers"),
        (lambda: Robot().command(math.inf, 0.0, 1.0), "t_s is inf; the robot is at 0.000000 s: give 0.000000 or later"),
        (lambda: Robot().advance(math.inf), "t_s is inf; give a finite number of seconds"),
    ],
)
def test_invalid_arguments_are_rejected_with_a_reason(use: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        use()


@pytest.mark.parametrize(
    "parameters",
    [
        RobotParameters(body=Arm(stiffness_nm_rad=(1e5,) * 5)),
        RobotParameters(cart=Cart(mass_kg=0.05), rail=Rail(velocity_gain_n_s_m=300.0)),
    ],
)
def test_an_unstable_body_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parameters: RobotParameters
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file here
    robot = Robot(parameters)
    robot.command(0.0, 0.3, 10.0)
    with pytest.raises(UnstableError, match=r"state became NaN or infinite at .* s; use weaker"):
        robot.advance(1.0)


def test_a_command_in_the_past_is_rejected() -> None:
    robot = Robot()
    robot.command(0.5, 0.1, 1.0)
    with pytest.raises(ValueError, match=r"give 0.500000 or later"):
        robot.command(0.4, 0.1, 1.0)
    robot.advance(1.0)
    with pytest.raises(ValueError, match=r"the robot is at 1.000000 s"):
        robot.command(0.9, 0.1, 1.0)


def test_measurements_come_once_and_do_not_depend_on_the_strides() -> None:
    def measured(strides: int) -> list[Any]:
        robot, frames, gauge, encoder = Robot(seed=2), [], [], []
        robot.command(0.0, 0.4, 12.0)
        robot.command(0.3, -0.4, 3.0)
        for stride in range(strides):
            robot.advance((stride + 1) / strides)
            frames += robot.mocap()
            gauge += robot.pressure()
            encoder += robot.rail()
        return [frames, gauge, encoder]

    whole = measured(1)
    assert [len(stream) for stream in whole] == [120, 120, 120]
    assert measured(7) == whole
    assert measured(1000) == whole
