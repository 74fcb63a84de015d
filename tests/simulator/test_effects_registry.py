"""The effect registry: every entry is complete and consistent with its readers."""

import math
import re
from pathlib import Path

import pytest

from softarm.common.quantity import UNITS
from softarm.schemas.model import Model
from softarm.simulator import effects
from softarm.simulator.effect_table import EFFECTS, RIVALS
from softarm.simulator.effects import REGISTRY, STAGES, Effect, EffectError, Parameter
from softarm.simulator.effects_page import markdown

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "effects.md"
PARAMETERS = [(effect, parameter) for effect in EFFECTS for parameter in effect.parameters]
BASE_UNITS = {"s", "m", "kg", "N", "rad", "kPa", "1", "-"}


def of(case: object) -> str:
    return case.name if isinstance(case, Effect | Parameter) else str(case)


@pytest.mark.parametrize("effect", REGISTRY.values(), ids=of)
def test_entry_is_complete(effect: Effect) -> None:
    assert re.fullmatch(r"[a-z]+\.[a-z_]+", effect.name)
    assert effect.stage in STAGES
    assert effect.meaning
    assert effect.source
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)
    # Something to switch on, for every test that takes the exemplar.
    assert not effect.parameters or any(p.exemplar != p.neutral for p in effect.parameters)
    assert not effect.parameters or any(p.default is None for p in effect.parameters)


def test_names_are_unique_and_in_causal_order() -> None:
    assert len(REGISTRY) == len(EFFECTS)
    stages = [STAGES.index(effect.stage) for effect in REGISTRY.values()]
    assert stages == sorted(stages)


@pytest.mark.parametrize(("effect", "p"), PARAMETERS, ids=of)
def test_bounds_and_unit_hold_what_they_should(effect: Effect, p: Parameter) -> None:
    assert -math.inf < p.low < p.high < math.inf
    assert p.low <= p.exemplar <= p.high
    # Outside the bounds stands only the neutral "no bound at all", which messages and page spell out.
    assert p.low <= p.neutral <= p.high or p.neutral == math.inf
    assert p.default in (None, p.neutral)
    assert p.meaning
    assert p.unit in UNITS
    factors = re.split(r"[ /]", p.unit)
    assert {re.sub(r"\^[234]$", "", factor) for factor in factors} <= BASE_UNITS


def test_every_confusable_pair_is_symmetric_and_has_an_experiment() -> None:
    pairs = [frozenset(pair[:2]) for pair in RIVALS]
    assert len(set(pairs)) == len(pairs)
    assert all(len(pair) == 2 and pair <= set(REGISTRY) for pair in pairs)
    for effect in REGISTRY.values():
        for rival, experiment in effect.separated_by.items():
            assert experiment
            assert REGISTRY[rival].separated_by[effect.name] == experiment


@pytest.mark.parametrize(("effect", "p"), PARAMETERS, ids=of)
def test_value_is_the_model_s_or_its_default_or_neutral(effect: Effect, p: Parameter) -> None:
    absent, bare, given = (
        Model(effects=chosen) for chosen in ({}, {effect.name: {}}, {effect.name: {p.name: p.exemplar}})
    )
    assert effects.value(absent, effect.name, p.name) == p.neutral
    assert effects.value(bare, effect.name, p.name) == p.neutral
    assert effects.value(given, effect.name, p.name) == p.exemplar
    assert effects.find(f"{effect.name}.{p.name}") == (REGISTRY[effect.name], p)


@pytest.mark.parametrize(("effect", "p"), PARAMETERS, ids=of)
def test_out_of_bounds_names_all_that_helps(effect: Effect, p: Parameter) -> None:
    too_much = 3 * p.high
    with pytest.raises(EffectError) as error:
        effects.validate({effect.name: {p.name: too_much}})
    message = str(error.value)
    assert message.startswith(f"{effect.name}.{p.name}: is {too_much:g}; allowed {p.low:g} to {p.high:g}")
    assert message.endswith(f"source: {effect.source}")
    assert p.unit == "-" or f" {p.unit}" in message
    assert error.value.violations[0].place == (effect.name, p.name)


def test_names_that_do_not_exist_are_refused_with_the_nearest() -> None:
    for path, nearest in (
        ("rail.dely.delay", "rail.delay"),
        ("mocap.friction.coefficient", "contact.friction"),
        ("arm.tilt.angl", "angle"),
    ):
        with pytest.raises(EffectError, match=rf"did you mean {nearest}\?"):
            effects.find(path)
    with pytest.raises(EffectError, match=r"unknown effect; `python -m softarm\.simulator\.effects_page`"):
        effects.find("zzz")
    with pytest.raises(EffectError, match=r"names no parameter; rail.delay has delay \(s\)"):
        effects.find("rail.delay")
    with pytest.raises(EffectError, match="no parameters"):
        effects.find("observation.finite_difference.on")
    with pytest.raises(EffectError, match="unknown effect"):
        effects.value(Model(), "rail.dely", "delay")


def test_the_generated_table_shows_every_effect_and_parameter() -> None:
    table = markdown()
    for effect in effects.REGISTRY.values():
        assert f"- **`{effect.name}`**: " in table
        assert all(f"| `{effect.name}.{p.name}` | {p.unit} |" in table for p in effect.parameters)


def test_the_walk_through_shows_the_present_code() -> None:
    text = (PAGE.parents[1] / "development" / "adding-an-effect.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n# (\S+)\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) >= 6
    for name, code in blocks:
        assert code in (PAGE.parents[2] / name).read_text(encoding="utf-8"), f"{name} has other code now"
