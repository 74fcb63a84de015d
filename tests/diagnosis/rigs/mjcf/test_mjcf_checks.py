"""Wrong descriptions of a mechanism are reported before the fit, each with its remedy."""

import re
from dataclasses import replace

import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, TrialError
from softarm.diagnosis.rigs.grid import held_integral, held_means
from softarm.diagnosis.rigs.mjcf.checks import Compared, assumptions, mistakes, unexplained, unlike
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from softarm.diagnosis.rigs.mjcf.view import JointView
from tests.diagnosis.rigs.recordings import of_joint, rms, view_of_joint
from validation.mechanisms.cases import stage_text
from validation.mechanisms.record import ROBOTS, Truth, record, write


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return the text of a healthy recording of camera, leg and cart-pole, by robot."""
    folder = tmp_path_factory.mktemp("recorded")
    found = {}
    for name, seconds in (("camera", 2.5), ("leg", 3.0), ("cartpole", 2.0)):
        write(record(ROBOTS[name], Truth({}), "multisine", seconds, np.random.default_rng(1)), folder / f"{name}.csv")
        found[name] = (folder / f"{name}.csv").read_text()
    return found


def view(folder, recorded, robot, joint, change=("", ""), model=("", "")):
    """Build the view of one joint, with a changed stage.yaml or MJCF: the old and the new text of each."""
    (folder / "multisine-0.csv").write_text(recorded[robot])
    stage = stage_text(ROBOTS[robot]).replace("  - {files: holds-*.csv, kind: holds}\n", "")
    (folder / "stage.yaml").write_text(stage.replace(*change))
    (folder / "robot.xml").write_text(ROBOTS[robot].model.read_text().replace(*model))
    return view_of_joint(folder / "stage.yaml", joint)


def signals(seen, speed, command, needed):
    """Return signals whose motion needs the opposite torque if the readings have the opposite sign."""
    return Compared(seen, command, needed, np.stack((np.sign(speed), speed), axis=1), lambda: -needed)


def complaints(found, joint="hip"):
    """Return the mistakes that signals of a joint of the leg, or of the camera, show."""
    robot = "leg" if joint == "hip" else "camera"
    return list(mistakes(Mechanism(ROBOTS[robot].model).joint(joint), "run.csv", found))


@pytest.mark.parametrize(
    ("robot", "joint", "old", "new", "said"),
    [
        ("camera", "tilt", "source: q_tilt, unit: rad", "source: q_tilt, unit: rad, scale: 57.2958", "unit: deg"),
        ("camera", "tilt", "source: cmd_tilt, unit: rad", "source: cmd_tilt, unit: deg", "range 57.[0-9]* times"),
        ("camera", "tilt", "source: q_tilt, unit: rad", "source: q_tilt, unit: rad, scale: -1", "opposite sign"),
        ("cartpole", "hinge", "q_hinge, unit: rad", "q_hinge, unit: deg", "with `unit: rad` for hinge it explains"),
        ("cartpole", "hinge", "q_hinge, unit: rad", "q_hinge, unit: rad, scale: 57.3", "with `unit: deg` for hinge"),
        ("cartpole", "hinge", "q_hinge, unit: rad", "q_hinge, unit: rad, add: 3.1416", "with `add: 3.142` for hinge"),
        ("cartpole", "hinge", "q_hinge, unit: rad", "q_hinge, unit: rad, scale: -1", "or `scale: -1` for rail"),
        ("camera", "pan", "pan: {source: q_pan", "pam: {source: q_pan", "did you mean pan"),
        ("camera", "pan", "pan_drive: {", "pan_motor: {", "add a column pan_drive"),
    ],
)
def test_a_wrong_description_names_its_remedy(tmp_path, recorded, robot, joint, old, new, said):
    joint = "pam" if "pam" in new else joint
    with pytest.raises(TrialError, match=said):
        view(tmp_path, recorded, robot, joint, (old, new))


@pytest.fixture(scope="module")
def noisy(recorded):
    """Return the recordings with encoders whose noise makes accelerations several times those of the leg."""
    header, *rows = (line.split(",") for line in recorded["leg"].split())
    values, random = np.array(rows, float), np.random.default_rng(3)
    encoders = [name.startswith("q_") for name in header]
    values[:, encoders] = np.round(values[:, encoders] + 1e-3 * random.normal(size=(len(values), 3)), 3)
    lines = [",".join(f"{x:.6g}" for x in row) for row in values]
    return {"leg": "\n".join([",".join(header), *lines, ""])}


@pytest.mark.parametrize(
    ("joint", "old", "new", "said"),
    [
        ("hip", "cmd_hip, unit: N m", "cmd_hip, unit: N m, scale: -1", "its command has the opposite sign"),
        ("knee", "q_knee, unit: rad", "q_knee, unit: rad, scale: -1", "its readings have the opposite sign"),
        ("ankle", "q_ankle, unit: rad", "q_ankle, unit: rad, scale: -1", "its readings have the opposite sign"),
        ("hip", "cmd_hip, unit: N m", "cmd_hip, unit: N m, scale: 0.01", "write the gear ratio as `gear`"),
    ],
)
def test_noise_of_accelerations_hides_no_mistake(tmp_path, noisy, joint, old, new, said):
    with pytest.raises(TrialError, match=f"{joint}.*{said}"):
        view(tmp_path, noisy, "leg", joint, (old, new))


def test_a_recording_with_a_constant_torque_hides_no_mistake(tmp_path, noisy):
    """The leg hangs at rest without torque, and the noise of its encoders is all that changes."""
    header, *rows = noisy["leg"].split()
    random = np.random.default_rng(4)
    still = [
        ",".join([row.split(",")[0], "0,0,0", *(f"{x:.3f}" for x in 1e-3 * random.normal(size=3))]) for row in rows
    ]
    (tmp_path / "multisine-1.csv").write_text("\n".join([header, *still, ""]))
    with pytest.raises(TrialError, match="its command has the opposite sign"):
        view(tmp_path, noisy, "leg", "hip", ("cmd_hip, unit: N m", "cmd_hip, unit: N m, scale: -1"))


def test_a_column_of_another_joint_is_warned_of(tmp_path, noisy):
    says = r"hip: by the model, its motion explains \d+ % of the variation of its torque; check that"
    for column in ("cmd", "q"):
        swapped = f"source: {column}_hip", f"source: {column}_ankle"
        (warning,) = view(tmp_path, noisy, "leg", "hip", swapped).assumptions
        assert re.match(says, warning)
    assert view(tmp_path, noisy, "leg", "hip").assumptions == ()


def test_a_wrong_column_is_found_by_the_torque_of_another_joint(tmp_path, noisy):
    turned = "q_knee, unit: rad", "q_knee, unit: rad, scale: -1"
    (warning,) = view(tmp_path, noisy, "leg", "hip", turned).assumptions
    assert re.fullmatch(r"hip: by the model, .* of its torque; with `scale: -1` for knee it explains 9\d %", warning)


def test_torques_for_a_position_loop_and_positions_for_a_motor_are_reported(tmp_path, recorded):
    servo = '<motor name="hip_motor" joint="hip" gear="6" ', '<position name="hip_motor" joint="hip" kp="20" kv="1" '
    with pytest.raises(TrialError, match=r"resembles the torque of its motion.*move the column to `torque`, as hip"):
        view(tmp_path, recorded, "leg", "hip", model=servo)
    motor = re.search(r'<position name="tilt_drive"[^>]*>', ROBOTS["camera"].model.read_text())
    with pytest.raises(TrialError, match="resembles its position, and its actuator tilt_drive takes torques"):
        view(tmp_path, recorded, "camera", "tilt", model=(motor[0], '<motor name="tilt_drive" joint="tilt"/>'))


@pytest.mark.parametrize("actuator", ['<position name="hip_motor" joint="hip" kp="20" kv="1"/>', ""])
def test_a_measured_torque_takes_the_place_of_any_actuator(tmp_path, recorded, actuator):
    motor = re.search(r"<motor name=\"hip_motor\"[^>]*>", ROBOTS["leg"].model.read_text())[0]
    torque = (
        "  torque:\n    time: {source: t, unit: s}\n    columns:\n"
        "      hip: {source: cmd_hip, unit: N m, scale: 6}\n  command:"
    )
    found = view(tmp_path, recorded, "leg", "hip", ("  command:", torque), (motor, actuator))
    assert rms(found) < 5e-3
    with pytest.raises(TrialError, match="resembles its position, and its actuator hip takes torques"):
        view(tmp_path, recorded, "leg", "hip", ("  command:", torque.replace("cmd_hip", "q_hip")), (motor, actuator))


def test_a_zero_outside_the_joints_range_is_reported(tmp_path, recorded):
    added = "source: q_tilt, unit: rad", "source: q_tilt, unit: rad, add: 3.2"
    ranged = 'name="tilt" type="hinge"', 'name="tilt" type="hinge" range="-0.8 0.8"'
    with pytest.raises(TrialError, match="their zeros differ: write `add`"):
        view(tmp_path, recorded, "camera", "tilt", added, ranged)
    below = 'name="tilt" type="hinge"', 'name="tilt" type="hinge" range="-4 -2.4"'
    with pytest.raises(TrialError, match="their sign or zero differs: write `scale: -1`, or `add` for the column"):
        view(tmp_path, recorded, "camera", "tilt", added, below)


@pytest.mark.parametrize(
    ("factor", "limit", "refused"),
    [(5.0, np.inf, True), (0.01, np.inf, True), (0.2, np.inf, False), (1.0, 0.3, False)],
)
def test_neither_a_torque_limit_nor_a_payload_is_a_wrong_unit(factor, limit, refused):
    """Small torques separate a limit from a wrong gear or unit; a payload may load a wrist with five times its own."""
    command = np.random.default_rng(2).normal(size=2000)
    needed = factor * np.clip(command, -limit, limit)
    seen = np.cumsum(command) * 1e-3
    assert bool(complaints(signals(seen, np.roll(command, 700), command, needed))) == refused


@pytest.mark.parametrize(("factor", "refused"), [(1.0, False), (5.0, True)])
def test_torque_in_pulses_shows_a_wrong_unit(factor, refused):
    random = np.random.default_rng(2)
    command = random.normal(size=2000) * (np.arange(2000) % 20 < 5)
    seen = np.cumsum(command) * 1e-3
    needed = factor * command + 1e-3 * random.normal(size=2000)
    assert bool(complaints(signals(seen, np.roll(command, 700), command, needed))) == refused


def beside_a_box(z_m, gap_m=0):
    """Return the old and the new world of the camera, with a geom near its centre and a large box at a height."""
    text, eye = ROBOTS["camera"].model.read_text(), '<body name="camera" pos="0 0 0.1">'
    world = text[text.index("<worldbody>") : text.index(eye) + len(eye)]
    box = f'<worldbody><geom type="box" size="9 9 9" pos="0 0 {z_m}" gap="{gap_m}"/>'
    return world, world.replace("<worldbody>", box) + f'<geom size="0.01" mass="0" gap="{gap_m}"/>'


def test_a_joint_that_always_touches_something_is_reported(tmp_path, recorded):
    message = r"tilt is free .* in 0 samples; needed are 100: camera touches world in (\d+) of \1; .* exclude this pair"
    with pytest.raises(TrialError, match=message):
        view(tmp_path, recorded, "camera", "tilt", model=beside_a_box(z_m=0))


def test_a_contact_within_its_gap_has_no_force_and_does_not_count(tmp_path, recorded):
    """Models of arms have touching links, whose contact MuJoCo lists and leaves out."""
    near = view(tmp_path, recorded, "camera", "tilt", model=beside_a_box(z_m=-12, gap_m=20))
    assert np.isfinite(near.measured).all()


def test_a_short_recording_in_free_motion_is_not_taken_for_contact(tmp_path, recorded):
    short = "files: multisine-*.csv, kind: multisine", "files: multisine-*.csv, kind: multisine, from_s: 1, to_s: 1.9"
    assert len(view(tmp_path, recorded, "camera", "tilt", short).measured) < 100


def test_joints_that_are_not_measured_are_stated_and_followers_are_not(tmp_path, recorded):
    """The tilt rides on the pan axis, on the vehicle and on a ship, and turns a knob with it."""
    trunk = '<body name="vehicle">', '<body name="ship"><freejoint name="root"/><geom size="0.1"/><body name="vehicle">'
    assert not view(tmp_path, recorded, "camera", "tilt").warnings({})
    text = ROBOTS["camera"].model.read_text().replace(*trunk).replace("</worldbody>", "</body></worldbody>", 1)
    knob = '<body name="knob"><joint name="knob" axis="0 0 1"/><geom size="0.01"/></body></worldbody>'
    tie = '</worldbody><equality><joint joint1="tilt" joint2="knob"/></equality>'
    text = text.replace("</worldbody>", knob, 1).replace("</worldbody>", tie, 1)
    (tmp_path / "tied.xml").write_text(text)
    mechanism, measured = Mechanism(tmp_path / "tied.xml", ("pan", "tilt")), dict.fromkeys(("pan", "tilt"))
    (still,) = assumptions(mechanism, mechanism.joint("tilt"), measured)
    assert still.startswith("tilt: no column measures root, track of the same chain: counted as still;")
    turned = measured | dict.fromkeys(("root_qw", "root_qx", "root_qy", "root_qz"))
    (still,) = assumptions(mechanism, mechanism.joint("tilt"), turned)
    assert "no column measures root_x, root_y, root_z, track of the same chain" in still
    assert mechanism.leader(mechanism.joint("knob")) == "tilt"


def test_stretches_of_a_recording_are_too_short_to_be_judged(tmp_path, recorded):
    """A chosen second of a right description may resemble a wrong one."""
    with pytest.raises(TrialError, match="opposite sign"):
        view(
            tmp_path, recorded, "camera", "tilt", ("source: q_tilt, unit: rad", "source: q_tilt, unit: rad, scale: -1")
        )
    (trial,) = of_joint(tmp_path / "stage.yaml", "tilt")
    assert JointView([replace(trial, recording="multisine")]).stage == "tilt"


def test_a_joint_that_stays_while_its_command_moves_is_reported(tmp_path, recorded):
    lines = [line.split(",") for line in recorded["camera"].splitlines()]
    tilt = lines[0].index("q_tilt")
    still = [*lines[:1], *([*row[:tilt], f"{float(row[tilt]) / 200:.4f}", *row[tilt + 1 :]] for row in lines[1:])]
    stuck = {**recorded, "camera": "\n".join(map(",".join, still)) + "\n"}
    (warning,) = (text for text in view(tmp_path, stuck, "camera", "tilt").warnings({}) if "its command by" in text)
    assert warning.startswith("tilt moves by 0.00")
    assert "blocked, switched off or weaker than its friction" in warning
    moving = view(tmp_path, recorded, "camera", "tilt")
    assert not any("its command by" in text for text in moving.warnings({}))


@pytest.mark.parametrize(("alike", "refused"), [(0.92, True), (0.77, False)])
def test_a_position_that_lags_far_behind_is_no_torque(alike, refused):
    """A servo that friction slows moves at a speed that follows its command, and so does the torque that it needs."""
    random = np.random.default_rng(4)
    command, other, seen = random.normal(size=(3, 5000))
    needed = alike * command + np.sqrt(1 - alike**2) * other
    assert bool(complaints(signals(seen, np.gradient(seen), command, needed), "tilt")) == refused


def test_friction_that_takes_most_of_the_torque_is_no_wrong_unit():
    """The model lacks it, as models of geared arms often do: its torques are a sixth of the commands."""
    random = np.random.default_rng(4)
    speed = np.cumsum(random.normal(size=5000))
    speed -= np.mean(speed)
    needed = 0.3 * np.sign(speed) + 0.1 * random.normal(size=5000)
    command = needed + 1.5 * np.sign(speed)
    assert complaints(signals(np.cumsum(speed), speed, command, needed)) == []
    assert len(complaints(signals(np.cumsum(speed), speed, 1000 * command, needed))) == 1


@pytest.mark.parametrize(("stiffness", "refused"), [(40.0, False), (0.0, True)])
def test_a_strong_spring_is_no_opposite_sign(stiffness, refused):
    """A spring turns the torque against the acceleration, as readings of the opposite sign do."""
    t_s = np.linspace(0.0, 20.0, 2000)
    waves = [(w, np.sin(w * t_s + w)) for w in (4.0, 4.5, 5.0)]
    seen, acceleration = sum(wave for _, wave in waves), sum(-(w**2) * wave for w, wave in waves)
    command = acceleration + stiffness * seen if stiffness else -acceleration
    hip = Mechanism(ROBOTS["leg"].model).joint("hip")
    found = signals(seen, np.gradient(seen, t_s), command, acceleration)
    assert np.corrcoef(command, -acceleration)[0, 1] > 0.85
    assert bool(complaints(found)) == refused
    assert not list(unlike(hip, found))


@pytest.mark.parametrize(("alike", "refused"), [(0.65, False), (0.95, True)])
def test_a_torque_of_another_form_is_no_wrong_unit(alike, refused):
    """A joint whose zero is off by a right angle has ten times its torque in the model, and another one."""
    command, other, seen = np.random.default_rng(4).normal(size=(3, 5000))
    needed = 10 * (alike * command + np.sqrt(1 - alike**2) * other)
    assert bool(complaints(signals(seen, np.gradient(seen), command, needed))) == refused


@pytest.mark.parametrize("torque", [0.3, 0.5, 1.0, 2.37])
def test_a_constant_torque_says_nothing_of_the_motion(torque):
    """Its means over samples differ by rounding."""
    speed = np.random.default_rng(4).normal(size=5000)
    stamps = Series(np.arange(0.0, 50.0, 0.01), {})
    command = held_means(held_integral(stamps, np.full(5000, torque), 1.0), 0.0, 0.01, 5000)
    assert np.ptp(command) > 0
    assert unexplained(command, speed[:, None], speed) == 0.0
    hip = Mechanism(ROBOTS["leg"].model).joint("hip")
    found = signals(np.cumsum(speed), speed, command, speed)
    assert [*complaints(found), *unlike(hip, found)] == []


@pytest.mark.parametrize("size", [0.0, 1e-6])
def test_a_motor_that_is_off_or_tiny_is_no_mistake(size):
    random = np.random.default_rng(4)
    speed, needed = random.normal(size=(2, 5000))
    hip = Mechanism(ROBOTS["leg"].model).joint("hip")
    found = signals(np.cumsum(speed), speed, size * needed, size * needed)
    assert [*complaints(found), *unlike(hip, found)] == []
