"""Candidates: every effect of the registry that the robot can have may be found, within its physical bounds."""

import math

import numpy as np
import pytest

from softarm.diagnosis.robot.candidates import candidates, nuisances
from softarm.diagnosis.robot.counts import TOLERANCE
from softarm.reality.parameters import RobotParameters
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, find, value
from validation.blind.imperfections import KNOWN, SAME_SIZE, draw_nuisances, read

ALL = candidates(Model())
BARE = Model(effects={})
FITTED_STAGES = {"pressure", "rail", "arm", "mocap"}


def _ids(each):
    return each.name + "".join(f"+{k.rpartition('.')[2]}" for k in each.form)


@pytest.mark.parametrize("model", [Model(), BARE], ids=["seed", "bare"])
def test_every_effect_of_the_robot_is_fitted_or_counted(model):
    wanted = {name for name, effect in REGISTRY.items() if effect.stage in FITTED_STAGES and effect.parameters}
    assert len(wanted) > 25
    fitted = {each.name for each in candidates(model)}
    assert fitted | set(TOLERANCE) >= wanted
    assert not fitted & set(TOLERANCE)
    assert fitted <= wanted


@pytest.mark.parametrize("candidate", [*ALL, *candidates(BARE)], ids=_ids)
def test_a_search_starts_within_the_bounds_and_away_from_nominal(candidate):
    assert candidate.starts
    for start in candidate.starts:
        assert len(start) == len(candidate.parameters)
        assert all(d.low <= u <= d.high for d, u in zip(candidate.parameters, start, strict=True))
        assert any(u != d.nominal for d, u in zip(candidate.parameters, start, strict=True))


@pytest.mark.parametrize("candidate", ALL, ids=_ids)
def test_a_parameter_covers_the_range_of_the_registry(candidate):
    ends = (lambda d: d.low, lambda d: d.high, lambda d: d.low - 5 * d.size, lambda d: d.high + 5 * d.size)
    for u in (*(tuple(map(end, candidate.parameters)) for end in ends), *candidate.starts):
        for path, x in candidate.point(u).items():
            if path not in candidate.form:
                assert find(path)[1].admits(x), (path, x)


@pytest.mark.parametrize("model", [Model(), BARE], ids=["seed", "bare"])
def test_a_parameter_at_nominal_has_the_model_s_value(model):
    for candidate in candidates(model):
        for fitted in candidate.parameters:
            effect, _, parameter = fitted.path.rpartition(".")
            assert fitted.value(fitted.nominal) == pytest.approx(value(model, effect, parameter))
            assert fitted.low <= fitted.nominal <= fitted.high
            assert fitted.size > 0


def test_inverse_dials_go_round_and_end_in_nothing():
    inverse = [fitted for candidate in candidates(BARE) for fitted in candidate.parameters if fitted.inverse]
    assert {d.path for d in inverse} >= {"pressure.rate_limit.rate", "rail.acceleration_limit.acceleration"}
    for fitted in inverse:
        assert math.isinf(fitted.value(0.0))
        assert fitted.nominal == fitted.neutral == 0.0
        parameter = find(fitted.path)[1]
        for x in (parameter.low * 1.001, parameter.exemplar, parameter.high):
            assert fitted.value(1 / x) == pytest.approx(x)
        assert fitted.value(fitted.high) == pytest.approx(parameter.low)


def test_starts_lie_on_both_sides_where_the_bounds_allow():
    for candidate in ALL:
        for i, fitted in enumerate(candidate.parameters):
            parameter = find(fitted.path)[1]
            if parameter.default is None and not fitted.inverse and fitted.low < fitted.nominal < fitted.high:
                changes = [start[i] - fitted.nominal for start in candidate.starts]
                signs = {math.copysign(1, change) for change in changes if change}
                assert signs == {-1.0, 1.0}, fitted.path


def test_a_dead_zone_of_any_width_has_a_start_close_by():
    """The instants at which a valve acts jump with its dead zone: 0.1 kPa from the true width no descent arrives."""
    candidate = next(c for c in ALL if c.name == "pressure.deadband")
    starts = np.array([u for (u,) in candidate.starts])
    for width_kpa in np.linspace(0.25, candidate.parameters[0].high, 200):
        assert np.abs(starts - width_kpa).min() < 0.026
    assert candidate.parameters[0].reach == pytest.approx(np.diff(starts).max())


def test_an_effect_of_the_model_can_be_taken_out():
    for name in ("pressure.lag", "rail.delay", "rail.acceleration_limit"):
        for fitted in next(each for each in ALL if each.name == name).parameters:
            assert fitted.low <= fitted.neutral <= fitted.high
            assert fitted.nominal != fitted.neutral


@pytest.mark.parametrize("model", [Model(), BARE], ids=["seed", "bare"])
def test_a_nuisance_is_a_box_about_the_model_within_the_bounds(model):
    found = nuisances(model)
    assert len(found) > 5
    for nuisance in found:
        effect, _, name = nuisance.path.rpartition(".")
        parameter = find(nuisance.path)[1]
        assert nuisance.nominal == value(model, effect, name)
        assert parameter.low <= nuisance.low <= nuisance.nominal <= nuisance.high <= parameter.high
        assert nuisance.low < nuisance.high
        assert nuisance.edge in (nuisance.low, nuisance.high)
        assert nuisance.edge != nuisance.nominal


def test_an_absent_effect_has_no_relative_tolerance():
    assert not {"pressure.lag.inflate", "rail.acceleration_limit.acceleration"} & {n.path for n in nuisances(BARE)}


def test_no_value_lies_between_the_largest_one_and_infinity():
    """A limit far away is no limit: a step of a fit must not end beyond the registry's bound."""
    (ceiling,) = next(c for c in candidates(Model()) if c.name == "pressure.ceiling").parameters
    for u in np.linspace(0.0, 0.02, 41):
        value = ceiling.value(float(u))
        assert math.isinf(value) or 1.0 <= value <= 100.0
    assert math.isinf(ceiling.value(0.0))


def _found(path):
    return next((c, d) for c in ALL for d in c.parameters if d.path == SAME_SIZE[path])


KNOBS = [
    pytest.param(knob, path, id=path)
    for variants in KNOWN.values()
    for variant in variants
    for knob in variant
    for path in knob.paths
    if path in SAME_SIZE and not path.startswith("clock") and not _found(path)[0].is_missing
]


def _change(candidate, fitted, x):
    """The candidate's coordinates with one parameter at x, the others nominal."""
    return tuple((1 / x if d.inverse else x) if d is fitted else d.nominal for d in candidate.parameters)


@pytest.mark.parametrize(("knob", "path"), KNOBS)
def test_the_weakest_cause_of_a_parameter_in_the_model_exceeds_its_tolerance(knob, path):
    candidate, fitted = _found(path)
    nominal = fitted.value(fitted.nominal)
    weakest = knob.weakened(1.0)
    x = {"set": weakest, "add": nominal + weakest, "times": nominal * weakest}[knob.how]
    assert candidate.exceeds_tolerance(_change(candidate, fitted, x))


BODY = {
    "stiffness_nm_rad": "arm.stiffness",
    "muscle_gain_nm_kpa": "arm.muscle_gain",
    "damping_nm_s_rad": "arm.damping",
    "torque_offset_nm": "arm.torque_offset",
}


@pytest.fixture(scope="module")
def good_robots():
    """Return robots without a cause."""
    random = np.random.default_rng(5)
    return [draw_nuisances(RobotParameters(), random) for _ in range(600)]


@pytest.mark.parametrize("name", BODY)
def test_good_robots_are_within_the_tolerance(name, good_robots):
    candidate, fitted = _found(BODY[name])
    usual = getattr(RobotParameters().body, name)
    scales = [float(np.mean(np.array(getattr(robot.body, name)) / usual)) - 1 for robot in good_robots]
    exceeding = [candidate.exceeds_tolerance(_change(candidate, fitted, x)) for x in scales]
    assert np.mean(exceeding) < 0.005


@pytest.mark.parametrize(
    "path",
    [
        "regulator.inflate_s",
        "regulator.deflate_s",
        "rail.acceleration_m_s2",
        "rail.delay_s",
        "mocap.offset_y_m",
        "mocap.offset_z_m",
    ],
)
def test_the_end_of_a_drawn_tolerance_is_within_it(path, good_robots):
    candidate, fitted = _found(path)
    nominal = fitted.value(fitted.nominal)
    for robot in good_robots:
        offset = read(robot, path) - read(RobotParameters(), path)
        assert not candidate.exceeds_tolerance(_change(candidate, fitted, nominal + offset))


def test_a_loop_at_the_end_of_its_law_may_be_named():
    """Plays side by side that carry most of the torque (reality) are the registry's loop at its strongest."""
    hysteresis, creep = (next(c for c in ALL if c.name == name) for name in ("arm.hysteresis", "arm.creep"))
    strength, width = hysteresis.parameters
    assert not hysteresis.at_bound((strength.high, 7.0))
    assert hysteresis.at_bound((strength.high, width.high))
    assert creep.at_bound((creep.parameters[0].high, 2.0))
