"""Every key of a stage.yaml's model changes the prediction of its view: no key is accepted and ignored."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.rigs.stage import view_of
from softarm.schemas.stage_model import CHANNELS, DESCRIBED, MODEL_KEYS, complaints
from tests.diagnosis.rigs.recordings import recording

T = np.arange(0, 6, 0.01)
WAVE = np.sin(3 * T) + 0.5 * np.sin(7.3 * T)
SERIES = {
    "tracking": {"command": {"command": WAVE}, "measured": {"position": 0.9 * np.sin(3 * T - 0.2)}},
    "driven_mass": {"force": {"force": WAVE}, "measured": {"position": -0.1 * np.sin(3 * T)}},
    "pendulum": {"measured": {"angle1": 0.3 * np.sin(7 * T), "angle2": 0.2 * np.sin(7 * T + 0.1)}},
    "chain": {
        "measured": {"angle1": 0.3 * np.sin(7 * T), "angle2": 0.2 * np.sin(7 * T + 0.1)},
        "torque": {"torque1": 0.2 * WAVE, "torque2": 0.1 * WAVE},
    },
}
LINKS = {"mass_kg": (1.0, 0.5), "centre_m": (0.1, 0.1), "inertia_kg_m2": (1e-3, 1e-3), "length_m": (0.2, 0.2)}
MODEL = {"tracking": {}, "driven_mass": {"mass_kg": 1.0}, "pendulum": LINKS, "chain": LINKS}
OTHER = {"lag_s": 0.2, "delay_s": 0.1, "gain": 2.0, "offset": 0.3, "map": ((-2.0, -1.0), (0.0, 0.5), (2.0, 0.6)),
         "rate_limit": 0.5, "acceleration_limit": 2.0, "mass_kg": 3.0, "inertia_kg_m2": 3.0, "viscous": 2.0,
         "coulomb": 0.4, "gravity_m_s2": 5.0, "damping_nm_s_rad": 0.05, "coulomb_nm": 0.05,
         "armature_kg_m2": 0.02, "inertia_joint_kg_m2": (0.0112, 0.0063)}  # fmt: skip
SECOND = {"length_m": (0.4, 0.2)}  # the last length has no effect


def residuals(kind, model):
    view, _ = view_of([recording("one", "waves", T, SERIES[kind], ("thing", kind, model))])
    return np.nan_to_num(view.gap([{}]))


@cache
def usual_residuals(kind):
    return residuals(kind, MODEL[kind])


@pytest.mark.parametrize(
    ("kind", "key"), [(kind, key.name) for kind, keys in MODEL_KEYS.items() if kind in DESCRIBED for key in keys]
)
def test_every_key_of_the_model_changes_the_prediction(kind, key):
    links = 2 if "link" in {each.each for each in MODEL_KEYS[kind]} else 1
    usual = MODEL[kind]
    if key in usual and isinstance(usual[key], tuple):
        other = SECOND.get(key, tuple(2 * value for value in usual[key]))
    else:
        other = OTHER[key]
    replaced = {"inertia_kg_m2": "mass_kg"} if links == 1 else {"inertia_joint_kg_m2": "inertia_kg_m2"}
    changed = {name: value for name, value in usual.items() if name != replaced.get(key)} | {key: other}
    assert list(complaints(kind, changed, links)) == []
    assert not np.allclose(residuals(kind, changed), usual_residuals(kind), rtol=1e-4, atol=1e-7)


def test_the_docs_list_every_channel_and_column():
    page = (Path(__file__).parents[3] / "docs" / "reference" / "trials.md").read_text(encoding="utf-8")
    for channels in CHANNELS.values():
        for name, channel in channels.items():
            for word in (name, *channel.any_of, *channel.others):
                assert f"`{word}`" in page, word
