"""The law of one joint against MuJoCo with hard friction, and against closed forms."""

import math

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism

H = 0.001
SERVO = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body>
      <joint name="elbow" type="hinge" axis="0 1 0" damping="{damping}" frictionloss="{dry}"
             armature="0.01" solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>
      <inertial pos="0 0 -0.2" mass="0.5" diaginertia="1e-3 1e-3 1e-4"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="elbow" kp="{kp}" kv="0.3" forcerange="-{limit} {limit}"/></actuator>
</mujoco>
"""


def law(**values):
    """Return the parameters of a law, without limits and friction unless given."""
    found = np.zeros(laws.COLUMNS)
    found[laws.LOW], found[laws.HIGH], found[laws.SPEED], found[laws.LOAD_SPEED] = -np.inf, np.inf, 1.0, 1.0
    for name, value in values.items():
        found[getattr(laws, name)] = value
    return found


def travelled(parameters, drive, path=None, start=(0.0, 0.0)):
    """Return the positions at every step; by default of a joint without any load, with an inertia of one."""
    return simulated(parameters[None], [drive], path, [start])[0]


def simulated(parameters, drives, path=None, starts=((0.0, 0.0),)):
    """Return the positions of P points [P, M]; windows of equal length begin at `starts`."""
    size = len(drives[0])
    if path is None:
        path = np.zeros((laws.ROWS, size))
        path[laws.INERTIA] = 1.0
    edges = np.linspace(0, size, len(starts) + 1).astype(np.int64)
    windows = laws.Windows(np.zeros(size), edges, np.array(starts), np.zeros(len(starts)), np.full(len(starts), H))
    return -laws.residuals(windows, laws.Inputs.of(drives, [path] * len(drives)), parameters, 1)


def of_mujoco(robot, joint):
    """Return the parameters of a driven joint that MuJoCo moves with its own steps."""
    servo, steps = joint.actuator, robot.stepping
    found = {"KP": servo.kp, "KD": servo.kd, "LOW": servo.low, "HIGH": servo.high}
    found |= {"AHEAD": steps.damping_s, "LOOP_AHEAD": steps.loop_s}
    return found | {"VISCOUS": joint.viscous, "DRY": joint.dry}


HARD = 'solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"'


@pytest.mark.parametrize(
    ("dry", "kp", "limit", "creeps"),
    [(0.0, 20, 10, False), (0.1, 20, 10, False), (0.1, 60, 0.8, False), (0.5, 20, 10, True), (1.0, 60, 4, True)],
)
def test_a_servo_moves_as_in_mujoco(tmp_path, dry, kp, limit, creeps):
    file, text = tmp_path / "servo.xml", SERVO.format(damping=0.05, dry=dry, kp=kp, limit=limit)
    file.write_text(text.replace(HARD, "") if creeps else text)
    assert HARD in text
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    command = 0.6 * np.sign(np.sin(2 * np.pi * 0.7 * H * np.arange(3000)))
    q, v = np.empty(3000), np.empty(3000)
    for k in range(3000):
        q[k], v[k] = data.qpos[0], data.qvel[0]
        data.ctrl[0] = command[k]
        mujoco.mj_step(model, data)
    robot = Mechanism(file)
    joint = robot.joint("elbow")
    path = robot.terms(joint, robot.course(joint, {"elbow": (q, v, np.zeros(3000))}))
    servo = joint.actuator
    own = law(**of_mujoco(robot, joint))
    soft = own.copy()
    soft[laws.SOFT], soft[laws.YIELDS] = joint.softness, joint.yields_per_s
    rigid, creeping = (travelled(each, servo.scale * command, path) for each in (own, soft))
    if creeps:
        assert np.abs(rigid - q).max() > 0.008
    assert (creeping if creeps else rigid) == pytest.approx(q, abs=5e-4)


@pytest.mark.parametrize("damping", [0.5, 5.0, 50.0, 5e4])
def test_any_damping_is_right_to_second_order(damping):
    """The mean speed of the step before a push from rest is that half a step before."""
    t = H * np.arange(1000)
    found = travelled(law(VISCOUS=damping), np.ones(1000), start=(0.0, -0.5 * H))
    assert found == pytest.approx(t / damping - (1 - np.exp(-damping * t)) / damping**2, rel=0.01 * H, abs=H**2)


def test_dry_friction_holds_a_joint_below_its_level_and_slows_it_above():
    assert np.abs(travelled(law(DRY=1.0), np.full(1000, 0.9))).max() == 0
    found = travelled(law(DRY=1.0), np.full(1000, 1.5))
    assert found[-1] == pytest.approx(0.5 * 0.5 * 0.999**2, rel=5e-3)


def test_dry_friction_bends_like_a_spring_before_it_slips():
    pushed = np.concatenate((np.full(4000, 0.5), np.full(4000, -0.25)))
    found = travelled(law(DRY=1.0, GIVE=0.01, VISCOUS=2.0), pushed)
    assert found[3999] == pytest.approx(0.005, rel=0.02)
    assert found[-1] == pytest.approx(-0.0025, rel=0.02)
    # Beyond its level it is the friction of a rigid contact, less the way that it has bent.
    slipped = [travelled(law(DRY=1.0, GIVE=give), np.full(1000, 3.0))[-1] for give in (0.0, 0.01)]
    assert slipped[1] == pytest.approx(slipped[0], rel=0.06)
    assert slipped[1] > slipped[0]
    stiff = travelled(law(DRY=1.0, GIVE=1e-6), np.full(1000, 3.0))[-1]
    assert stiff == pytest.approx(slipped[0], rel=1e-3)


def test_errors_within_the_dead_band_make_no_torque():
    found = travelled(law(KP=50.0, KD=30.0, WIDTH=0.1), np.full(9000, 50.0))
    assert found[-1] == pytest.approx(0.9, abs=5e-3)


def test_play_delays_a_reversal_by_its_gap():
    there_and_back = np.concatenate((np.full(500, 1.0), np.full(1000, -1.0)))
    true = travelled(law(), there_and_back)
    seen = travelled(law(GAP=0.02), there_and_back)
    assert seen.max() == pytest.approx(true.max() - 0.01, abs=1e-4)
    assert seen[-1] == pytest.approx(true[-1] + 0.01, abs=1e-4)


def test_a_command_is_limited_in_its_rate_and_follows_with_a_lag():
    out = np.empty(1000)
    laws.follow(np.concatenate(([0.0], np.ones(999))), 2.0, 0.0, H, out)
    assert out[250] == pytest.approx(0.5, abs=2e-3)
    laws.follow(np.concatenate(([0.0], np.ones(999))), np.inf, 0.2, H, out)
    assert out[200] == pytest.approx(1 - math.exp(-1), abs=5e-3)


def test_points_and_windows_of_a_batch_do_not_depend_on_each_other():
    random = np.random.default_rng(4)
    points, size = 11, 180
    parameters = np.array(
        [
            law(
                KP=random.uniform(0, 100),
                DRY=random.uniform(0, 1),
                GIVE=random.choice([0.0, 0.01]),
                STICTION=random.choice([0.0, 0.5]),
                SPEED=0.1,
                HIGH=5.0,
                GAP=0.01,
            )
            for _ in range(points)
        ]
    )
    drives = [random.normal(size=size) for _ in range(points)]
    starts = random.normal(size=(5, 2))
    together = simulated(parameters, drives, starts=starts)
    alone = np.stack([simulated(x[None], [d], starts=starts)[0] for x, d in zip(parameters, drives, strict=True)])
    assert np.array_equal(together, alone)
    each = [travelled(parameters[0], drives[0][36 * w : 36 * (w + 1)], start=starts[w]) for w in range(5)]
    assert np.array_equal(together[0], np.concatenate(each))


def test_a_simulation_that_diverges_is_far_from_every_sample():
    found = travelled(law(SPRING=-1e6), np.full(3000, 1.0))
    assert np.abs(found[-1]) == laws.FAR
    assert np.isfinite(found).all()


def falls(share, part, speed=100.0):
    """Return the fall of a joint within 0.2 s whose motor lifts 0.9 N m of a weight of 1 N m."""
    path = np.zeros((laws.ROWS, 200))
    path[laws.INERTIA], path[laws.LOAD] = 1.0, 1.0
    friction = law(LOADED=share, FROM_LOAD=part, LOAD_SPEED=speed)
    return -travelled(friction, np.full(200, 0.9), path)[-1]


@pytest.mark.parametrize(("part", "gear_torque"), [(0.0, 0.9), (0.5, 0.95), (1.0, 1.0)])
def test_friction_in_a_gear_holds_a_share_of_the_torque_of_each_side(part, gear_torque):
    enough = 0.1 / gear_torque
    assert falls(1.01 * enough, part) == pytest.approx(0.0, abs=1e-12)
    assert falls(0.5 * enough, part) == pytest.approx(0.5 * falls(0.0, part), rel=1e-6)


def test_friction_in_a_gear_fades_with_the_speed():
    assert falls(0.05, 0.5) < falls(0.05, 0.5, speed=5e-3) < falls(0.0, 0.5)
