"""The whole diagnosis on campaigns of known cause: that is named, nothing else, and nothing where nothing is wrong.

The robot is the seed's simulator at another rate behind noisy sensors. What it has and the nominal model lacks is
taken out of the model, what the model lacks beyond the seed's is put into the robot.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.robot.chain import FLOOR_M
from softarm.diagnosis.robot.experiments import NOTHING
from softarm.schemas.model import Model, seed_effects
from softarm.schemas.verdict import Verdict
from softarm.simulator.effects import validate
from softarm.simulator.simulator import Simulator
from validation.blind.shrink import measure_shrink

pytestmark = pytest.mark.slow
SEED = seed_effects()


@pytest.fixture(scope="module")
def diagnosed(campaign):
    """The diagnosis of a robot with `effects` by a nominal model without `out`; each is made once."""

    @cache
    def made(out, effects):
        model = Model(effects={name: values for name, values in SEED.items() if name not in out})
        return diagnose(campaign(effects) if out else campaign(effects, KINDS), model)

    return lambda out=(), effects=(): made(out, effects)


def _names(diagnosis):
    return sorted(effect.name for effect in diagnosis.verdict.effects)


KINDS = ("pressure-multisine", "rail-steps")  # to separate several missing effects takes more
PAYLOAD = (("arm.payload", (("mass", 0.04),)),)
THREE = ("pressure.lag", "rail.delay", "observation.finite_difference")
ONE_AT_A_TIME = [pytest.param((name,), marks=pytest.mark.prove, id=name) for name in SEED]


# Over 3 s: each is a whole diagnosis, made once for all tests below.
@pytest.mark.parametrize("out", [*ONE_AT_A_TIME, THREE], ids="+".join)
def test_only_the_missing_effect_of_the_seed_is_named(out, diagnosed):
    verdict = diagnosed(out).verdict
    assert _names(diagnosed(out)) == sorted(out)
    assert verdict.verdict == "named"
    for effect in verdict.effects:  # a limited force leaves 1.8 % more of the gap than a limited acceleration
        assert effect.equivalents == (("rail.force_limit",) if effect.name == "rail.acceleration_limit" else ())
    assert verdict.where.stage in {name.partition(".")[0] for name in out}


@pytest.mark.parametrize("out", [*ONE_AT_A_TIME[:3], THREE], ids="+".join)
def test_the_parameters_are_those_of_the_robot_and_are_not_calibrated(out, diagnosed):
    calibrated = {each.name for each in diagnosed(out).verdict.calibration}
    for effect in diagnosed(out).verdict.effects:
        for name, true in SEED[effect.name].items():
            estimate = effect.parameters[name]
            assert estimate.value == pytest.approx(true, rel=0.05), (effect.name, name)
            assert estimate.low <= estimate.value <= estimate.high
            assert f"{effect.name}.{name}" not in calibrated


@pytest.mark.parametrize("out", [*ONE_AT_A_TIME, THREE], ids="+".join)
def test_the_gap_of_its_stage_shrinks_and_the_shrink_is_held_out(out, diagnosed):
    verdict = diagnosed(out).verdict
    for effect in verdict.effects:
        stage, shrink = effect.name.partition(".")[0], effect.shrink.stage
        assert shrink.low <= shrink.value <= shrink.high <= 1
        assert shrink.value > 0.5
        assert verdict.gap.after[stage].value < 0.5 * verdict.gap.before[stage].value
    assert sum(verdict.where.share[stage] for stage in {name.partition(".")[0] for name in out}) > 0.8


def test_the_total_shrink_has_an_interval_around_its_share(diagnosed):
    diagnosis = diagnosed(THREE)
    gap = diagnosis.verdict.gap
    assert {"pressure", "rail", "chain"} <= diagnosis.total_shrink.keys()
    for stage, of in diagnosis.total_shrink.items():
        assert of.value == pytest.approx(1 - gap.after[stage].value / gap.before[stage].value, abs=2e-3), stage
        assert of.low < of.value < of.high or of.value == of.high == 1, stage
    assert diagnosis.held_out == "kind"


def test_the_shrink_of_a_single_trial_has_an_interval_over_its_blocks(campaign):
    model = Model(effects={name: values for name, values in SEED.items() if name != "pressure.lag"})
    diagnosis = diagnose(campaign(kinds=("pressure-multisine",)), model)
    (effect,) = diagnosis.verdict.effects
    assert effect.name == "pressure.lag"
    total = diagnosis.total_shrink
    for found in (effect.shrink.stage, effect.shrink.chain, total["pressure"], total["chain"]):
        assert found.high - found.low > 0.021  # what is added to every interval


def test_the_shrink_holds_on_excitations_that_no_fit_has_seen(diagnosed, campaign):
    diagnosis = diagnosed(THREE)
    fresh = measure_shrink(campaign(kinds=("sinusoid", "rail-chirp")), diagnosis.nominal, diagnosis.patched)
    fitted = {effect.name.partition(".")[0]: effect for effect in diagnosis.verdict.effects if effect.parameters}
    assert set(fitted) == {"pressure", "rail"}
    for stage, effect in fitted.items():
        assert fresh[stage] > 0.8
        assert effect.shrink.stage.value == pytest.approx(fresh[stage], abs=0.15)
    assert abs(fresh["mocap"]) < 0.05
    assert fresh["chain"] == pytest.approx(diagnosis.total_shrink["chain"].value, abs=0.15)


@pytest.mark.parametrize("out", [ONE_AT_A_TIME[0], ONE_AT_A_TIME[3], THREE], ids="+".join)
def test_the_patched_model_has_the_missing_effect(out, diagnosed):
    patched = diagnosed(out).patched
    assert set(patched.effects) == set(SEED)
    validate(patched.effects)
    assert Model.model_validate_json(patched.model_dump_json()) == patched
    robot = Simulator(patched)
    robot.step(0.2, 10.0, 0.5)
    assert np.isfinite(robot.tip_m()).all()


def test_a_payload_is_the_arm_s_though_the_rail_feels_it(diagnosed):
    diagnosis = diagnosed(effects=PAYLOAD)
    effect = diagnosis.verdict.effects[0]
    assert _names(diagnosis) == ["arm.payload"]
    assert effect.parameters["mass"].value == pytest.approx(0.04, rel=0.15)
    assert diagnosis.verdict.where.stage == "arm"
    assert diagnosis.verdict.where.share.get("rail", 0.0) < 0.1


@pytest.mark.prove
def test_a_zero_error_and_a_biased_sensor_are_inseparable_without_mocap(diagnosed, campaign):
    """The regulator's own reading is off by a constant: the set is reported, since the arm hardly reacts to 1.2 kPa."""
    trials = [
        replace(t, channels={k: v for k, v in t.channels.items() if k in ("command", "pressure", "rail")})
        for t in campaign((("pressure.sensor_bias", (("bias", 1.2),)),))
    ]
    verdict = diagnose(trials, Model()).verdict
    effect = verdict.effects[0]
    assert {effect.name, *effect.equivalents} == {"pressure.gain", "pressure.sensor_bias"}
    assert len(verdict.effects) == 1
    assert effect.confidence is not None  # eleven sets of known cause stand behind it
    assert diagnosed(("rail.delay",)).verdict.effects[0].confidence > 0.8
    assert any("arm is not observable" in warning for warning in verdict.warnings)
    assert verdict.next_experiment is not None
    assert {effect.name, *effect.equivalents} >= set(verdict.next_experiment.separates)
    assert len(verdict.next_experiment.separates) == 2
    assert verdict.next_experiment.excitation.startswith(NOTHING)


@pytest.fixture(scope="module")
def within_tolerance(campaign):
    """The diagnosis of a robot whose joints are off, each within its tolerance."""
    arm = Model().arm
    off = [s * (1 + x) for s, x in zip(arm.stiffness_nm_rad, (0.04, -0.03, 0.04, -0.04, 0.03), strict=True)]
    return diagnose(campaign((), KINDS, arm.model_copy(update={"stiffness_nm_rad": tuple(off)})), Model())


def test_a_verdict_survives_its_file(within_tolerance, diagnosed):
    for verdict in (within_tolerance.verdict, diagnosed(THREE).verdict):
        assert Verdict.model_validate_json(verdict.model_dump_json()) == verdict


def test_joints_within_tolerance_are_calibrated_and_not_named_and_the_floors_that_are_shown_hold_them(within_tolerance):
    """Single joints that are off add up at the tip: `none` means that every gap is within its floor."""
    verdict, gap = within_tolerance.verdict, within_tolerance.verdict.gap
    assert (verdict.verdict, verdict.effects, verdict.where.stage, verdict.next_experiment) == ("none", (), None, None)
    assert within_tolerance.patched is None
    assert all(gap.before[stage].value <= gap.floor[stage].value for stage in gap.before), gap
    assert gap.floor["chain"].value > FLOOR_M
    assert gap.floor["arm"].value > 1.9e-3  # 1.82e-3 if no joint is off
    found = {each.name: each.value for each in verdict.calibration if "[" in each.name}
    assert found["arm.stiffness_nm_rad[1]"] == pytest.approx(0.03, abs=0.005)
    assert max(map(abs, found.values())) < 0.04
