"""The published baselines run and answer as they are described: what the diagnosis is compared with is really there."""

import pytest

from softarm.schemas.model import Model
from softarm.simulator.effects import validate
from validation.blind.run import METHODS

pytestmark = pytest.mark.slow
LATE = (("pressure.dead_time", (("delay", 0.06),)),)


def _names(diagnosis):
    return [effect.name for effect in diagnosis.verdict.effects]


@pytest.mark.prove
def test_largest_gain_names_one_strong_effect(campaign):
    found = METHODS["largest-gain"](campaign(LATE), Model())
    verdict = found.verdict
    assert _names(found)[0] == "pressure.dead_time"
    assert verdict.effects[0].parameters["delay"].value == pytest.approx(0.06, abs=0.01)
    assert verdict.where.stage == "pressure"
    assert found.patched.effects["pressure.dead_time"]["delay"] == verdict.effects[0].parameters["delay"].value
    validate(found.patched.effects)


def test_all_at_once_names_one_effect_of_the_registry_and_its_patch_is_a_model(campaign):
    found = METHODS["all-at-once"](campaign(LATE, ("pressure-multisine", "both")), Model())
    assert len(_names(found)) <= 1
    validate(found.patched.effects)
