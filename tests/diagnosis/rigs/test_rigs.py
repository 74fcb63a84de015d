"""Views of rigs: laws against closed forms, effects against the registry, diagnoses of simulated and real tables."""

import re
from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import Series, TableStage, Trial
from softarm.diagnosis.engine.folds import interleaved
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.rigs.candidates import nuisances
from softarm.diagnosis.rigs.chain.model import chain_of
from softarm.diagnosis.rigs.chain.shooting import swing as swung
from softarm.diagnosis.rigs.chain.view import ChainView
from softarm.diagnosis.rigs.diagnose import diagnose_table, view_of
from softarm.diagnosis.rigs.driven_mass import DrivenMassView
from softarm.diagnosis.rigs.grid import grid, windows
from softarm.diagnosis.rigs.laws import chain as law
from softarm.diagnosis.rigs.tracking import TrackingView, velocity_warnings
from softarm.simulator.effects import REGISTRY

MODEL = {
    "mass_kg": 0.15,
    "centre_m": 0.15,
    "inertia_kg_m2": 1e-4,
    "damping_nm_s_rad": 2e-4,
    "gravity_m_s2": 9.81,
}


def servo(command, position, t, kind="multisine", name="one", **more):
    channels = {
        "command": Series(t.copy(), {"command": command.copy()}),
        "measured": Series(t.copy(), {"position": position.copy(), **more}),
    }
    return Trial(name, kind, Path(name), channels, stage=TableStage("servo", "tracking", {}))


def pendulum(angle, t, name="swing", model=MODEL):
    columns = {f"angle{i + 1}": np.ascontiguousarray(a) for i, a in enumerate(np.atleast_2d(angle))}
    return Trial(
        name,
        "free swing",
        Path(name),
        {"measured": Series(t.copy(), columns)},
        stage=TableStage("joint", "pendulum", model),
    )


def tone(t, seed=0):
    draw = np.random.default_rng(seed)
    return sum(
        0.05 * np.sin(2 * np.pi * f * t + p) for f, p in zip((0.2, 0.5, 1.1, 2.3), draw.uniform(0, 6, 4), strict=True)
    )


T = np.arange(0, 16, 0.02)


def follow(point, command=None, t=T, start=0.0):
    """Return the prediction of the view: measured minus gap."""
    command = tone(t) if command is None else command
    view = TrackingView([servo(command, np.full_like(t, start), t)])
    return view.measured[:, 0] - view.gap([{f"servo.{k}": v for k, v in point.items()}])[0, :, 0]


def cart(nominal):
    channels = {
        "force": Series(T.copy(), {"force": np.sin(3 * T)}),
        "measured": Series(T.copy(), {"position": -0.05 * np.sin(3 * T)}),
    }
    return Trial("push", "sine", Path("push"), channels, stage=TableStage("cart", "driven_mass", nominal))


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


def test_only_a_wrong_velocity_gives_a_warning():
    y = np.sin(T)
    slope = np.gradient(y, T)
    assert velocity_warnings([servo(y, y, T, velocity=slope)]) == []
    (text,) = velocity_warnings([servo(y, y, T, velocity=2.2 * slope)])
    assert "servo: the measured velocity is 2.2 times the slope of its position" in text


def swing(point, amplitude=0.3, seconds=12.0, model=MODEL, rate_hz=100.0):
    """Simulate a swing with the law, from rest at an amplitude."""
    chain = chain_of(TableStage("joint", "pendulum", model))
    rows, n = chain.rows(), chain.n
    table = rows[: law.EACH * n].reshape(law.EACH, n)
    table[law.VISCOUS] *= point.get("damping", 1.0)
    table[law.DRY], table[law.GIVE] = point.get("torque", 0.0), 3e-4
    rows[law.EACH * n + law.DRAG] = point.get("drag", 0.0)
    steps = round(seconds * rate_hz)
    state = np.concatenate((np.full(n, amplitude), np.zeros(2 * n)))[None, None]
    still = np.zeros((1, 4 * steps, n)), np.zeros((1, 4 * steps))
    out = swung(rows[None], state, *still, 0.25 / rate_hz, 4)[0, 0]
    return np.arange(len(out)) / rate_hz, out


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


def test_windows_contain_every_sample_once():
    t, angle = swing({}, 0.3, 12.0)
    trial = pendulum(angle[:, 0], t)
    parts = windows(trial, 3.0)
    assert len(parts) == 4
    np.testing.assert_array_equal(np.concatenate([p.channels["measured"].t_s for p in parts]), t)
    assert len({p.name for p in parts}) == 4


def test_trials_are_cut_into_windows_and_held_out_whole():
    t, angle = swing({}, 0.3, 12.0)
    trials = [pendulum(angle[:, 0], t, f"swing {i}") for i in range(4)]
    view, found = view_of(trials)
    parts, origins = found.trials, found.origins
    assert len(parts) == 4 * len(ChainView.windows(trials[0])) == 16
    assert [trials[k].name for k in origins] == [part.name.split(" from")[0] for part in parts]
    setup = Setup([view], nuisances(view), [t.kind for t in parts], origins)
    assert setup.held_out == "trial"
    assert [int(f) for f in setup.fold] == [origins[trial] for trial, _ in setup.blocks]


def test_a_perfect_model_has_no_gap():
    draw = np.random.default_rng(2)
    trials = []
    for i in range(4):
        t, angle = swing({}, 0.1 + 0.05 * i, 3.0)
        trials.append(
            pendulum(np.round((angle[:, 0] + 1e-4 * draw.normal(size=len(t))) / 4e-4) * 4e-4, t, f"swing {i}")
        )
    verdict = diagnose_table(trials).verdict
    assert (verdict.verdict, verdict.effects) == ("none", ())


def test_dead_band_and_droop_of_a_servo_are_named():
    draw = np.random.default_rng(3)
    truth = {"deadband.width": 0.03, "gain.offset": 0.04}
    trials = []
    for i, kind in enumerate(("multisine", "steps", "slow")):
        steps, slow = 0.15 * np.sign(np.sin(0.8 * T)), 0.2 * np.sin(0.3 * T)
        command = {"multisine": tone(T, i), "steps": steps, "slow": slow}[kind]
        seen = np.nan_to_num(follow(truth, command), nan=0.0)
        trials.append(servo(command, np.round((seen + 2e-4 * draw.normal(size=len(T))) / 1e-3) * 1e-3, T, kind, kind))
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


def swept(t, seed):
    """Return a sweep up to 3 Hz, which a motor's limited torque cannot follow."""
    return 0.12 * np.sin(2 * np.pi * (0.2 * t + 1.4 * t**2 / t[-1]) + seed)


def late_servo():
    """Return trials of a servo with dead time, lag and limited torque under three commands."""
    draw = np.random.default_rng(4)
    truth = {"dead_time.delay": 0.033, "lag.rise": 0.05, "lag.fall": 0.05, "acceleration_limit.acceleration": 12.0}
    trials = []
    for i, kind in enumerate(("sweep", "multisine", "steps")):
        command = {"sweep": swept(T, i), "multisine": tone(T, i), "steps": 0.1 * np.sign(np.sin(0.8 * T))}[kind]
        seen = np.nan_to_num(follow(truth, command), nan=0.0)
        trials.append(servo(command, np.round((seen + 2e-4 * draw.normal(size=len(T))) / 1e-3) * 1e-3, T, kind, kind))
    return trials


@pytest.mark.prove
def test_a_late_servo_is_split_into_dead_time_lag_and_acceleration_limit():
    verdict = diagnose_table(late_servo()).verdict
    found = {e.name.partition(".")[2]: e for e in verdict.effects}
    assert set(found) == {"dead_time", "lag", "acceleration_limit"}
    assert "servo.latency" in found["dead_time"].equivalents  # only the sum shows
    assert found["dead_time"].parameters["delay"].value == pytest.approx(0.033, abs=0.004)
    assert found["lag"].parameters["rise"].value == pytest.approx(0.05, rel=0.3)  # correlated with the limit
    assert found["acceleration_limit"].parameters["acceleration"].value == pytest.approx(12.0, rel=0.1)


@pytest.mark.slow
def test_large_swings_show_drag_and_dry_friction_next_to_the_models_viscous_friction():
    draw = np.random.default_rng(5)
    trials, true = [], {"drag": 0.01, "coulomb_friction": 5e-4}
    for i, amplitude in enumerate((1.4, 1.0, 0.7, 0.4)):
        t, angle = swing({"damping": 0.0, "torque": 5e-4, "drag": 0.01}, amplitude, 3.0)
        trials.append(pendulum(angle[:, 0] + 2e-4 * draw.normal(size=len(t)), t, f"swing {i}"))
    verdict = diagnose_table(trials).verdict
    found = {e.name.partition(".")[2]: e.parameters for e in verdict.effects}
    assert (verdict.verdict, set(found)) == ("named", set(true))
    for name, parameter in (("drag", "coefficient"), ("coulomb_friction", "torque")):
        assert found[name][parameter].low < true[name] < found[name][parameter].high


def test_the_search_holds_out_blocks_and_the_verdict_whole_kinds():
    trials = late_servo()
    view, found = view_of(trials)
    setup = Setup([view], nuisances(view), [t.kind for t in found.trials], found.origins)
    searched = dict(zip(setup.blocks, interleaved(setup.blocks), strict=True))
    for k in range(len(trials)):
        assert len({fold for (trial, _), fold in searched.items() if trial == k}) >= 3
        assert len({fold for (trial, _), fold in zip(setup.blocks, setup.fold, strict=True) if trial == k}) == 1
    assert setup.held_out == "kind"


def named(stage, data, element=None, verdict="named"):
    trials = tables.read(Path(tables.__file__).parents[1] / "rigs" / "stages" / stage, data)
    diagnosis = diagnose_table([t for t in trials if element in (None, t.stage.name)])
    assert diagnosis.verdict.verdict == verdict
    return diagnosis, {e.name.partition(".")[2]: e.parameters for e in diagnosis.verdict.effects}


@pytest.mark.prove
def test_large_swings_of_a_real_pendulum_show_dry_friction_and_drag(data):
    diagnosis, found = named("pendulum-single.yaml", data)
    assert set(found) == {"coulomb_friction", "drag"}
    assert 4e-4 < found["coulomb_friction"]["torque"].value < 6.5e-4  # the torque of the small swings
    drag = next(r for r in diagnosis.rivals if r.name == "joint.drag")
    assert drag.conditional.low > 0.2
    assert any("the model's viscous friction vanishes" in text for text in diagnosis.verdict.warnings)


@pytest.mark.prove
def test_dead_band_and_droop_of_a_real_servo_are_named_and_its_delay_reported(data):
    diagnosis, found = named("so101.yaml", data, "servo3", "incomplete")  # eight floors of its gap stay
    members = {name.partition(".")[2] for e in diagnosis.verdict.effects for name in (e.name, *e.equivalents)}
    assert {"deadband", "backlash"} & members  # hardly separable
    assert "gain" in found
    late = ("dead_time", "lag", "second_order")
    unnamed = " ".join(text for text in diagnosis.verdict.warnings if "is not named" in text)
    assert any(name in found or f"servo3.{name}" in unnamed for name in late)
    assert "rate_limit" not in found  # it moves faster than any that would fit
    width = found["deadband"]["width"].value if "deadband" in found else found["backlash"]["gap"].value / 2
    assert 0.025 < width < 0.045
