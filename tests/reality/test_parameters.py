"""Parameters of the independent robot, and their table in the documentation."""

import dataclasses

import pytest

from softarm.common.quantity import UNITS
from softarm.reality.parameters import GROUPS, Mocap, RobotParameters, of_model
from softarm.reality.quantities import of, table
from softarm.schemas.model import Arm as ModelArm
from softarm.schemas.model import Model

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


def test_the_table_for_the_page_has_a_row_for_every_parameter() -> None:
    rows = table(*GROUPS).splitlines()[2:]
    assert [row.split("`")[1] for row in rows] == NAMES
