"""Rail motion in logs and trial folders."""

from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.data.read import rail_motions
from softarm.diagnosis.data.trials import TrialError
from softarm.schemas.config import Config

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"


def test_rail_motion_is_read_from_logs_and_trial_folders_only(tmp_path):
    trial, without, table = tmp_path / "a", tmp_path / "b", tmp_path / "stage.yaml"
    for folder in (trial, without):
        folder.mkdir()
        (folder / "trial.yaml").write_text("kind: dashes\n")
        (folder / "command.csv").write_text("t,cart_velocity,pressure\n0.0,0.5,0\n0.1,-0.5,0\n")
    (trial / "rail.csv").write_text("t,position,velocity\n0.0,0.0,0.0\n0.02,0.001,0.1\n0.04,0.004,0.2\n")
    table.write_text("name: servo\n")
    (tmp_path / "flight.mcap").write_bytes(FLIGHT.read_bytes())
    folder, log = rail_motions([tmp_path, table])
    assert folder.source == trial
    assert folder.set_point_m_s.tolist() == [0.5, -0.5]
    assert folder.velocity_m_s.tolist() == [0.0, 0.1, 0.2]
    assert folder.obeyed.all()
    assert folder.config is None
    assert isinstance(log.config, Config)
    assert np.abs(log.velocity_m_s).max() > 0.5


def test_an_invalid_log_is_rejected(tmp_path):
    (tmp_path / "a.mcap").write_text("invalid")
    with pytest.raises(TrialError, match="not a log"):
        rail_motions([tmp_path])
