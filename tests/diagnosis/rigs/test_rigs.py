"""Views of rigs: laws against closed forms, effects against the registry, diagnoses of simulated and real tables."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, TrialError
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.rigs.candidates import nuisances
from softarm.diagnosis.rigs.chain.view import ChainView
from softarm.diagnosis.rigs.diagnose import diagnose_table, merged, refuse_two_models
from softarm.diagnosis.rigs.driven_mass import DrivenMassView
from softarm.diagnosis.rigs.grid import grid
from softarm.diagnosis.rigs.stage import view_of
from softarm.diagnosis.rigs.tracking import TrackingView
from softarm.simulator.effects import REGISTRY
from tests.diagnosis.rigs.recordings import named, recording, shipped
from tests.diagnosis.rigs.test_chain import Made

MODEL = {
    "mass_kg": 0.15,
    "centre_m": 0.15,
    "inertia_kg_m2": 1e-4,
    "damping_nm_s_rad": 2e-4,
    "gravity_m_s2": 9.81,
}


def servo(command, position, t, kind="multisine", name="one", **more):
    channels = {"command": {"command": command}, "measured": {"position": position, **more}}
    return recording(name, kind, t, channels, ("servo", "tracking", {}))


def pendulum(angle, t, name="swing", model=MODEL):
    return recording(name, "free swing", t, {"measured": {"angle1": angle}}, ("joint", "pendulum", model))


def tone(t, seed=0):
    draw = np.random.default_rng(seed)
    return sum(
        0.05 * np.sin(2 * np.pi * f * t + p) for f, p in zip((0.2, 0.5, 1.1, 2.3), draw.uniform(0, 6, 4), strict=True)
    )


T = np.arange(0, 16, 0.02)


def followed(point, commands, seed):
    """Return trials of a servo that follows commands as the view predicts, read with noise by an encoder."""
    draw, trials = np.random.default_rng(seed), []
    for kind, command in commands.items():
        view = TrackingView([servo(command, np.zeros_like(T), T)])
        moved = view.measured[:, 0] - view.gap([{f"servo.{k}": v for k, v in point.items()}])[0, :, 0]
        seen = np.round((np.nan_to_num(moved) + 2e-4 * draw.normal(size=len(T))) / 1e-3) * 1e-3
        trials.append(servo(command, seen, T, kind, kind))
    return trials


def cart(nominal):
    channels = {"force": {"force": np.sin(3 * T)}, "measured": {"position": -0.05 * np.sin(3 * T)}}
    return recording("push", "sine", T, channels, ("cart", "driven_mass", nominal))


@pytest.mark.parametrize(
    "view",
    [
        TrackingView([servo(tone(T), tone(T), T)]),
        ChainView([pendulum(0.3 * np.cos(T), T)]),
        DrivenMassView([cart({"mass_kg": 2.0})]),
        DrivenMassView([cart({"mass_kg": 2.0, "viscous": 1.5, "coulomb": 1.0})]),
    ],
    ids=["tracking", "chain", "mass", "mass with friction"],
)
def test_every_effect_of_a_rig_has_bounds_source_and_known_rivals(view):
    known, sources = view.effects, {registered.source for registered in REGISTRY.values()}
    for effect in known:
        assert effect.name.startswith(f"{view.stage}.")
        assert effect.meaning
        assert effect.source
        # A driven mass and a resonance have effects that the soft arm lacks.
        assert isinstance(view, DrivenMassView) or effect.name == "servo.second_order" or effect.source in sources
        for p in effect.parameters:
            assert p.low < p.high
            assert p.admits(p.neutral)
            assert p.admits(p.exemplar)
            assert p.admits(view.nominal(f"{effect.name}.{p.name}".partition(".")[2]))
        assert set(effect.separated_by) <= {e.name for e in known}
        assert all(": " in experiment for experiment in effect.separated_by.values())


def test_effects_of_a_rig_never_speak_of_the_soft_arm():
    chain = ChainView([pendulum(0.3 * np.cos(T), T, model=MODEL | {"length_m": 0.3})])
    assert "joint.payload" in {effect.name for effect in chain.effects}
    for effect in (*TrackingView([servo(tone(T), tone(T), T)]).effects, *chain.effects):
        texts = [effect.meaning, *(p.meaning for p in effect.parameters), *effect.separated_by.values()]
        words = set(re.findall(r"[a-z]+", " ".join(texts).lower()))
        assert not words & {"cart", "regulator", "muscle", "mocap", "pose", "poses", "tip"}, effect.name


def test_stages_with_one_name_need_one_model():
    one, other = (replace(cart({"mass_kg": mass}), source=Path(f"{mass}.csv")) for mass in (2.0, 3.0))
    with pytest.raises(TrialError, match=r"^2.0.csv and 3.0.csv: .* cart, but mass_kg .* 2.0 and 3.0; .* `name`"):
        diagnose_table([one, other])


def test_copies_of_an_mjcf_file_are_one_model(tmp_path):
    files = [tmp_path / name for name in ("a.xml", "b.xml")]
    trials = [replace(cart({"mjcf": str(file)}), source=file) for file in files]
    for file in files:
        file.write_text("<mujoco/>")
    refuse_two_models(trials)
    files[1].write_text("<mujoco model='other'/>")
    with pytest.raises(TrialError, match="allowed is one model for each name"):
        refuse_two_models(trials)


def test_a_warning_of_several_stages_is_given_once():
    given = ["hip: late", "knee: late", "hip: weak", "foot: late", "knee: weak", "hip: late", "run-1.csv: a gap"]
    found = merged([*given, "hip.play is not named: late"], ["foot", "hip", "knee"])
    assert found == ("all 3 stages: late", "hip, knee: weak", "run-1.csv: a gap", "hip.play is not named: late")
    assert merged(["hip: late"], ["hip"]) == ("hip: late",)


def swing(amplitude, seconds, **beyond):
    """Simulate a swing from rest at an amplitude; return stamps and angles."""
    t = np.arange(0, seconds, 0.01)
    return t, Made(MODEL, **beyond).swing(amplitude, t)[:, 0]


def test_fast_sources_are_averaged_and_gaps_become_nan():
    t = np.delete(np.arange(0, 4, 1e-3), slice(1000, 1500))
    found = grid(Series(t, {"x": 2.0 * t}), 100.0)
    assert found.step_s == pytest.approx(0.01)
    inside = (found.t_s > 1.01) & (found.t_s < 1.49)
    assert np.isnan(found.columns["x"][inside]).all()
    outside = (found.t_s < 0.98) | (found.t_s > 1.52)
    np.testing.assert_allclose(found.columns["x"][outside], 2 * found.t_s[outside], atol=1e-9)


def test_jitter_of_stamps_at_the_edge_of_a_bin_does_not_change_its_mean():
    draw = np.random.default_rng(3)
    t = 0.005 * (np.arange(2000) + 0.02 * draw.normal(size=2000))
    t = t[draw.random(2000) > 0.01]  # some are missing
    found = grid(Series(t, {"angle1": np.sin(7 * t)}), 100.0)
    assert found.step_s == pytest.approx(0.01, rel=1e-2)
    np.testing.assert_allclose(found.columns["angle1"][1:-1], np.sin(7 * found.t_s[1:-1]), atol=1e-3)


def test_trials_are_cut_into_windows_and_held_out_whole():
    t, angle = swing(0.3, 12.0)
    trials = [pendulum(angle, t, f"swing {i}") for i in range(4)]
    view, found = view_of(trials)
    parts, origins = found.trials, found.origins
    assert len(parts) == 4 * len(ChainView.windows(trials[0])) == 16
    assert [trials[k].name for k in origins] == [part.name.split(" from")[0] for part in parts]
    setup = Setup([view], nuisances(view), [t.kind for t in parts], origins)
    assert setup.held_out == "trial"
    assert [int(f) for f in setup.fold] == [origins[trial] for trial, _ in setup.blocks]


def test_dead_band_and_droop_of_a_servo_are_named():
    commands = {"multisine": tone(T, 0), "steps": 0.15 * np.sign(np.sin(0.8 * T))}
    trials = followed({"deadband.width": 0.03, "gain.offset": 0.04}, commands, seed=3)
    shares: list[float] = []
    diagnosis = diagnose_table(trials, lambda text, share: shares.append(share))
    assert shares == sorted(shares)
    assert len({round(share, 1) for share in shares}) > 7  # it moves during the search
    found = {e.name: e for e in diagnosis.verdict.effects}
    together, gap = diagnosis.total_shrink["servo"], diagnosis.verdict.gap
    assert together.value == pytest.approx(1 - gap.after["servo"].value / gap.before["servo"].value, abs=1e-6)
    assert together.low < together.value < together.high
    assert all(diagnosis.vocabulary[name].meaning for e in found.values() for name in (e.name, *e.equivalents))
    named = {name: {name, *e.equivalents} for name, e in found.items()}
    assert any("servo.deadband" in each for each in named.values())
    assert any("servo.gain" in each for each in named.values())
    assert len(found) == 2


@pytest.mark.prove
def test_a_late_servo_is_split_into_dead_time_lag_and_acceleration_limit():
    # A sweep up to 3 Hz, which a motor's limited torque cannot follow.
    sweep = 0.12 * np.sin(2 * np.pi * (0.2 * T + 1.4 * T**2 / T[-1]))
    commands = {"sweep": sweep, "multisine": tone(T, 1), "steps": 0.1 * np.sign(np.sin(0.8 * T))}
    truth = {"dead_time.delay": 0.033, "lag.rise": 0.05, "lag.fall": 0.05, "acceleration_limit.acceleration": 12.0}
    verdict, found = named(followed(truth, commands, seed=4))
    assert set(found) == {"dead_time", "lag", "acceleration_limit"}
    assert "servo.latency" in next(e for e in verdict.effects if e.name == "servo.dead_time").equivalents
    assert found["dead_time"]["delay"] == pytest.approx(0.033, abs=0.004)
    assert found["lag"]["rise"] == pytest.approx(0.05, rel=0.3)  # correlated with the limit
    assert found["acceleration_limit"]["acceleration"] == pytest.approx(12.0, rel=0.1)


@pytest.mark.prove
def test_large_swings_show_drag_and_dry_friction_next_to_the_models_viscous_friction():
    draw = np.random.default_rng(5)
    trials, true = [], {"drag": 0.01, "coulomb_friction": 5e-4}
    for i, amplitude in enumerate((1.4, 1.0, 0.7, 0.4)):
        t, angle = swing(amplitude, 3.0, viscous=-2e-4, dry=5e-4, drag=0.01)
        trials.append(pendulum(angle + 2e-4 * draw.normal(size=len(t)), t, f"swing {i}"))
    verdict = diagnose_table(trials).verdict
    found = {e.name.partition(".")[2]: e.parameters for e in verdict.effects}
    assert (verdict.verdict, set(found)) == ("named", set(true))
    for name, parameter in (("drag", "coefficient"), ("coulomb_friction", "torque")):
        assert found[name][parameter].low < true[name] < found[name][parameter].high


@pytest.mark.prove
@pytest.mark.parametrize("late", [False, True])
def test_either_half_of_every_large_swing_shows_dry_friction_and_drag(data, late):
    """In the first halves, all above 1 rad, the published viscous friction hid both until it vanished."""
    trials = shipped("pendulum-single.yaml", data)
    halves = []
    for each in trials:
        rows = each.channels["measured"]
        kept = (rows.t_s > 0.5 * (rows.t_s[0] + rows.t_s[-1])) == late
        halves.append(replace(each, channels={**each.channels, "measured": rows.kept(kept)}))
    diagnosis = diagnose_table(halves)
    found = {e.name: e.parameters for e in diagnosis.verdict.effects}
    assert (diagnosis.verdict.verdict, set(found)) == ("named", {"joint.coulomb_friction", "joint.drag"})
    assert 4e-4 < found["joint.coulomb_friction"]["torque"].value < 6.5e-4  # the torque of the small swings
    assert 3e-3 < found["joint.drag"]["coefficient"].value < 5e-3
    drag = next(r for r in diagnosis.rivals if r.name == "joint.drag")
    assert drag.conditional.low > 0.2
    assert any("the model's viscous friction vanishes" in text for text in diagnosis.verdict.warnings)


@pytest.mark.prove
def test_dead_band_and_droop_of_a_real_servo_are_named_and_its_delay_reported(data):
    verdict, found = named([t for t in shipped("so101.yaml", data) if t.stage.name == "servo3"])
    assert verdict.verdict == "incomplete"  # eight floors of its gap stay
    members = {name.partition(".")[2] for e in verdict.effects for name in (e.name, *e.equivalents)}
    assert {"deadband", "backlash"} & members  # hardly separable
    assert "gain" in found
    late = ("dead_time", "lag", "second_order")
    unnamed = " ".join(text for text in verdict.warnings if "is not named" in text)
    assert any(name in found or f"servo3.{name}" in unnamed for name in late)
    assert "rate_limit" not in found  # it moves faster than any that would fit
    width = found["deadband"]["width"] if "deadband" in found else found["backlash"]["gap"] / 2
    assert 0.025 < width < 0.045
