"""Body of the simulated robot: sensor effects and the ends of the rail."""

import math

import pytest

from softarm.drivers.bodies.in_process import InProcessRobot
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Arm, Model

PERIOD_NS = 33_333_333


def robot(**effects):
    seed = Model()
    model = seed.model_copy(
        update={"effects": {**seed.effects, **{k.replace("__", "."): v for k, v in effects.items()}}}
    )
    made = InProcessRobot(SimulatedBody(model))
    made.regulator.write(True, 5.0)
    return made


def frames(made, ticks=30):
    seen = []
    for _ in range(ticks):
        made.rail.write(True, 0.5)
        seen += made.mocap.read(made.now_ns + PERIOD_NS)
    return seen


def test_latency_returns_poses_older_than_their_stamp():
    prompt, late = frames(robot()), frames(robot(mocap__latency={"delay": 2 * PERIOD_NS * 1e-9}))
    assert late[20].t_capture_ns == prompt[20].t_capture_ns
    assert late[20].bodies[0].y_m == pytest.approx(prompt[18].bodies[0].y_m, abs=1e-6)


def test_a_dropped_frame_leaves_a_gap_in_the_numbers():
    seen = frames(robot(mocap__dropout={"share": 0.5}), ticks=60)
    assert 10 < len(seen) < 50
    assert len({frame.sequence for frame in seen}) == len(seen)
    assert seen[-1].sequence > len(seen)


def test_the_frame_may_be_turned_scaled_shifted_and_noisy():
    straight = frames(robot(), 5)[-1].bodies[5]
    turned = frames(robot(mocap__rotation={"angle": 0.1}), 5)[-1].bodies[5]
    assert turned.y_m == pytest.approx(math.cos(0.1) * straight.y_m - math.sin(0.1) * straight.z_m, abs=1e-6)
    shifted = frames(robot(mocap__offset={"y": 0.01, "z": -0.02}), 5)[-1].bodies[5]
    assert (shifted.y_m - straight.y_m, shifted.z_m - straight.z_m) == pytest.approx((0.01, -0.02), abs=1e-6)
    noisy = frames(robot(mocap__noise={"sigma": 0.001}), 5)[-1].bodies[5]
    assert 0 < abs(noisy.y_m - straight.y_m) < 0.006


def test_a_pressure_offset_affects_the_reading_only():
    true, biased = robot(), robot(pressure__sensor_bias={"bias": 1.5})
    assert frames(true)[-1].bodies == frames(biased)[-1].bodies
    assert biased.regulator.read().pressure_kpa - true.regulator.read().pressure_kpa == pytest.approx(1.5, abs=1e-5)


def test_a_wrong_feed_constant_shows_between_read_back_and_mocap():
    made = robot(rail__gain={"scale": 0.1})
    cart = frames(made, 12)[-1].bodies[0].y_m
    assert cart == pytest.approx(1.1 * made.rail.read().position_m, rel=1e-5)
    assert made.rail.read().velocity_m_s == pytest.approx(0.5, abs=0.03)


def test_without_sensor_effects_the_readings_are_exact():
    made = robot()
    last = frames(made)[-1]
    assert last.bodies[0].y_m == float(made.body.simulator.cart_position_m[0])
    assert last.bodies[5][:2] == tuple(made.body.simulator.tip_m()[0].tolist())


def test_motion_capture_shows_the_arm_below_the_cart():
    body = SimulatedBody()
    [frame] = body.frames()
    cart, *links = frame.bodies
    assert len(links) + 1 == len(BODY_NAMES)
    assert (cart.y_m, cart.z_m) == (0.0, body.model.arm.base_height_m)
    assert [link.z_m for link in links] == pytest.approx([0.965 - 0.0885 * i for i in range(1, 6)], abs=1e-5)


def test_a_model_with_another_number_of_links_is_refused():
    arm = Arm(**{name: value[:3] if isinstance(value, tuple) else value for name, value in Arm()})
    with pytest.raises(ValueError, match="the model has 3 links, the robot 5"):
        SimulatedBody(Model(arm=arm))
