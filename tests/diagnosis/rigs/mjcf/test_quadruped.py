"""A quadruped that trots on the ground, recorded by MuJoCo itself: floating base, contacts and soft friction."""

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data import tables
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.mjcf.view import JointView
from tests.diagnosis.rigs.recordings import described, rms

pytestmark = pytest.mark.prove

LEG = """
<body name="{leg}_hip" pos="{x} {y} 0"><joint name="{leg}_hip" axis="1 0 0"/>
  <inertial pos="0 {out} 0" mass="0.68" diaginertia="9e-4 6e-4 5e-4"/>
  <body name="{leg}_thigh" pos="0 {out} 0"><joint name="{leg}_thigh" axis="0 1 0"/>
    <inertial pos="0 0 -0.04" mass="1.15" diaginertia="6e-3 6e-3 9e-4"/>
    <body name="{leg}_calf" pos="0 0 -0.21"><joint name="{leg}_calf" axis="0 1 0"/>
      <inertial pos="0 0 -0.12" mass="0.24" diaginertia="1.5e-3 1.5e-3 6e-5"/>
      <geom size="0.022" pos="0 0 -0.21" mass="0"/>
    </body>
  </body>
</body>
"""
LEGS = {"fl": (0.19, 0.05), "fr": (0.19, -0.05), "rl": (-0.19, 0.05), "rr": (-0.19, -0.05)}
JOINTS = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")]
JUDGED = JOINTS[6:9]
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
MODEL = f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><joint type="hinge" damping="0.2" armature="0.01" frictionloss="0.2"/></default>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body name="base" pos="0 0 0.36">
      <freejoint/>
      <inertial pos="0 0 0" mass="6.9" diaginertia="0.1 0.1 0.03"/>
      {"".join(LEG.format(leg=leg, x=x, y=y, out=0.1 * np.sign(y)) for leg, (x, y) in LEGS.items())}
    </body>
  </worldbody>
  <actuator>{"".join(f'<motor name="{joint}_motor" joint="{joint}"/>' for joint in JOINTS)}</actuator>
</mujoco>
"""
HOME = np.array([0.0, 0.9, -1.8] * 4)
PHASES = (0.0, 0.5, 0.5, 0.0)
FRICTION_NM = 0.8


def gait(t, rate_hz):
    """Return the wanted angles of all joints, which trot on the spot."""
    wanted, rise = HOME.copy(), min(t, 1.0)
    for i, phase in enumerate(PHASES):
        lift = max(0.0, np.sin(2 * np.pi * (t * rate_hz + phase))) * rise
        wanted[3 * i] = 0.08 * np.sin(np.pi * t + i)
        wanted[3 * i + 1] += 0.35 * lift + 0.05 * np.sin(2.3 * t + i)
        wanted[3 * i + 2] -= 0.7 * lift
    return wanted


def trot(file, rate_hz, random):
    """Record torques, angles and the base's pose at 500 Hz for eight seconds."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.dof_frictionloss[model.joint("rl_calf").dofadr] = FRICTION_NM
    data, rows = mujoco.MjData(model), []
    data.qpos[7:] = HOME
    for k in range(4000):
        data.ctrl[:] = np.clip(120 * (gait(0.002 * k, rate_hz) - data.qpos[7:]) - 2.5 * data.qvel[6:], -30, 30)
        angles, place = data.qpos[7:] + 5e-5 * random.normal(size=12), data.qpos[:3] + 1e-4 * random.normal(size=3)
        turn = data.qpos[3:7] + 5e-5 * random.normal(size=4)
        rows.append((0.002 * k, *data.ctrl, *angles, *place, *turn))
        mujoco.mj_step(model, data, nstep=2)
    assert data.qpos[2] > 0.2  # it stands
    names = ["t", *(f"{joint}_motor" for joint in JOINTS), *JOINTS, *(f"base_{part}" for part in POSE)]
    np.savetxt(file, rows, "%.7g", ",", header=",".join(names), comments="")


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    folder, random = tmp_path_factory.mktemp("quadruped"), np.random.default_rng(5)
    for number, rate_hz in enumerate((1.6, 1.9)):
        trot(folder / f"trot-{number}.csv", rate_hz, random)
    (folder / "robot.xml").write_text(MODEL)
    # One leg is judged, and the others move as measured.
    base = dict.fromkeys((joint for joint in JOINTS if joint not in JUDGED), "rad")
    base |= {f"base_{part}": "m" if len(part) == 1 else "1" for part in POSE}
    command = dict.fromkeys((f"{joint}_motor" for joint in JUDGED), "N m")
    return tables.read(
        described(folder, "robot.xml", measured=dict.fromkeys(JUDGED, "rad"), command=command, base=base)
    )


def test_the_swings_of_a_leg_remain_and_the_model_predicts_them(trials):
    view = JointView([trial for trial in trials if trial.stage.name == "rl_thigh"])
    assert 0.1 < np.isfinite(view.measured).mean() < 0.5
    assert rms(view) < 3e-3


def test_the_friction_of_one_calf_is_named(trials):
    verdict = diagnose_table(trials).verdict
    assert [effect.name for effect in verdict.effects] == ["rl_calf.coulomb_friction"]
    assert verdict.effects[0].parameters["torque"].value == pytest.approx(FRICTION_NM, rel=0.05)
