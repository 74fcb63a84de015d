"""Complete diagnosis of an excerpt of a real recording, from the tables to the patch and back."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.io import loadmat

from softarm.diagnosis.rigs import patch
from softarm.schemas.verdict import Verdict
from tests.cli.invoke import succeed

HERE = Path(__file__).parent / "pendulum-free"
# Dry friction in other parts of the recording.
PUBLISHED_NM = (5.0e-4, 5.4e-4)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return the folder with verdict, report and patch of the excerpt."""
    folder = tmp_path_factory.mktemp("written")
    files = {"--json": "verdict.json", "--report": "report.html", "--patch": "whole.yaml"}
    succeed("diagnose", HERE / "stage.yaml", *(word for key, name in files.items() for word in (key, folder / name)))
    return folder


def verdict_of(file):
    return Verdict.model_validate_json(file.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_dry_friction_of_a_real_pendulum_is_named_with_its_size(written):
    verdict = verdict_of(written / "verdict.json")
    assert verdict.verdict == "named"
    (found,) = verdict.effects
    assert (found.name, found.equivalents) == ("joint.coulomb_friction", ())
    torque = found.parameters["torque"]
    assert torque.unit == "N m"
    assert PUBLISHED_NM[0] <= torque.value <= PUBLISHED_NM[1]
    assert torque.low < sum(PUBLISHED_NM) / 2 < torque.high
    assert torque.high - torque.low < 0.25 * torque.value
    assert verdict.gap.after["joint"].value < 0.2 * verdict.gap.before["joint"].value
    assert "dry friction" in (written / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_patched_pendulum_has_its_friction_and_is_not_missing_it_again(written, tmp_path):
    whole, named = written / "whole.yaml", tmp_path / "named.yaml"
    verdict = verdict_of(written / "verdict.json")
    named.write_text(patch.patched(HERE / "stage.yaml", verdict, calibration=False), encoding="utf-8")
    effects, alone = (yaml.safe_load(path.read_text())["effects"] for path in (whole, named))
    assert alone == {"joint.coulomb_friction": effects["joint.coulomb_friction"]}
    assert effects["joint.coulomb_friction"]["torque"] == pytest.approx(verdict.effects[0].parameters["torque"].value)
    assert effects.keys() > alone.keys()
    assert "valid" in succeed("check", whole, "--data", HERE).output
    for patched in (whole, named):
        succeed("diagnose", patched, "--data", HERE, "--json", tmp_path / "again.json")
        assert (again := verdict_of(tmp_path / "again.json")).verdict == "none", again.effects


def test_the_excerpt_is_part_of_the_recording(data):
    with (data / "multiarm-pendulum" / "SingleDataFreeSwing_1_Dt_0_0001.mat").open("rb") as file:
        theta = loadmat(file, squeeze_me=True, struct_as_record=False)["Theta1"]
    excerpt = np.loadtxt(HERE / "free-swing-1.csv", delimiter=",", skiprows=1)
    readings = slice(0, 100 * len(excerpt), 100)
    np.testing.assert_allclose(excerpt[:, 0], theta.time[readings], atol=5.1e-4)
    np.testing.assert_allclose(excerpt[:, 1], theta.signals.values.ravel()[readings], atol=5.1e-7)
