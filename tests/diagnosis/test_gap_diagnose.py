"""The whole diagnosis on campaigns of known cause: that is named, nothing else, and nothing where nothing is wrong.

The robot is the seed's simulator at another rate behind noisy sensors. What it has and the nominal model lacks is
taken out of the model, what the model lacks beyond the seed's is put into the robot.
"""

from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.shrink import measure_shrink
from softarm.diagnosis.trials import Series, Trial, TrialError
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model, seed_effects
from softarm.schemas.verdict import Verdict
from softarm.simulator.effects import validate
from softarm.simulator.simulator import Simulator

SEED = seed_effects()
# Excitation -> from which second of it on; 5 s of each make a campaign that is diagnosed in seconds.
CAMPAIGN = {"pressure-multisine": 0.0, "both": 1.0, "rail-steps": 9.5, "rail-multisine": 1.7}
LENGTH_S, FRAME_S, MOCAP_LATE_S, FRAMES_A_TICK = 5.0, 1 / 120, 0.004, 4
NOISE_M, NOISE_RAD, NOISE_KPA = 0.2e-3, 2e-3, 0.05


@cache
def _campaign(effects=(), kinds=tuple(CAMPAIGN)):
    """The seed's robot with further effects ((name, ((parameter, value), ...)), ...) under a campaign's excitations."""
    model = Model(effects=SEED | {name: dict(values) for name, values in effects})
    return tuple(_record(kind, model, seed) for seed, kind in enumerate(kinds))


def _record(kind, model, seed):
    """Mocap at 120 Hz, readings at 60 Hz, ticks at 30 Hz whose velocities are differences over a tick."""
    draw, plan = np.random.default_rng(seed), EXCITATIONS[kind]
    begun_s = CAMPAIGN.get(kind, 0.0)
    robot = Simulator(model, physics_rate_hz=720.0)
    for _ in range(60):  # hang still before the recording
        robot.step(*plan.at(begun_s), 1 / 30)
    frames, slow = [], []
    for k in range(round(LENGTH_S / FRAME_S)):
        t = k * FRAME_S
        bodies = [(robot.cart_position_m[0], model.arm.base_height_m, 0.0)]
        bodies += [(y, z, a) for (y, z), a in zip(robot.link_ends_m()[0], robot.link_angles_rad[0], strict=True)]
        poses = np.array(bodies, dtype=float) + draw.normal(size=(6, 3)) * (NOISE_M, NOISE_M, NOISE_RAD)
        frames.append((t, t + MOCAP_LATE_S, *poses.ravel()))
        command = plan.at(begun_s + FRAMES_A_TICK * FRAME_S * (k // FRAMES_A_TICK))
        if k % 2 == 0:
            reading = robot.pressure_reading_kpa[0] + draw.normal() * NOISE_KPA
            slow.append((t, *command, reading, robot.cart_position_m[0], robot.cart_velocity_m_s[0]))
        robot.step(*command, FRAME_S)
    return _trial(kind, np.array(frames, dtype=float), np.array(slow, dtype=float))


def _trial(name, frames, slow):
    bodies = ("cart", *(f"link{i}" for i in range(1, 6)))
    columns = ["t_receive", *(f"{body}_{part}" for body in bodies for part in ("y", "z", "angle"))]
    t, sent = slow[:, 0], slow[:: FRAMES_A_TICK // 2]
    mocap = Series(frames[:, 0].copy(), {c: frames[:, i].copy() for i, c in enumerate(columns, 1)})
    return Trial(name, name, Path(name), {
        "command": Series(sent[:, 0].copy(), {"cart_velocity": sent[:, 1].copy(), "pressure": sent[:, 2].copy()}),
        "pressure": Series(t.copy(), {"pressure": slow[:, 3].copy()}),
        "rail": Series(t.copy(), {"position": slow[:, 4].copy(), "velocity": slow[:, 5].copy()}),
        "mocap": mocap,
        "observation": _observation(mocap, sent[2:, 0]),
    })  # fmt: skip


def _observation(mocap, ticks):
    """What a policy is shown at its ticks: the newest pose, velocities as differences from tick to tick."""
    newest = np.searchsorted(mocap["t_receive"], ticks + 1e-9, side="right") - 1
    rates = {}
    for part in ("y", "z"):
        place, before = mocap[f"link5_{part}"][newest], mocap[f"link5_{part}"][newest - FRAMES_A_TICK]
        rates[f"tip_v{part}"] = (place - before) / (mocap.t_s[newest] - mocap.t_s[newest - FRAMES_A_TICK])
    return Series(ticks.copy(), rates)


@cache
def _diagnosed(out=(), effects=(), kinds=tuple(CAMPAIGN)):
    """The diagnosis of a robot with `effects` by a nominal model without `out`."""
    model = Model(effects={name: values for name, values in SEED.items() if name not in out})
    return diagnose(_campaign(effects, kinds), model)


def _names(diagnosis):
    return sorted(effect.name for effect in diagnosis.verdict.effects)


PAYLOAD = (("arm.payload", (("mass", 0.04),)),)
ONE_AT_A_TIME = [(name,) for name in SEED]
PAIRS = list(combinations(SEED, 2))


def test_when_nothing_is_wrong_nothing_is_named():
    diagnosis = _diagnosed()
    assert diagnosis.verdict.verdict == "none"
    assert diagnosis.verdict.effects == ()
    assert diagnosis.verdict.where.stage is None
    assert diagnosis.verdict.next_experiment is None
    assert diagnosis.patched is None


@pytest.mark.parametrize("out", ONE_AT_A_TIME + PAIRS, ids="+".join)
def test_what_the_seed_s_simulator_lacks_is_named_and_nothing_else(out):
    """The paper's four effects, one at a time and in pairs."""
    verdict = _diagnosed(out).verdict
    assert _names(_diagnosed(out)) == sorted(out)
    assert verdict.verdict == "named"
    assert all(effect.equivalents == () for effect in verdict.effects)
    assert verdict.where.stage in {name.partition(".")[0] for name in out}


@pytest.mark.parametrize("out", ONE_AT_A_TIME[:3] + PAIRS, ids="+".join)
def test_the_parameters_are_those_of_the_robot(out):
    for effect in _diagnosed(out).verdict.effects:
        for name, true in SEED[effect.name].items():
            estimate = effect.parameters[name]
            assert estimate.value == pytest.approx(true, rel=0.05), (effect.name, name)
            assert estimate.low <= estimate.value <= estimate.high


@pytest.mark.parametrize("out", ONE_AT_A_TIME, ids="+".join)
def test_the_gap_of_its_stage_shrinks_and_the_shrink_is_held_out(out):
    verdict = _diagnosed(out).verdict
    stage, shrink = out[0].partition(".")[0], verdict.effects[0].shrink.stage
    assert shrink.low <= shrink.value <= shrink.high <= 1
    assert shrink.value > 0.5
    assert verdict.gap.after[stage].value < 0.5 * verdict.gap.before[stage].value
    assert verdict.where.share[stage] > 0.8


def test_the_shrink_holds_on_excitations_that_no_fit_has_seen():
    out = ("pressure.lag", "rail.delay")
    diagnosis = _diagnosed(out)
    fresh = measure_shrink(_campaign(kinds=("sinusoid", "rail-chirp")), diagnosis.nominal, diagnosis.patched)
    for effect in diagnosis.verdict.effects:
        stage = effect.name.partition(".")[0]
        assert fresh[stage] > 0.8
        assert effect.shrink.stage.value == pytest.approx(fresh[stage], abs=0.15)
    assert abs(fresh["mocap"]) < 0.05


@pytest.mark.parametrize("out", [ONE_AT_A_TIME[0], ONE_AT_A_TIME[3], PAIRS[1]], ids="+".join)
def test_the_patched_model_is_a_model_and_has_what_was_missing(out):
    patched = _diagnosed(out).patched
    assert set(patched.effects) == set(SEED)
    validate(patched.effects)
    assert Model.model_validate_json(patched.model_dump_json()) == patched
    robot = Simulator(patched)
    robot.step(0.2, 10.0, 0.5)
    assert np.isfinite(robot.tip_m()).all()


def test_a_payload_is_the_arm_s_though_the_rail_feels_it():
    diagnosis = _diagnosed(effects=PAYLOAD)
    effect = diagnosis.verdict.effects[0]
    assert _names(diagnosis) == ["arm.payload"]
    assert effect.parameters["mass"].value == pytest.approx(0.04, rel=0.15)
    assert diagnosis.verdict.where.stage == "arm"
    assert diagnosis.verdict.where.share.get("rail", 0.0) < 0.1


def test_a_wrong_zero_and_a_biased_sensor_cannot_be_told_apart_without_mocap():
    """The regulator's own reading is off by a constant: the set is told, and what to fly next."""
    trials = [
        replace(t, channels={k: v for k, v in t.channels.items() if k in ("command", "pressure", "rail")})
        for t in _campaign((("pressure.sensor_bias", (("bias", 1.2),)),))
    ]
    verdict = diagnose(trials, Model()).verdict
    effect = verdict.effects[0]
    assert {effect.name, *effect.equivalents} == {"pressure.gain", "pressure.sensor_bias"}
    assert len(verdict.effects) == 1
    assert effect.confidence < _diagnosed(("rail.delay",)).verdict.effects[0].confidence
    assert any("arm is not observable" in warning for warning in verdict.warnings)
    assert verdict.next_experiment is not None
    assert {effect.name, *effect.equivalents} >= set(verdict.next_experiment.separates)
    assert len(verdict.next_experiment.separates) == 2
    assert verdict.next_experiment.excitation in EXCITATIONS


def test_two_runs_and_any_order_of_the_trials_give_the_same_verdict():
    out = ("pressure.lag", "rail.delay")
    model = Model(effects={name: values for name, values in SEED.items() if name not in out})
    shuffled = [_campaign()[i] for i in (2, 0, 3, 1)]
    assert diagnose(shuffled, model).verdict == _diagnosed(out).verdict


@pytest.mark.parametrize("out", [(), *ONE_AT_A_TIME, PAIRS[1]], ids="+".join)
def test_a_verdict_survives_its_file(out):
    verdict = _diagnosed(out).verdict
    assert Verdict.model_validate_json(verdict.model_dump_json()) == verdict


def test_inputs_that_are_no_campaign_are_refused_in_words():
    with pytest.raises(TrialError, match="no trial to diagnose; name a campaign"):
        diagnose([])
