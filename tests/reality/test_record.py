"""A recorded trial contains the measurements in the files of the trial format."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from softarm.reality.parameters import Clock, RobotParameters
from softarm.reality.record import SETTLE_S, record
from softarm.reality.robot import Robot

LINKS = [f"link{i}_{part}" for i in range(1, 6) for part in ("y", "z", "angle")]
COLUMNS = {
    "command": ["t", "cart_velocity", "pressure"],
    "pressure": ["t", "pressure"],
    "rail": ["t", "position", "velocity"],
    "mocap": ["t_capture", "t_receive", "cart_y", "cart_z", "cart_angle", *LINKS],
    "observation": [
        *("t", "cart_position", "cart_velocity", "tip_y", "tip_z", "tip_vy", "tip_vz"),
        *("previous_cart_velocity_command", "pressure"),
    ],
}


def swing(t_s: float) -> tuple[float, float]:
    return 0.4 * np.sin(4 * t_s), 8.0 + 6.0 * np.cos(3 * t_s)


def table(folder: Path, name: str) -> Any:
    return np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True, deletechars="")


def read(folder: Path) -> dict[str, Any]:
    return {name: table(folder, name) for name in COLUMNS}


def test_a_trial_folder_has_the_formats_files_and_columns(tmp_path: Path) -> None:
    folder = record(swing, tmp_path / "campaign" / "swing", 1.0, kind="sine")
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        [*(f"{name}.csv" for name in COLUMNS), "trial.yaml"]
    )
    assert yaml.safe_load((folder / "trial.yaml").read_text()) == {"kind": "sine", "rail": "free"}
    for name, table in read(folder).items():
        assert list(table.dtype.names) == COLUMNS[name]
        assert all(np.isfinite(table[column]).all() for column in table.dtype.names)


def test_the_files_contain_the_robots_measurements(tmp_path: Path) -> None:
    """The same commands given to a second robot by hand yield the file's numbers, digit for digit."""
    parameters = replace(RobotParameters(), clock=Clock(tick_jitter_s=0.003))
    trial = read(record(swing, tmp_path / "trial", 1.0, parameters, seed=5, kind="sine"))
    robot = Robot(parameters, seed=5, hanging=True)
    robot.command(0.0, 0.0, 0.0)
    robot.advance(SETTLE_S)
    robot.mocap(), robot.pressure(), robot.rail()
    for t, velocity, pressure in trial["command"].tolist():
        robot.command(t, velocity, pressure)
        assert (velocity, pressure) != (0.0, 0.0)
    robot.advance(SETTLE_S + 1.0)
    frames = [(f.t_capture_ns, f.t_receive_ns, *(v for pose in f.bodies for v in pose[:3])) for f in robot.mocap()]
    recorded = np.array(trial["mocap"].tolist())
    np.testing.assert_array_equal(recorded[:, 2:], np.array(frames)[:, 2:])
    np.testing.assert_allclose(recorded[:, :2], 1e-9 * np.array(frames)[:, :2], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(trial["pressure"]["pressure"], [r.pressure_kpa for r in robot.pressure()])
    np.testing.assert_array_equal(trial["rail"]["position"], [r.position_m for r in robot.rail()])


def test_the_observation_is_the_newest_frame_and_first_differences(tmp_path: Path) -> None:
    trial = read(record(swing, tmp_path / "trial", 1.0, kind="sine"))
    observed, mocap = trial["observation"], trial["mocap"]
    for before, now, sent in zip(observed[1:-1], observed[2:], trial["command"][1:-1], strict=True):
        new = mocap[np.searchsorted(mocap["t_receive"], now["t"] + 1e-9) - 1]
        old = mocap[np.searchsorted(mocap["t_receive"], before["t"] + 1e-9) - 1]
        step = new["t_capture"] - old["t_capture"]
        assert step == pytest.approx(1 / 30, abs=0.01)
        assert (now["tip_y"], now["tip_z"]) == (new["link5_y"], new["link5_z"])
        assert now["tip_vy"] == pytest.approx((new["link5_y"] - old["link5_y"]) / step, rel=1e-6)
        assert now["cart_velocity"] == pytest.approx((new["cart_y"] - old["cart_y"]) / step, rel=1e-6)
        assert now["previous_cart_velocity_command"] == sent["cart_velocity"]


def test_the_same_arguments_write_the_same_bytes_and_another_seed_does_not(tmp_path: Path) -> None:
    one, again, other = (
        record(swing, tmp_path / name, 0.5, seed=seed, kind="sine") for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    for path in one.iterdir():
        assert path.read_bytes() == (again / path.name).read_bytes()
    assert (one / "mocap.csv").read_bytes() != (other / "mocap.csv").read_bytes()


def test_an_irregular_controller_ticks_late_and_skips_ticks(tmp_path: Path) -> None:
    clock = Clock(tick_jitter_s=0.005, missed_ticks=0.2)
    trial = record(swing, tmp_path / "trial", 5.0, replace(RobotParameters(), clock=clock), kind="sine")
    command = table(trial, "command")
    late_s = (command["t"] - SETTLE_S) % (1 / 30)
    assert len(command) == pytest.approx(0.8 * 150, abs=12)
    assert np.sqrt(np.mean(late_s**2)) == pytest.approx(0.005, rel=0.2)
    regular = table(record(swing, tmp_path / "regular", 1.0, kind="sine"), "command")["t"]
    np.testing.assert_allclose(np.diff(regular), 1 / 30, atol=2e-9)


def test_a_clamped_cart_does_not_move_while_the_arm_bends(tmp_path: Path) -> None:
    folder = record(lambda t: (0.5, 15.0), tmp_path / "held", 1.0, kind="step", held=True)
    trial = read(folder)
    assert yaml.safe_load((folder / "trial.yaml").read_text())["rail"] == "held"
    np.testing.assert_allclose(trial["rail"]["position"], 0.0, atol=1e-5)
    assert trial["mocap"]["link5_y"][-1] < trial["mocap"]["link5_y"][0] - 0.02


def test_a_recording_never_overwrites_and_needs_a_duration(tmp_path: Path) -> None:
    record(swing, tmp_path / "trial", 0.2, kind="sine")
    with pytest.raises(FileExistsError, match="is not empty; name a new folder"):
        record(swing, tmp_path / "trial", 0.2, kind="sine")
    with pytest.raises(ValueError, match=r"duration_s is 0; give 0.1 to 3600 seconds"):
        record(swing, tmp_path / "none", 0, kind="sine")
