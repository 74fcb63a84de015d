"""Transformation to the robot's plane: both vertical axes, any yaw and tilt, markers away from the arm's axis."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.bridge.frame import Plane, View, names_of, product
from softarm.drivers.bridge.natnet import Body
from softarm.drivers.twin.motive import IDS, bodies_of
from softarm.schemas.bridge import Marked, Marks, Room
from softarm.schemas.messages import BODY_NAMES, Pose

NAMES = {number: name for name, number in IDS.items()}
number = st.floats(-3.0, 3.0)
rooms = st.builds(
    Room,
    up=st.sampled_from(["y", "z"]),
    yaw_rad=st.floats(-math.pi, math.pi),
    tilt_rad=st.floats(-0.05, 0.05),
    origin_m=st.tuples(number, number, number),
)
poses = st.builds(Pose, number, number, st.floats(-3.1, 3.1), st.just(True))


@given(rooms, st.lists(poses, min_size=6, max_size=6))
def test_transformed_points_are_recovered(room, there):
    shown = bodies_of(Plane(room), dict(zip(BODY_NAMES, there, strict=True)))
    seen = View(room, Marks()).of(shown, NAMES)
    for back, pose in zip(seen, there, strict=True):
        assert back[:3] == pytest.approx(pose[:3], abs=1e-9)
        assert back.tracked


def test_y_up_is_rotated_as_in_motive():
    """Compare x, y, z with y up and x, -z, y with z up."""
    for yaw in (0.0, 0.7, -2.0):
        lying, standing = Plane(Room(up="y", yaw_rad=yaw)), Plane(Room(up="z", yaw_rad=yaw))
        assert lying.place((1.0, 2.0, -3.0)) == pytest.approx(standing.place((1.0, 3.0, 2.0)))
    assert Plane(Room(up="z", yaw_rad=math.pi / 2)).place((1.0, 2.0, 3.0)) == pytest.approx((2.0, 3.0))


@given(rooms, st.floats(-3.0, 3.0), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0, 6.2), number, number)
def test_markers_with_any_offset_and_axes_are_recovered(room, angle, across, along, twist, a, b):
    """Use a streamed point away from the arm's axis, and body axes with any rotation."""
    plane = Plane(room)
    made = (
        math.sin(twist / 2) * math.cos(a),
        math.sin(twist / 2) * math.sin(a) * math.cos(b),
        0.0,
        math.cos(twist / 2),
    )
    length = math.sqrt(sum(part**2 for part in made))
    made = tuple(part / length for part in made)
    cos, sin = math.cos(angle), math.sin(angle)
    point = plane.point(0.1 - cos * across + sin * along, 0.5 - sin * across - cos * along)
    body = Body(6, point, product(plane.turn(angle), made), True)
    pose = View(room, Marks()).pose(body, Marked(hanging=made, across_m=across, along_m=along))
    assert pose[:3] == pytest.approx((0.1, 0.5, angle), abs=1e-9)


def test_a_twist_about_the_arm_is_ignored():
    plane = Plane(Room(yaw_rad=1.0))
    twist = (0.0, math.sin(0.2), 0.0, math.cos(0.2))
    assert plane.angle(product(plane.turn(0.6), twist), (0.0, 0.0, 0.0, 1.0)) == pytest.approx(0.6)


def test_a_body_untracked_unnamed_or_with_nan_is_lost():
    body = Body(1, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0), True)
    bodies = [
        body,
        body._replace(id=2, tracked=False),
        body._replace(id=3, position_m=(math.nan, 0.0, 0.0)),
        body._replace(id=4, orientation=(0.0, 0.0, 0.0, 0.0)),
        body._replace(id=99),
    ]
    seen = View(Room(), Marks(link5=Marked(rigid_body=77), link4=None)).of(bodies, NAMES)
    assert [pose.tracked for pose in seen] == [True, False, False, False, False, False]


def test_bodies_are_found_by_name_or_by_id():
    marks = Marks(cart=Marked(rigid_body="Wagen"), link2=Marked(rigid_body=40), link3=None)
    names, missing = names_of(marks, {"Wagen": 7, "link1": 8, "link2": 9, "link5": 10})
    assert names == {7: "cart", 8: "link1", 40: "link2", 10: "link5"}
    assert missing == ("link4",)
