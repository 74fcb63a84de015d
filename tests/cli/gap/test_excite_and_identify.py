"""Tests of `softarm excite` and `softarm identify`."""

import json
import re
from pathlib import Path

import pytest

from softarm.daemon.config import configuration
from softarm.schemas.config import Config
from softarm.simulator import model_file
from tests.cli.invoke import succeed

FILES = {"--out": "m.yaml", "--json": "m.json", "--plots": "pictures", "--limits": "limits-patch.yaml"}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("excite")
    config = folder / "softarm.yaml"
    config.write_text(f"recorder: {{directory: {folder / 'logs'}}}\n")
    outcome = succeed("excite", "pressure-multisine", "--simulated", "--config", config)
    (log,) = (folder / "logs").glob("*.mcap")
    assert f"next: softarm identify {log} --out model.yaml" in outcome.output
    return log


@pytest.mark.slow
def test_identify_writes_a_model_results_and_plots(recorded, tmp_path):
    files = {option: tmp_path / name for option, name in FILES.items()}
    outcome = succeed("identify", recorded, *(word for pair in files.items() for word in pair))
    fitted = model_file.load(tmp_path / "m.yaml").arm
    assert fitted.stiffness_nm_rad[0] == pytest.approx(0.8385, rel=0.01)
    assert fitted.muscle_gain_nm_kpa[2] == pytest.approx(0.0113, rel=0.02)
    written = json.loads((tmp_path / "m.json").read_text())
    assert written["torque_rmse_nm"]["refined"] < 0.02
    assert len(written["parameters"]) == 20
    # The cart stood still: nothing is known of its rail, and nothing is patched.
    assert "# Left out: " in (tmp_path / "limits-patch.yaml").read_text()
    assert configuration.load(tmp_path / "limits-patch.yaml") == Config()
    assert written["limits"]["rail"]["braking_m_s2"]["measured"] is None
    assert "no held-out excitation" in outcome.output
    pictures = sorted(p.name for p in (tmp_path / "pictures").iterdir())
    assert pictures == ["parameters.png", f"torques-{recorded.stem}.png"]
    assert all((tmp_path / "pictures" / p).read_bytes().startswith(b"\x89PNG") for p in pictures)


@pytest.mark.prove
def test_a_fault_of_the_independent_robot_is_diagnosed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = succeed(
        "excite", "free-decay", "pressure-multisine", "--reality", "--fault", "regulator.gain=0.2", "--logs", "mine"
    )
    logs = re.findall(r"recorded (\S+)", outcome.output)
    assert sorted(logs) == sorted(str(log.resolve()) for log in Path("mine").glob("*.mcap"))
    assert len(logs) == 2
    assert f"or:   softarm diagnose {' '.join(logs)} --report report.html" in outcome.output
    outcome = succeed("diagnose", *logs, "--json", "verdict.json")
    (effect,) = json.loads(Path("verdict.json").read_text())["effects"]
    assert effect["name"] == "pressure.gain"
    assert effect["parameters"]["scale"]["value"] == pytest.approx(0.2, abs=0.02)
