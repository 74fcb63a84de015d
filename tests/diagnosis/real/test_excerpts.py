"""Complete diagnosis of an excerpt of a real recording."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import loadmat

from softarm.cli.main import main
from softarm.schemas.verdict import Verdict

HERE = Path(__file__).parent / "pendulum-free"
# Dry friction in other parts of the recording.
PUBLISHED_NM = (5.0e-4, 5.4e-4)


@pytest.mark.slow
def test_dry_friction_of_a_real_pendulum_is_named_with_its_size(tmp_path):
    answer, report = tmp_path / "verdict.json", tmp_path / "report.html"
    outcome = CliRunner().invoke(
        main, ["diagnose", f"{HERE}/stage.yaml", "--json", str(answer), "--report", str(report)]
    )
    assert outcome.exit_code == 0, outcome.output
    verdict = Verdict.model_validate_json(answer.read_text(encoding="utf-8"))
    assert verdict.verdict == "named"
    (found,) = verdict.effects
    assert (found.name, found.equivalents) == ("joint.coulomb_friction", ())
    torque = found.parameters["torque"]
    assert torque.unit == "N m"
    assert PUBLISHED_NM[0] <= torque.value <= PUBLISHED_NM[1]
    assert torque.low < sum(PUBLISHED_NM) / 2 < torque.high
    assert torque.high - torque.low < 0.25 * torque.value
    assert verdict.gap.after["joint"].value < 0.2 * verdict.gap.before["joint"].value
    assert "dry friction" in report.read_text(encoding="utf-8")


def test_the_excerpt_is_part_of_the_recording(data):
    with (data / "multiarm-pendulum" / "SingleDataFreeSwing_1_Dt_0_0001.mat").open("rb") as file:
        theta = loadmat(file, squeeze_me=True, struct_as_record=False)["Theta1"]
    excerpt = np.loadtxt(HERE / "free-swing-1.csv", delimiter=",", skiprows=1)
    readings = slice(0, 100 * len(excerpt), 100)
    np.testing.assert_allclose(excerpt[:, 0], theta.time[readings], atol=5.1e-4)
    np.testing.assert_allclose(excerpt[:, 1], theta.signals.values.ravel()[readings], atol=5.1e-7)
