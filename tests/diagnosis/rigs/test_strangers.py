"""Independently simulated poles with effects that the model may lack."""

import numpy as np
import pytest

from softarm.diagnosis.diagnose import diagnose
from tests.diagnosis.rigs.test_chain import Made, driven, trial

MODEL = {"mass_kg": 0.5, "centre_m": 0.2, "length_m": 0.4, "inertia_kg_m2": 4e-3, "damping_nm_s_rad": 4e-3}
STEP_S = 5e-3
NOISE = 2e-4
pytestmark = pytest.mark.slow


def with_motor(**beyond):
    """Return four motions driven by a motor, whose torque is held between samples."""
    t = np.arange(0, 8, STEP_S)
    levels = np.random.default_rng(3).uniform(-1, 1, 10)
    motions = {
        "steps": levels[(t / 0.9).astype(int)],
        "sweep": np.sin(2 * np.pi * (0.2 * t + 0.11 * t**2)),
        "tones": (np.sin(1.3 * t) + np.sin(3.1 * t + 1) + np.sin(5.7 * t + 2) + np.sin(9.4 * t + 4)) / 2,
        "calm": 0.6 * (np.sin(1.9 * t) + np.sin(4.4 * t + 2) + np.sin(7.5 * t + 3)) / 2,
    }

    def recorded(kind, torque):
        def held(now):
            return 0.45 * torque[[int(now / STEP_S + 1e-6)]]

        return driven(kind, Made(MODEL, **beyond), t, held, MODEL, 0.0, kind=kind, noise=NOISE)

    return [recorded(kind, torque) for kind, torque in motions.items()]


def free(**beyond):
    """Return three free swings."""
    made, t = Made(MODEL, **beyond), np.arange(0, 3, STEP_S)
    return [
        trial(f"swing {k}", t, made.swing(q, t), MODEL, kind="swing", noise=NOISE, seed=k)
        for k, q in enumerate((0.9, 0.5, 0.25))
    ]


@pytest.mark.parametrize("made", [pytest.param(with_motor, marks=pytest.mark.prove), free])
def test_an_unknown_effect_gives_no_confident_name(made):
    """A spring at the joint resembles a heavier pole or a tilted base, and leaves a large residual."""
    verdict = diagnose(made(spring=0.25, rest=0.1 if made is with_motor else 0.0)).verdict
    assert verdict.gap.after["arm"].value > 8 * verdict.gap.floor["arm"].value
    assert verdict.verdict in ("incomplete", "unknown")
    assert {e.name for e in verdict.effects} <= {"arm.stiffness"}
    assert all(e.confidence is None for e in verdict.effects)
