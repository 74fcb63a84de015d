"""Columns whose cells hold lists, as in a LeRobot dataset: one file for each episode, one list for all joints."""

import shutil

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError
from tests.diagnosis.data.servo import changed
from validation.mechanisms.record import ROBOTS

STAGE = """
kind: mujoco
channels:
  measured:
    time: {source: timestamp, unit: s}
    columns:
      pan: {source: observation.state, element: 0, unit: deg}
      tilt: {source: observation.state, element: 1, unit: deg}
  command:
    time: {source: timestamp, unit: s}
    columns:
      pan_drive: {source: action, element: 0, unit: deg}
      tilt_drive: {source: action, element: 1, unit: deg}
model: {mjcf: camera.xml}
trials:
  - {files: data/chunk-*/episode_*.parquet}
"""
T = np.arange(0, 4, 1 / 30)
ANGLES = np.rad2deg(np.stack((0.5 * np.sin(2 * T), 0.3 * np.sin(3 * T)), axis=1))


@pytest.fixture
def dataset(tmp_path):
    """A dataset in the layout of LeRobot 2.1, with two episodes."""
    for episode in range(2):
        file = tmp_path / "data" / "chunk-000" / f"episode_{episode:06d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        lists = pa.array(ANGLES.astype(np.float32).tolist(), pa.list_(pa.float32(), 2))
        columns = {"timestamp": T.astype(np.float32), "observation.state": lists, "action": lists}
        parquet.write_table(pa.table(columns), file)
    shutil.copy(ROBOTS["camera"].model, tmp_path / "camera.xml")
    return tmp_path


def test_each_element_is_a_joint_and_each_episode_a_trial(dataset):
    (dataset / "stage.yaml").write_text(STAGE)
    trials = tables.read(dataset / "stage.yaml")
    assert [(trial.name, trial.stage.name) for trial in trials] == [
        ("000-000000/pan", "pan"), ("000-000001/pan", "pan"), ("000-000000/tilt", "tilt"), ("000-000001/tilt", "tilt"),
    ]  # fmt: skip
    for trial in trials:
        assert np.rad2deg(trial.channels["measured"]["tilt"]) == pytest.approx(ANGLES[:, 1], abs=1e-4)


@pytest.mark.parametrize("first", [0, 20241101])
def test_the_episodes_of_one_file_are_split_by_their_column(dataset, first):
    """Version 3 of the format has many episodes in a file, each with stamps from zero."""
    files = sorted((dataset / "data" / "chunk-000").glob("*.parquet"))
    whole = [
        parquet.read_table(file).append_column("episode_index", pa.array([i] * len(T)))
        for i, file in enumerate(files, first)
    ]
    parquet.write_table(pa.concat_tables(whole), dataset / "file-000.parquet")
    text = STAGE.replace("data/chunk-*/episode_*.parquet", "file-000.parquet, split: episode_index")
    (dataset / "stage.yaml").write_text(text)
    trials = tables.read(dataset / "stage.yaml")
    numbers = first, first + 1
    assert {trial.name for trial in trials} == {f"file-000-{i}/{joint}" for i in numbers for joint in ("pan", "tilt")}
    assert all(len(trial.channels["measured"]) == len(T) for trial in trials)


PAN = "pan: {source: observation.state, element: 0"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (PAN, "pan: {source: timestamp, element: 0", "contains plain numbers, not lists; leave `element` out"),
        (PAN, "pan: {source: timestamp, row: 7", "timestamp has no rows to choose from; leave `row` out"),
        ("episode_*.parquet", "episode_*.parquet, split: episode", "no column episode"),
    ],
)
def test_a_place_that_the_columns_lack_is_refused(dataset, old, new, message):
    (dataset / "stage.yaml").write_text(changed(STAGE, (old, new)))
    with pytest.raises(TrialError, match=message):
        tables.read(dataset / "stage.yaml")
