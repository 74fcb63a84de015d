"""ROS bags and MCAP files as tables: the numbers of each topic by TOPIC/JOINT/FIELD."""

import json
import shutil

import numpy as np
import pytest
import yaml
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from softarm.diagnosis.data import bags, tables
from softarm.diagnosis.data.trials import TrialError
from softarm.recordings.live import LIBRARY
from tests.cli.invoke import refuse, succeed
from validation.mechanisms.record import ROBOTS

STORE = get_typestore(Stores.ROS2_HUMBLE)
START_NS = 1_764_000_000_000_000_000
T = np.arange(0, 4, 0.02)
PAN, TILT = 0.5 * np.sin(2 * T), 0.3 * np.sin(3 * T)


def message(kind: str, **fields):
    return STORE.types[kind](**fields)


def joints(ns: int, names, positions, stamped: bool = True):
    stamp = message("builtin_interfaces/msg/Time", sec=ns // 10**9 * stamped, nanosec=ns % 10**9 * stamped)
    return message(
        "sensor_msgs/msg/JointState",
        header=message("std_msgs/msg/Header", stamp=stamp, frame_id=""),
        name=list(names),
        position=np.array(positions, dtype=float),
        velocity=np.array(positions, dtype=float) * 2,
        effort=np.array([]) if len(names) < 2 else np.array(positions, dtype=float) * 3,
    )


def write(path, topics, plugin=StoragePlugin.MCAP) -> None:
    """Write a ROS 2 bag: topic -> [(time of reception in ns, message), ...]."""
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        for topic, messages in topics.items():
            kind = messages[0][1].__msgtype__
            connection = bag.add_connection(topic, kind, typestore=STORE)
            for ns, each in messages:
                bag.write(connection, ns, STORE.serialize_cdr(each, kind))


def camera(path, plugin=StoragePlugin.MCAP) -> None:
    """Write the measured and commanded joints of a camera; measurements are received 5 ms after their stamp."""
    stamps = START_NS + np.round(T * 1e9).astype(int)
    seen = [
        (ns + 5_000_000, joints(ns, ("pan", "tilt"), at)) for ns, *at in zip(stamps.tolist(), PAN, TILT, strict=True)
    ]
    # The order of the joints changes, as between two publishers of one topic.
    sent = [
        (ns, joints(ns, ("tilt", "pan"), at, stamped=False)) for ns, *at in zip(stamps.tolist(), TILT, PAN, strict=True)
    ]
    write(path, {"/joint_states": seen, "/joint_commands": sent}, plugin)


@pytest.mark.parametrize(("plugin", "suffix"), [(StoragePlugin.MCAP, ".mcap"), (StoragePlugin.SQLITE3, ".db3")])
def test_joints_are_found_by_name_and_stamps_by_header(tmp_path, plugin, suffix):
    camera(tmp_path / "run", plugin)
    found = bags.columns(tmp_path / "run" / f"run{suffix}")
    assert found["/joint_states/pan/position"] == pytest.approx(PAN)
    assert found["/joint_commands/pan/position"] == pytest.approx(PAN)
    assert found["/joint_states/time"] == pytest.approx(START_NS / 1e9 + T, abs=1e-6)
    # Without a stamp the reception counts.
    assert found["/joint_commands/time"] == pytest.approx(START_NS / 1e9 + T, abs=1e-6)


def test_a_joint_that_some_messages_lack_has_no_value_there(tmp_path):
    rows = [
        (START_NS, joints(START_NS, ("pan", "tilt"), (0.1, 0.2))),
        (START_NS + 9, joints(START_NS + 9, ("tilt",), (0.3,))),
    ]
    write(tmp_path / "run", {"/joint_states": rows})
    found = bags.columns(tmp_path / "run" / "run.mcap")
    assert found["/joint_states/pan/position"] == pytest.approx([0.1, np.nan], nan_ok=True)
    assert found["/joint_states/tilt/position"] == pytest.approx([0.2, 0.3])


def test_arrays_have_indices_frames_have_names_and_images_are_left_out(tmp_path):
    layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    command = message("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array([1.5, 2.5]))
    vector = message("geometry_msgs/msg/Vector3", x=0.1, y=0.2, z=0.3)
    turn = message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    frames = message(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            message(
                "geometry_msgs/msg/TransformStamped",
                header=joints(START_NS, (), ()).header,
                child_frame_id="tip",
                transform=message("geometry_msgs/msg/Transform", translation=vector, rotation=turn),
            )
        ],
    )
    image = message("std_msgs/msg/UInt8MultiArray", layout=layout, data=np.zeros(40_000, np.uint8))
    write(
        tmp_path / "run",
        {"/commands": [(START_NS, command)], "/tf": [(START_NS, frames)], "/image": [(START_NS, image)]},
    )
    found = bags.columns(tmp_path / "run" / "run.mcap")
    assert found["/commands/data[1]"] == [2.5]
    assert found["/tf/tip/transform/translation/z"] == [0.3]
    assert not any(name.startswith("/image") for name in found)


def json_log(path, encoding="json", library="") -> None:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(library=library)
        schema = writer.register_schema("joints", "jsonschema", b"{}")
        channel = writer.register_channel("/joints", encoding, schema)
        for t, pan in zip(T, PAN, strict=True):
            data = json.dumps({"joint_names": ["pan"], "position": [pan], "ok": True, "mode": "run"}).encode()
            writer.add_message(channel, int(START_NS + t * 1e9), data, int(START_NS + t * 1e9))
        writer.finish()


def test_messages_in_json_are_read_without_ros(tmp_path):
    json_log(tmp_path / "run.mcap")
    found = bags.columns(tmp_path / "run.mcap")
    assert sorted(found) == ["/joints/ok", "/joints/pan/position", "/joints/time"]
    assert found["/joints/pan/position"] == pytest.approx(PAN)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ({"encoding": "protobuf"}, "messages are in protobuf; allowed are json and cdr"),
        ({"library": LIBRARY}, "a log of the robot; `softarm diagnose` reads it without a stage file"),
    ],
)
def test_other_encodings_and_logs_of_the_robot_are_refused(tmp_path, made, words):
    json_log(tmp_path / "run.mcap", **made)
    with pytest.raises(TrialError, match=words):
        bags.columns(tmp_path / "run.mcap")


def test_a_damaged_bag_is_an_error_with_its_file(tmp_path):
    camera(tmp_path / "run")
    whole = (tmp_path / "run" / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(whole[: len(whole) // 2])
    refuse("run.mcap: cannot be read", "new", "rig", tmp_path / "run.mcap", "--out", tmp_path / "stage.yaml")


def test_a_bag_and_a_model_make_a_stage_file_that_reads(tmp_path):
    shutil.copy(ROBOTS["camera"].model, tmp_path / "camera.xml")
    camera(tmp_path / "bags" / "sweep-1")
    succeed("new", "rig", tmp_path / "camera.xml", tmp_path / "bags", "--out", tmp_path / "stage.yaml")
    stage = yaml.safe_load((tmp_path / "stage.yaml").read_text())
    assert stage["channels"]["command"]["columns"]["pan_drive"]["source"] == "/joint_commands/pan/position"
    trial = next(trial for trial in tables.read(tmp_path / "stage.yaml") if trial.stage.name == "tilt")
    assert trial.channels["measured"]["tilt"] == pytest.approx(TILT)
    # The command is one tick old where the measurement is not, since both stamps are of one clock.
    assert trial.channels["command"].t_s[0] == pytest.approx(trial.channels["measured"].t_s[0], abs=1e-6)
