"""Errors of a recorded simulation that are no effect of the robot."""

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data import tables
from softarm.diagnosis.rigs.stage import examine, view_of
from tests.diagnosis.rigs.recordings import described_model, noisy, of_joint, rms, simulate

pytestmark = pytest.mark.slow
ROBOT = """<mujoco>
  <option timestep="0.002" integrator="{integrator}"/>
  <worldbody><body name="base">
    <joint name="turret" axis="0 0 1" damping="0.1"/>
    <geom type="cylinder" size="0.06 0.05" mass="2" contype="0" conaffinity="0"/>
    <body name="boom" pos="0 0 0.1">
      <joint name="shoulder" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03" mass="3" contype="0" conaffinity="0"/>
    </body>
  </body></worldbody>
  <actuator><motor name="turn" joint="turret"/><motor name="lift" joint="shoulder"/></actuator>
</mujoco>
"""
RATE_HZ, SECONDS = 125, 3


def record(text, file, seed):
    """Track sines by torques of the model's inverse dynamics, with MuJoCo's own steps, and encoders of 0.02 mrad."""
    model = mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(model), np.random.default_rng(seed)
    t = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    phase = random.uniform(0, 2 * np.pi, (2, 2))
    wanted = [
        [0.5 * np.sin(2 * np.pi * f * t + p) / f**0.5 for f, p in zip((0.4, 1.1), each, strict=True)] for each in phase
    ]
    wanted = np.sum(wanted, axis=1).T
    speeds = np.gradient(wanted, 1 / RATE_HZ, axis=0)
    data.qpos[:], data.qvel[:] = wanted[0], speeds[0]

    def torques(data, goal):
        data.qacc[:] = 100 * (goal[0] - data.qpos) + 20 * (goal[1] - data.qvel)
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse

    goals = np.stack((wanted, speeds), axis=1)
    simulate(model, file, goals, data=data, control=torques, read=noisy(random, 2e-5), step_s=1 / RATE_HZ)


def turret(folder, integrator, recordings=2):
    """Return the trials of the turret, of a healthy robot that MuJoCo has moved."""
    text = ROBOT.format(integrator=integrator)
    for seed in range(recordings):
        record(text, folder / f"motion-{seed}.csv", seed)
    return of_joint(described_model(folder, text, "N m"), "turret")


@pytest.mark.parametrize("integrator", ["Euler", pytest.param("implicitfast", marks=pytest.mark.prove)])
def test_the_steps_of_a_simulation_are_recognised_and_no_effect(tmp_path, integrator):
    trials = turret(tmp_path, integrator)
    without = rms(view_of(trials)[0])
    found = examine(trials)
    assert found.decision.kind == "none"
    assert any("the model's own step of 0.002 s" in text for text in found.warnings)
    assert not any("creep" in text for text in found.warnings)
    assert found.answer.before < 0.5 * without


SERVO = """<mujoco>
  <option timestep="{step}"><flag eulerdamp="disable"/></option>
  <worldbody><body>
    <joint name="elbow" axis="0 1 0" damping="{damping}" armature="{armature}" frictionloss="{dry}"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.01" mass="{mass}"/>
  </body></worldbody>
  <actuator><position name="servo" joint="elbow" kp="{kp}"/></actuator>
</mujoco>
"""
FINGER = {"step": 0.01, "damping": 0.2, "armature": 0.0015, "mass": 0.03, "kp": 3}
KNEE = {"step": 0.002, "damping": 7, "armature": 0.1, "mass": 1, "kp": 400}


def servo(folder, sizes, dry):
    """Return the trials of a position loop that MuJoCo has moved; dry: friction besides the model's."""
    model, t = mujoco.MjModel.from_xml_string(SERVO.format(dry=0.02 + dry, **sizes)), np.arange(300) / 100
    for seed in range(2):
        data, random = mujoco.MjData(model), np.random.default_rng(seed)
        phases = random.uniform(0, 2 * np.pi, 3)
        goals = 0.2 * sum(np.sin(2 * np.pi * f * t + p) for f, p in zip((0.3, 0.9, 1.7), phases, strict=True))
        data.qpos[:] = goals[0]
        simulate(model, folder / f"motion-{seed}.csv", goals, data=data, read=noisy(random, 2e-4))
    return tables.read(described_model(folder, SERVO.format(dry=0.02, **sizes)))


@pytest.mark.parametrize(
    ("sizes", "dry"),
    [
        (FINGER, 0.0),
        pytest.param(FINGER, 0.1, marks=pytest.mark.prove),
        pytest.param(KNEE, 3.0, marks=pytest.mark.prove),
    ],
)
def test_a_simulated_position_loop_has_its_friction_and_nothing_else(tmp_path, sizes, dry):
    found = examine(servo(tmp_path, sizes, dry))
    assert [effect.name for effect in found.named] == (["elbow.coulomb_friction"] if dry else [])
    assert found.answer.after < 1.5 * float(found.answer.floor)


def test_an_integrator_of_higher_order_has_no_such_error(tmp_path):
    view, _ = view_of(turret(tmp_path, "RK4", recordings=1))
    assert not any(law["simulation.stepped"] for law in view.laws)
