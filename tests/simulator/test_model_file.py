"""Model files: round trip, and errors with file, line, key, bounds and source."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.schemas.model import Arm, Cart, Model, seed_effects
from softarm.simulator import effects, model_file
from softarm.simulator.model_file import ROBOT, ModelFileError

ABLATIONS = {
    "no-pressure-lag": "pressure.lag",
    "no-acceleration-limit": "rail.acceleration_limit",
    "no-delay": "rail.delay",
    "no-finite-difference": "observation.finite_difference",
}


def test_shipped_file_is_the_seed_s_simulator_as_saved(tmp_path: Path) -> None:
    assert model_file.load("seed") == model_file.load(model_file.SEED) == Model()
    model_file.save(Model(), tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == model_file.SEED.read_text()


def test_shipped_models_are_the_seed_and_its_ablations() -> None:
    assert set(model_file.shipped()) == {"seed", *ABLATIONS}
    for name, absent in ABLATIONS.items():
        remaining = {effect: given for effect, given in seed_effects().items() if effect != absent}
        assert model_file.load(name) == Model(effects=remaining)


def test_table_of_the_robot_covers_its_parameters_and_admits_the_seed_s() -> None:
    model = Model()
    assert list(ROBOT) == [
        f"{group}.{name}" for group in ("arm", "cart") for name in type(getattr(model, group)).model_fields
    ]
    for key, quantity in ROBOT.items():
        group, _, name = key.partition(".")
        value = getattr(getattr(model, group), name)
        assert all(map(quantity.admits, value if isinstance(value, tuple) else (value,))), key
        assert quantity.source


@st.composite
def any_effects(draw: st.DrawFn) -> dict[str, dict[str, float]]:
    """Some effects, some of their parameters, anywhere within the bounds or at neutral."""
    chosen = draw(st.lists(st.sampled_from(list(effects.REGISTRY.values())), unique=True))
    return {
        effect.name: {
            p.name: draw(st.floats(p.low, p.high) | st.just(p.neutral))
            for i, p in enumerate(effect.parameters)
            if i == 0 or draw(st.booleans())
        }
        for effect in chosen
    }


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(0.01, 50.0), any_effects(), st.integers(1, 12))
def test_any_model_survives_the_file(
    tmp_path_factory: pytest.TempPathFactory, mass_kg: float, chosen: dict[str, dict[str, float]], links: int
) -> None:
    lists = {}
    for name in Arm.model_fields:
        if isinstance(getattr(Arm(), name), tuple):
            allowed = ROBOT[f"arm.{name}"]
            lists[name] = tuple(allowed.low + (allowed.high - allowed.low) * (i + 1) / 14 for i in range(links))
    model = Model(arm=Arm(**lists), cart=Cart(mass_kg=mass_kg), effects=chosen)
    path = tmp_path_factory.mktemp("models") / "model.yaml"
    model_file.save(model, path)
    assert model_file.load(path) == model


def test_removing_an_effect_s_line_removes_the_effect(tmp_path: Path) -> None:
    path = tmp_path / "ablation.yaml"
    path.write_text("effects:\n  pressure.lag: {inflate: 0.2}\n  observation.finite_difference: {}\n")
    model = model_file.load(path)
    assert model.effects == {"pressure.lag": {"inflate": 0.2}, "observation.finite_difference": {}}
    assert effects.value(model, "pressure.lag", "deflate") == 0.0


def test_file_without_effects_has_the_seed_s(tmp_path: Path) -> None:
    path = tmp_path / "heavy.yaml"
    path.write_text("cart: {mass_kg: 5e-1}\n")
    assert model_file.load(path) == Model(cart=Cart(mass_kg=0.5))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "cart:\n  mass_kg: -1\n",
            r"model.yaml:2: cart.mass_kg: is -1; allowed 0.01 to 50 kg; source of the .*: \[C\]",
        ),
        (
            "cart:\n  mass: 1\n",
            r":2: cart.mass: unknown key; did you mean mass_kg\? \(allowed above 0 kg; default",
        ),
        ("effects:\n  rail.dely: {}\n", r":2: effects.rail.dely: unknown effect; did you mean rail.delay\?"),
        (
            "effects:\n  rail.delay: {dely: 0.1}\n",
            r"rail.delay.dely: .*did you mean delay\? rail.delay has delay \(s\)",
        ),
        (
            "effects:\n  rail.delay:\n    delay: 33\n",
            r":3: effects.rail.delay.delay: is 33; allowed 0 to 0.1 s; if you meant 33 ms, write 0.033; source: \[P\]",
        ),
        (
            "effects: {pressure.ceiling: {limit: .nan}}\n",
            r"limit: is nan; allowed 1 to 100 kPa, or inf for none; source",
        ),
        ("effects: {rail.delay: }\n", r":1: effects.rail.delay: has no value; write {} or "),
        ("effects: {rail.delay: {}}\n", r":1: effects.rail.delay: names no parameter.*; give delay \(s\), or remove"),
        ("effects: {observation.finite_difference: {on: 1}}\n", r"has no parameters: it is on or absent; write {}"),
        ("effects: [rail.delay]\n", r":1: effects: is a list; allowed a group of names of your choice; change it"),
        (
            "arm:\n  link_mass_kg:\n  - 1\n  - x\n",
            r":4: arm.link_mass_kg.1: is 'x'; .*; write a bare number in kg;",
        ),
        ("arm:\n  link_mass_kg: [1]\n", r":1: arm: link_mass_kg has 1 entries, link_length_m has 5: give one entry"),
        ("arm:\n  link_mass_kg: 1\n", r":2: arm.link_mass_kg: is 1; allowed a list; change it"),
        ("- 1\n", r":1: must hold keys; allowed: arm, cart, effects"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(text)
    with pytest.raises(ModelFileError, match=complaint):
        model_file.load(path)


def test_all_errors_are_reported_at_once_and_in_order(tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    path.write_text("cart:\n  mass_kg: 0\n  travel_m: 0\n  mas: 1\neffects:\n  arm.tilt: {angle: 2}\n  arm.tlt: {}\n")
    with pytest.raises(ModelFileError) as error:
        model_file.load(path)
    lines = str(error.value).splitlines()
    assert [line.split(":")[1] for line in lines] == ["2", "3", "4", "6", "7"]


def test_missing_file_and_unknown_name_are_named(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=r"absent.yaml: no such file; name a model file"):
        model_file.load(tmp_path / "absent.yaml")
    with pytest.raises(ModelFileError, match=r"no-dely: no such file or model; did you mean no-delay\?.* seed"):
        model_file.load("no-dely")
    with pytest.raises(ModelFileError, match=r"é: no such file or model; name a file, or one of"):
        model_file.load("é" * 300)  # longer than a file name may be
