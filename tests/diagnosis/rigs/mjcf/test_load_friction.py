"""Friction in a servo's gear, model M3 of Duclusaud et al. 2024: a share of the difference of both torques."""

import numpy as np

from softarm.diagnosis.diagnose import diagnose_files
from tests.diagnosis.rigs.recordings import described_model

STEP_S, EACH, COUNTS = 5e-4, 20, 4096
KP, BACK_EMF, ARMATURE, DRY = 30.0, 0.7, 0.012, 0.1  # of a servo like a Dynamixel MX-64
MASS_KG, LENGTH_M, GRAVITY = 1.0, 0.15, 9.81
SHARE = 0.1
MODEL = f"""
<mujoco>
  <option gravity="0 0 -{GRAVITY}" timestep="0.001"/>
  <worldbody>
    <body>
      <joint name="horn" axis="1 0 0" armature="{ARMATURE}" damping="{BACK_EMF}" frictionloss="{DRY}"/>
      <inertial pos="0 0 -{LENGTH_M}" mass="{MASS_KG}" diaginertia="1e-6 1e-6 1e-6"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="horn" kp="{KP}"/></actuator>
</mujoco>
"""
MOTIONS = {
    "sweep": lambda t: np.sin(t**2),
    "waves": lambda t: 1.5 * np.sin(t) + 0.5 * np.sin(5 * t) * np.sin(2 * t),
    "slow": lambda t: 1.4 * np.sin(0.7 * t) ** 2,
}


def recorded(command):
    """Return commands and readings of a pendulum, at 100 Hz for 6 s."""
    angle = speed = 0.0
    inertia, rows = MASS_KG * LENGTH_M**2 + 1e-6 + ARMATURE, []
    for k in range(600):
        wanted = float(command(k * STEP_S * EACH))
        turn = 2 * np.pi / COUNTS
        rows.append((k * STEP_S * EACH, wanted, round(angle / turn) * turn))
        for _ in range(EACH):
            motor, load = KP * (wanted - angle) - BACK_EMF * speed, -MASS_KG * GRAVITY * LENGTH_M * np.sin(angle)
            friction = DRY + SHARE * abs(motor - load)
            stops = inertia / STEP_S * speed + motor + load
            speed += (motor + load - np.clip(stops, -friction, friction)) / inertia * STEP_S
            angle += speed * STEP_S
    return np.array(rows)


def test_friction_by_the_load_of_a_gear_is_named_with_its_share(tmp_path):
    for name, command in MOTIONS.items():
        np.savetxt(tmp_path / f"{name}.csv", recorded(command), delimiter=",", header="t,servo,horn", comments="")
    verdict = diagnose_files([described_model(tmp_path, MODEL)], processes=1).verdict
    assert [each.name for each in verdict.effects] == ["horn.load_friction"]
    assert not verdict.effects[0].equivalents
    share, part = (verdict.effects[0].parameters[name] for name in ("share", "from_load"))
    assert share.low <= 2 * SHARE <= share.high  # both torques are alike at rest
    assert share.high - share.low < 0.2 * SHARE * 2
    assert part.low <= 0.5 <= part.high
