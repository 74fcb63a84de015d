"""Laws of a simulation, which all joints of a mechanism determine together."""

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data import tables
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.settling import chosen_law, common_law, is_other_law
from softarm.diagnosis.rigs.stage import examine
from tests.diagnosis.rigs.recordings import described_model, noisy, of_joint, simulate

# Energies per sample with the usual law, with friction that creeps, and with the steps of a simulation as well.
HEALTHY, FAULTY = (1.18, 1.17, 0.97), (2.2, 2.0, 2.0)


@pytest.mark.parametrize(
    ("losses", "law"),
    [
        ([HEALTHY] * 8, 2),  # each alone is not sure
        ([*[HEALTHY] * 8, FAULTY, FAULTY], 2),
        ([*[HEALTHY] * 8, *[(1.0, 1.0)] * 9], 2),  # a joint that shows fewer laws does not count
        ([HEALTHY] * 2, None),  # too few
        ([FAULTY] * 8, None),  # no law leaves noise alone
        ([(1.0, 1.0, 1.0)] * 8, None),
        ([(1.18, 1.2, 6.0)] * 8, None),
        ([()] * 8, None),
    ],
)
def test_joints_determine_a_law_together_and_each_keeps_its_own_without_evidence(losses, law):
    assert chosen_law(HEALTHY) == 0
    assert common_law(losses) == law


def test_a_healthy_joint_is_diagnosed_again_only_if_the_common_law_leaves_a_gap():
    assert not is_other_law(HEALTHY, 2, has_cause=False)
    assert is_other_law(HEALTHY, 2, has_cause=True)
    assert is_other_law((1.1, 1.1, 2.0), 2, has_cause=False)  # an effect stood in for the steps
    assert not is_other_law((2.0, 2.0, 1.0), 2, has_cause=True)  # this joint chose the law itself
    assert not is_other_law((), 2, has_cause=True)


STEP_S, RATE_HZ, SECONDS = 0.004, 125, 16
LEG = '<body><joint name="j{k}" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" mass="2"/></body>'
ROBOT = f"""<mujoco>
  <option timestep="{STEP_S}"><flag contact="disable"/></option>
  <default>
    <joint damping="2" armature="0.1" frictionloss="0.2"/><geom size="0.03"/><position kp="400" kv="20"/>
  </default>
  <worldbody>{"".join(LEG.format(k=k) for k in range(4))}</worldbody>
  <actuator>{"".join(f'<position name="a{k}" joint="j{k}"/>' for k in range(4))}</actuator>
</mujoco>
"""


def write(folder):
    """Record four legs side by side in MuJoCo, of which one has twice the damping, and describe them."""
    model = mujoco.MjModel.from_xml_string(ROBOT)
    model.dof_damping[1] = 4.0
    t = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    for seed in range(3):
        data, random = mujoco.MjData(model), np.random.default_rng(seed)
        phase, speed = random.uniform(0, 2 * np.pi, (4, 3)), random.uniform(0.7, 1.3, (4, 3)) * (0.3, 0.9, 1.9)
        goals = 0.2 * np.sin(2 * np.pi * t[:, None, None] * speed + phase).sum(axis=2)
        data.qpos[:] = goals[0]
        file = folder / f"motion-{seed}.csv"
        simulate(model, file, goals, data=data, read=noisy(random, 2e-4), step_s=1 / RATE_HZ)
    return described_model(folder, ROBOT)


@pytest.mark.prove
def test_an_effect_beside_the_steps_of_a_simulation_has_its_own_size(tmp_path):
    stage = write(tmp_path)
    alone = examine(of_joint(stage, "j1"))
    assert not any("own step" in text for text in alone.warnings)  # the effect stands in for the steps
    shares: list[float] = []
    verdict = diagnose_table(tables.read(stage), lambda text, share: shares.append(share)).verdict
    assert shares == sorted(shares)
    assert any("own step" in text for text in verdict.warnings if text.startswith("j1"))
    (effect,) = verdict.effects
    assert effect.name == "j1.damping"
    assert effect.parameters["viscous"].low < 4.0 < effect.parameters["viscous"].high
