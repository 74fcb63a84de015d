"""ROS 2 topics in the wire format of rmw_zenoh, received by a real Zenoh session and read with rosbags."""

import math
import time
from contextlib import contextmanager
from dataclasses import replace

import pytest
import zenoh
from zenoh.ext import Int64, z_deserialize

from softarm.daemon.assembly import Daemon
from softarm.daemon.control.records import EStop
from softarm.daemon.ros.node import RosNode
from softarm.daemon.runtime.devices import simulated_devices
from softarm.drivers.mocap.zenoh_session import listener
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.messages import MocapFrame, Pose
from softarm.schemas.policy import Observation
from tests.daemon.rig import BUSY_MACHINE
from tests.processes import free_port, until

typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
NOW_NS, WALL_NS = 20_000_000_000, 1_700_000_000_000_000_000
POINT, EMPTY = "geometry_msgs/msg/PointStamped", "std_msgs/msg/Empty"
TYPES = {
    "joint_states": "sensor_msgs/msg/JointState",
    "tip": "geometry_msgs/msg/PoseStamped",
    "pressure": "sensor_msgs/msg/FluidPressure",
    "goal": POINT,
    "stopped": "std_msgs/msg/Bool",
    "answer": "std_msgs/msg/String",
}


def key(name, type_name, domain=0):
    package, _, short = type_name.split("/")
    return f"{domain}/softarm/{name}/{package}::msg::dds_::{short}_/{STORE.hash_rihs01(type_name)}"


class Router:
    """Zenoh session in the place of the ROS 2 router, and of a ROS node that subscribes and publishes."""

    def __init__(self):
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.session = zenoh.open(listener(self.endpoint))
        self.samples = []
        self._subscriber = self.session.declare_subscriber("*/softarm/*/*/*", self.samples.append)

    def messages(self, name, part=slice(None)):
        """Return the messages of a topic so far, or a part of them, deserialised."""
        topic = key(name, TYPES[name])
        data = [each.payload for each in self.samples.copy() if str(each.key_expr) == topic]
        return [STORE.deserialize_cdr(each.to_bytes(), TYPES[name]) for each in data[part]]

    def first(self, name):
        until(lambda: self.messages(name, slice(1)))
        return self.messages(name, slice(1))[0]

    def answer(self):
        return self.first("answer").data

    def tokens(self):
        return {str(reply.ok.key_expr) for reply in self.session.liveliness().get("@ros2_lv/**")}

    def send(self, name, type_name, message):
        """Publish a message once somebody subscribes to its topic."""
        publisher = self.session.declare_publisher(key(name, type_name))
        until(lambda: publisher.matching_status.matching)
        publisher.put(bytes(STORE.serialize_cdr(message, type_name)))

    def send_goal(self, y_m, z_m, frame="world", x_m=0.0):
        new = STORE.types
        header = new["std_msgs/msg/Header"](new["builtin_interfaces/msg/Time"](0, 0), frame)
        point = new[POINT](header, new["geometry_msgs/msg/Point"](x_m, y_m, z_m))
        self.send("command/goal", POINT, point)

    def send_stop(self):
        self.send("command/stop", EMPTY, STORE.types[EMPTY]())


@pytest.fixture(scope="module")
def opened():
    router = Router()
    yield router
    router.session.close()


@pytest.fixture
def router(opened):
    opened.samples.clear()
    return opened


@contextmanager
def node(router, loop, frame=None, **ros):
    config = Config.model_validate({"ros": {"router": router.endpoint, **ros}})
    clocks = {"clock": lambda: NOW_NS, "wall_ns": lambda: WALL_NS}
    made = RosNode(config, loop.inbox, lambda: loop.outputs, lambda: frame, **clocks)
    made.start()
    try:
        until(router.tokens)
        yield made
    finally:
        made.stop()
        until(lambda: not router.tokens())


def frame(**poses):
    angles = {f"link{k}": -0.1 * k * k for k in range(1, 6)}
    bodies = {"cart": Pose(0.12, 0.965, 0.0)} | {name: Pose(0.1, 0.6, angle) for name, angle in angles.items()}
    return MocapFrame(7, NOW_NS - 30_000_000, NOW_NS - 20_000_000, tuple((bodies | poses).values()))


def stamp_ns(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def test_joint_states_and_the_tip_of_a_frame_have_its_capture_time(router, loop):
    with node(router, loop, frame(link5=Pose(-0.2, 0.65, -2.5))):
        joints, tip = router.first("joint_states"), router.first("tip")
    assert joints.name == ["cart", "joint1", "joint2", "joint3", "joint4", "joint5"]
    assert joints.position == pytest.approx([0.12, -0.1, -0.3, -0.5, -0.7, -0.9])
    assert len(joints.velocity) == len(joints.effort) == 0
    at, turn = tip.pose.position, tip.pose.orientation
    assert (tip.header.frame_id, at.x, at.y, at.z) == ("world", 0.0, -0.2, 0.65)
    assert (turn.x, turn.y, turn.z, turn.w) == pytest.approx((math.sin(-1.25), 0.0, 0.0, math.cos(-1.25)))
    assert stamp_ns(joints) == stamp_ns(tip) == WALL_NS - 30_000_000


def test_a_frame_with_an_untracked_body_is_left_out(router, loop):
    with node(router, loop, frame(link3=Pose(math.nan, math.nan, math.nan, tracked=False))):
        router.first("pressure")
    assert router.messages("joint_states") == router.messages("tip") == []


def test_pressure_goal_and_stop_of_a_tick(router, stalled):
    loop = stalled
    seen = replace(loop.outputs.observed, values=Observation(*[0.0] * 7, 12.5), pressure_age_ns=4_000_000)
    goal = GoalStatus(Goal("reach", -0.2, 0.65), "running", number=1)
    loop.outputs = replace(loop.outputs, t_ns=NOW_NS - 1_000_000, observed=seen, goal=goal, estop=EStop.LATCHED)
    with node(router, loop):
        pressure, target, stopped = router.first("pressure"), router.first("goal"), router.first("stopped")
    assert (pressure.fluid_pressure, pressure.variance) == (12_500.0, 0.0)
    assert stamp_ns(pressure) == WALL_NS - 5_000_000
    assert (target.header.frame_id, target.point.x, target.point.y, target.point.z) == ("world", 0.0, -0.2, 0.65)
    assert stopped.data is True


def test_ros_sees_the_node_and_its_topics(router, loop):
    with node(router, loop, domain_id=3, commands="all"):
        until(lambda: len(router.tokens()) == 9)
        tokens = sorted(token.split("/") for token in router.tokens())
        until(lambda: router.samples)
        first = router.samples[0]
    (session,) = {token[2] for token in tokens}
    assert ["@ros2_lv", "3", session, "0", "0", "NN", "%", "%", "softarm"] in tokens
    kinds = {token[9]: token[5] for token in tokens if len(token) == 13}
    published = {f"%softarm%{name}": "MP" for name in TYPES}
    assert kinds == published | {"%softarm%command%goal": "MS", "%softarm%command%stop": "MS"}
    assert len({token[4] for token in tokens}) == 9
    (tip,) = (token for token in tokens if token[9:10] == ["%softarm%tip"])
    type_hash = "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
    assert tip[10:] == ["geometry_msgs::msg::dds_::PoseStamped_", type_hash, "::,10:,:,:,,"]
    number, source_ns, gid = z_deserialize(tuple[Int64, Int64, bytes], first.attachment)
    assert (number, source_ns, len(gid), len(first.attachment)) == (1, WALL_NS, 16, 33)


def test_by_default_ros_cannot_command(router, loop):
    with node(router, loop):
        tokens = router.tokens()
        for name, type_name in (("command/goal", POINT), ("command/stop", EMPTY)):
            assert not router.session.declare_publisher(key(name, type_name)).matching_status.matching
    assert not any("command" in token for token in tokens)


def test_ros_that_may_stop_may_not_set_goals(router, loop):
    with node(router, loop, commands="stop"):
        router.send_stop()
        assert router.answer() == "stop accepted"
        assert not router.session.declare_publisher(key("command/goal", POINT)).matching_status.matching
    assert [(post.request.kind, post.request.who) for post in loop.taken] == [("stop", f"ROS 2, {router.endpoint}")]


def test_a_stop_counts_whatever_its_message_holds(router, loop):
    with node(router, loop, commands="stop"):
        until(lambda: any("command" in token for token in router.tokens()))
        router.session.put(key("command/stop", EMPTY), b"")
        until(lambda: loop.taken)
    assert loop.taken[0].request.kind == "stop"


def test_a_goal_is_a_request_like_those_of_the_api(router, loop):
    with node(router, loop, commands="all"):
        router.send_goal(-0.2, 0.65)
        assert router.answer() == "goal accepted"
    assert loop.taken[0].request.goal == Goal("reach", -0.2, 0.65)


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        ({"y_m": -0.2, "z_m": 0.2}, "z_m 0.2 is outside the workspace; allowed 0.5..0.85 m (goals.workspace)"),
        ({"y_m": math.nan, "z_m": 0.65}, "y_m nan is outside the workspace"),
        ({"y_m": -0.2, "z_m": 0.65, "frame": "map"}, "frame_id is 'map'; allowed 'world' or none"),
        ({"y_m": -0.2, "z_m": 0.65, "x_m": 0.1}, "x is 0.1; allowed 0"),
    ],
)
def test_an_impossible_goal_is_refused_with_its_reason(router, loop, sent, said):
    with node(router, loop, commands="all"):
        router.send_goal(**sent)
        assert router.answer().startswith(f"goal refused: {said}")
    assert loop.taken == []


def test_a_goal_that_the_loop_refuses_is_answered_with_its_reasons(router, loop):
    loop.refuse = ("the arm is disarmed: `softarm arm`", "no frame yet")
    with node(router, loop, commands="all"):
        router.send_goal(-0.2, 0.65)
        assert router.answer() == "goal refused: the arm is disarmed: `softarm arm`; no frame yet"


def test_a_stop_that_the_loop_does_not_answer_names_the_button(stalled):
    config = Config.model_validate({"ros": {"router": "tcp/127.0.0.1:7447"}})
    made = RosNode(config, stalled.inbox, lambda: stalled.outputs, lambda: None, clock=iter((0, 500_000_001)).__next__)
    made._ask("stop", None)
    answer = made._answer(made._waiting[0], stalled.outputs)
    assert answer.startswith("stop: the control loop did not answer within 0.5 s; use the emergency-stop button")


def test_a_message_of_another_type_is_refused(router, loop):
    with node(router, loop, commands="all"):
        until(lambda: any("command%goal" in token for token in router.tokens()))
        router.session.put(key("command/goal", POINT), b"\x00\x01\x00\x00hello")
        assert router.answer().startswith(f"goal refused: the message is no {POINT}")
    assert loop.taken == []


def test_a_node_that_was_not_started_can_be_stopped():
    """Another part of the daemon may fail to start first."""
    config = Config.model_validate({"ros": {"router": "tcp/127.0.0.1:7447"}})
    RosNode(config, None, lambda: None, lambda: None).stop()


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_goal_and_a_stop_reach_the_daemon(router, tmp_path):
    ros = {"router": router.endpoint, "commands": "all"}
    config = Config.model_validate(
        {
            "api": {"port": 0, "stop_port": 0},
            "failsafe": BUSY_MACHINE,  # a stop would end the goal before it is published
            "recorder": {"directory": tmp_path},
            "control": {"realtime_priority": 0, "policy": "pid"},
            "ros": ros,
        }
    )
    with Daemon(config, simulated_devices()) as daemon:
        until(lambda: (now := daemon.loop.snapshot) is not None and not now.arming_refusals)
        daemon.inbox.post("arm")
        until(lambda: daemon.loop.snapshot.mode == "armed")
        router.send_goal(-0.2, 0.65)
        until(lambda: daemon.loop.snapshot.goal.number == 1)
        assert (target := router.first("goal").point).y == -0.2
        assert target.z == 0.65
        router.send_stop()
        until(lambda: daemon.loop.snapshot.estop is not EStop.CLEAR)
        until(lambda: router.messages("stopped", slice(-1, None))[0].data)
        until(lambda: "stop" in [entry.what for entry in daemon.recorder.history.entries if "ROS 2" in entry.text])
    assert router.messages("joint_states")[0].position[0] == pytest.approx(0.0, abs=0.3)
    stamps = [stamp_ns(message) for message in router.messages("tip")]
    assert stamps == sorted(set(stamps))
    assert abs(stamps[-1] - time.time_ns()) < 60e9
