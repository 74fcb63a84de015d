"""The published baselines, asked as the blind benchmark asks: each answers by its rule, and answers whole."""

from functools import cache

import pytest

from softarm.diagnosis.blind import methods, run
from softarm.diagnosis.engine.search import EFFECTS_MAX
from softarm.reality.parameters import RobotParameters
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict
from softarm.simulator.effects import REGISTRY, validate

DEAD_TIME_S = 0.06
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def asked(flown):
    """The verdict of a method on a campaign, by its dead time: a whole verdict, and a model that can be flown."""

    @cache
    def ask(method, dead_time_s):
        answer = run.answer_case(flown(dead_time_s), method)
        assert answer["failure"] == ""
        verdict = Verdict.model_validate(answer["verdict"])
        assert verdict.verdict == ("named" if verdict.effects else "none")
        assert {effect.name for effect in verdict.effects} <= REGISTRY.keys()
        assert len({effect.name for effect in verdict.effects}) == len(verdict.effects)
        model = Model.model_validate(answer["patched_model"])
        validate(model.effects)
        assert {effect.name for effect in verdict.effects} <= model.effects.keys()
        return verdict

    return ask


def test_there_are_three_besides_ours():
    assert methods.METHODS.keys() == {methods.DEFAULT, "largest-gain", "bic", "all-at-once"}


def test_the_largest_gain_is_one_effect_at_most(asked):
    """The rule knows no tolerance, so a difference between two valid simulators may gain, too."""
    (effect,) = asked("largest-gain", DEAD_TIME_S).effects
    assert effect.name == "pressure.dead_time"
    late_s = DEAD_TIME_S + RobotParameters().regulator.tube_s
    assert effect.parameters["delay"].value == pytest.approx(late_s, abs=0.005)
    assert len(asked("largest-gain", 0.0).effects) <= 1


@pytest.mark.prove
def test_bic_begins_with_the_largest_gain_and_ends_at_the_most(asked):
    found = asked("bic", DEAD_TIME_S).effects
    assert found[0].name == asked("largest-gain", DEAD_TIME_S).effects[0].name
    assert 1 <= len(found) <= EFFECTS_MAX


@pytest.mark.prove
def test_all_at_once_names_the_one_that_is_clearest_off_its_neutral_value(asked):
    """The names of this rule are no better than chance: docs/gap/diagnosis.md."""
    assert len(asked("all-at-once", DEAD_TIME_S).effects) == 1
