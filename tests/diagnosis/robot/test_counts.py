"""Tests of effects measured from stamps and noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.robot.counts import TOLERANCE, VELOCITY_FLOOR_M_S, counts
from softarm.schemas.model import Model

TICK_S, FRAME_S, LENGTH_S = 1 / 30, 1 / 120, 20.0
DIFFERENCED, TRUE = Model(), Model(effects={})


def _place(t):
    """A smooth motion of every marker, m."""
    return 0.08 * np.sin(2 * np.pi * 0.7 * t) + 0.03 * np.sin(2 * np.pi * 1.9 * t)


def _slope(t):
    return 2 * np.pi * (0.7 * 0.08 * np.cos(2 * np.pi * 0.7 * t) + 1.9 * 0.03 * np.cos(2 * np.pi * 1.9 * t))


def _trial(name, stamps=None, frames=None, noise_m=1e-4, seed=0, repeat=()):
    """Commands at stamps and mocap at frames; `repeat`: frames that show the pose before once more."""
    draw = np.random.default_rng(seed)
    stamps = np.arange(0, LENGTH_S, TICK_S) if stamps is None else stamps
    frames = np.arange(0, LENGTH_S, FRAME_S) if frames is None else frames
    poses = {}
    for body in ("cart", "link1", "link2"):
        poses |= {f"{body}_{part}": _place(frames) + noise_m * draw.normal(size=len(frames)) for part in ("y", "z")}
        poses[f"{body}_angle"] = draw.normal(size=len(frames))
    for values in poses.values():
        for i in repeat:
            values[i] = values[i - 1]
    channels = {
        "command": Series(stamps, {"cart_velocity": 0 * stamps, "pressure": 0 * stamps}),
        "mocap": Series(frames, {"t_receive": frames + 0.004, **poses}),
    }
    return Trial(name, name, Path(name), channels)


def _count(trials, name, model=DIFFERENCED):
    return next(each for each in counts(trials, model) if each.name == name)


def _late(seed, sigma_s):
    k = np.arange(round(LENGTH_S / TICK_S))
    return 10.0 + k * TICK_S + sigma_s * np.abs(np.random.default_rng(seed).normal(size=len(k)))


def test_late_ticks_are_named_as_jitter():
    found = _count([_trial(f"t{i}", stamps=_late(i, 0.004)) for i in range(4)], "clock.jitter")
    assert found.named
    assert found.value == pytest.approx(0.004, rel=0.1)
    assert found.low < 0.004 < found.high
    assert found.shrink > 0.8


def test_symmetric_jitter_is_named():
    draw = np.random.default_rng(5)
    k = np.arange(600)
    trials = [_trial(f"t{i}", stamps=k * TICK_S + 0.003 * draw.normal(size=600)) for i in range(3)]
    assert _count(trials, "clock.jitter").value == pytest.approx(0.003, rel=0.1)


def test_missed_ticks_are_named_and_are_no_jitter():
    trials = []
    for i in range(4):
        here = np.random.default_rng(i).random(600) >= 0.06
        here[[0, -1]] = True
        trials.append(_trial(f"t{i}", stamps=np.arange(600)[here] * TICK_S))
    found = _count(trials, "clock.missed_ticks")
    assert found.named
    assert found.value == pytest.approx(0.06, abs=0.015)
    assert not _count(trials, "clock.jitter").named


@pytest.mark.parametrize("way", ["lost", "repeated"])
def test_lost_and_repeated_frames_are_named_as_dropout(way):
    trials = []
    for i in range(4):
        gone = np.flatnonzero(np.random.default_rng(i).random(2400) < 0.08)
        gone = gone[(gone > 0) & (gone < 2399)]
        frames = np.arange(2400) * FRAME_S
        lost = {"frames": np.delete(frames, gone)} if way == "lost" else {"repeat": gone}
        trials.append(_trial(f"t{i}", seed=i, **lost))
    found = _count(trials, "mocap.dropout")
    assert found.named
    assert found.value == pytest.approx(0.08, abs=0.015)
    assert not _count(trials, "mocap.noise").named


def _drifting(i, rate, jitter_s=0.0008, length_s=LENGTH_S):
    """Cameras whose stamps gain `rate`, behind a network whose frames come late at random."""
    true = 3.0 + np.arange(round(length_s / FRAME_S)) * FRAME_S
    late = 0.004 + np.random.default_rng(i).exponential(jitter_s, len(true))
    trial = _trial(f"t{i}", frames=true * (1 + rate))
    columns = {**trial.channels["mocap"].columns, "t_receive": np.maximum.accumulate(true + late)}
    return replace(trial, channels={**trial.channels, "mocap": Series(trial.channels["mocap"].t_s, columns)})


@pytest.mark.parametrize("rate", [-0.004, -0.0005, 0.0005, 0.004])
def test_a_drift_of_the_cameras_has_its_sign(rate):
    found = _count([_drifting(i, rate) for i in range(4)], "clock.drift")
    assert found.named
    assert found.value == pytest.approx(rate, abs=1e-5)
    assert found.low <= rate + 1e-5
    assert found.high >= rate - 1e-5
    assert -0.01 < found.low < found.high
    assert found.shrink > 0.9


@pytest.mark.parametrize(("rate", "jitter_s"), [(50e-6, 0.0008), (-50e-6, 0.005), (0.0, 0.02)])
def test_a_clock_as_clocks_are_is_not_named_however_frames_come(rate, jitter_s):
    for length_s in (3.0, LENGTH_S):
        found = _count([_drifting(i, rate, jitter_s, length_s) for i in range(6)], "clock.drift")
        assert not found.named
        assert abs(found.value) < TOLERANCE["clock.drift"]


def test_one_long_trial_shows_a_drift():
    found = _count([_drifting(0, 0.002)], "clock.drift")
    assert found.value == pytest.approx(0.002, abs=1e-5)


def test_a_drift_that_the_model_has_is_no_gap_and_one_that_it_has_for_nothing_is():
    model = Model(effects={"clock.drift": {"rate": 0.002}})
    assert not _count([_drifting(i, 0.002) for i in range(3)], "clock.drift", model).named
    found = _count([_drifting(i, 0.0) for i in range(3)], "clock.drift", model)
    assert found.before == pytest.approx(0.002, abs=1e-5)


def test_noise_is_separated_from_motion():
    trials = [_trial(f"t{i}", noise_m=0.002, seed=i) for i in range(3)]
    found = _count(trials, "mocap.noise")
    assert found.named
    assert found.value == pytest.approx(0.002, rel=0.1)


def test_a_well_kept_rig_shows_nothing():
    trials = []
    for i in range(4):
        stamps = np.delete(_late(i, 0.5 * TOLERANCE["clock.jitter"]), [100, 300, 500])
        frames = np.delete(np.arange(2400) * FRAME_S, np.arange(50, 2350, 150))
        trials.append(_trial(f"t{i}", stamps, frames, 0.5 * TOLERANCE["mocap.noise"], i))
    found = counts(trials, DIFFERENCED)
    assert {c.name for c in found} == set(TOLERANCE)
    assert [c.name for c in found if c.named] == []
    assert all(c.value > 0 for c in found if c.name != "clock.drift")


@pytest.mark.parametrize(("modelled_s", "true_s", "named"), [(0.004, 0.004, False), (0.006, 0.0003, True)])
def test_an_effect_of_the_model_is_named_only_if_the_robot_lacks_it(modelled_s, true_s, named):
    model = Model(effects={"clock.jitter": {"sigma": modelled_s}})
    found = _count([_trial(f"t{i}", stamps=_late(i, true_s)) for i in range(4)], "clock.jitter", model)
    assert found.named == named
    assert found.value == pytest.approx(true_s, abs=4e-4)


def test_an_effect_without_its_channel_is_left_out():
    trial = _trial("t")
    only = Trial("t", "t", Path("t"), {"command": trial.channels["command"]})
    assert {c.name for c in counts([only], DIFFERENCED)} == {"clock.jitter", "clock.missed_ticks"}


def _seen(name, differenced, seed=0):
    """A trial whose observation's velocities are differences over a tick, or true."""
    trial = _trial(name, seed=seed)
    mocap = trial.channels["mocap"]
    ticks = np.arange(0.5, LENGTH_S - 0.5, TICK_S) + 1e-3
    newest = np.searchsorted(mocap["t_receive"], ticks, side="right") - 1
    columns = {}
    for part in ("y", "z"):
        place = mocap[f"link2_{part}"][newest]
        rate = np.diff(place, prepend=place[0]) / np.diff(mocap.t_s[newest], prepend=mocap.t_s[newest][0] - TICK_S)
        columns[f"tip_v{part}"] = rate if differenced else _slope(mocap.t_s[newest])
    return Trial(name, name, Path(name), {**trial.channels, "observation": Series(ticks, columns)})


@pytest.mark.parametrize(("robot", "model"), [(True, TRUE), (False, DIFFERENCED), (True, DIFFERENCED), (False, TRUE)])
def test_finite_differences_and_true_velocities_are_separated(robot, model):
    found = _count([_seen(f"t{i}", robot, i) for i in range(3)], "observation.finite_difference", model)
    differs = robot != (model is DIFFERENCED)
    assert found.named == differs
    if differs:
        assert found.present == robot
        assert found.before > VELOCITY_FLOOR_M_S
        assert found.shrink > 0.5


def test_a_tip_that_was_never_tracked_says_nothing_of_velocities():
    seen, other = (_seen(f"t{i}", True, i) for i in range(2))
    mocap = other.channels["mocap"]
    lost = {name: mocap[name] + (np.nan if name.startswith("link2") else 0) for name in mocap.columns}
    trials = [seen, replace(other, channels=other.channels | {"mocap": Series(mocap.t_s, lost)})]
    name = "observation.finite_difference"
    assert _count(trials, name, TRUE) == _count([seen], name, TRUE)


@pytest.mark.slow
def test_95_percent_intervals_hold_the_truth_95_times_in_100():
    k, truth, runs = np.arange(400), {"clock.missed_ticks": 0.05, "clock.jitter": 0.004}, 200
    inside = dict.fromkeys(truth, 0)
    for seed in range(runs):
        draw, trials = np.random.default_rng(seed), []
        for i in range(5):
            kept = draw.random(len(k)) >= truth["clock.missed_ticks"]
            kept[[0, -1]] = True
            late = truth["clock.jitter"] * np.abs(draw.normal(size=len(k)))
            stamps = (10.0 + k * TICK_S + late)[kept]
            trials.append(Trial(f"t{i}", "", Path(f"t{i}"), {"command": Series(stamps, {})}))
        for found in counts(trials, DIFFERENCED):
            inside[found.name] += int(found.low <= truth[found.name] <= found.high)
    fewest, most = binom.ppf((0.001, 0.999), runs, 0.95)
    assert all(fewest <= each <= most for each in inside.values()), inside
