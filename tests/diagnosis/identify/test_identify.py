"""Identification finds the parameters of a bench that it has not seen, and says how sure it is."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.diagnosis.data import folder
from softarm.diagnosis.data.trials import Series, TrialError
from softarm.diagnosis.identify import bench, motion, plots, regression
from softarm.diagnosis.identify.identify import TIP_Y_M, TIP_Z_M, TORQUE_RMSE_NM, identify
from softarm.reality.parameters import Arm as IndependentArm
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import record as fly
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def truth():
    """A robot whose K, D, b and offset are 10 to 30 % away from the seed's."""
    model = Model()
    draw = np.random.default_rng(7)
    factors = 1 + draw.choice((-1, 1), 20) * draw.uniform(0.1, 0.3, 20)
    return model.model_copy(update={"arm": bench.from_column(model.arm, bench.to_columns(model.arm) * factors)})


@pytest.fixture(scope="module")
def result(truth, record):
    trials = record("both", truth, seed=1, length_s=4.0), record("rail-chirp", truth, seed=2, length_s=6.0)
    return identify(Model(), trials, (record("sinusoid", truth, seed=3, length_s=3.0),))


def test_only_the_refinement_finds_stiffness_damping_and_gain_within_five_percent(result, truth):
    """The regression alone misses them: sensor noise in the angles, the filter."""
    fitted, true = result.refinement, bench.to_columns(truth.arm)
    first, errors = (np.abs(each.column / true - 1)[:15] for each in (result.regression, fitted))
    assert errors.max() < 0.05 < first.max()
    assert fitted.converged
    assert fitted.rmse_m < 0.75 * fitted.rmse_before_m
    assert np.median((fitted.high - fitted.low)[:15] / 2 / true[:15]) < 0.05


def test_trials_of_one_name_have_a_picture_each(result, tmp_path):
    alike = replace(result, trials=("seed", "seed"))
    written = [path.name for path in plots.save(alike, tmp_path)]
    assert written == ["torques-seed.png", "torques-seed (2).png", "check-sinusoid.png", "parameters.png"]


def test_torques_and_the_unseen_sinusoid_are_within_what_the_paper_reports(result):
    assert result.regression.rmse_nm <= TORQUE_RMSE_NM
    assert result.torque_rmse_nm <= TORQUE_RMSE_NM
    (check,) = result.checks
    assert check.rmse_m[0] < TIP_Y_M / 10
    assert check.rmse_m[1] < TIP_Z_M / 10
    assert np.ptp(check.measured_m[:, 0]) > 0.05  # there was something to follow


@pytest.mark.prove
def test_two_runs_agree_to_the_last_bit_and_the_order_of_trials_does_not_count(record):
    a, b = record("pressure-multisine"), record("rail-multisine")
    columns = [identify(Model(), trials).refinement for trials in ((a, b), (b, a))]
    np.testing.assert_array_equal(columns[0].column, columns[1].column)
    np.testing.assert_array_equal(columns[0].low, columns[1].low)


def test_inverse_dynamics_balances_the_springs(record):
    """Independent of the kernel: torques of an exact motion are -K theta - D theta' - b p - offset."""
    model = Model()
    smooth = motion.derivatives(motion.measured(record("both", noise=0.0), 5))
    torque = regression.joint_torques(model.arm, smooth)
    expected = regression.modelled(bench.to_columns(model.arm), smooth)
    assert np.sqrt(np.mean((torque - expected) ** 2)) < 0.02 * np.std(expected)


def test_a_payload_that_the_model_lacks_is_noticed_on_the_check(record):
    arm = Model().arm
    heavy = Model().model_copy(update={"arm": arm.model_copy(update={"link_mass_kg": (0.005,) * 4 + (0.25,)})})
    trials = (record("pressure-multisine", length_s=2.0),), (record("rail-chirp", heavy, length_s=4.0),)
    doubtful = identify(Model(), *trials)
    assert any("rail-chirp: tip error of" in warning for warning in doubtful.warnings), doubtful.warnings


@pytest.mark.prove
def test_a_flown_robot_of_another_make_is_found(tmp_path):
    """The independent robot, a fifth stiffer than the model and of twice as many links: its motions are followed."""
    robot = RobotParameters(arm=IndependentArm(stiffness=0.2))
    trials = []
    for seed, kind in enumerate(("seed", "rail-chirp", "both")):
        fly(EXCITATIONS[kind].at, tmp_path / kind, 10.0, robot, seed, kind=kind)
        trials.append(folder.read(tmp_path / kind))
    found = identify(Model(), trials)
    stiffer = np.array(found.model.arm.stiffness_nm_rad) / np.array(Model().arm.stiffness_nm_rad)
    assert stiffer.mean() == pytest.approx(1.2, rel=0.05)  # the joints share it out: theirs are two each
    assert found.refinement.rmse_m < found.refinement.rmse_before_m


def test_a_muscle_at_rest_keeps_the_models_gain_and_the_papers_misprinted_masses_are_named(record):
    arm = Model().arm.model_copy(update={"link_mass_kg": (0.05,) * 4 + (0.1,)})
    result = identify(Model(arm=arm), (record("rail-multisine", noise=0.0, length_s=2.0),))
    np.testing.assert_allclose(result.model.arm.muscle_gain_nm_kpa, arm.muscle_gain_nm_kpa, rtol=1e-3)
    assert any("the muscle gain is not fitted" in warning for warning in result.warnings)
    assert any("a shell of 0.05 kg is a misprint in the paper" in warning for warning in result.warnings)


def test_lost_frames_and_a_long_gap_are_survived(record):
    trial = record("pressure-multisine", length_s=7.0)
    mocap = trial.channels["mocap"]
    draw = np.random.default_rng(0)
    seen = draw.random(len(mocap)) > 0.1
    seen[600:660] = False
    thinned = Series(mocap.t_s[seen], {name: values[seen] for name, values in mocap.columns.items()})
    gappy = motion.measured(replace(trial, channels={**trial.channels, "mocap": thinned}), 5)
    assert len(gappy.t_s) <= seen.sum()
    assert not gappy.compared.all()
    assert gappy.compared.mean() > 0.8


def test_a_trial_of_which_the_filter_leaves_nothing_is_refused(record):
    with pytest.raises(TrialError, match=r"0 samples are .* a gap of over 0\.1 s; .* frames closer together"):
        identify(Model(), (record("pressure-multisine", length_s=0.55),))


def test_doubts_about_the_data_of_a_trial_that_is_refused_are_stated(record):
    """The pressure is stamped in milliseconds, so that no frame has one."""
    trial = record("pressure-multisine", length_s=7.0)
    late = replace(trial.channels["pressure"], t_s=1e3 + trial.channels["pressure"].t_s)
    odd = replace(trial, channels={**trial.channels, "pressure": late}, warnings=("divide ms by 1e3",))
    with pytest.raises(TrialError, match=r"0 frames show every link and the pressure, .* needed; divide ms by 1e3"):
        identify(Model(), (odd,))


def test_a_trial_without_pressure_is_left_out_in_words(record):
    trial = record("pressure-multisine", length_s=7.0)
    blind = replace(trial, channels={k: v for k, v in trial.channels.items() if k != "pressure"})
    with pytest.raises(TrialError, match=r"no trial shows the arm: .* was left out: arm is not observable"):
        identify(Model(), (blind,))
