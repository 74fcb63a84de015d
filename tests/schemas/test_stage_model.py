"""Keys of a stage's nominal model: errors state the allowed values, and the generated table shows every key."""

import re

import pytest

from softarm.schemas.stage_model import CHANNELS, MODEL_KEYS, complaints, table

PENDULUM = {"mass_kg": 0.1, "centre_m": 0.2, "inertia_kg_m2": 0}
CHAIN = {"mass_kg": [1, 2], "centre_m": [0.1, 0.2], "inertia_kg_m2": [0, 0], "length_m": [0.2]}


def test_the_generated_table_shows_every_key():
    assert all(f"| `{key.name}` |" in table() for keys in MODEL_KEYS.values() for key in keys)


@pytest.mark.parametrize(
    ("kind", "model", "links"),
    [
        ("tracking", {}, 1),
        ("tracking", {"lag_s": 0.1, "delay_s": 0, "gain": -2.5, "offset": 1, "rate_limit": 3}, 1),
        ("tracking", {"map": [[0, 0], [5, 100], [10, 250]]}, 1),
        ("driven_mass", {"mass_kg": 2, "gain": 0.5, "viscous": 1, "coulomb": 0.1, "offset": -1, "delay_s": 0}, 1),
        ("driven_mass", {"inertia_kg_m2": 1e-4}, 1),
        ("pendulum", PENDULUM, 1),
        ("pendulum", {**CHAIN, "length_m": 0.2}, 2),
        ("pendulum", {**CHAIN, "length_m": [0.2, 0.3], "damping_nm_s_rad": 0.1, "gravity_m_s2": 9.8}, 2),
        ("chain", {**CHAIN, "coulomb_nm": [0.1, 0], "armature_kg_m2": 0.001}, 2),
    ],
)
def test_a_valid_model_has_no_error(kind, model, links):
    assert list(complaints(kind, model, links)) == []


@pytest.mark.parametrize(
    ("kind", "model", "links", "key", "says"),
    [
        ("tracking", {"time_constant_s": 1}, 1, "time_constant_s", "unknown key; did you mean lag_s\\? the model"),
        ("tracking", {"delay": 1}, 1, "delay", "unknown key; did you mean delay_s\\? "),
        ("tracking", {"frobnicate": 1}, 1, "frobnicate", "unknown key; the model of a tracking stage has lag_s, "),
        ("tracking", {"lag_s": -1}, 1, "lag_s", "is -1; allowed 0 to 1000 s"),
        ("tracking", {"lag_s": "50 ms"}, 1, "lag_s", "write a bare number in s: 0.05"),
        ("tracking", {"lag_s": [1, 2]}, 1, "lag_s", "is a list; allowed one number"),
        ("tracking", {"gain": 0}, 1, "gain", "is 0, so nothing would move"),
        ("tracking", {"gain": 2, "map": [[0, 0], [1, 2]]}, 1, "map", "is given together with gain; keep one"),
        ("tracking", {"map": [[0, 0]]}, 1, "map", "allowed two \\[command, reached\\] pairs or more"),
        ("tracking", {"map": [[0, 0], [0, 2]]}, 1, "map", "commands that do not rise"),
        ("driven_mass", {}, 1, "", "needs either mass_kg"),
        ("driven_mass", {"mass_kg": 1, "inertia_kg_m2": 1}, 1, "", "needs either mass_kg"),
        ("driven_mass", {"mass_kg": 0}, 1, "mass_kg", "is 0; allowed above 0 kg"),
        ("pendulum", {}, 1, "", "lacks mass_kg .* centre_m .* inertia_kg_m2"),
        ("chain", {**CHAIN, "mass_kg": [1, 2, 3]}, 2, "mass_kg", "has 3 numbers, the stage has 2 links"),
        ("chain", {**CHAIN, "mass_kg": 0.2}, 2, "mass_kg", "has 1 number, the stage has 2 links; write a list with"),
        ("chain", {**CHAIN, "mass_kg": [1, -2]}, 2, "mass_kg", "is -2; allowed above 0 kg"),
        ("chain", {**CHAIN, "mass_kg": [1, 0]}, 2, "mass_kg", "is 0; allowed above 0 kg"),
        ("chain", {**CHAIN, "mass_kg": [1, None]}, 2, "mass_kg", "allowed above 0 kg"),
        ("chain", {k: v for k, v in CHAIN.items() if k != "length_m"}, 2, "", "2 links need length_m"),
    ],
)
def test_a_wrong_model_is_reported_with_key_and_next_step(kind, model, links, key, says):
    ((name, text),) = complaints(kind, model, links)
    assert name == key
    assert re.search(says, text), text


def test_common_names_for_a_key_are_no_other_keys():
    for keys in MODEL_KEYS.values():
        names = [name for key in keys for name in (key.name, *key.called)]
        assert len(names) == len(set(names))
    assert CHANNELS.keys() == MODEL_KEYS.keys()
