"""The last link of a mechanism, which carries a payload."""

import numpy as np
import pytest

from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from validation.mechanisms.record import ROBOTS

MASS = '<inertial pos="0 0 -0.1" mass="{kg}" diaginertia="1e-3 1e-3 1e-3"/>'


def body(name, kg, *carried):
    """Return the text of a body on a hinge, with the bodies that it carries."""
    hinge = f'<joint name="{name}" axis="0 1 0"/>'
    return f'<body name="{name}" pos="0 0.05 -0.2">{hinge}{MASS.format(kg=kg)}{"".join(carried)}</body>'


def end(folder, joint, root):
    """Return the body at the end behind a joint of a model."""
    (folder / "robot.xml").write_text(f"<mujoco><worldbody>{root}</worldbody></mujoco>")
    robot = Mechanism(folder / "robot.xml")
    return robot.last_link(robot.joint(joint)).body


def finger(name):
    return body(name, 0.1, body(f"{name} tip", 0.05))


ARMS = [body(f"{side} shoulder", 2.0, body(f"{side} elbow", 1.0, body(f"{side} hand", 0.5))) for side in ("l", "r")]


@pytest.mark.parametrize(
    ("joint", "root", "expected"),
    [
        ("arm", body("arm", 2.0, body("palm", 0.5, finger("one"), finger("two"))), "palm"),
        ("palm", body("arm", 2.0, body("palm", 0.5, finger("one"), finger("two"))), "palm"),
        ("two", body("arm", 2.0, body("palm", 0.5, finger("one"), finger("two"))), "two tip"),
        ("arm", body("arm", 2.0, body("hand", 0.5, body("jaw", 0.1))), "jaw"),
        ("shank", body("shank", 2.0, body("rod", 0.05), body("foot", 0.6)), "foot"),
        ("waist", body("waist", 9.0, *ARMS), "r hand"),
        ("waist", body("waist", 9.0, *ARMS, body("head", 3.0)), "head"),
    ],
)
def test_fingers_are_no_end_of_a_mechanism_but_a_foot_and_a_hand_are(tmp_path, joint, root, expected):
    assert end(tmp_path, joint, root) == expected


def test_a_palm_reaches_as_far_as_its_fingers():
    gripper = Mechanism(ROBOTS["gripper"].model)
    palm, finger = (gripper.last_link(gripper.joint(name)) for name in ("wrist", "left"))
    assert (palm.body, finger.body) == ("palm", "right")
    assert palm.reach_m == pytest.approx(0.15)
    assert palm.place((0.15, 0.0, 0.0)) == pytest.approx([0.0, 0.0, -0.15])
    assert palm.axes @ palm.axes.T == pytest.approx(np.eye(3), abs=1e-12)


FLANGE = """<mujoco><worldbody><body name="base"><geom size=".1"/>
<body name="upper" pos="0 0 .3"><joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" size=".04" fromto="0 0 0 0 0 .5"/>
<body name="fore" pos="0 0 .5"><joint name="elbow" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 .4"/>
<body name="flange" pos="0 0 .4"><joint name="roll" axis="0 0 1"/>
<inertial pos="0 0 -.02" mass=".3" diaginertia="1e-4 1e-4 1e-4"/></body></body></body></body></worldbody></mujoco>"""


def test_a_tool_is_sought_at_a_tenth_of_the_arm_on_either_side_of_a_short_flange(tmp_path):
    """A tool 0.2 m beyond the last joint of an iiwa was out of range, and six numbers of the arm were named instead."""
    file = tmp_path / "arm.xml"
    file.write_text(FLANGE)
    robot = Mechanism(file)
    for joint in robot.joints.values():
        assert robot.last_link(joint).reach_m == pytest.approx(0.09)  # of 0.5 and 0.4 m
        assert robot.last_link(joint).is_short
    file.write_text(FLANGE.replace('pos="0 0 -.02" mass', 'pos="0 0 .1" mass'))
    link = Mechanism(file).last_link(robot.joint("elbow"))
    assert (link.reach_m, link.is_short) == (pytest.approx(0.1), False)
