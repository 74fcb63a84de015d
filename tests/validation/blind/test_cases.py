"""Cases of the blind benchmark: shares, strengths, nuisances and files."""

from collections import Counter
from dataclasses import fields, replace
from itertools import permutations

import numpy as np
import pytest

from softarm.diagnosis.data.folder import read as read_trial
from softarm.diagnosis.data.read import read_all
from softarm.reality.parameters import RobotParameters
from softarm.schemas.excitation import Excitation, Ramp
from softarm.schemas.model import Model
from softarm.simulator import model_file
from softarm.simulator.effects import REGISTRY
from validation.blind import make
from validation.blind.cases import SINGLES, draw, separable
from validation.blind.imperfections import (
    KNOWN,
    REMOVABLE,
    UNKNOWN,
    UNKNOWNS,
    Cause,
    draw_cause,
    draw_nuisances,
    given,
    variants_of,
)

CAUSES = (*KNOWN, *(UNKNOWN + name for name in UNKNOWNS))
# Fields of the independent robot that the nuisances change; all others are neutral without a cause.
CHANGED = {
    *("inflate_s", "deflate_s", "tube_s", "acceleration_m_s2", "delay_s", "velocity_gain_n_s_m", "bias_kpa"),
    *("offset_y_m", "offset_z_m", "rotation_rad", "noise_m", "angle_noise_rad", "noise_kpa", "camera_drift"),
    *("tick_jitter_s", "transport_s", "transport_jitter_s", "dropout"),
}
GROUPS = ("regulator", "rail", "arm", "mocap", "pressure_sensor", "rail_sensor", "clock")


@pytest.fixture(scope="module")
def cases():
    return draw(200, seed=5)


def test_every_cause_is_drawn_equally_often(cases):
    singles = Counter((case.causes[0].name, case.causes[0].removed) for case in cases if case.kind == "single")
    assert set(singles) == set(SINGLES)
    assert max(singles.values()) - min(singles.values()) <= 1
    # rail.servo describes the drive of every case.
    robot = {name for name in REGISTRY if not name.startswith("contact.") and name != "rail.servo"}
    assert {name for name, _ in singles} == robot
    unknowns = Counter(case.causes[0].name for case in cases if case.kind == "unknown")
    assert len(unknowns) >= 5
    assert max(unknowns.values()) - min(unknowns.values()) <= 1


def test_combined_causes_are_never_rivals(cases):
    several = [[cause.name for cause in case.causes] for case in cases if case.kind in ("two", "three")]
    assert Counter(map(len, several)) == {2: 28, 3: 12}
    assert all(separable(*pair) for names in several for pair in permutations(names, 2))
    assert not separable("pressure.gain", "pressure.sensor_bias")
    assert not separable("arm.tilt", "arm.tilt")


@pytest.mark.parametrize("name", CAUSES)
def test_every_cause_is_allowed_at_both_ends_and_changes_the_robot(name):
    nominal = RobotParameters()
    for variant in variants_of(name):
        for end in ("low", "high"):
            values = [getattr(knob, end) for knob in variant]
            robot, settings = given(nominal, variant, values)
            assert robot != nominal
            assert set(settings) == {path for knob in variant for path in knob.paths}
            mirrored = [
                (1 / v if knob.how == "times" else -v) if knob.either_way else v
                for knob, v in zip(variant, values, strict=True)
            ]
            assert given(nominal, variant, mirrored)[0] != nominal
    assert Cause(name, False, {}).stage in {"pressure", "rail", "arm", "mocap", "clock"}


def test_a_removed_effect_changes_the_model_file_and_not_the_robot(cases):
    removed = [case for case in cases if any(cause.removed for cause in case.causes)]
    assert {cause.name for case in removed for cause in case.causes if cause.removed} == set(REMOVABLE)
    for case in removed:
        gone = {cause.name for cause in case.causes if cause.removed}
        assert set(case.model.effects) == set(Model().effects) - gone
    for case in cases:
        if case not in removed:
            assert case.model == Model()
    robot = draw_nuisances(RobotParameters(), np.random.default_rng(1))
    assert draw_cause(robot, "rail.delay", True, np.random.default_rng(2))[0] == robot


def test_nuisances_change_only_the_listed_parameters():
    nominal = RobotParameters()
    robots = [draw_nuisances(nominal, np.random.default_rng(seed)) for seed in range(100)]
    for group in GROUPS:
        for field in fields(getattr(nominal, group)):
            values = {getattr(getattr(robot, group), field.name) for robot in robots}
            if field.name in CHANGED:
                assert len(values) == len(robots), field.name
            else:
                assert values == {getattr(getattr(nominal, group), field.name)}, field.name
    for name, sigma in (("stiffness_nm_rad", 0.015), ("damping_nm_s_rad", 0.05)):
        scales = np.array([getattr(robot.body, name) for robot in robots]) / getattr(nominal.body, name) - 1
        assert np.std(scales) == pytest.approx(sigma * np.sqrt(2), rel=0.2)  # once for all joints, once for each
        assert np.std(scales.mean(axis=1)) == pytest.approx(sigma * np.sqrt(1.2), rel=0.25)


def test_a_written_case_can_be_read_and_a_partial_one_is_written_again(tmp_path, monkeypatch):
    brief = Excitation("rail-multisine", "two seconds", cart_velocity_m_s=(Ramp(2.0, 0.0, 0.2),))
    monkeypatch.setattr(make, "EXCITATIONS", {brief.name: brief})
    case = next(case for case in draw(20, seed=2) if case.kind == "single")
    short = next(trial for trial in case.fresh if trial.excitation == "rail-multisine")
    case = replace(case, planned=(replace(short, folder="trial-1"),), fresh=(replace(short, seed=99),))
    data, fresh = tmp_path / "data", tmp_path / "fresh"
    (data / case.name / "trial-1").mkdir(parents=True)
    (data / case.name / "trial-1" / "left.csv").write_text("half")
    assert not make.is_written(case, data, fresh)
    make.write_case(case, data, fresh)
    assert make.is_written(case, data, fresh)
    (trial,) = read_all([data / case.name])
    assert (trial.name, trial.kind, trial.rail) == ("trial-1", "rail-multisine", "free")
    assert not trial.not_observable
    assert model_file.load(data / case.name / "model.yaml") == case.model
    assert not (data / case.name / "trial-1" / "left.csv").exists()
    other = read_trial(fresh / case.name / "trial-3")
    assert not np.array_equal(other.channels["mocap"]["link5_y"][:100], trial.channels["mocap"]["link5_y"][:100])


def test_names_reveal_nothing(cases):
    assert len({case.name for case in cases}) == len(cases)
    by_name = [case.kind for case in sorted(cases, key=lambda case: case.name)]
    assert by_name != sorted(by_name)
    assert {trial.folder for case in cases for trial in case.planned} == {f"trial-{i}" for i in range(1, 9)}
