"""Independently simulated poles with effects that the model may lack."""

import math

import numpy as np
import pytest

from softarm.diagnosis.diagnose import diagnose
from tests.diagnosis.rigs.recordings import recording

MODEL = {"mass_kg": 0.5, "centre_m": 0.2, "length_m": 0.4, "inertia_kg_m2": 4e-3, "damping_nm_s_rad": 4e-3}
INERTIA, WEIGHT = 4e-3 + 0.5 * 0.2**2, 0.5 * 0.2 * 9.81
STEP_S, EACH = 1e-3, 5
NOISE = 2e-4
pytestmark = pytest.mark.slow


def pole(angle, torque, *, spring=0.0, rest=0.0, dry=0.0):
    """Return angles [T] from rest under a torque [T EACH]; spring: N m/rad, an effect that no table contains."""

    def rate(q, v, u):
        pull = WEIGHT * math.sin(q) + spring * (q - rest) + 4e-3 * v + dry * math.tanh(v / 5e-3)
        return (u - pull) / INERTIA

    q, v, h, seen = angle, 0.0, STEP_S, []
    for k, u in enumerate(torque):
        if k % EACH == 0:
            seen.append(q)
        a = rate(q, v, u)
        b = rate(q + 0.5 * h * v, v + 0.5 * h * a, u)
        c = rate(q + 0.5 * h * v + 0.25 * h * h * a, v + 0.5 * h * b, u)
        d = rate(q + h * v + 0.5 * h * h * b, v + h * c, u)
        q, v = q + h * v + h * h * (a + b + c) / 6, v + h * (a + 2 * b + 2 * c + d) / 6
    return np.array(seen)


def recorded(name, kind, angles, torque=None):
    draw = np.random.default_rng(sum(map(ord, name)))
    t = STEP_S * EACH * np.arange(len(angles))
    channels = {"measured": {"angle1": angles + draw.normal(0, NOISE, len(t))}}
    if torque is not None:
        channels["torque"] = {"torque1": torque[::EACH]}
    return recording(name, kind, t, channels, ("pole", "chain", MODEL))


def driven(**beyond):
    """Return four motions driven by a motor."""
    t = np.arange(0, 8, STEP_S)
    levels = np.random.default_rng(3).uniform(-1, 1, 10)
    motions = {
        "steps": levels[(t / 0.9).astype(int)],
        "sweep": np.sin(2 * np.pi * (0.2 * t + 0.11 * t**2)),
        "tones": (np.sin(1.3 * t) + np.sin(3.1 * t + 1) + np.sin(5.7 * t + 2) + np.sin(9.4 * t + 4)) / 2,
        "calm": 0.6 * (np.sin(1.9 * t) + np.sin(4.4 * t + 2) + np.sin(7.5 * t + 3)) / 2,
    }
    held = {kind: np.repeat(0.45 * u[::EACH], EACH) for kind, u in motions.items()}
    return [recorded(kind, kind, pole(0.0, u, **beyond), u) for kind, u in held.items()]


def free(**beyond):
    """Return three free swings."""
    still = np.zeros(round(3 / STEP_S))
    return [recorded(f"swing {k}", "swing", pole(q, still, **beyond)) for k, q in enumerate((0.9, 0.5, 0.25))]


def floors_left(verdict):
    return verdict.gap.after["pole"].value / verdict.gap.floor["pole"].value


@pytest.mark.parametrize("made", [pytest.param(driven, marks=pytest.mark.prove), free])
def test_an_unknown_effect_gives_no_confident_name(made):
    """A spring at the joint resembles a heavier pole or a tilted base, and leaves a large residual."""
    verdict = diagnose(made(spring=0.25, rest=0.1 if made is driven else 0.0)).verdict
    assert floors_left(verdict) > 8
    assert verdict.verdict in ("incomplete", "unknown")
    assert {e.name for e in verdict.effects} <= {"pole.stiffness"}
    assert all(e.confidence is None for e in verdict.effects)
