"""`softarm new rig MODEL.xml DATA...`: columns are found by the names of joints and actuators."""

import shutil

import numpy as np
import pytest
import yaml

from softarm.diagnosis.describe.joints import ModelJoint
from tests.cli.invoke import invoke, refuse, succeed
from tests.diagnosis.describe.conftest import T
from validation.mechanisms.record import ROBOTS, Truth, record


@pytest.fixture(scope="module")
def columns():
    return record(ROBOTS["camera"], Truth({}), "multisine", 1.5, np.random.default_rng(1))


@pytest.fixture(scope="module")
def drone():
    return record(ROBOTS["drone"], Truth({}), "multisine", 1.0, np.random.default_rng(1))


def new_rig(folder, model, columns):
    """Write columns as a table, and return the command that describes it with the model."""
    data = folder / "run-1.csv"
    table = np.stack([*columns.values()], axis=1)
    np.savetxt(data, table, delimiter=",", header=",".join(columns), comments="", fmt="%.6f")
    return "new", "rig", model, data, "--out", folder / "stage.yaml"


def channels_of(folder, model, columns):
    """Return the channels of the stage file that is written for a table and a model, and its text."""
    succeed(*new_rig(folder, model, columns))
    text = (folder / "stage.yaml").read_text()
    return yaml.safe_load(text)["channels"], text


def of_camera(folder, columns, names):
    """Write a table with renamed columns beside the model, and return the command that describes both."""
    model = shutil.copy(ROBOTS["camera"].model, folder / "camera.xml")
    return new_rig(folder, model, {new: columns[old] * scale for old, new, scale in names})


def described(folder, columns, names):
    """Return what the command prints for a table with renamed columns, and the stage."""
    result = succeed(*of_camera(folder, columns, names))
    return result.output, yaml.safe_load((folder / "stage.yaml").read_text())


USUAL = [
    ("t", "t_s", 1.0),
    ("cmd_pan", "pan_goal", 1.0),
    ("cmd_tilt", "tilt_goal", 1.0),
    ("q_pan", "pan", 1.0),
    ("q_tilt", "tilt", 1.0),
]


@pytest.fixture(scope="module")
def complete(tmp_path_factory, columns):
    """Describe a table in which every joint of the model is measured."""
    return described(tmp_path_factory.mktemp("complete"), columns, [*USUAL, ("q_track", "track_m", 1.0)])


def test_joints_actuators_and_units_are_found_and_the_check_lists_each_column_once(complete):
    printed, stage = complete
    assert stage["kind"] == "mujoco"
    assert stage["model"] == {"mjcf": "camera.xml"}
    assert {name: use["source"] for name, use in stage["channels"]["measured"]["columns"].items()} == {
        "track": "track_m", "pan": "pan", "tilt": "tilt",
    }  # fmt: skip
    assert {name: use["source"] for name, use in stage["channels"]["command"]["columns"].items()} == {
        "pan_drive": "pan_goal", "tilt_drive": "tilt_goal",
    }  # fmt: skip
    rows = [[cell.strip() for cell in line.split("│")] for line in printed.splitlines()]
    listed = [row[6] for row in rows if row[1:2] == ["run-1"]]
    assert sorted(listed) == ["pan", "pan_drive", "tilt", "tilt_drive", "track"]
    assert "complete `model:`" not in printed


def test_degrees_are_recognised_by_the_range_or_the_header(tmp_path, columns):
    degrees = [(old, new, 57.29578 if old != "t" else 1.0) for old, new, _ in USUAL]
    _, stage = described(tmp_path, columns, [(old, new.replace("tilt", "tilt_deg"), s) for old, new, s in degrees])
    uses = [*stage["channels"]["measured"]["columns"].values(), *stage["channels"]["command"]["columns"].values()]
    assert {use["unit"] for use in uses} == {"deg"}


def test_a_joint_that_moves_little_is_in_degrees_as_the_others_are(tmp_path, columns):
    degrees = [(old, new, 57.29578 * (0.05 if "tilt" in old else 1.0) if old != "t" else 1.0) for old, new, _ in USUAL]
    _, stage = described(tmp_path, columns, degrees)
    uses = [*stage["channels"]["measured"]["columns"].values(), *stage["channels"]["command"]["columns"].values()]
    assert {use["unit"] for use in uses} == {"deg"}


@pytest.mark.parametrize(("command", "spins"), [("rad", False), ("N m", True)], ids=["position loop", "motor"])
def test_a_motor_without_a_limit_may_spin_and_a_position_loop_may_not(command, spins):
    assert (ModelJoint("wheel", "rad", np.inf, "drive", command).widest > 50.0) == spins


def test_a_joint_that_no_column_measures_is_stated_before_the_diagnosis(tmp_path, columns, complete):
    printed, _ = described(tmp_path, columns, USUAL)
    (warning,) = [line for line in printed.splitlines() if "no column measures track" in line]
    assert warning.startswith("warning: all 2 stages: no column measures track")
    assert "no column measures" not in complete[0]


def test_a_joint_without_a_commanded_actuator_counts_as_moved_from_outside(tmp_path, columns):
    still = [(old, new, 0.0 if new == "tilt_goal" else scale) for old, new, scale in USUAL]
    without = [each for each in still if each[1] != "tilt_goal"]
    missing, constant = "no column commands tilt_drive", "the command of tilt_drive is constant"
    beside = [*without, ("cmd_tilt", "tilt_current", 0.0)]  # no command
    for number, (names, reason) in enumerate(((without, missing), (beside, missing), (still, constant))):
        folder = tmp_path / str(number)
        folder.mkdir()
        _, stage = described(folder, columns, names)
        assert list(stage["channels"]["base"]["columns"]) == ["tilt"]
        assert list(stage["channels"]["measured"]["columns"]) == ["pan"]
        assert f"tilt counts as moved from outside: {reason}" in (folder / "stage.yaml").read_text()


def test_columns_without_a_joints_name_are_an_error_with_both_lists(tmp_path, columns):
    command = of_camera(tmp_path, columns, [("t", "t_s", 1.0), ("q_pan", "alpha", 1.0), ("cmd_pan", "beta", 1.0)])
    refuse("the model has track, pan, tilt; the recordings have", *command)
    assert not (tmp_path / "stage.yaml").exists()


def test_a_column_with_the_name_of_an_actuator_is_its_command(tmp_path, columns):
    names = [(old, new.replace("pan_goal", "pan_drive"), scale) for old, new, scale in USUAL]
    _, stage = described(tmp_path, columns, names)
    assert stage["channels"]["command"]["columns"]["pan_drive"]["source"] == "pan_drive"
    assert stage["channels"]["measured"]["columns"]["pan"]["source"] == "pan"


def test_measured_joints_without_any_command_are_an_error_that_names_their_actuators(tmp_path, columns):
    still = [(old, new, 0.0 if "goal" in new else scale) for old, new, scale in USUAL]
    for names in (still, [each for each in still if each[1] != "tilt_goal"]):
        message = "no column commands an actuator (pan_drive of pan, tilt_drive of tilt); the recordings"
        result = refuse(message, *of_camera(tmp_path, columns, names))
        assert "pan_goal (constant)" in result.output
        assert not (tmp_path / "stage.yaml").exists()


def test_a_joint_whose_name_ends_like_a_unit_is_found(tmp_path, columns):
    """Spot's knees are called fl_kn, and kN is a unit."""
    model = tmp_path / "spot.xml"
    model.write_text(ROBOTS["camera"].model.read_text().replace('"tilt"', '"fl_kn"'))
    table = {new.replace("tilt", "fl_kn"): columns[old] for old, new, _ in USUAL}
    channels, text = channels_of(tmp_path, model, table)
    assert channels["measured"]["columns"]["fl_kn"] == {"source": "fl_kn", "unit": "rad"}
    assert "Not used" not in text


@pytest.mark.parametrize("suffix", ["", "_pos"])
@pytest.mark.parametrize("joint", ["right_w0", "target_x", "input"])
def test_words_in_a_joints_own_name_make_no_command(tmp_path, columns, joint, suffix):
    """Baxter's wrists are called w0, w1 and w2, and w is a set-point to a control engineer."""
    model = tmp_path / "baxter.xml"
    model.write_text(ROBOTS["camera"].model.read_text().replace('"tilt"', f'"{joint}"'))
    names = {"tilt": joint + suffix, "tilt_goal": f"{joint}_goal"}
    channels, text = channels_of(tmp_path, model, {names.get(new, new): columns[old] for old, new, _ in USUAL})
    assert channels["measured"]["columns"][joint]["source"] == joint + suffix
    assert channels["command"]["columns"]["tilt_drive"]["source"] == f"{joint}_goal"
    assert "Not used" not in text


@pytest.mark.parametrize(
    ("names", "message"), [(("a.xml", "b.XML"), "allowed is one model"), (("a.xml",), "no recordings")]
)
def test_two_models_or_a_model_alone_are_refused(tmp_path, names, message):
    for name in names:
        shutil.copy(ROBOTS["camera"].model, tmp_path / name)
    refuse(message, "new", "rig", *(tmp_path / name for name in names), code=2)


@pytest.mark.parametrize(
    ("joint", "header", "message"),
    [
        ("", "knee", "the model has no joint;"),
        ('<joint name="knee"/>', "knee [ticks]", "no column has the name and unit of a driven or free joint;"),
    ],
)
def test_a_model_without_joints_and_readings_in_another_unit_are_named(tmp_path, joint, header, message):
    model = tmp_path / "leg.xml"
    model.write_text(f'<mujoco><worldbody><body>{joint}<geom size="0.1"/></body></worldbody></mujoco>')
    result = refuse(message, *new_rig(tmp_path, model, {"t": T, header: np.sin(T), "": np.cos(T)}))
    assert ', "";' in result.output


POSE = {f"hull_{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")}
FOLLOWER = "right follows left by an equality of the model and is under base"


@pytest.mark.parametrize(
    ("robot", "base", "measured", "note"),
    [
        ("gripper", {"right"}, {"wrist", "left"}, FOLLOWER),
        ("drone", POSE, {"shoulder", "elbow", "twist"}, "kind: mujoco"),
    ],
)
def test_joints_that_follow_and_poses_are_under_base(tmp_path, drone, robot, base, measured, note):
    columns = drone
    if robot != "drone":
        columns = record(ROBOTS[robot], Truth({}), "multisine", 1.0, np.random.default_rng(1))
    table = {name.removeprefix("q_"): values for name, values in columns.items()}
    channels, text = channels_of(tmp_path, ROBOTS[robot].model, table)
    assert set(channels["base"]["columns"]) == base
    assert set(channels["measured"]["columns"]) == measured
    assert "count as free" not in text


@pytest.mark.parametrize(
    ("place", "turn"),
    [
        ("base_{}", "base_q{}"),
        ("imu_pos_{}", "imu_quat_{}"),
        ("/odom pose.position.{}", "/odom pose.orientation.{}"),
    ],
)
def test_the_only_pose_of_a_recording_is_that_of_the_only_floating_body(tmp_path, drone, place, turn):
    names = {f"hull_{axis}": place.format(axis) for axis in "xyz"}
    names |= {f"hull_q{axis}": turn.format(axis) for axis in "wxyz"}
    table = {names.get(name, name.removeprefix("q_")): values for name, values in drone.items()}
    channels, text = channels_of(tmp_path, ROBOTS["drone"].model, table)
    assert {name: use["source"] for name, use in channels["base"]["columns"].items()} == names
    assert "the only pose in the recordings counts as that of hull" in " ".join(text.split())


@pytest.mark.parametrize(
    ("actuator", "unit"),
    [
        ('<general {} gainprm="0.3" biastype="affine" biasprm="0 -100 -10" ctrlrange="0 255"/>', "-"),
        ('<motor {} gear="30" ctrlrange="-10 10"/>', "-"),
        ("<motor {}/>", "N m"),
        ('<velocity {} kv="2"/>', "rad/s"),
    ],
)
def test_a_command_has_the_unit_of_its_actuator(tmp_path, actuator, unit):
    """Grippers often take 0 to 255 for their whole range, geared motors -1 to 1: no degrees, and no torque."""
    body = '<body><joint name="finger" range="0 0.8"/><geom size="0.1"/></body>'
    model = tmp_path / "gripper.xml"
    servo = actuator.format('name="grip" joint="finger"')
    model.write_text(f"<mujoco><worldbody>{body}</worldbody><actuator>{servo}</actuator></mujoco>")
    table = {"t": T, "grip": 3 * np.sin(T), "finger": 0.3 + 0.15 * np.sin(T - 0.1)}
    assert channels_of(tmp_path, model, table)[0]["command"]["columns"]["grip"]["unit"] == unit


@pytest.mark.parametrize("encoder", ["encoder_1", "marker_qx"])
def test_columns_with_the_names_of_the_models_sensors_belong_to_what_they_read(tmp_path, encoder):
    """A log of MuJoCo's sensors has their names, which need not contain those of the joints and sites.

    A name may begin as another one does.
    """
    model = tmp_path / "arm.xml"
    link = '<body pos="0 0 -1"><joint name="{0}" range="-90 90"/><geom size="0.1"/><site name="{0}_mark"/>{1}</body>'
    model.write_text(
        f"<mujoco><worldbody>{link.format('upper', link.format('lower', ''))}</worldbody>"
        '<actuator><position name="servo" joint="upper" kp="20"/></actuator><sensor>'
        '<framepos name="marker" objtype="site" objname="lower_mark"/>'
        f'<jointpos name="{encoder}" joint="upper"/>'
        '<framepos name="apart" objtype="site" objname="upper_mark" reftype="site" refname="lower_mark"/>'
        "</sensor></mujoco>"
    )
    names = ("servo", encoder, "marker_x", "marker_y", "marker_z", "apart_x")
    table = {"t": T} | {name: 0.5 * np.sin(T - 0.1 * place) for place, name in enumerate(names)}
    invoke(*new_rig(tmp_path, model, table))  # is written though the marker does not show the lower joint
    channels = yaml.safe_load((tmp_path / "stage.yaml").read_text())["channels"]
    assert {name: use["source"] for name, use in channels["measured"]["columns"].items()} == {"upper": encoder}
    assert {name: use["source"] for name, use in channels["mocap"]["columns"].items()} == {
        f"lower_mark_{axis}": f"marker_{axis}" for axis in "xyz"
    }


@pytest.mark.parametrize(
    ("actuator", "angle", "torque"),
    [
        ('<position name="servo" joint="upper" kp="20"/>', "upper/position", "upper/effort"),
        ("", "upper_rad", "upper_tau_Nm"),
        ('<motor name="servo" joint="upper"/>', "upper", "load_cell"),  # by the name of the model's sensor
    ],
)
def test_a_joint_without_commands_is_driven_by_its_torque(tmp_path, actuator, angle, torque):
    """A robot's joint states have efforts more often than a log has the commands of its drives."""
    model = tmp_path / "arm.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="upper" range="-90 90"/><geom pos="0 0 -0.5" size="0.1"/></body>'
        f"</worldbody><actuator>{actuator}</actuator>"
        '<sensor><jointactuatorfrc name="load_cell" joint="upper"/></sensor></mujoco>'
    )
    channels, text = channels_of(tmp_path, model, {"t": T, angle: 0.5 * np.sin(T), torque: np.cos(3 * T)})
    assert channels.keys() == {"measured", "torque"}
    upper = channels["torque"]["columns"]["upper"]
    assert (upper["source"], upper["unit"].replace(" ", "")) == (torque, "Nm")
    assert "count as free" not in text


def test_joints_that_nothing_drives_are_stated_in_the_terminal(tmp_path):
    """A URDF has no actuators, and positions alone do not show that motors drive its joints."""
    model = tmp_path / "arm.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="upper" range="-90 90"/><geom pos="0 0 -0.5" size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    table = {"t": T, "upper": 0.5 * np.sin(T), "upper/temperature": np.cos(3 * T)}
    result = succeed(*new_rig(tmp_path, model, table))
    assert "these joints count as free: upper; if motors drive them" in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("angle", "command", "others"),
    [
        ("joint1_present_position", "joint1_goal_position", ("joint1_present_voltage", "joint1_present_temperature")),
        ("joint1_position", "joint1_cmd", ("joint1_temp", "joint1_err", "joint1_acc [deg/s^2]")),
        ("joint1_measured", "joint1_desired", ("joint1_err",)),
        ("joint1", "joint1_ref", ("joint1_position_error", "joint1_A")),
        ("qpos.joint1", "ctrl.joint1", ("qvel.joint1",)),
        ("observation.state.joint1.pos", "action.joint1.pos", ()),
    ],
)
def test_temperatures_voltages_and_errors_of_a_joint_are_not_its_angle(tmp_path, angle, command, others):
    model = tmp_path / "arm.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="joint1" range="-90 90"/><geom pos="0 0 -0.5" size="0.1"/></body>'
        '</worldbody><actuator><position name="servo" joint="joint1" kp="20"/></actuator></mujoco>'
    )
    table = {"t": T, angle: 0.5 * np.sin(T - 0.1), command: 0.5 * np.sin(T)}
    channels, _ = channels_of(tmp_path, model, table | {name: np.cos(3 * T) for name in others})
    assert channels["measured"]["columns"]["joint1"]["source"] == angle
    assert channels["command"]["columns"]["servo"]["source"] == command


def test_a_motor_takes_no_angle_for_its_torque(tmp_path):
    """Logs of legged robots have the angle that the controller wants beside the torque that it sends."""
    model = tmp_path / "leg.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="knee" range="-90 90"/><geom pos="0 0 -0.5" size="0.1"/></body>'
        '</worldbody><actuator><motor name="drive" joint="knee"/></actuator></mujoco>'
    )
    table = {"t": T, "q_knee": 0.5 * np.sin(T - 0.1), "q_des_knee": 0.5 * np.sin(T), "tau_knee": np.cos(3 * T)}
    channels, _ = channels_of(tmp_path, model, table)
    assert channels["torque"]["columns"]["knee"]["source"] == "tau_knee"
    assert "command" not in channels
