"""The patch of a rig: a stage.yaml of the calibrated model, which the same command diagnoses again."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.rigs import patch
from softarm.diagnosis.rigs.stage import view_of
from tests.diagnosis.rigs.recordings import SERVO, recording
from tests.diagnosis.verdicts import with_parameters as found

T = np.arange(0, 4, 0.01)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def servo(tmp_path):
    """A servo in degrees with a table."""
    command = 20 * np.sin(3 * T)
    rows = "\n".join(f"{t:.3f},{u:.5f},{min(u, 15):.5f}" for t, u in zip(T, command, strict=True))
    write(tmp_path / "sine.csv", f"t,u,y\n{rows}\n")
    return write(tmp_path / "grip.yaml", SERVO)


def viewed(path, data):
    return view_of(tables.read(path, data))[0]


def test_a_patch_is_in_the_units_of_the_table_and_keeps_the_name(servo, tmp_path):
    text = patch.patched(servo, found([("grip.deadband.width", 2.0, "")], [("grip.gain.scale", 0.01, "")]), True)
    view = viewed(write(tmp_path / "other.yaml", text), tmp_path)
    assert view.stage == "grip"
    assert view.nominal("deadband.width") == pytest.approx(np.radians(2.0))
    assert view.nominal("gain.scale") == pytest.approx(0.01)
    nominal, given = viewed(servo, tmp_path), {"grip.deadband.width": np.radians(2.0), "grip.gain.scale": 0.01}
    np.testing.assert_allclose(view.gap([{}]), nominal.gap([given]), atol=1e-6)


def test_a_ceiling_of_the_nominal_model_holds(servo, tmp_path):
    text = patch.patched(servo, found([("grip.ceiling.limit", 15.0, "")]), True)
    gap = viewed(write(tmp_path / "other.yaml", text), tmp_path).gap([{}])
    assert np.nanmax(np.abs(viewed(servo, tmp_path).gap([{}]))) > np.radians(4)
    assert np.nanmax(np.abs(gap)) < np.radians(1)


def test_a_patch_is_patched_again(servo, tmp_path):
    one = write(tmp_path / "one.yaml", patch.patched(servo, found([("grip.deadband.width", 2.0, "")]), True))
    two = yaml.safe_load(patch.patched(one, found((), [("grip.gain.scale", 0.01, "")]), True))
    assert two["effects"] == {"grip.deadband": {"width": 2.0}, "grip.gain": {"scale": 0.01}}


def test_without_findings_there_is_no_patch(servo):
    assert patch.patched(servo, found(), True) is None
    assert patch.patched(servo, found((), [("grip.gain.scale", 0.01, "")]), False) is None


@pytest.mark.parametrize("inertia", ["inertia_kg_m2", "inertia_joint_kg_m2"])
def test_the_masses_of_a_chain_are_calibrated_in_its_model(inertia, tmp_path):
    t = np.arange(0, 6, 0.01)
    swing = np.stack([0.3 * np.cos(5 * t), 0.4 * np.cos(5 * t)])
    np.savetxt(tmp_path / "swing.csv", np.stack([t, *swing], axis=1), delimiter=",", header="t,a,b", comments="")
    columns = {f"angle{i}": {"source": name, "unit": "rad"} for i, name in ((1, "a"), (2, "b"))}
    stage = {
        "name": "arm",
        "kind": "chain",
        "links": 2,
        "channels": {"measured": {"time": {"source": "t", "unit": "s"}, "columns": columns}},
        "model": {"mass_kg": [1.0, 0.5], "centre_m": [0.2, 0.1], "length_m": [0.4], inertia: [0.05, 0.02]},
        "trials": [{"files": "swing.csv"}],
    }
    path = write(tmp_path / "stage.yaml", yaml.safe_dump(stage))
    changes = [("arm.mass1", 0.02, ""), ("arm.inertia1", -0.01, ""), ("arm.mass2", 0.01, "")]
    text = patch.patched(path, found((), changes), True)
    own = np.array([0.05, 0.02]) - (0.0 if inertia == "inertia_kg_m2" else np.array([0.04, 0.005]))
    stage["model"].pop("inertia_joint_kg_m2", None)
    stage["model"] |= {"mass_kg": [1.02, 0.505], "inertia_kg_m2": (own * (0.99, 1.0)).tolist()}
    wanted = write(tmp_path / "wanted.yaml", yaml.safe_dump(stage))
    gap, right = (viewed(each, tmp_path).gap([{}]) for each in (write(tmp_path / "other.yaml", text), wanted))
    np.testing.assert_allclose(gap, right, atol=1e-6)


@pytest.mark.parametrize(
    ("effects", "text"),
    [
        ("{claw.gain: {scale: 0.1}}", "no mechanism claw"),
        ("{grip.slack: {gap: 0.1}}", "grip.slack: unknown, or no effect that"),
        ("{grip.gain: {size: 0.1}}", "grip.gain.size: unknown parameter"),
        ("{grip.second_order: {frequency: 0}}", "grip.second_order.frequency: is 0; allowed above 0 Hz"),
        ("{grip.rate_limit: {rate: -5}}", "grip.rate_limit.rate: is -5; allowed above 0 deg/s"),
        ("{grip.lag: {rise: -0.1}}", "grip.lag.rise: is -0.1; allowed 0 or more s"),
    ],
)
def test_a_wrong_effect_is_refused_with_what_there_is(effects, text, servo, tmp_path):
    path = write(tmp_path / "other.yaml", f"name: grip\n{SERVO}effects: {effects}\n")
    with pytest.raises(TrialError, match=text):
        viewed(path, tmp_path)


@pytest.mark.parametrize(
    ("effect", "values", "text"),
    [
        ("mass", {"scale": -1.0}, "cart.mass.scale: is -1; allowed above -1"),
        ("stiction", {"force": 1.0, "speed": 0.0}, "cart.stiction.speed: is 0; allowed above 0 m/s"),
        ("coulomb_friction", {"force": -3.0}, "cart.coulomb_friction.force: is -3; allowed 0 or more N"),
    ],
)
def test_an_effect_without_a_physical_meaning_is_refused(effect, values, text):
    channels = {"force": {"force": np.sin(3 * T)}, "measured": {"position": -0.05 * np.sin(3 * T)}}
    trial = recording("push", "sine", T, channels, ("cart", "driven_mass", {"mass_kg": 2.0}))
    stage = replace(trial.stage, effects={effect: values})
    with pytest.raises(TrialError, match=text):
        view_of([replace(trial, stage=stage)])
