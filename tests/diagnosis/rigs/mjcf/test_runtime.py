"""Effects at run time: MuJoCo with them moves as the law that the diagnosis has fitted."""

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from softarm.diagnosis.rigs.mjcf.runtime import Motion, RuntimeEffects, Simulation
from tests.diagnosis.rigs.mjcf.test_joint_law import SERVO, H, law, of_mujoco, travelled
from tests.diagnosis.verdicts import effect, verdict, with_parameters
from validation.mechanisms.record import ROBOTS

STEPS = 500
COMMAND = 0.6 * np.sign(np.sin(2 * np.pi * 1.3 * H * np.arange(STEPS)))


PLAIN = SERVO.format(damping=0.05, dry=0.0, kp=20, limit=10)
DRY = SERVO.format(damping=0.05, dry=0.02, kp=20, limit=10)


def written(folder, model_text, *effects):
    """Write a model and a verdict, and return their paths."""
    model, file = folder / "servo.xml", folder / "verdict.json"
    model.write_text(model_text)
    file.write_text(verdict("named", *effects).model_dump_json())
    return file, model


def exact(name, unit="-", **sizes):
    return effect(name, **{key: (value, value, value, unit) for key, value in sizes.items()})


def flown(effects, path):
    """Return true positions, speeds and readings before every step, [STEPS] each."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    simulation = Simulation(effects, model, data)
    rows = []
    for command in COMMAND:
        rows.append((data.qpos[0], data.qvel[0], simulation.readings[0]))
        simulation.step(np.array([command]))
    return np.array(rows).T


@pytest.mark.parametrize(
    ("name", "sizes", "same"),
    [
        ("deadband", {"width": 0.08}, {"WIDTH": 0.08}),
        ("torque_offset", {"torque": 0.3}, {"OFFSET": 0.3}),
        ("drag", {"coefficient": 0.05}, {"DRAG": 0.05}),
        ("stiction", {"torque": 0.3, "speed": 0.3}, {"STICTION": 0.3, "SPEED": 0.3}),
        (
            "load_friction",
            {"share": 0.3, "from_load": 0.0, "speed": 20.0},
            {"LOADED": 0.3, "FROM_LOAD": 0.0, "LOAD_SPEED": 20.0},
        ),
        (
            "load_friction",
            {"share": 0.5, "from_load": 1.0, "speed": 1.5},
            {"LOADED": 0.5, "FROM_LOAD": 1.0, "LOAD_SPEED": 1.5},
        ),
        ("backlash", {"gap": 0.05}, {"GAP": 0.05}),
        ("sensor_bias", {"bias": 0.1}, {"BIAS": 0.1}),
    ],
)
def test_mujoco_moves_as_the_fitted_law(tmp_path, name, sizes, same):
    file, model = written(tmp_path, DRY, exact(f"elbow.{name}", **sizes))
    true, speed, seen = flown(RuntimeEffects.read(file, model), model)
    robot = Mechanism(model)
    joint = robot.joint("elbow")
    known = of_mujoco(robot, joint)
    path = robot.terms(joint, robot.course(joint, {"elbow": (true, speed, np.zeros(STEPS))}))
    drive = joint.actuator.scale * COMMAND
    expected = travelled(law(**known, **same), drive, path, start=(seen[0], 0.0))
    without = travelled(law(**known), drive, path)
    assert np.abs(seen - expected).max() < 0.1 * np.abs(expected - without).max()


def test_the_damping_of_a_loop_without_a_derivative_part_brakes_before_the_gear(tmp_path):
    sizes = {"share": 0.5, "from_load": 0.5, "speed": 20.0}
    text = SERVO.format(damping=1.5, dry=0.02, kp=20, limit=10).replace('kv="0.3"', 'kv="0"')
    file, model = written(tmp_path, text, exact("elbow.load_friction", **sizes))
    true, speed, _ = flown(RuntimeEffects.read(file, model), model)
    robot = Mechanism(model)
    joint = robot.joint("elbow")
    path = robot.terms(joint, robot.course(joint, {"elbow": (true, speed, np.zeros(STEPS))}))
    drive, known = joint.actuator.scale * COMMAND, of_mujoco(robot, joint)
    same = {"LOADED": 0.5, "FROM_LOAD": 0.5, "LOAD_SPEED": 20.0}
    after = travelled(law(**known, **same), drive, path)
    before = travelled(law(**known, **same, BACK_EMF=1.0), drive, path)
    assert joint.back_emf
    assert np.abs(true - before).max() < 0.1 * np.abs(after - before).max()


@pytest.mark.parametrize("name", ['name="servo"', ""])  # the robots of Gymnasium have actuators without names
def test_commands_and_readings_are_late_by_the_delays(tmp_path, name):
    text = PLAIN.replace('name="servo"', name)
    _, _, plain = flown(RuntimeEffects.read(*written(tmp_path, text)), tmp_path / "servo.xml")
    late = exact("elbow.dead_time", "ms", delay=40.0), exact("elbow.latency", "ms", delay=12.5)
    _, _, seen = flown(RuntimeEffects.read(*written(tmp_path, text, *late)), tmp_path / "servo.xml")
    at = np.arange(STEPS)
    assert seen[60:] == pytest.approx(np.interp(at - 52.5, at, plain)[60:], abs=1e-9)


def test_a_command_changes_no_faster_than_its_limit(tmp_path):
    slow = exact("elbow.rate_limit", "rad/s", rate=0.5)
    effects = RuntimeEffects.read(*written(tmp_path, PLAIN, slow))
    state, sent = effects.start(np.zeros(1), np.zeros(1)), []
    for _ in range(100):
        state, applied = effects.apply(state, np.ones(1), Motion(*(np.zeros(1),) * 4))
        sent.append(applied.ctrl[0])
    assert np.diff(sent) == pytest.approx(0.5 * H)


def test_a_batch_of_robots_is_drawn_within_the_intervals(tmp_path):
    found = effect("elbow.deadband", width=(0.05, 0.04, 0.06, "rad")), effect("elbow.latency", delay=(9, 6, 12, "ms"))
    effects = RuntimeEffects.read(*written(tmp_path, PLAIN, *found))
    many = effects.drawn(np.random.default_rng(3), 500)
    width = many.parameters.deadband
    assert width.shape == (500, 1)
    assert 0.04 <= width.min() < 0.042
    assert 0.058 < width.max() <= 0.06
    state = many.start(np.zeros((500, 1)), np.zeros((500, 1)))
    motion = Motion(*(np.zeros((500, 1)),) * 4)
    _, applied = many.apply(state, np.full((500, 1), 0.05), motion)
    assert applied.ctrl == pytest.approx(np.maximum(0.05 - width, 0.0))
    for k in range(20):
        state, seen = many.measure(state, np.full((500, 1), k * 1.0))
    assert seen == pytest.approx(19 - many.parameters.latency_s / H)


def test_calibration_and_best_fit_are_read_as_the_patch_has_them(tmp_path):
    file, model = written(tmp_path, DRY)
    found = with_parameters(
        [("elbow.deadband.width", 0.08, "rad")],
        [("elbow.dead_time.delay", 3.0, "ms")],
        [("elbow.backlash.gap", 0.05, "rad")],
    )
    file.write_text(found.model_dump_json())

    def read(**choice):
        read = RuntimeEffects.read(file, model, **choice)
        p = read.parameters
        return *(float(each[0]) for each in (p.deadband, p.dead_time_s, p.backlash)), len(read.intervals)

    assert read() == (0.08, 0.003, 0.0, 1)
    assert read(calibration=False) == (0.08, 0.0, 0.0, 1)
    assert read(best_fit=True) == (0.0, 0.0, 0.05, 0)


def test_a_verdict_of_another_robot_is_refused(tmp_path):
    file, _ = written(tmp_path, PLAIN, exact("elbow.deadband", width=0.1))
    with pytest.raises(TrialError, match="no hinge or slide joint elbow"):
        RuntimeEffects.read(file, ROBOTS["camera"].model)


def test_friction_by_load_is_a_share_of_the_whole_torque_of_a_tendon(tmp_path):
    """The tendon moves the gripper's left finger by half, and the right one by the other half."""
    file, model = written(tmp_path, ROBOTS["gripper"].model.read_text(), exact("left.load_friction", share=0.1))
    robot = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(robot)
    simulation = Simulation(RuntimeEffects.read(file, model), robot, data)
    for _ in range(2):
        simulation.step(np.array([0.0, 0.01]))
    force, dry = abs(data.actuator("grip_servo").force[0]), robot.dof_frictionloss[robot.joint("left").dofadr[0]]
    assert force > 5
    assert dry == pytest.approx(1.2 + 0.1 * force, rel=0.05)
