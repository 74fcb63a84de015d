"""Attributes of MuJoCo models that the nominal simulation of a joint must contain, recorded with MuJoCo itself."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.rigs.stage import examine, view_of
from tests.diagnosis.rigs.recordings import described_model, of_joint, rms, simulate

ROBOT = (Path(__file__).parents[4] / "examples/mujoco/robot.xml").read_text()
ELBOW, SERVO, FORE = '<joint name="elbow" range="-2 2"', 'joint="elbow"/>', '<body name="fore"'
TENDON = (
    '<tendon><fixed name="band" {}><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-1"/></fixed></tendon>'
)
CHANGES = {
    "damping that grows with speed": (ELBOW, f'{ELBOW} damping="0.05 0.4"'),
    "stiffness that grows with the angle": (ELBOW, f'{ELBOW} stiffness="1 0 6"'),
    "spring with a rest angle": (ELBOW, f'{ELBOW} stiffness="4" springref="0.5"'),
    "damping of the actuator": (SERVO, 'joint="elbow" damping="2"/>'),
    "rotor of the actuator": (SERVO, 'joint="elbow" armature="0.15"/>'),
    "first-order actuator": (SERVO, 'joint="elbow" timeconst="0.05"/>'),
    "late actuator": (SERVO, 'joint="elbow" delay="0.03" nsample="400"/>'),
    "carried weight": (FORE, '<body name="fore" gravcomp="1"'),
    "weight carried by the actuator": (
        FORE,
        '<body name="fore" gravcomp="1"',
        ELBOW,
        f'{ELBOW} actuatorgravcomp="true"',
    ),
    "elastic band": ("<actuator>", TENDON.format('stiffness="4" damping="0.3"') + "<actuator>"),
    "water": ("<option ", '<option density="1000" viscosity="0.5" '),
}


def changed(*pairs):
    """Return the robot's file with some parts replaced."""
    text = ROBOT
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


def elbows(folder, text):
    """Return the trials of the elbow, for a model of the robot."""
    return of_joint(described_model(folder, text), "elbow")


def record(text, file, seconds):
    """Simulate some seconds at 5 kHz and write them at 100 Hz, with an encoder of 0.1 mrad."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = 2e-4
    data, random = mujoco.MjData(model), np.random.default_rng(1)
    held = np.repeat(random.uniform(-0.6, 0.6, (2 * seconds, 2)), 50, axis=0)
    commands = held + 0.4 * np.sin(2 * np.pi * np.outer(np.arange(100 * seconds) / 100, [0.9, 1.3]))
    data.act[:] = commands[0, 1]  # of a first-order actuator at rest
    simulate(model, file, commands, data=data, read=lambda positions: np.round(positions, 4))


def gap(folder, text):
    """Return the RMS of the elbow's gap for a model of the robot, rad."""
    return rms(view_of(elbows(folder, text))[0])


@pytest.mark.parametrize("name", CHANGES)
def test_a_joint_moves_as_in_mujoco(tmp_path, name):
    right = changed(*CHANGES[name])
    # The first second of a late actuator is left out, and some of a slow one.
    seconds = {"late actuator": 3, "first-order actuator": 2}.get(name, 1)
    record(right, tmp_path / "motion.csv", seconds)
    left = gap(tmp_path, right)
    assert left < 1.2e-3
    assert gap(tmp_path, ROBOT) > 4 * left


@pytest.mark.prove
def test_a_servo_with_a_fiftieth_of_the_models_gain_is_found(tmp_path):
    """Each of its differences alone looks like another effect: a lag, a rate limit, a spring."""
    loop, passive = 'kp="30" kv="1.2" forcerange="-8 8"', 'damping="0.05" armature="0.01" frictionloss="0.05"'
    weak = 'kp="12" kv="0.05" forcerange="-3 3"', 'damping="0.4" armature="0.04" frictionloss="0.2"'
    record(changed(loop, weak[0], passive, weak[1]), tmp_path / "motion.csv", seconds=5)
    found = examine(elbows(tmp_path, changed(loop, 'kp="600" kv="2.7" forcerange="-8 8"')))
    sizes = {effect.name: effect.parameters for effect in found.named}
    assert sizes["elbow.gain"]["scale"].value == pytest.approx(-0.98, abs=0.005)
    assert sizes["elbow.ceiling"]["limit"].value == pytest.approx(3.0, rel=0.2)
    assert found.answer.after < 0.05 * found.answer.before
