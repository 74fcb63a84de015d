"""The scene matches the robot: frames, limits, target and shelf."""

import math
from itertools import pairwise

import numpy as np
import pytest

from softarm.recordings.foxglove import scene
from softarm.schemas.config import Config, Policy
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.messages import BODY_NAMES, MocapFrame, Pose
from softarm.schemas.model import Arm

REACH = GoalStatus(Goal("reach", -0.45, 0.62), "running")


def matrix(transform):
    """By the textbook's formula for any quaternion, not by the one angle that ours is made of."""
    x, y, z, w = (transform["rotation"][part] for part in "xyzw")
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return turn, np.array([transform["translation"][part] for part in "xyz"])


def entities(update):
    return {entity["id"]: entity for entity in update["entities"]}


def test_each_link_connects_its_frame_to_the_previous_one(converted):
    """So angle, sign and place are right: the beam is drawn without a gap in any of the flight's frames."""
    lengths = [entity["cylinders"][0]["size"]["z"] for entity in converted["/scene/robot"][0]["entities"][2:7]]
    assert lengths == list(Arm().link_length_m)
    swung = 0.0
    for said in converted["/tf"]:
        frames = {transform["child_frame_id"]: matrix(transform) for transform in said["transforms"]}
        assert list(frames) == list(BODY_NAMES)
        for (before, name), length in zip(pairwise(BODY_NAMES), lengths, strict=True):
            turn, origin = frames[name]
            near = origin + turn @ np.array([0.0, 0.0, length])
            np.testing.assert_allclose(near, frames[before][1], atol=1e-5)
            swung = max(swung, abs(origin[1] - frames["cart"][1][1]))
    assert swung > 0.3


def test_an_untracked_body_has_no_frame():
    poses = [Pose(0.1 * i, 0.9, 0.0) for i in range(6)]
    poses[2], poses[4] = Pose(0.0, 0.0, 0.0, tracked=False), Pose(math.nan, 0.5, 0.0)
    labels = scene.frames(MocapFrame(1, 5, 6, tuple(poses)), 1_700_000_000_000_000_005)
    assert [each["child_frame_id"] for each in labels["transforms"]] == ["cart", "link1", "link3", "link5"]
    assert labels["transforms"][0]["timestamp"] == {"sec": 1_700_000_000, "nsec": 5}


def test_the_rail_has_its_soft_and_hard_limits():
    config = Config.model_validate({"limits": {"rail": {"position_min_m": -0.2, "position_max_m": 0.15}}})
    rail = entities(scene.robot(config, 0))["rail"]
    assert sorted(cube["pose"]["position"]["y"] for cube in rail["cubes"]) == [-0.3, -0.2, 0.0, 0.15, 0.3]
    assert {text["text"] for text in rail["texts"]} == {"soft limit -0.2 m", "soft limit 0.15 m"}
    assert scene.fixed_frames(0)["transforms"][0]["translation"]["z"] == Arm().base_height_m


def test_the_target_is_a_sphere_of_the_success_radius_and_goes_when_there_is_none():
    (target,) = scene.target(REACH, 0.04, 0)["entities"]
    assert target["spheres"][0]["size"] == {"x": 0.08, "y": 0.08, "z": 0.08}
    assert target["spheres"][0]["pose"]["position"] == {"x": 0.0, "y": -0.45, "z": 0.62}
    for status in (GoalStatus(), GoalStatus(Goal("hold"), "running")):
        gone = scene.target(status, 0.04, 7)
        assert gone["entities"] == []
        assert gone["deletions"][0]["type"] == 1


@pytest.mark.parametrize(
    ("policy", "edge_m"), [("reach", None), ("shelf", -0.375), ("mine", -0.35), ("other", None)], ids=str
)
def test_the_shelf_is_where_the_shelf_policy_assumes_it(policy, edge_m):
    made = {
        "mine": Policy(plugin="onnx", options={"model": "shelf", "target_depth_m": 0.1}),
        "other": Policy(plugin="onnx", options={"model": "reach"}),
    }
    shown = scene.shelf(REACH, policy, Config(policies=made), 0)["entities"]
    if edge_m is None:
        assert shown == []
        return
    board = shown[0]["cubes"][0]
    at, size = board["pose"]["position"], board["size"]
    assert at["y"] + size["y"] / 2 == pytest.approx(edge_m)
    assert at["z"] + size["z"] / 2 == pytest.approx(0.62 - 0.005)


def test_scenes_are_sent_on_changes_and_contain_all_targets(converted):
    assert len(converted["/scene/robot"]) == len(converted["/tf_static"]) == 1
    shown = [update["entities"][0]["spheres"][0] for update in converted["/scene/target"] if update["entities"]]
    places = [(ball["pose"]["position"]["y"], ball["pose"]["position"]["z"]) for ball in shown]
    assert list(dict.fromkeys(places)) == [
        (-0.3, 0.62),
        (-0.1, 0.65),
        (-0.42, 0.68),
        (0.35, 0.6),
        (-0.3, 0.6),
        (-0.2, 0.6),
    ]
    assert len(shown) < 20


def test_the_trail_is_where_the_tip_was_in_the_last_second_and_a_half(converted, log):
    seen = [(frame.t_capture_ns, frame.bodies[-1]) for inputs, _ in log.ticks() for frame in inputs.mocap]
    offset_ns = int(log.metadata["clock"]["wall_minus_monotonic_ns"])
    labels = converted.messages["/scene/trail"]
    assert np.diff([at for _, at, _ in labels]).min() >= 50_000_000
    for _, at_ns, said in labels[2 :: len(labels) // 7]:
        (line,) = said["entities"][0]["lines"]
        places = {
            (round(pose.y_m, 4), round(pose.z_m, 4)) for t, pose in seen if at_ns - 1.5e9 <= t + offset_ns <= at_ns
        }
        points = [(point["y"], point["z"]) for point in line["points"]]
        assert places.issuperset(points)
        newest = next(pose for t, pose in seen if t + offset_ns == at_ns)
        assert points[-1] == (round(newest.y_m, 4), round(newest.z_m, 4))
    assert len(points) > 15
