"""The example of the page on MuJoCo models runs as it is shown, and finds what its recordings hide."""

import json
import re
import runpy
import shlex
import shutil
from pathlib import Path

import mujoco
import pytest
from click.testing import CliRunner

from softarm.cli.main import main

ROOT = Path(__file__).parents[2]
HIDDEN_FRICTION_NM = 0.2


def shorten(stage):
    """Leave the elbow and two recordings: the shoulder counts as moved from outside."""
    text = stage.read_text()
    shoulder = re.search(r"\n +shoulder: .*", text)[0]
    text = re.sub(r"\n.*name: \w+-2,.*", "", text.replace(shoulder, "")).replace("\n      shoulder_servo", "\n#")
    base = "  base:\n    time: {source: t, unit: s}\n    columns:" + shoulder + "\n"
    stage.write_text(text.replace("  # What was commanded", base + "  # What was commanded"))


# Over 3 s: the diagnosis of one joint.
@pytest.mark.slow
def test_the_example_ends_in_a_patched_model_with_the_hidden_friction(tmp_path, monkeypatch):
    page = (ROOT / "docs/gap/mujoco.md").read_text(encoding="utf-8")
    shown = re.search(r"```sh\n(.*?)```", page, re.DOTALL)[1].splitlines()
    made, copied, recorded, *diagnosed = (shlex.split(line) for line in shown)
    assert [made[0], copied[0], recorded[0]] == ["mkdir", "cp", "python"]
    shutil.copytree(ROOT / "examples/mujoco", tmp_path / "examples/mujoco")
    script = tmp_path / "examples/mujoco/record.py"
    script.write_text(script.read_text().replace("DURATION_S, RATE_HZ = 8.0", "DURATION_S, RATE_HZ = 2.0"))
    folder = tmp_path / made[1]
    folder.mkdir()
    monkeypatch.chdir(folder)
    shutil.copy(*copied[1:])
    monkeypatch.setattr("sys.argv", recorded[1:])
    runpy.run_path(recorded[1], run_name="__main__")
    for words in diagnosed:
        more = ["--json", "verdict.json"] if words[1] == "diagnose" else []
        result = CliRunner().invoke(main, [*words[1:], *more])
        assert result.exit_code == 0, result.output
        if words[1] == "new":
            shorten(Path("stage.yaml"))

    assert re.search(r'\+ +<joint name="elbow".* frictionloss=', result.output)
    model = mujoco.MjModel.from_xml_path("patched.xml")
    assert model.joint("elbow").frictionloss[0] == pytest.approx(HIDDEN_FRICTION_NM, rel=0.2)
    verdict = json.loads(Path("verdict.json").read_text())
    (effect,) = verdict["effects"]
    torque = effect["parameters"]["torque"]
    assert effect["name"] == "elbow.coulomb_friction"
    assert torque["low"] <= HIDDEN_FRICTION_NM <= torque["high"]
    before, after = (verdict["gap"][when]["elbow"]["value"] for when in ("before", "after"))
    assert after < 0.4 * before
    assert effect["shrink"]["stage"]["value"] == pytest.approx(1 - after / before, abs=0.05)
