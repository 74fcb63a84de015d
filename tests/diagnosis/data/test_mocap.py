"""Joints of a MuJoCo model by motion capture of its sites and bodies."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from softarm.diagnosis.data import mocap, tables
from softarm.diagnosis.data.skeleton import Skeleton
from softarm.diagnosis.data.trials import Series, TrialError
from tests.cli.invoke import succeed

# A turret, an upper arm and a forearm, and a carriage that carries them.
ARM = """
<mujoco><compiler angle="radian"/><worldbody>
<site name="left" pos="-.5 0 .1"/><site name="right" pos=".5 .1 0"/><site name="back" pos="0 .6 .3"/>
<body name="rack" pos="0 -.5 .2" euler=".1 .2 .3"><geom size=".01"/></body>
<body name="carriage"><joint name="rail" type="slide" axis="1 0 0" range="-1 1"/><geom size=".1"/>
<body name="turret" pos="0 0 .2"><joint name="yaw" axis="0 0 1" range="-1.5 1.5"/><geom size=".05"/>
<body name="upper" pos="0 0 .1"><joint name="shoulder" axis="0 1 0" range="-1.5 1.5"/>
<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/><site name="elbow_marker" pos=".28 0 .03"/>
<body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="ELBOW"/>
<geom type="capsule" size=".02" fromto="0 0 0 .25 0 0"/><site name="tip" pos=".25 .01 0"/>
</body></body></body></body></worldbody>
<actuator><position name="yaw_servo" joint="yaw" kp="20"/><position name="shoulder_servo" joint="shoulder" kp="40"/>
<position name="elbow_servo" joint="elbow" kp="20"/></actuator>EXTRA</mujoco>"""
JOINTS = ("rail", "yaw", "shoulder", "elbow")
T = np.arange(61) * 0.033


def write(folder, elbow="-2.4 2.4", extra=""):
    """Write the model into a folder, with a range of the elbow and more elements."""
    file = folder / "arm.xml"
    file.write_text(ARM.replace("ELBOW", elbow).replace("EXTRA", extra))
    return file


@pytest.fixture
def arm(tmp_path):
    return write(tmp_path)


def motion(elbow=(0.8, 0.6)):
    """Return positions of the joints, [T, 4]; elbow: its mean and amplitude."""
    swings = [0.2 * np.sin(2 * T), 0.7 * np.sin(3 * T + 1), 0.5 * np.sin(4 * T), elbow[0] + elbow[1] * np.sin(5 * T)]
    return np.stack(swings, axis=1)


TRUE = motion()


def tracked(file, positions, names, noise_m=0.0):
    """Return columns of sites and bodies in some poses; a name with + has an orientation as well."""
    m, random = mujoco.MjModel.from_xml_path(str(file)), np.random.default_rng(0)
    data, found = mujoco.MjData(m), {}
    for name in names:
        for part in ("x", "y", "z", *(("qw", "qx", "qy", "qz") if name.endswith("+") else ())):
            found[f"{name.rstrip('+')}_{part}"] = np.empty(len(positions))
    for k, row in enumerate(positions):
        data.qpos[:] = row
        mujoco.mj_kinematics(m, data)
        for name in (each.rstrip("+") for each in names):
            is_site = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SITE, name) >= 0
            at = data.site(name).xpos if is_site else data.body(name).xpos
            for axis, value in zip("xyz", at + noise_m * random.normal(size=3), strict=True):
                found[f"{name}_{axis}"][k] = value
            for i, part in enumerate(("qw", "qx", "qy", "qz")):
                if f"{name}_{part}" in found:
                    found[f"{name}_{part}"][k] = data.body(name).xquat[i]
    return found


def solved(file, columns, base=None, base_t_s=T):
    """Return the joints' positions from tracked points; base: known joints."""
    known = [] if base is None else [Series(base_t_s, base)]
    return mocap.positions(Skeleton(file, columns, base or ()), Series(T, columns), known, Path("run.csv"))[0]


@settings(max_examples=4)
@given(seed=st.integers(0, 10_000), points=st.sampled_from([("tip", "elbow_marker"), ("fore+",), ("tip", "upper+")]))
def test_tracked_points_give_the_positions_that_made_them(tmp_path_factory, seed, points):
    file = write(tmp_path_factory.mktemp("arm"), "0.2 2.4")
    random = np.random.default_rng(seed)
    low, high = np.array([(-1, 1), (-1.5, 1.5), (-1.5, 1.5), (0.2, 2.4)]).T
    middle, half = (low + high) / 2, 0.4 * (high - low)
    true = middle + half * np.sin(np.outer(T, random.uniform(1, 4, 4)) + random.uniform(0, 6, 4))
    found = solved(file, tracked(file, true, points))
    seen = np.isin(T, found.t_s)
    assert seen.sum() > 30
    for name, of in zip(JOINTS, true[seen].T, strict=True):
        assert found[name] == pytest.approx(of, abs=1e-6)


def test_a_known_joint_is_not_sought(arm):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker"))
    found = solved(arm, columns, {"rail": TRUE[:, 0]})
    assert found.columns.keys() == {"yaw", "shoulder", "elbow"}
    assert found["shoulder"] == pytest.approx(TRUE[:, 2], abs=1e-6)


def test_a_coordinate_may_be_missing(arm):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker"))
    del columns["tip_y"]
    assert solved(arm, columns)["elbow"] == pytest.approx(TRUE[:, 3], abs=1e-6)


def test_rows_in_which_the_points_hardly_show_a_joint_are_left_out(tmp_path):
    file, true = write(tmp_path, "-0.1 2.4"), motion(elbow=(0.9, 0.9))
    found = solved(file, tracked(file, true, ("tip",)), {"rail": true[:, 0]})
    stretched = true[:, 3] < 0.1  # the tip's distance from the shoulder hardly changes with the elbow there
    assert stretched.any()
    assert not np.isin(T[stretched], found.t_s).any()
    assert len(found) > 30
    assert found["elbow"] == pytest.approx(true[np.isin(T, found.t_s), 3], abs=1e-6)


@pytest.mark.parametrize(("step_s", "shift"), [(0.03, 0.0), (0.03, 0.2), (0.02, 0.0), (0.02, 0.1)])
def test_a_joint_that_was_stretched_bends_in_its_range_again(tmp_path, step_s, shift):
    """Points without a coordinate to spare show no delay, though a tip out of reach seems to."""
    file, t_s = write(tmp_path, "-0.1 2.4"), step_s * np.arange(60)
    true = np.stack(
        [0.2 * np.sin(2 * t_s), 0.7 * np.sin(3 * t_s), 0.5 * np.sin(4 * t_s), 1 + np.sin(5 * t_s + shift)], 1
    )
    columns = tracked(file, true, ("tip",))
    known = [Series(t_s, {"rail": true[:, 0]})]
    found, warnings = mocap.positions(Skeleton(file, columns, ["rail"]), Series(t_s, columns), known, Path("run.csv"))
    assert len(found) > 20
    assert found["elbow"] == pytest.approx(true[np.isin(t_s, found.t_s), 3], abs=1e-6)
    assert not warnings


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["tips_x"], "no site or body tips; did you mean tip.? the model has left, right, back, elbow_marker,"),
        (["tip_u"], "tip_u is no coordinate; name the columns of a site or body NAME_x"),
        (["fore_x", "fore_qw", "fore_qx"], "the orientation of fore needs fore_qw to fore_qz"),
    ],
)
def test_a_wrong_column_is_refused(arm, names, message):
    with pytest.raises(TrialError, match=message):
        Skeleton(arm, names)


def test_points_that_do_not_show_a_joint_are_refused(arm):
    with pytest.raises(TrialError, match=r"do not show the position of .*elbow; track more points"):
        solved(arm, tracked(arm, TRUE, ("tip",)))


def test_several_poses_that_fit_are_refused(arm, tmp_path):
    columns, rail = tracked(arm, TRUE, ("tip",)), {"rail": TRUE[:, 0]}
    with pytest.raises(TrialError, match=r"several poses fit .* shoulder, elbow may be at .* or .*; track a point on"):
        solved(arm, columns, rail)
    found = solved(write(tmp_path, "0.1 2.4"), columns, rail)
    assert found["elbow"] == pytest.approx(np.interp(found.t_s, T, TRUE[:, 3]), abs=1e-6)


@pytest.mark.parametrize("wrong", ["unit", "axes", "place"])
def test_points_that_fit_no_pose_are_refused(arm, wrong):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker"))
    match wrong:
        case "unit":
            columns = {name: 1000 * x for name, x in columns.items()}
        case "axes":  # y upwards
            turned = {"x": "x", "y": "z", "z": "y"}
            columns = {f"{n[:-1]}{turned[n[-1]]}": -x if n[-1] == "y" else x for n, x in columns.items()}
        case "place":
            other = {"tip": "elbow_marker", "elbow_marker": "tip"}
            columns = {f"{other[n[:-2]]}{n[-2:]}": x for n, x in columns.items()}
    message = r"run.csv: the tracked points differ by .* best poses .* that origin and axes are those of the model"
    with pytest.raises(TrialError, match=message):
        solved(arm, columns)


def test_a_few_rows_without_the_points_are_left_out_with_a_warning(arm):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker"))
    for values in columns.values():
        values[[0, 30]] = 0.0  # as a system writes a lost marker
    skeleton = Skeleton(arm, columns)
    found, (warning,) = mocap.positions(skeleton, Series(T, columns), [], Path("run.csv"))
    assert warning.startswith("run.csv: in 2 rows, first at 0.000 s, the tracked points differ by more than")
    assert found["elbow"] == pytest.approx(np.delete(TRUE[:, 3], [0, 30]), abs=1e-6)


def test_an_orientation_that_is_no_unit_quaternion_is_refused(arm):
    columns = tracked(arm, TRUE, ("fore+",))
    columns["fore_qw"][10], columns["fore_qx"][10] = 0.0, 0.0
    with pytest.raises(TrialError, match=r"run.csv: fore_qw, .* have a length of .* at 0.330 s"):
        solved(arm, columns)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ('<equality><joint joint1="yaw" joint2="elbow"/></equality>', "couples yaw with other joints"),
        ('<equality><connect body1="fore" body2="turret" anchor="0 0 0"/></equality>', "couples shoulder with"),
    ],
)
def test_joints_that_an_equality_couples_are_refused(tmp_path, extra, message):
    with pytest.raises(TrialError, match=message):
        Skeleton(write(tmp_path, extra=extra), ["tip_x", "tip_y", "tip_z"])
    assert Skeleton(write(tmp_path, extra=extra.replace("fore", "carriage")), ["carriage_x"]).joints == ("rail",)


@pytest.fixture
def floating(arm):
    """Return the model with a carriage that floats."""
    slide = '<joint name="rail" type="slide" axis="1 0 0" range="-1 1"/>'
    arm.write_text(arm.read_text().replace(slide, "<freejoint/>"))
    return arm


POSE = ("carriage_x", "carriage_y", "carriage_z", "carriage_qw", "carriage_qx", "carriage_qy", "carriage_qz")


def test_a_point_of_a_floating_body_without_its_pose_is_refused(floating):
    message = "body carriage has a joint without a name, .* write the whole pose under `base`"
    for known in ((), POSE[:6]):
        with pytest.raises(TrialError, match=message):
            Skeleton(floating, ["tip_x"], known)


def test_joints_behind_a_floating_body_are_found_beside_its_pose(floating):
    turn, place = 0.4 * np.sin(2 * T), 0.3 * np.sin(T)
    quaternion = np.stack([np.cos(turn / 2), 0 * T, 0 * T, np.sin(turn / 2)], axis=1)
    qpos = np.column_stack((place, 0 * T, 1 + 0 * T, quaternion, TRUE[:, 1:]))
    columns = tracked(floating, qpos, ("tip", "elbow_marker"))
    signs = np.where(T > 1, -1.0, 1.0)  # motion capture may give either of two quaternions
    pose = dict(zip(POSE, (place, 0 * T, 1 + 0 * T, *(quaternion.T * signs)), strict=True))
    found = solved(floating, columns, pose)
    assert found.columns.keys() == {"yaw", "shoulder", "elbow"}
    for name, of in zip(JOINTS[1:], TRUE[:, 1:].T, strict=True):
        assert found[name] == pytest.approx(of, abs=1e-6)


def test_readings_of_another_rate_are_known_between_their_rows(arm):
    fine = np.arange(0.3, 1.5, 0.001)
    fine = fine[(fine < 0.8) | (fine > 1.0)]  # a gap
    rail = {"rail": 0.2 * np.sin(2 * fine)}
    found = solved(arm, tracked(arm, TRUE, ("tip", "elbow_marker")), rail, fine)
    inside = (T >= 0.3) & (T < 1.499) & ((T <= 0.799) | (T >= 1.001))
    assert found.t_s == pytest.approx(T[inside])
    assert found["elbow"] == pytest.approx(TRUE[inside, 3], abs=1e-5)


def in_another_frame(columns, wrong=None):
    """Return coordinates in a frame with y upwards that is turned and shifted as well; wrong: a point, 0.1 m off."""
    turn, shift = Rotation.from_euler("xzy", (-np.pi / 2, 0.4, 0.1)), np.array([1.0, 0.3, -2.0])
    found = dict(columns)
    for name in {column.rpartition("_")[0] for column in columns}:
        place = turn.apply(np.stack([columns[f"{name}_{axis}"] for axis in "xyz"], axis=1)) + shift
        found |= {f"{name}_{axis}": x + 0.1 * (name == wrong) for axis, x in zip("xyz", place.T, strict=True)}
        if f"{name}_qw" in columns:
            quaternion = np.stack([columns[f"{name}_q{part}"] for part in "wxyz"], axis=1)
            turned = (turn * Rotation.from_quat(quaternion, scalar_first=True)).as_quat(scalar_first=True)
            found |= {f"{name}_q{part}": x for part, x in zip("wxyz", turned.T, strict=True)}
    return found


@pytest.mark.parametrize(
    ("fixed", "moved"), [(("left", "right", "back"), ("fore+",)), (("rack+",), ("tip", "elbow_marker"))]
)
def test_fixed_points_show_the_frame_of_motion_capture(arm, fixed, moved):
    found = solved(arm, in_another_frame(tracked(arm, TRUE, (*moved, *fixed))))
    for name, of in zip(JOINTS, TRUE.T, strict=True):
        assert found[name] == pytest.approx(of, abs=1e-6)


@pytest.mark.parametrize("fixed", [("left", "right"), ("rack",)])
def test_with_fewer_fixed_points_coordinates_have_to_be_in_the_frame_of_the_model(arm, fixed):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker", *fixed))
    assert solved(arm, columns)["elbow"] == pytest.approx(TRUE[:, 3], abs=1e-6)
    with pytest.raises(TrialError, match=r"tracked points differ by .* that origin and axes are those of the model"):
        solved(arm, in_another_frame(columns))


def test_a_fixed_point_that_is_elsewhere_is_refused(arm):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker", "left", "right", "back"))
    with pytest.raises(TrialError, match=r"run.csv: the fixed points left, right, back differ by 0\.\d+ m from"):
        solved(arm, in_another_frame(columns, wrong="left"))


def test_a_point_without_a_coordinate_is_not_turned(arm):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker", "left", "right", "back"))
    del columns["tip_y"]
    with pytest.raises(TrialError, match=r"run.csv: tip lacks a coordinate, .* leave the fixed points out"):
        solved(arm, columns)


@pytest.mark.parametrize("late_s", [0.03, -0.012])
def test_stamps_of_motion_capture_that_are_late_beside_encoders_are_corrected(arm, late_s):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker", "upper"), 1e-4)
    fine = np.arange(-0.2, 2.2, 0.004)
    rail = Series(fine, {"rail": 0.2 * np.sin(2 * fine)})
    skeleton = Skeleton(arm, columns, ["rail"])
    found, warnings = mocap.positions(skeleton, Series(T + late_s, columns), [rail], Path("run.csv"))
    said = re.fullmatch(r"run.csv: the tracked points are (.*) ms (late|early) beside rail; .* one clock.*", *warnings)
    assert float(said[1]) == pytest.approx(1e3 * abs(late_s), abs=0.5)
    assert said[2] == ("late" if late_s > 0 else "early")
    assert found.t_s == pytest.approx(T, abs=5e-4)
    assert found["elbow"] == pytest.approx(TRUE[:, 3], abs=5e-3)


@pytest.mark.parametrize("noise_m", [0.0, 1e-4])
def test_stamps_of_one_clock_are_not_corrected(arm, noise_m):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker", "upper"), noise_m)
    rail = Series(T, {"rail": TRUE[:, 0]})
    assert not mocap.positions(Skeleton(arm, columns, ["rail"]), Series(T, columns), [rail], Path("run.csv"))[1]


@pytest.mark.parametrize("at_s", [T + 100, T[:1]], ids=["elsewhere", "one row"])
def test_readings_at_another_time_are_refused(arm, at_s):
    columns = tracked(arm, TRUE, ("tip", "elbow_marker"))
    with pytest.raises(TrialError, match=r"run.csv: motion capture and rail have no time in common; give them stamps"):
        solved(arm, columns, {"rail": TRUE[: len(at_s), 0]}, at_s)


def test_tracked_points_whose_joints_are_all_known_are_refused(arm):
    with pytest.raises(TrialError, match="every joint that moves carriage has a column of its own; leave `mocap` out"):
        Skeleton(arm, ["carriage_x"], ["rail"])


@pytest.mark.parametrize("encoder_step_s", [0.004, 0.05])
def test_encoders_and_tracked_joints_have_the_stamps_of_the_slower_ones(encoder_step_s):
    at = np.arange(0, 1.9, encoder_step_s)
    joints = mocap.joined(Series(T, {"elbow": 2 * T}), Series(at, {"rail": 3 * at}), Path("run.csv"))
    slow = T if encoder_step_s < 0.02 else at
    assert joints.t_s == pytest.approx(slow[slow <= at[-1]])
    assert joints["elbow"] == pytest.approx(2 * joints.t_s)
    assert joints["rail"] == pytest.approx(3 * joints.t_s)


def described(folder, encoders=(), fixed=(), means=(0.8,)):
    """Return the description of recordings of tracked points in mm, 0.1 mm off, and what its command printed.

    encoders: joints that have a column of their own. fixed: tracked points of the base, which show another frame.
    means: mean of the elbow in each recording.
    """
    file, recordings = write(folder), []
    for number, mean in enumerate(means, 1):
        true = motion(elbow=(mean, 0.6))
        seen = tracked(file, true, ("tip", "elbow_marker"), 1e-4)
        if fixed:
            seen = in_another_frame(seen | tracked(file, true, fixed))
        columns = {name: 1e3 * x for name, x in seen.items()}
        columns |= {f"{name}_servo": x for name, x in zip(JOINTS[1:], true[:, 1:].T, strict=True)}
        columns |= {name: true[:, JOINTS.index(name)] for name in encoders}
        table = np.stack([T, *columns.values()], axis=1)
        recordings.append(folder / f"run-{number}.csv")
        np.savetxt(recordings[-1], table, delimiter=",", header="t," + ",".join(columns), comments="")
    out = folder / "stage.yaml"
    return out, succeed("new", "rig", file, *recordings, "--out", out).stdout


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return described(tmp_path_factory.mktemp("rig"), means=(0.8, 1.2))


def test_a_description_is_written_and_its_joints_are_checked(rig):
    file, printed = rig
    assert "valid; 8 trials of rail (mujoco), yaw (mujoco), shoulder (mujoco), elbow (mujoco)" in printed
    channels = yaml.safe_load(file.read_text())["channels"]
    assert channels.keys() == {"mocap", "command"}
    assert channels["mocap"]["columns"]["tip_x"] == {"source": "tip_x", "unit": "mm"}
    assert len(channels["mocap"]["columns"]) == 6
    assert [*channels["command"]["columns"]] == ["yaw_servo", "shoulder_servo", "elbow_servo"]


def test_a_trial_has_the_joints_and_their_effects_and_not_the_points(rig):
    stage = yaml.safe_load(rig[0].read_text()) | {"effects": {"elbow.gain": {"scale": 0.1}}}
    other = rig[0].with_name("effects.yaml")
    other.write_text(yaml.safe_dump(stage))
    elbow = next(t for t in tables.read(other) if t.name == "run-1/elbow")
    assert elbow.channels.keys() == {"measured", "command"}
    assert elbow.channels["measured"]["elbow"] == pytest.approx(TRUE[:, 3], abs=5e-3)
    assert elbow.stage.effects == {"gain": {"scale": 0.1}}


def test_joints_with_encoders_and_tracked_joints_are_measured_together(tmp_path):
    file, _ = described(tmp_path, ["rail"])
    stage = yaml.safe_load(file.read_text())
    channels = stage["channels"]
    assert channels.keys() == {"measured", "mocap", "command"}
    assert [*channels["measured"]["columns"]] == ["rail"]
    assert "(1 joints of the model are measured and points are tracked)" in file.read_text()
    elbow = next(t for t in tables.read(file) if t.name == "run-1/elbow")
    assert elbow.channels["measured"].columns.keys() == {*JOINTS}
    assert elbow.channels["measured"]["rail"] == pytest.approx(TRUE[:, 0])
    assert elbow.channels["measured"]["elbow"] == pytest.approx(TRUE[:, 3], abs=5e-3)
    channels["base"] = channels.pop("measured")
    stage["trials"][0].update(files=dict.fromkeys(("mocap", "command"), "run-1.csv"))
    file.write_text(yaml.safe_dump(stage))
    with pytest.raises(TrialError, match=r"run-1.csv: trial run-1 names no file for the base channel; add it, since"):
        tables.read(file)


def test_fixed_points_are_found_though_they_never_move(tmp_path):
    file, _ = described(tmp_path, fixed=("left", "right", "back"))
    assert "in the model's frame" not in file.read_text()
    assert len(yaml.safe_load(file.read_text())["channels"]["mocap"]["columns"]) == 15
    elbow = next(t for t in tables.read(file) if t.name == "run-1/elbow")
    assert elbow.channels["measured"]["elbow"] == pytest.approx(TRUE[:, 3], abs=5e-3)


def test_points_whose_joints_all_have_encoders_are_not_tracked(tmp_path):
    file, _ = described(tmp_path, JOINTS)
    assert yaml.safe_load(file.read_text())["channels"].keys() == {"measured", "command"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s["channels"].pop("mocap"), "a mujoco stage needs a channel measured"),
        (lambda s: s["channels"]["mocap"]["columns"]["tip_x"].update(unit="rad"), "allowed are units of m"),
        (lambda s: s.update(effects={"tip.gain": {"scale": 0.1}}), "no mechanism tip; allowed rail, yaw, "),
        (lambda s: s["trials"][0].update(files={"command": "run-1.csv"}), "names no file for the mocap channel"),
    ],
)
def test_a_wrong_description_is_refused(rig, change, message):
    stage = yaml.safe_load(rig[0].read_text())
    change(stage)
    wrong = rig[0].with_name("wrong.yaml")
    wrong.write_text(yaml.safe_dump(stage))
    with pytest.raises(TrialError, match=re.escape(message)):
        tables.read(wrong)
