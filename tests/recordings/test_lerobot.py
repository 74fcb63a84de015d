"""Logs as a LeRobot dataset: the fields that its loader needs, and the numbers of the log."""

import json

import numpy as np
import pytest
from pyarrow import parquet

from softarm.daemon.logbook.ticks import TickFile
from softarm.recordings import lerobot, tables


@pytest.fixture(scope="module")
def dataset(log, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    return folder, lerobot.write(folder, lerobot.episodes(log.path))


def test_each_reach_goal_is_an_episode_with_the_inputs_and_actions_of_its_ticks(log, dataset):
    folder, written = dataset
    data = parquet.read_table(folder / "data/chunk-000/file-000.parquet")
    ticks = {name: np.array(values) for name, values in tables.ticks(log).items()}
    running = (ticks["goal_state"] == "running") & (ticks["goal_kind"] == "reach")
    numbers = np.unique(ticks["goal_number"][running])
    assert written.episodes == len(numbers)
    assert written.frames == data.num_rows == running.sum()
    state, action = (np.stack(data[name].to_numpy()) for name in ("observation.state", "action"))
    assert state[:, 2] == pytest.approx(ticks["observed_tip_y_m"][running], abs=1e-6)
    assert state[:, 8] == pytest.approx(ticks["target_y_m"][running], abs=1e-6)
    assert action[:, 1] == pytest.approx(ticks["action_pressure_kpa"][running], abs=1e-5)
    ends = [ticks["goal_state"][ticks["goal_number"] == number][-1] for number in numbers]
    success = np.array(data["next.success"])[np.array(data["next.done"])]
    assert success.tolist() == [end == "reached" for end in ends]
    assert written.reached == success.sum() > 0


def test_the_files_and_fields_are_those_of_format_3(dataset):
    folder, written = dataset
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 30, written.episodes)
    assert info["features"]["observation.state"]["shape"] == [10]
    assert info["features"]["action"]["names"] == ["cart_velocity_m_s", "pressure_kpa"]
    data = parquet.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(data.column_names) == set(info["features"])
    assert np.array(data["index"]).tolist() == list(range(info["total_frames"]))
    episodes = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for one in episodes:
        own = np.array(data["episode_index"])[one["dataset_from_index"] : one["dataset_to_index"]]
        assert set(own) == {one["episode_index"]}
        assert one["length"] == len(own)
        assert one["stats/action/count"] == [len(own)]
    statistics = json.loads((folder / "meta/stats.json").read_text())
    assert set(statistics) == set(info["features"])
    tasks = parquet.read_table(folder / "meta/tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]


def test_a_goal_with_a_missed_tick_is_left_out_and_counted(log, tmp_path):
    found = list(lerobot.episodes(log.path))
    written = lerobot.write(tmp_path, [None, *found])
    assert (written.episodes, written.left_out) == (len(found), 1)
    rows = [(tick, [0.0] * 10, [0.0, 0.0]) for tick in (1, 2, 4)]
    assert lerobot.complete(rows, True) is None


def test_a_goal_that_runs_at_the_end_of_a_log_is_left_out_and_counted(log, tmp_path):
    with (tmp_path / "killed.mcap").open("wb") as file:
        writer = TickFile(file)
        for inputs, outputs, timing in log:
            writer.write((inputs, outputs, timing))
            if outputs.goal.number == 2 and outputs.goal.state == "running":
                break
        writer.flush()
    first, second = lerobot.episodes(tmp_path / "killed.mcap")
    assert first is not None
    assert second is None


def test_a_log_without_a_complete_goal_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no complete reach goal; 1 are incomplete"):
        lerobot.write(tmp_path / "none", [None])
    assert not (tmp_path / "none").exists()


def test_only_an_own_dataset_is_replaced(log, dataset, tmp_path):
    folder, written = dataset
    assert lerobot.write(folder, lerobot.episodes(log.path)) == written
    for other in ("data/thesis.txt", "meta/info.json"):
        file = tmp_path / other[:4] / other
        file.parent.mkdir(parents=True)
        file.write_text("{}")
        with pytest.raises(ValueError, match="only a dataset of `softarm logs export` is replaced"):
            lerobot.write(tmp_path / other[:4], lerobot.episodes(log.path))
        assert [each for each in file.parents[1].rglob("*") if each.is_file()] == [file]


def test_a_dataset_is_read_as_it_was_written(log, dataset):
    folder, _ = dataset
    for read, wrote in zip(lerobot.read(folder), lerobot.episodes(log.path), strict=True):
        assert np.array_equal(read.state, wrote.state)
        assert np.array_equal(read.action, wrote.action)
        assert read.reached == wrote.reached


def test_a_dataset_of_format_2_with_a_file_for_each_episode_is_read(log, dataset, tmp_path):
    folder, written = dataset
    data = parquet.read_table(folder / "data/chunk-000/file-000.parquet")
    info = json.loads((folder / "meta/info.json").read_text()) | {"codebase_version": "v2.1"}
    (tmp_path / "data/chunk-000").mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text(json.dumps(info))
    numbers = np.array(data["episode_index"])
    for number in range(written.episodes):
        one = data.filter(numbers == number)
        parquet.write_table(one, tmp_path / f"data/chunk-000/episode_{number:06d}.parquet")
    lengths = [len(episode.state) for episode in lerobot.episodes(log.path)]
    assert [len(episode.state) for episode in lerobot.read(tmp_path)] == lengths
