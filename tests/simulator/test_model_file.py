"""Model files: what is written comes back; what is wrong is named by file, line, key and range."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.model import Arm, Cart, Effects, Model
from simulator import model_file
from simulator.model_file import ModelFileError


def test_shipped_file_is_the_seed_s_simulator() -> None:
    assert model_file.load(model_file.SEED) == Model()


def test_shipped_file_is_as_saved(tmp_path: Path) -> None:
    model_file.save(Model(), tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == model_file.SEED.read_text()


@settings(max_examples=30, deadline=None)
@given(
    st.floats(1e-9, 1e9),
    st.sets(st.sampled_from(["pressure.lag", "rail.acceleration_limit", "rail.delay"])),
    st.integers(1, 12),
)
def test_any_model_survives_the_file(
    tmp_path_factory: pytest.TempPathFactory, mass_kg: float, absent: set[str], links: int
) -> None:
    lists = {
        name: (0.5 + i / 3,) * links
        for i, name in enumerate(Arm.model_fields)
        if isinstance(getattr(Arm(), name), tuple)
    }
    model = Model(
        arm=Arm(**lists),
        cart=Cart(mass_kg=mass_kg),
        effects=Effects.model_validate(dict.fromkeys(absent)),
    )
    path = tmp_path_factory.mktemp("models") / "model.yaml"
    model_file.save(model, path)
    assert model_file.load(path) == model


def test_removing_an_effect_s_line_removes_the_effect(tmp_path: Path) -> None:
    path = tmp_path / "ablation.yaml"
    path.write_text("effects:\n  pressure.lag: {inflate: 0.2}\n  rail.delay: {}\n")
    effects = model_file.load(path).effects
    assert effects.pressure_lag is not None
    assert effects.pressure_lag.inflate == 0.2
    assert effects.rail_delay is not None
    assert effects.rail_acceleration_limit is None
    assert effects.observation_finite_difference is None


def test_file_without_effects_has_the_seed_s(tmp_path: Path) -> None:
    path = tmp_path / "heavy.yaml"
    path.write_text("cart: {mass_kg: 5e-1}\n")
    assert model_file.load(path) == Model(cart=Cart(mass_kg=0.5))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("cart:\n  mass_kg: -1\n", r"model.yaml:2: cart.mass_kg: must be greater than 0 but is -1; change it"),
        ("cart:\n  mass: 1\n", r"model.yaml:2: cart.mass: unknown key; did you mean mass_kg\? allowed: mass_kg, "),
        ("effects:\n  rail.dely: {}\n", r":2: effects.rail.dely: unknown key; did you mean rail.delay\?"),
        (
            "effects:\n  rail.delay:\n    delay: 3\n",
            r":3: effects.rail.delay.delay: must be less than or equal to 0.1 but is 3",
        ),
        ("arm:\n  link_mass_kg:\n  - 1\n  - x\n", r":4: arm.link_mass_kg.1: must be a valid number but is 'x'"),
        ("arm:\n  link_mass_kg: [1]\n", r":1: arm: link_mass_kg has 1 entries, link_length_m has 5: one entry"),
        ("cart: {mass_kg: yes}\n", r":1: cart.mass_kg: must be a valid number but is True"),
        ("cart: {mass_kg: 1, mass_kg: 2}\n", r":1: is not valid YAML: mass_kg stands twice"),
        ("cart: [\n", r"is not valid YAML"),
        ("- 1\n", r":1: the model: must be an object but is a list"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(text)
    with pytest.raises(ModelFileError, match=complaint):
        model_file.load(path)


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    path.write_text("cart:\n  mass_kg: 0\n  travel_m: 0\n")
    with pytest.raises(ModelFileError, match=r"(?s):2: cart.mass_kg.*:3: cart.travel_m"):
        model_file.load(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=r"absent.yaml: cannot be read .*; name a model file"):
        model_file.load(tmp_path / "absent.yaml")
