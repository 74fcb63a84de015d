"""Candidates: every effect of the registry that the robot can have may be found, within its physical bounds."""

import math

import numpy as np
import pytest

from softarm.diagnosis.blind.imperfections import KNOWN, draw_nuisances, read
from softarm.diagnosis.robot.candidates import candidates, nuisances
from softarm.diagnosis.robot.counts import TOLERANCE
from softarm.reality.parameters import RobotParameters
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, find, value

ALL = candidates(Model())
BARE = Model(effects={})
FITTED_STAGES = {"pressure", "rail", "arm", "mocap"}


def _ids(each):
    return each.name + "".join(f"+{k.rpartition('.')[2]}" for k in each.form)


@pytest.mark.parametrize("model", [Model(), BARE], ids=["seed", "bare"])
def test_every_effect_of_the_robot_is_fitted_or_counted(model):
    """An effect that is added to the registry and that nobody can find shows here."""
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
def test_what_a_dial_turns_to_is_what_the_registry_admits(candidate):
    """At both ends, at every start and beyond the ends."""
    ends = [tuple(d.low for d in candidate.parameters), tuple(d.high for d in candidate.parameters)]
    beyond = [
        tuple(d.low - 5 * d.size for d in candidate.parameters),
        tuple(d.high + 5 * d.size for d in candidate.parameters),
    ]
    for u in (*ends, *beyond, *candidate.starts):
        for path, x in candidate.point(u).items():
            if path not in candidate.form:
                assert find(path)[1].admits(x), (path, x)


@pytest.mark.parametrize("model", [Model(), BARE], ids=["seed", "bare"])
def test_at_nominal_a_dial_says_what_the_model_says(model):
    for candidate in candidates(model):
        for fitted in candidate.parameters:
            effect, _, parameter = fitted.path.rpartition(".")
            assert fitted.value(fitted.nominal) == pytest.approx(value(model, effect, parameter))
            assert fitted.low <= fitted.nominal <= fitted.high
            assert fitted.size > 0


def test_inverse_dials_go_round_and_end_in_nothing():
    """Where only infinity changes nothing, the coordinate is 1 / value: zero is the effect's absence."""
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


def test_an_effect_of_the_model_can_be_taken_out():
    """Some start or bound of the seed's own effects reaches the value at which the effect is absent."""
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


def test_what_a_model_lacks_is_no_nuisance_of_its_size():
    assert not {"pressure.lag.inflate", "rail.acceleration_limit.acceleration"} & {n.path for n in nuisances(BARE)}


def test_between_the_last_finite_value_and_none_there_is_nothing():
    """A limit far away is no limit: a step of a fit must not end beyond the registry's bound."""
    (ceiling,) = next(c for c in candidates(Model()) if c.name == "pressure.ceiling").parameters
    for u in np.linspace(0.0, 0.02, 41):
        value = ceiling.value(float(u))
        assert math.isinf(value) or 1.0 <= value <= 100.0
    assert math.isinf(ceiling.value(0.0))


@pytest.mark.parametrize("direction", ["y", "z"])
def test_a_frame_as_far_off_as_well_kept_ones_are_is_no_news_and_half_the_weakest_cause_is(direction):
    candidate, fitted = next((c, d) for c in ALL for d in c.parameters if d.path == f"mocap.offset.{direction}")
    at = candidate.parameters.index(fitted)

    def news(off_m):
        return candidate.is_news(tuple(off_m if i == at else 0.0 for i in range(len(candidate.parameters))))

    random, path = np.random.default_rng(6), f"mocap.offset_{direction}_m"
    drawn = [read(draw_nuisances(RobotParameters(), random), path) for _ in range(200)]
    assert not any(news(off_m) for off_m in drawn)
    (knob,) = (k for variant in KNOWN["mocap.offset"] for k in variant if path in k.paths)
    assert news(knob.halved(knob.low))
    assert news(-knob.halved(knob.low))
