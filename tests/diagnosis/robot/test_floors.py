"""Tests of the noise floors on given trials, with tolerated deviations and drift."""

import numpy as np
import pytest

from softarm.diagnosis.robot.chain import stage_of_tip_gap, tip_gap
from softarm.diagnosis.robot.comparison import DRIFT_FLOOR_M_S, drift, slow
from softarm.diagnosis.robot.trial_grid import on_grid
from softarm.diagnosis.robot.views import with_joints
from softarm.schemas.model import Model
from tests.diagnosis.engine.gauge import channel

VIEW = channel(4, 900)
NOISE = 0.02 * np.random.default_rng(1).normal(size=(len(VIEW.trial), 1))
PULLED = np.where((VIEW.t_s > 5)[:, None], -0.010, 0.0)  # half its floor: 10 cm in the ten seconds that are left


def test_noise_as_large_as_the_velocity_s_floor_does_not_drift():
    assert slow(VIEW, NOISE) < DRIFT_FLOOR_M_S
    assert drift(VIEW, NOISE, NOISE) is None


def test_a_pull_far_below_the_velocity_s_floor_drifts():
    found = drift(VIEW, NOISE + PULLED, NOISE + PULLED)
    assert found is not None
    assert found.energy == pytest.approx(0.010**2 * 2 / 3 / DRIFT_FLOOR_M_S**2, rel=0.2)
    assert "drift" in found.where


def test_a_small_rest_of_a_large_drift_is_no_further_cause():
    assert drift(VIEW, 10 * PULLED, PULLED) is None
    assert drift(VIEW, 2 * PULLED, PULLED) is not None


def test_missing_samples_do_not_drift():
    gone = np.where((VIEW.trial < 3)[:, None], np.nan, NOISE + PULLED)
    assert slow(VIEW, gone) == pytest.approx(0.0082, rel=0.15)
    assert slow(VIEW, np.full_like(NOISE, np.nan)) == 0.0


def test_joints_are_off_by_shares_of_their_own_and_torques_by_shares_of_the_largest():
    model = Model()
    moved = with_joints(model, {"arm.stiffness_nm_rad[2]": 0.04, "arm.torque_offset_nm[1]": 0.1, "rail.lag.time": 1.0})
    before, after = model.arm, moved.arm
    assert after.stiffness_nm_rad[1] == pytest.approx(1.04 * before.stiffness_nm_rad[1])
    assert after.torque_offset_nm[0] == pytest.approx(before.torque_offset_nm[0] + 0.1 * max(before.torque_offset_nm))
    assert after.damping_nm_s_rad == before.damping_nm_s_rad
    assert with_joints(model, {}) == model


def test_a_tip_gap_belongs_to_the_rail_or_to_the_arm(campaign):
    """A command that the model takes for another moves the cart, a heavier tip what hangs from it."""
    trials = campaign(kinds=("both", "rail-steps"))
    slower = Model(effects=Model().effects | {"rail.gain": {"scale": 0.1}})
    assert stage_of_tip_gap(on_grid(trials, slower), slower) == "rail"
    loaded = Model(effects=Model().effects | {"arm.payload": {"mass": 0.06}})
    assert stage_of_tip_gap(on_grid(trials, loaded), loaded) == "arm"
    assert np.isfinite(tip_gap(on_grid(trials, loaded), loaded, [{}])).any()
