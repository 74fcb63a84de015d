"""Starts of the windows in which a joint is simulated."""

import numpy as np

from softarm.diagnosis.rigs.mjcf.simulation import CREEP
from tests.diagnosis.rigs.recordings import described_model, noisy, rms, simulate, view_of_joint

ROTOR = """
<mujoco>
  <option timestep="0.0005" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="rotor">
      <joint name="wrist" type="hinge" axis="0 0 1" armature="2" damping="0.01" frictionloss="1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="wrist"/></actuator>
</mujoco>
"""


def test_a_window_starts_right_at_an_abrupt_motion_that_friction_stops(tmp_path):
    """Steps come every 1.5 s, where windows start; smoothing takes 0.3 rad/s for the speed of a joint at rest."""

    def follow(data, target):
        return 240 * (target - data.qpos[0]) - 31 * data.qvel[0]

    random = np.random.default_rng(1)
    for number in range(3):
        steps, read = np.repeat(random.uniform(-0.6, 0.6, 8), 150), noisy(random, 2e-4)
        simulate(ROTOR, tmp_path / f"steps-{number}.csv", steps, control=follow, read=read)
    view = view_of_joint(described_model(tmp_path, ROTOR, "N m"), "wrist")
    view.assume(CREEP, 1.0)
    assert rms(view) < 2 * view.floor[0]
