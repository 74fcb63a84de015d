"""Trials of a body that shares no line with the simulator: its one fault is named with its size, and no other."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.diagnose import diagnose
from softarm.reality.parameters import Arm, RobotParameters
from softarm.reality.record import record
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from validation.blind.cases import PROGRAMME, with_trials
from validation.blind.imperfections import UNKNOWNS, draw_cause, draw_nuisances, given
from validation.blind.make import write_case

DEAD_TIME_S = 0.06
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return the trials of a robot by the dead time of its regulator and kind; each is flown once."""

    @cache
    def fly(dead_time_s, kinds=("pressure-multisine", "both")):
        sound = RobotParameters()
        robot = replace(sound, regulator=replace(sound.regulator, dead_time_s=dead_time_s))
        campaign = tmp_path_factory.mktemp("campaign")
        for seed, kind in enumerate(kinds):
            record(EXCITATIONS[kind].at, campaign / kind, 4.5, robot, seed, kind=kind)
        return read_all([campaign])

    return fly


@pytest.fixture(scope="module")
def diagnosed(recorded):
    """Return the answers in the order of the folder."""
    return cache(lambda *robot: diagnose(recorded(*robot), Model()))


def test_its_one_fault_is_named_and_its_size_lies_in_its_interval(diagnosed):
    found = diagnosed(DEAD_TIME_S, ("both",))
    verdict = found.verdict
    assert (verdict.verdict, verdict.where.stage) == ("named", "pressure")
    (effect,) = verdict.effects
    assert (effect.name, effect.equivalents) == ("pressure.dead_time", ())
    delay = effect.parameters["delay"]
    assert delay.low <= DEAD_TIME_S <= delay.high  # its tube delays the pressure as well
    assert delay.high - delay.low < 0.5 * DEAD_TIME_S
    assert effect.shrink.stage.low > 0.5
    assert verdict.gap.after["pressure"].value < 0.3 * verdict.gap.before["pressure"].value
    assert found.patched.effects["pressure.dead_time"]["delay"] == delay.value
    assert "rail.servo" in found.patched.effects  # that is what its drive is


@pytest.mark.prove
def test_where_nothing_is_wrong_nothing_is_named(diagnosed):
    found = diagnosed(0.0)
    assert (found.verdict.verdict, found.verdict.effects, found.patched) == ("none", (), None)


@pytest.mark.prove
def test_a_shuffled_campaign_gets_the_same_verdict(diagnosed, recorded):
    assert diagnose(recorded(DEAD_TIME_S)[::-1], Model()).verdict == diagnosed(DEAD_TIME_S).verdict


@pytest.mark.prove
def test_joint_friction_within_its_tolerance_is_named_if_the_noise_resolves_it(tmp_path):
    friction_nm = 0.003
    robot = RobotParameters(arm=Arm(friction_nm=friction_nm))
    for seed, kind in enumerate(PROGRAMME):
        record(EXCITATIONS[kind].at, tmp_path / kind, EXCITATIONS[kind].duration_s, robot, seed, kind=kind)
    (effect,) = diagnose(read_all([tmp_path]), Model()).verdict.effects
    torque = effect.parameters["torque"]
    assert effect.name == "arm.coulomb_friction"
    # The blind benchmark counts how many intervals hold the true size; this one ends at it.
    assert 0.0 <= torque.low < torque.value < torque.high < 2 * friction_nm


@pytest.mark.prove
@pytest.mark.parametrize(
    ("seed", "stiction", "further", "kind"),
    [(5, [8.6, 0.18], [], "unknown"), (16, [6.0, 0.15], ["rail.gain"], "incomplete")],
)
def test_a_stiction_is_no_dry_friction_and_a_cause_next_to_it_has_no_confidence(
    tmp_path, seed, stiction, further, kind
):
    random = np.random.default_rng(seed)
    robot = draw_nuisances(RobotParameters(), random)
    robot, _ = given(robot, UNKNOWNS["stribeck_stiction"][0], stiction)
    for name in further:
        robot, _ = draw_cause(robot, name, False, random)
    place = tmp_path / write_case(with_trials("stiction", "unknown", [], robot, random), tmp_path)
    verdict = diagnose(read_all([place]), Model()).verdict
    assert verdict.verdict == kind
    assert [(effect.name, effect.confidence) for effect in verdict.effects] == [(name, None) for name in further]
