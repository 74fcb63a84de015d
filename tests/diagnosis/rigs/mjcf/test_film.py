"""Film of a mechanism: bodies as measured and as simulated, with enlarged deviations."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, TableStage, Trial
from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.diagnosis.rigs.mjcf.film import film
from tests.diagnosis.verdicts import gap, rms, verdict

# The rail moves further than the arm.
TWO = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="rail" type="slide" axis="0 1 0"/><geom size=".02"/>
<body name="upper" euler="EULER"><joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/>
<body name="fore" pos="0 0 -.3"><joint name="elbow" axis="0 1 0"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2"/></body></body></body></worldbody></mujoco>"""
ACROSS, ALONG, FLAT = "0 0 0", "0 0 1.5708", "1.5708 0 0"  # plane of the arm, with the rail along y
JOINTS = ("shoulder", "elbow")
T = np.arange(401) * 0.01
MOTION = {"rail": 0.4 * T, "shoulder": 0.5 * np.sin(2 * T), "elbow": 0.8 * np.sin(3 * T)}
WORST = (T > 1.5) & (T < 3.0)


@pytest.fixture
def filmed(tmp_path):
    """Return a function that films overlays with these errors of each joint, [T], nominal and patched."""

    def of(nominal, patched=None, stage="elbow", name="run-0/{}", kinds=("mujoco", "mujoco"), euler=ACROSS):
        (tmp_path / "two.xml").write_text(TWO.replace("EULER", euler))
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


def tips(euler, *positions):
    """Return the lower ends of all shapes in one pose by MuJoCo, [3, 3]."""
    model = mujoco.MjModel.from_xml_string(TWO.replace("EULER", euler))
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    mujoco.mj_kinematics(model, data)
    reach = (model.geom_size[:, 0] + model.geom_size[:, 1])[:, None] * data.geom_xmat.reshape(-1, 3, 3)[:, :, 2]
    ends = data.geom_xpos + reach, data.geom_xpos - reach
    return np.where(ends[0][:, 2:] < ends[1][:, 2:], *ends)


def test_the_film_shows_the_two_seconds_with_the_largest_gap(filmed):
    found = filmed({"shoulder": 0.0 * T, "elbow": 0.02 * WORST})
    assert found.trial == "run-0"
    assert 0.9 < found.t_s[0] <= 1.6
    assert found.t_s[-1] - found.t_s[0] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(("euler", "plane"), [(ACROSS, [0, 2]), (ALONG, [1, 2])])
def test_each_body_is_where_mujoco_has_it_and_deviations_are_enlarged_in_their_plane(filmed, euler, plane):
    errors = {"shoulder": 0.01 * WORST, "elbow": 0.02 * WORST}, dict.fromkeys(JOINTS, 0.001 * WORST)
    found = filmed(*errors, euler=euler)
    assert found.factor == 10
    k = 20
    rail, shoulder, elbow = (np.interp(found.t_s[k], T, motion) for motion in MOTION.values())
    drawn = {
        "measured": tips(euler, rail, shoulder, elbow),
        "nominal": tips(euler, rail, shoulder + 0.1, elbow + 0.2),
        "patched": tips(euler, rail, shoulder + 0.01, elbow + 0.01),
    }
    for kind, ends in drawn.items():
        for outline, end in zip(found.lines[kind][k], ends, strict=True):
            assert np.linalg.norm(outline - end[plane], axis=1).min() < 0.005, kind
            (x, y), (ahead_x, ahead_y) = outline.T, np.roll(outline, -1, axis=0).T
            assert np.sum(x * ahead_y - y * ahead_x) > 0  # counter-clockwise


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


def test_a_flat_mechanism_is_seen_from_above(filmed):
    found = filmed({"shoulder": 0.0 * T, "elbow": 0.02 * WORST}, euler=FLAT)
    assert np.ptp(found.lines["measured"], axis=(0, 1, 2)).min() > 0.3
