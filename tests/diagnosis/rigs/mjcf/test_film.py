"""Film of a mechanism: bodies as measured and as simulated, with enlarged deviations."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.diagnosis.data.trials import Series, TableStage, Trial
from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.diagnosis.rigs.mjcf.film import _outlines, _plane, film
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


def tips(shoulder, elbow):
    """Return the lower ends of both capsules in one pose by MuJoCo, [2, 3]."""
    model = mujoco.MjModel.from_xml_string(TWO)
    data = mujoco.MjData(model)
    data.qpos[:] = shoulder, elbow
    mujoco.mj_kinematics(model, data)
    reach = (model.geom_size[:, 0] + model.geom_size[:, 1])[:, None] * data.geom_xmat.reshape(-1, 3, 3)[:, :, 2]
    ends = data.geom_xpos + reach, data.geom_xpos - reach
    return np.where(ends[0][:, 2:] < ends[1][:, 2:], *ends)


def test_the_film_shows_the_two_seconds_with_the_largest_gap(filmed):
    found = filmed({"shoulder": 0.0 * T, "elbow": 0.02 * WORST})
    assert found.trial == "run-0"
    assert 0.9 < found.t_s[0] <= 1.6
    assert found.t_s[-1] - found.t_s[0] == pytest.approx(2.0, abs=0.1)


def test_each_body_is_where_mujoco_has_it_and_deviations_are_enlarged(filmed):
    found = filmed({"shoulder": 0.01 * WORST, "elbow": 0.02 * WORST}, dict.fromkeys(JOINTS, 0.001 * WORST))
    assert found.factor == 5
    k = 20
    shoulder, elbow = (np.interp(found.t_s[k], T, MOTION[joint]) for joint in JOINTS)
    drawn = {
        "measured": tips(shoulder, elbow),
        "nominal": tips(shoulder + 0.05, elbow + 0.1),
        "patched": tips(shoulder + 0.005, elbow + 0.005),
    }
    for kind, ends in drawn.items():
        for outline, end in zip(found.lines[kind][k], ends, strict=True):
            assert np.linalg.norm(outline - end[[0, 2]], axis=1).min() < 0.005, kind


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


@pytest.mark.parametrize("plane", ["xz", "yz", "xy"])
def test_the_drawing_shows_the_plane_of_the_deviation(plane):
    axes = _plane(swinging(plane), swinging(plane, 0.1))
    assert np.abs(axes) == pytest.approx(np.abs([np.eye(3)["xyz".index(each)] for each in plane]))


def test_wider_motion_without_a_deviation_is_seen_from_its_end():
    """A gantry moves along y by 1 m, and what hangs from it swings along x."""
    way = np.zeros((40, 1, 1, 3))
    way[..., 1] = np.arange(40)[:, None, None] / 20
    assert _plane(swinging("xz") + way, swinging("xz", 0.1) + way)[0] == pytest.approx([1, 0, 0])


def swinging(plane, more=0.0):
    """Return a rod of 1 m that swings to both sides in a plane, such as xz; more: amplitude, rad."""
    angle, points = (0.5 + more) * np.sin(np.pi * np.arange(40) / 20), np.zeros((40, 1, 2, 3))
    points[:, 0, 1, "xyz".index(plane[0])] = np.sin(angle)
    points[:, 0, 1, "xyz".index(plane[1])] = -np.cos(angle)
    return points


@given(st.integers(1, 100), st.integers(0, 2**32 - 1))
def test_an_outline_holds_its_shape_and_turns_counter_clockwise(shapes, seed):
    flat = np.random.default_rng(seed).normal(size=(2, shapes, 30, 2))
    outlines = _outlines(flat)
    ahead = np.roll(outlines, -1, axis=2) - outlines
    area = outlines[..., 0] * ahead[..., 1] - outlines[..., 1] * ahead[..., 0]
    assert (area.sum(axis=2) > 0).all()
    for axis in range(2):
        assert outlines[..., axis].max(axis=2) == pytest.approx(flat[..., axis].max(axis=2))
        assert outlines[..., axis].min(axis=2) == pytest.approx(flat[..., axis].min(axis=2))
