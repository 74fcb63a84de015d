"""`softarm excite` records what `softarm identify` reads."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.daemon.config import configuration
from softarm.schemas.config import Config
from softarm.simulator import model_file


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("excite")
    config = folder / "softarm.yaml"
    config.write_text(f"recorder: {{directory: {folder / 'logs'}}}\n")
    outcome = run("excite", "pressure-multisine", "--simulated", "--config", config)
    assert outcome.exit_code == 0, outcome.output
    (log,) = (folder / "logs").glob("*.mcap")
    assert f"next: softarm identify {log} --out model.yaml" in outcome.output
    return log


@pytest.mark.slow
def test_identify_writes_a_model_numbers_and_pictures(recorded, tmp_path):
    outcome = run(
        "identify",
        recorded,
        "--out",
        tmp_path / "m.yaml",
        "--json",
        tmp_path / "m.json",
        "--plots",
        tmp_path / "pictures",
        "--limits",
        tmp_path / "limits-patch.yaml",
    )
    assert outcome.exit_code == 0, outcome.output
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
    assert "no unseen excitation was given" in outcome.output
    pictures = sorted(p.name for p in (tmp_path / "pictures").iterdir())
    assert pictures == ["parameters.png", f"torques-{recorded.stem}.png"]
    assert all((tmp_path / "pictures" / p).read_bytes().startswith(b"\x89PNG") for p in pictures)


@pytest.mark.slow
def test_a_campaign_on_the_independent_robot_shows_its_fault(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = run(
        "excite", "free-decay", "pressure-multisine", "--reality", "--fault", "regulator.gain=0.2", "--logs", "mine"
    )
    assert outcome.exit_code == 0, outcome.output
    logs = re.findall(r"recorded (\S+)", outcome.output)
    assert sorted(logs) == sorted(str(log.resolve()) for log in Path("mine").glob("*.mcap"))
    assert len(logs) == 2
    assert f"or:   softarm diagnose {' '.join(logs)} --report report.html" in outcome.output
    outcome = run("diagnose", *logs, "--json", "verdict.json")
    assert outcome.exit_code == 0, outcome.output
    (effect,) = json.loads(Path("verdict.json").read_text())["effects"]
    assert effect["name"] == "pressure.gain"
    assert effect["parameters"]["scale"]["value"] == pytest.approx(0.2, abs=0.02)


def test_the_same_log_cannot_be_fitted_and_checked(recorded, tmp_path):
    outcome = run("identify", recorded, "--check", recorded, "--out", tmp_path / "m.yaml")
    assert outcome.exit_code == 1
    assert "is to be fitted and to be the unseen check" in outcome.output
    assert not (tmp_path / "m.yaml").exists()


@pytest.mark.parametrize(
    ("arguments", "says", "code"),
    [
        (("excite",), "which excitation? `softarm excite --list` shows them", 2),
        (("excite", "seed"), "which robot? --config FILE for real devices, --simulated, or --reality", 2),
        (("excite", "seed", "--simulated", "--fault", "arm.payload_kg=0.03"), "add --reality", 2),
        (("excite", "seed", "--reality", "--fault", "arm.paylod_kg=0.03"), "write group.quantity=value", 1),
        (("excite", "free-decay", "sed", "--simulated"), "no excitation 'sed'; did you mean seed?", 1),
        (("excite", "sed", "--simulated"), "no excitation 'sed'; did you mean seed?", 1),
        (("identify", "nowhere", "--out", "m.yaml"), "nowhere: is not there; name an MCAP log, a trial folder", 1),
    ],
)
def test_a_wrong_command_says_what_to_do(arguments, says, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = run(*arguments)
    assert says in outcome.output
    assert outcome.exit_code == code


def test_the_list_shows_every_excitation():
    from softarm.schemas.excitation import EXCITATIONS

    outcome = run("excite", "--list")
    assert all(line.split()[0] in EXCITATIONS for line in outcome.output.splitlines())
    assert len(outcome.output.splitlines()) == len(EXCITATIONS)
