"""Effects of a joint found in an independently simulated mechanism, from recordings to the patched model."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.diagnosis.data import tables
from softarm.diagnosis.rigs.diagnose import diagnose_table, view_of
from softarm.reality.mechanisms.cases import stage_text
from softarm.reality.mechanisms.record import ROBOTS, JointLaw, Truth, record, write
from tests.diagnosis.rigs.recordings import SERVO, shipped

KINDS = ("multisine", "holds", "multisine")


def written(folder, robot, laws):
    """Record three trials of a robot with its model and its stage.yaml."""
    random = np.random.default_rng(3)
    for number, kind in enumerate(KINDS):
        write(record(ROBOTS[robot], Truth(laws), kind, 5.0, random), folder / f"{kind}-{number}.csv")
    shutil.copy(ROBOTS[robot].model, folder / "robot.xml")
    (folder / "stage.yaml").write_text(stage_text(ROBOTS[robot]))
    return folder / "stage.yaml"


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    """A camera whose tilt axis ignores errors below 12 mrad, on a vehicle that moves."""
    law = replace(JointLaw(), dead=0.012)
    return written(tmp_path_factory.mktemp("faulty"), "camera", {"tilt": law})


def test_each_measured_joint_is_a_stage_of_its_own(faulty):
    assert {trial.stage.name for trial in tables.read(faulty)} == {"pan", "tilt"}


def test_the_motion_of_the_other_joints_and_of_the_base_drives_a_joint(faulty):
    trials = [trial for trial in tables.read(faulty) if trial.stage.name == "pan"]
    without = [replace(t, channels={n: s for n, s in t.channels.items() if n != "base"}) for t in trials]
    left, more = (np.sqrt(np.nanmean(view_of(each)[0].gap([{}]) ** 2)) for each in (trials, without))
    assert left < 1.2e-3  # the step of the encoder is 1 mrad
    assert more > 3 * left


@pytest.mark.prove
def test_a_dead_band_is_named_at_its_joint_with_its_size(faulty):
    verdict = diagnose_table([t for t in tables.read(faulty) if t.stage.name == "tilt"], budget_s=4).verdict
    assert [effect.name for effect in verdict.effects] == ["tilt.deadband"]
    assert verdict.where.stage == "tilt"
    assert verdict.effects[0].parameters["width"].value == pytest.approx(0.012, rel=0.15)
    assert verdict.gap.after["tilt"].value < 0.5 * verdict.gap.before["tilt"].value


def test_a_patched_model_as_xml_is_for_mujoco_alone(tmp_path):
    (tmp_path / "s.csv").write_text("t,u,y\n" + "".join(f"{0.01 * i},{i % 100},{i % 100}\n" for i in range(400)))
    stage = tmp_path / "stage.yaml"
    stage.write_text(SERVO)
    result = CliRunner().invoke(main, ["diagnose", str(stage), "--patch", str(tmp_path / "x.xml")])
    assert result.exit_code == 2
    assert "is for a stage of kind mujoco" in result.output
    assert "reading" not in result.output  # refused before the work
    result = CliRunner().invoke(main, ["diagnose", str(stage), str(stage), "--patch", str(tmp_path / "x.xml")])
    assert result.exit_code == 2
    assert "for one stage.yaml of kind mujoco" in result.output


def test_a_real_elbow_has_the_dry_friction_that_its_authors_found(data):
    """Its authors give 0.078 N m times arctan(100 rate), at most 0.123 N m, and hardly any viscous friction."""
    trials = [trial for trial in shipped("double-pendulum-mujoco.yaml", data) if trial.stage.name == "elbow"]
    view, _ = view_of(trials)

    def left(path, values):
        gaps = view.gap([{f"elbow.{path}": value} for value in values])
        return np.sqrt(np.nanmean(gaps**2, axis=(1, 2)))

    dry, viscous = (0.0, 0.1, 0.123, 0.15), (0.01, 0.02, 0.03)
    with_dry = left("coulomb_friction.torque", dry)
    assert dry[int(np.argmin(with_dry))] == 0.123
    assert with_dry.min() < 0.4 * with_dry[0]
    assert with_dry.min() < 0.8 * left("damping.viscous", viscous).min()
    assert not view.warnings  # the other joint's accelerations are known between the samples
