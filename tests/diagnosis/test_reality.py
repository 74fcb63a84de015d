"""The diagnosis on the independent robot: what was put into a body that shares no line with the simulator is named."""

from dataclasses import replace

import pytest

from softarm.diagnosis.data import folder
from softarm.diagnosis.diagnose import diagnose
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import record
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model

CAMPAIGN = ("seed", "pressure-multisine", "both")
LENGTH_S, DEAD_TIME_S = 8.0, 0.06
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The diagnosis of an independent robot whose regulator has a dead time, by the seed's simulator."""
    robot = RobotParameters()
    late = replace(robot, regulator=replace(robot.regulator, dead_time_s=DEAD_TIME_S))
    place = tmp_path_factory.mktemp("campaign")
    trials = []
    for seed, name in enumerate(CAMPAIGN):
        excitation = EXCITATIONS[name]
        record(excitation.at, place / name, LENGTH_S, late, seed, kind=name)
        trials.append(folder.read(place / name))
    return diagnose(trials, Model())


def test_the_one_effect_is_named_and_nothing_else(found):
    assert found.verdict.verdict == "named"
    assert [effect.name for effect in found.verdict.effects] == ["pressure.dead_time"]
    assert found.verdict.where.stage == "pressure"


def test_the_effect_has_its_size_and_shrink(found):
    (effect,) = found.verdict.effects
    whole_s = DEAD_TIME_S + RobotParameters().regulator.tube_s  # the simulator has no tube
    assert effect.parameters["delay"].value == pytest.approx(whole_s, abs=0.005)
    assert effect.shrink.stage.value > 0.8
    assert found.patched.effects["pressure.dead_time"]["delay"] == effect.parameters["delay"].value
