"""Tables of rigs: CSV, Parquet and .mat give the same trial, and public data sets can be read."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError
from tests.diagnosis.data import servo
from tests.diagnosis.data.servo import changed

STAGES = Path(tables.__file__).parents[1] / "rigs" / "stages"
T = np.arange(50) * 0.02
COMMAND, MEASURED = np.sin(T), np.degrees(np.sin(T - 0.1))
STAGE = changed(servo.STAGE, ("t, unit: s", "t, unit: ms"), ("y, unit: rad", "y, unit: deg, add: 1.0"))
STAGE = changed(STAGE, ("trials:", "model: {lag_s: 0.05}\ntrials:"), ("files: data.csv", "files: FILE"))


def put(folder, suffix):
    path = folder / f"data{suffix}"
    columns = {"t": T * 1e3, "u": COMMAND, "y": MEASURED}
    if suffix == ".csv":
        rows = zip(*(c.tolist() for c in columns.values()), strict=True)
        path.write_text("t,u,y\n" + "\n".join(",".join(map(repr, row)) for row in rows) + "\n")
    elif suffix == ".parquet":
        parquet.write_table(pa.table(columns), path)
    else:
        savemat(path, columns)
    stage = folder / "stage.yaml"
    stage.write_text(STAGE.replace("FILE", path.name))
    return stage


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
def test_every_format_gives_the_same_values(tmp_path, suffix):
    (trial,) = tables.read(put(tmp_path, suffix))
    assert (trial.name, trial.kind, trial.stage.name, trial.stage.kind) == ("one", "sine", "servo", "tracking")
    assert trial.stage.model == {"lag_s": 0.05}
    np.testing.assert_allclose(trial.channels["measured"].t_s, T, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(trial.channels["command"]["command"], COMMAND, rtol=1e-12)
    np.testing.assert_allclose(trial.channels["measured"]["position"], np.sin(T - 0.1) + 1.0, rtol=1e-12)


def test_a_damaged_mat_file_is_rejected_even_if_it_crashes_scipy(tmp_path):
    stage = put(tmp_path, ".mat")
    data = bytearray((tmp_path / "data.mat").read_bytes())
    data[144] ^= 0xDB
    (tmp_path / "data.mat").write_bytes(data)
    with pytest.raises(TrialError, match=r"data\.mat: "):
        tables.read(stage)


def test_degrees_declared_as_radians_are_reported(tmp_path):
    stage = put(tmp_path, ".csv")
    stage.write_text(stage.read_text().replace("unit: deg", "unit: rad"))
    with pytest.raises(TrialError, match=r"data\.csv: column y: position moves 60.1 times .* position looks like deg"):
        tables.read(stage)
    stage.write_text(stage.read_text().replace("lag_s: 0.05", "gain: 57"))
    (trial,) = tables.read(stage)
    assert "position goes up to 44.16 rad (from y); is it in degrees?" in trial.warnings[0]


def test_lists_in_cells_give_a_stage_for_each_element(tmp_path):
    rows = "\n".join(f'{1e3 * t!r},"[{u!r}, {2 * u!r}]"' for t, u in zip(T.tolist(), COMMAND.tolist(), strict=True))
    (tmp_path / "data.csv").write_text("t,u\n" + rows + "\n")
    stage = tmp_path / "stage.yaml"
    text = STAGE.replace("FILE", "data.csv").replace("source: y, unit: deg, add: 1.0", "source: u, unit: rad")
    stage.write_text(text.replace("kind: tracking", "kind: tracking\nelements: {a: 0, b: 1}"))
    a, b = tables.read(stage)
    assert (a.name, b.name, b.stage.name) == ("one/a", "one/b", "b")
    np.testing.assert_array_equal(b.channels["measured"]["position"], 2 * COMMAND)
    stage.write_text(text.replace("kind: tracking", "kind: tracking\nelements: {a: 2}"))
    with pytest.raises(TrialError, match=r"column u, row 2: \[.*\] has no number at place 2"):
        tables.read(stage)


@pytest.mark.prove
@pytest.mark.parametrize(("stage", "doubted"), [("so101", {"servo6"}), ("so101-mujoco", set())])
def test_recordings_of_public_servos_are_read_with_one_doubt(data, stage, doubted):
    """Servo 6 states 2.2 times its velocity."""
    trials = tables.read(STAGES / f"{stage}.yaml", data)
    assert len(trials) == 30
    assert {t.stage.name for t in trials if t.warnings} == doubted
    assert all("times the slope of position" in warning for t in trials for warning in t.warnings)
    if stage == "so101":
        servo = next(t for t in trials if t.name == "step-response/servo3")
        lag = np.corrcoef(servo.channels["command"]["command"], servo.channels["measured"]["position"])[0, 1]
        assert 0.9 < lag < 1.0


def test_public_recordings_of_pendulums_are_read_without_a_warning(data):
    stages = ("double-pendulum", "pendulum-free", "pendulum-single", "pendulum-triple")
    trials = [trial for stage in stages for trial in tables.read(STAGES / f"{stage}.yaml", data)]
    assert sum(trial.stage.kind == "pendulum" for trial in trials) == 1 + 6 + 26
    assert [w for t in trials for w in t.warnings] == []
    free = next(t for t in trials if t.name == "free-swing-1").channels["measured"]
    assert len(free) == 231_757
    assert np.abs(free["angle1"]).max() < 0.07  # hangs at zero, swings about 4 degrees
    assert np.ptp(free.t_s) == pytest.approx(23.1756)


@pytest.mark.parametrize(
    ("model", "inside"),
    [
        ("gain: 50, offset: 0.1, lag_s: 0.05", {"gain": 5e6, "offset": 10.0, "lag_s": 0.05}),
        ("map: [[-1, -60], [1, 60]], rate_limit: 3", {"map": ((-0.001, -6e3), (0.001, 6e3)), "rate_limit": 300.0}),
    ],
)
def test_model_parameters_are_converted_to_standard_units(tmp_path, model, inside):
    stage = put(tmp_path, ".csv")
    text = changed(STAGE, ("u, unit: rad", "u, unit: mV"), ("lag_s: 0.05", model), ("FILE", "data.csv"))
    stage.write_text(changed(text, ("position: {source: y, unit: deg, add: 1.0}", "pressure: {source: y, unit: bar}")))
    (trial,) = tables.read(stage)
    assert trial.stage.model.keys() == inside.keys()
    for key, value in inside.items():
        assert np.asarray(trial.stage.model[key]) == pytest.approx(np.asarray(value))
    assert trial.stage.units["measured"]["pressure"] == ("bar", 100.0, "kPa")
    assert (trial.stage.unit("command", "command"), trial.stage.unit("measured", "velocity")) == ("V", "")


CHAIN = """
name: arm
kind: chain
links: 2
angles: relative
channels:
  measured:
    time: {source: t, unit: s}
    columns: {angle1: {source: a, unit: rad}, angle2: {source: b, unit: deg}, rate1: {source: w, unit: rad/s}}
  torque: {time: {source: t, unit: s}, columns: {torque2: {source: m, unit: mN m}}}
model: {mass_kg: [1, 1], centre_m: [0.1, 0.1], inertia_kg_m2: [0, 0], length_m: [0.2]}
trials: [{name: one, kind: sine, files: data.csv}]
"""


def test_relative_angles_of_a_chain_are_absolute_in_memory(tmp_path):
    text = servo.table("t,a,b,w,m", T, np.sin(T), np.cos(T), T, 0.3 * T)
    (trial,) = servo.read(tmp_path, text, stage=CHAIN)
    measured = trial.channels["measured"]
    np.testing.assert_allclose(measured["angle2"], np.sin(T) + np.radians(np.cos(T)), atol=1e-8)
    np.testing.assert_allclose(measured["angle1"], np.sin(T), atol=1e-8)
    np.testing.assert_allclose(measured["rate1"], T, atol=1e-8)
    np.testing.assert_allclose(trial.channels["torque"]["torque2"], 0.3e-3 * T, atol=1e-8)
