"""Poles of an outsider: a law of its own, in plain Runge and Kutta, beside a model that may lack a part of it."""

import math
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from softarm.diagnosis.data.trials import Series, TableStage, Trial
from softarm.diagnosis.diagnose import diagnose

MODEL = {"mass_kg": 0.5, "centre_m": 0.2, "length_m": 0.4, "inertia_kg_m2": 4e-3, "damping_nm_s_rad": 4e-3}
INERTIA, WEIGHT = 4e-3 + 0.5 * 0.2**2, 0.5 * 0.2 * 9.81
STEP_S, EACH = 1e-3, 5
NOISE = 2e-4
pytestmark = pytest.mark.slow


def pole(angle, torque, *, spring=0.0, rest=0.0, dry=0.0):
    """[T] angles from rest under a torque [T EACH]; spring: N m/rad about an angle of rest, which no list has."""

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
    channels = {"measured": Series(t, {"angle1": angles + draw.normal(0, NOISE, len(t))})}
    if torque is not None:
        channels["torque"] = Series(t, {"torque1": torque[::EACH]})
    return Trial(name, kind, Path(name), channels, stage=TableStage("pole", "chain", MODEL))


def driven(**beyond):
    """Four motions that a motor made."""
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
    """Three swings that die away."""
    still = np.zeros(round(10 / STEP_S))
    return [recorded(f"swing {k}", "swing", pole(q, still, **beyond)) for k, q in enumerate((0.9, 0.5, 0.25))]


def floors_left(verdict):
    return verdict.gap.after["pole"].value / verdict.gap.floor["pole"].value


@pytest.mark.parametrize("made", [driven, free])
def test_beside_a_gap_that_stays_nothing_is_the_whole(made):
    """A spring at the joint is nearly a heavier pole, or a leaning base, and leaves many floors."""
    verdict = diagnose(made(spring=0.25, rest=0.1 if made is driven else 0.0)).verdict
    assert floors_left(verdict) > 8
    assert verdict.verdict in ("incomplete", "unknown")
    assert {e.name for e in verdict.effects} <= {"pole.stiffness"}  # the weight's moment, which grows likewise
    assert all(e.confidence is None for e in verdict.effects)


@pytest.mark.parametrize(("made", "dry"), [(driven, 0.03), (free, 0.01)])
def test_what_is_found_and_leaves_next_to_nothing_is_the_whole(made, dry):
    verdict = diagnose(made(dry=dry)).verdict
    assert verdict.verdict == "named"
    (found,) = verdict.effects
    assert found.name == "pole.coulomb_friction"
    assert found.parameters["torque"].value == pytest.approx(dry, rel=0.05)
    assert floors_left(verdict) < 5


def test_a_pole_as_its_model_says_is_none():
    assert diagnose(driven()).verdict.verdict == "none"


def test_a_diagnosis_has_one_thread_for_each_library_and_gives_the_others_back():
    seen = []
    with threadpool_limits(2):
        diagnose(driven()[:1], tell=lambda text, share: seen.extend(threadpool_info()))
        assert {each["num_threads"] for each in seen} == {1}
        assert {each["num_threads"] for each in threadpool_info()} == {2}
    assert {each["user_api"] for each in seen} == {"blas", "openmp"}  # the trees' too
