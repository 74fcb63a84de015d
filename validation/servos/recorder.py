"""Recorder of servos by BAM (Better Actuator Models), which runs in a Python 3.12 of its own.

It simulates a servo on a pendulum with BAM's laws, integrator and identified parameters. For each case it writes
recordings, the same as logs of BAM, and the MJCF that an owner has: the same numbers without the friction that MJCF
lacks. `validation/servos/benchmark.py` starts it.
"""

import json
import sys
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from bam.model import load_model
from bam.simulate import Simulator
from bam.trajectory import trajectories

STEP_S, EACH = 5e-4, 10  # integration step, and steps per sample
STEP = 2 * np.pi / 4096  # of the encoder, rad
MOTIONS = "sin_time_square", "sin_sin", "up_and_down"  # those of BAM that keep the motor on
SIZES = 1.0, 0.6  # factors of a motion
DURATION_S = 6.0
GRAVITY_M_S2 = 9.80665
LAWS = "m1", "m2", "m3", "m4", "m5", "m6"  # BAM's models of friction; MJCF holds the first


class Bench(NamedTuple):
    """Pendulum of a servo, and how it is driven."""

    mass_kg: float
    length_m: float
    arm_kg: float
    kp: float  # of the servo's firmware
    reach: float = 1.0  # factor of all motions; larger ones would meet the speed limit of the motor's voltage


BENCHES = {
    "mx64": Bench(1.0, 0.15, 0.05, 32.0),
    "mx106": Bench(1.5, 0.15, 0.05, 32.0),
    "xl320": Bench(0.06, 0.1, 0.01, 32.0),
    "xl330": Bench(0.1, 0.12, 0.01, 400.0),
    "erob80_50": Bench(4.0, 0.4, 0.5, 100.0, reach=0.4),
    "erob80_100": Bench(6.0, 0.5, 0.5, 100.0, reach=0.4),
}


def record(servo: str, law: str, folder: Path) -> None:
    """Record one servo with the friction of one of BAM's models into FOLDER/data, its logs and its truth beside it."""
    bench, case = BENCHES[servo], f"{servo}-{law}"
    data, logs, truths = folder / "data" / case, folder / "logs" / case, folder / "truths"
    for place in (data / "recordings", logs, truths):
        place.mkdir(parents=True, exist_ok=True)
    model = load_model(motor_name=servo, model=law)
    model.q_offset.value = 0.0  # of the authors' own bench
    log = {"mass": bench.mass_kg, "arm_mass": bench.arm_kg, "length": bench.length_m, "kp": bench.kp}
    log |= {"vin": getattr(model.actuator, "vin", 0.0), "dt": STEP_S * EACH}
    for motion, size in product(MOTIONS, SIZES):
        name = f"{motion}-{round(100 * size)}"
        rows = run(model, log, partial(_goal, motion, bench.reach * size))
        header = "t,servo_command,servo"
        np.savetxt(data / "recordings" / f"{name}.csv", rows, "%.7g", ",", header=header, comments="")
        speeds = np.gradient([q for *_, q in rows], STEP_S * EACH)
        entries = [
            {"timestamp": t, "goal_position": goal, "position": q, "speed": float(speed), "torque_enable": True}
            for (t, goal, q), speed in zip(rows, speeds, strict=True)
        ]
        (logs / f"{name}.json").write_text(json.dumps(log | {"entries": entries}))
    (data / "robot.xml").write_text(mjcf(model, bench))
    truth = {name: each.value for name, each in model.get_parameters().items()}
    (truths / f"{case}.json").write_text(json.dumps({"case": case, "servo": servo, "law": law, **truth}))


def _goal(motion: str, size: float, time_s: float) -> float:
    angle, _ = trajectories[motion](time_s)
    return float(size * angle)


def run(model: Any, log: dict[str, Any], goal: Callable[[float], float]) -> list[tuple[float, float, float]]:
    """Return time, goal and encoder angle of one motion, s and rad."""
    model.actuator.load_log(log)
    simulator = Simulator(model)
    simulator.reset(goal(0.0), 0.0)
    rows = []
    for k in range(round(DURATION_S / STEP_S / EACH)):
        wanted = goal(k * STEP_S * EACH)
        rows.append((k * STEP_S * EACH, wanted, float(np.round(simulator.q / STEP) * STEP)))
        for _ in range(EACH):
            control = model.actuator.compute_control(wanted, simulator.q, simulator.dq, STEP_S)
            simulator.step(control, True, STEP_S)
    return rows


def mjcf(model: Any, bench: Bench) -> str:
    """Return the servo on its pendulum with all of its numbers that MJCF expresses."""
    kt, ohm = model.kt.value, model.R.value
    actuator = model.actuator
    if actuator.control_unit() == "amps":
        kp, kv = kt * bench.kp, kt * actuator.damping * np.sqrt(bench.kp)
        most, back = kt * actuator.max_amps, 0.0
    else:
        kp, kv = actuator.error_gain * bench.kp * actuator.vin * kt / ohm, 0.0
        most, back = actuator.vin * actuator.max_pwm * kt / ohm, kt**2 / ohm
    mass = bench.mass_kg + bench.arm_kg
    centre = (bench.mass_kg + bench.arm_kg / 2) * bench.length_m / mass
    inertia = (bench.mass_kg + bench.arm_kg / 3) * bench.length_m**2 - mass * centre**2
    damping, dry = model.friction_viscous.value + back, model.friction_base.value
    return f"""<mujoco model="servo">
  <compiler angle="radian"/>
  <option gravity="0 0 -{GRAVITY_M_S2}" timestep="0.001"/>
  <worldbody>
    <body name="pendulum">
      <joint name="servo" axis="1 0 0" armature="{actuator.get_extra_inertia():.9g}" damping="{damping:.9g}"
             frictionloss="{dry:.9g}"/>
      <inertial pos="0 0 -{centre:.9g}" mass="{mass:.9g}" diaginertia="{inertia:.9g} {inertia:.9g} {inertia:.9g}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -{bench.length_m}" size="0.005" mass="0"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="servo" kp="{kp:.9g}" kv="{kv:.9g}" forcerange="-{most:.9g} {most:.9g}"/>
  </actuator>
</mujoco>
"""


def main() -> None:
    """Record every servo with every model of friction into a folder."""
    for servo, law in product(BENCHES, LAWS):
        record(servo, law, Path(sys.argv[1]))


if __name__ == "__main__":
    main()
