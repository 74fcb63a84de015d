"""Film of a mechanism: links as measured and as simulated, with enlarged deviations."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, TableStage, Trial
from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.diagnosis.rigs.mjcf.film import film
from tests.diagnosis.verdicts import gap, rms, verdict

TWO = """<mujoco><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/>
<body name="fore" pos="0 0 -.3"><joint name="elbow" axis="0 1 0"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2"/></body></body></worldbody></mujoco>"""
JOINTS = ("shoulder", "elbow")
T = np.arange(401) * 0.01
MOTION = {"shoulder": 0.5 * np.sin(2 * T), "elbow": 0.8 * np.sin(3 * T)}
WORST = (T > 1.5) & (T < 3.0)


@pytest.fixture
def filmed(tmp_path):
    """Return a function that films overlays with these errors of each joint, [T], nominal and patched."""
    (tmp_path / "two.xml").write_text(TWO)

    def of(nominal, patched=None, stage="elbow", name="run-0/{}", kinds=("mujoco", "mujoco")):
        trials, overlays = [], []
        for joint, kind in zip(JOINTS, kinds, strict=True):
            about = TableStage(joint, kind, {"mjcf": str(tmp_path / "two.xml")} if kind == "mujoco" else {})
            channels = {"measured": Series(T, {k: v.copy() for k, v in MOTION.items()})}
            trials.append(Trial(name.format(joint), "sine", Path("run.csv"), channels, stage=about))
            seen = MOTION[joint]
            after = None if patched is None else seen + patched[joint]
            overlays.append(
                Overlay(joint, name.format(joint), "sine", joint, "rad", T, seen, seen + nominal[joint], after)
            )
        found = verdict("named", stage=stage, gaps=gap(floor=rms("rad", shoulder=1e-3, elbow=1e-3)))
        return film(Diagnosis(found, overlays=tuple(overlays)), trials)

    return of


def links(shoulder, elbow):
    """Return both ends of both links in one pose by MuJoCo, [2, 2, 3]."""
    model = mujoco.MjModel.from_xml_string(TWO)
    data = mujoco.MjData(model)
    data.qpos[:] = shoulder, elbow
    mujoco.mj_kinematics(model, data)
    elbow_at = data.body("fore").xpos
    return np.array([(data.body("upper").xpos, elbow_at), (elbow_at, 2 * data.body("fore").xipos - elbow_at)])


def test_the_film_shows_the_two_seconds_with_the_largest_gap(filmed):
    found = filmed({"shoulder": 0.0 * T, "elbow": 0.02 * WORST})
    assert found.trial == "run-0"
    assert 0.9 < found.t_s[0] <= 1.6
    assert found.t_s[-1] - found.t_s[0] == pytest.approx(2.0, abs=0.1)


def test_each_link_is_where_mujoco_has_it_and_deviations_are_enlarged(filmed):
    found = filmed({"shoulder": 0.01 * WORST, "elbow": 0.02 * WORST}, dict.fromkeys(JOINTS, 0.001 * WORST))
    assert found.factor == 5
    k = 20
    shoulder, elbow = (np.interp(found.t_s[k], T, MOTION[joint]) for joint in JOINTS)
    assert found.lines["measured"][k] == pytest.approx(links(shoulder, elbow), abs=1e-9)
    assert found.lines["nominal"][k] == pytest.approx(links(shoulder + 0.05, elbow + 0.1), abs=1e-9)
    assert found.lines["patched"][k] == pytest.approx(links(shoulder + 0.005, elbow + 0.005), abs=1e-9)


def test_without_a_named_effect_there_is_no_patched_robot_and_a_large_deviation_keeps_its_size(filmed):
    found = filmed({"shoulder": 0.0 * T, "elbow": 0.3 * WORST})
    assert found.factor == 1
    assert found.lines.keys() == {"measured", "nominal"}


def test_stretches_of_a_recording_are_joined(filmed):
    """A long recording is cut, and each stage may have other stretches."""
    found = filmed({"shoulder": 0.01 * WORST, "elbow": 0.02 * WORST}, name="run from 2 s/{} from 0.5 s")
    assert found.trial == "run from 2 s"
    assert np.linalg.norm(found.lines["nominal"] - found.lines["measured"], axis=-1).max() > 0.01


def test_without_a_gap_or_if_it_is_no_joints_there_is_no_film(filmed):
    assert filmed(dict.fromkeys(JOINTS, 0.0 * T), stage=None) is None
    assert filmed({"shoulder": 0.0 * T, "elbow": 0.02 * WORST}, kinds=("mujoco", "tracking")) is None
