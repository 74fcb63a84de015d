"""Through the dark: cart and tip are carried on from what was seen last, and soon not at all."""

import math

import pytest

from softarm.daemon.control.alignment import Past
from softarm.daemon.control.dead_reckoning import DeadReckoning, Readings, Sighting, Strength, TipModel
from softarm.daemon.control.observer import Observer
from softarm.daemon.control.records import Inputs
from softarm.daemon.shell.offline import Lockstep
from softarm.drivers.bodies.in_process import InProcessMocap
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame, Pose, PressureReading, RailReading

MS = 1_000_000
TICK_NS = 33_333_333
HINGE_M = 0.965


def swing(lag_ns=0, cart_off_m=0.0, read_until_ns=10**12, strength=1.0, angle=0.3):
    """A robot that is as the model says: sightings every 8 ms, axis and pressure read beside them."""
    model, axis, pressure = TipModel(), Past(), Past()
    rate, seen = -1.0, []
    for step in range(60):
        t_ns = round(step * 1e9 / 120)
        cart_m, cart_m_s, cart_m_s2 = (
            0.1 * math.sin(0.04 * step),
            0.1 * 0.04 * 120 * math.cos(0.04 * step),
            -0.1 * (0.04 * 120) ** 2 * math.sin(0.04 * step),
        )
        kpa = 2.0 + 0.1 * step
        if t_ns <= read_until_ns:
            axis.add(t_ns, cart_m, cart_m_s)
            pressure.add(t_ns, kpa)
        length = 0.44 + model.bent_m(angle, kpa)
        cart_y_m = cart_m + cart_off_m
        tip = (cart_y_m + length * math.sin(angle), HINGE_M - length * math.cos(angle))
        seen.append(Sighting(t_ns + lag_ns, cart_y_m, *tip))
        rate += (strength * model.own_rad_s2(angle, rate, kpa) + model.pulled_rad_s2(angle, cart_m_s2)) / 120
        angle += rate / 120
    return seen, Readings(axis, pressure, lag_ns)


def off_m(one, other):
    return max(abs(a - b) for a, b in zip(one[1:], other[1:], strict=True))


@pytest.mark.parametrize("lag_ms", [0, 46])
@pytest.mark.parametrize("cart_off_m", [0.0, 0.02])
def test_a_robot_that_is_as_the_model_says_is_carried_on_to_a_millimetre(lag_ms, cart_off_m):
    """Also where the cameras are late, and where their frame is off: the cart goes on from where it was seen."""
    seen, readings = swing(lag_ms * MS, cart_off_m)
    reckoning = DeadReckoning(seen[16], seen[20], readings)
    for then in (seen[24], seen[28], seen[32], seen[40]):
        assert off_m(reckoning.at(then.t_ns), then) < 0.003


@pytest.mark.parametrize("strength", [0.75, 1.0, 1.2])
def test_the_arms_strength_is_told_from_its_swing(strength):
    seen, readings = swing(strength=strength, angle=0.9)
    told = Strength()
    for sighting in seen[::4]:
        told.see(sighting, readings)
    assert told.value == pytest.approx(strength, abs=0.05)


def test_an_arm_at_rest_tells_no_strength_and_a_gap_is_not_differenced_over():
    seen, readings = swing()
    told = Strength()
    for sighting in (seen[0], seen[4], seen[30], seen[34]):
        told.see(sighting, readings)
    assert told.value == 1.0
    still, axis, pressure = Strength(), Past(), Past()
    for tick in range(30):
        axis.add(tick * TICK_NS, 0.0)
        pressure.add(tick * TICK_NS, 0.0)
        angle = TipModel().offset_rad_s2 / TipModel().stiffness_1_s2 + 1e-3 * (tick % 2)
        hanging = Sighting(tick * TICK_NS, 0.0, 0.44 * math.sin(angle), HINGE_M - 0.44 * math.cos(angle))
        still.see(hanging, Readings(axis, pressure, 0))
    assert still.value == pytest.approx(1.0, abs=0.1)


def test_where_axis_or_pressure_is_silent_too_nothing_is_carried_on():
    seen, readings = swing(read_until_ns=200 * MS)
    reckoning = DeadReckoning(seen[16], seen[20], readings)
    assert reckoning.at(240 * MS) is not None
    assert reckoning.at(260 * MS) is None
    assert reckoning.at(270 * MS) is None
    blind = Readings(Past(), readings.pressure, 0)
    assert DeadReckoning(seen[16], seen[20], blind).at(200 * MS) is None


def test_the_deviation_grows_with_the_dark():
    deviations = [TipModel().deviation_m(each) for each in (0.0, 0.033, 0.067, 0.1, 0.133, 0.167)]
    assert deviations == sorted(deviations)
    assert deviations[-1] < 0.05


class Eyes(InProcessMocap):
    """Cameras at 120 Hz that can be shut."""

    shut = False

    def read(self, now_ns):
        since_ns = self._robot.now_ns
        frames = [
            f for part in (1, 2, 3, 4) for f in super(Eyes, self).read(since_ns + part * (now_ns - since_ns) // 4)
        ]
        return () if self.shut else tuple(frames)


@pytest.fixture
def swinging():
    daemon = Lockstep(Config(), registry.load("reach"))
    daemon.robot.mocap = eyes = Eyes(daemon.robot)
    daemon.arm()
    daemon.tick(daemon.request("goal", Goal("reach", -0.4, 0.8)))
    for _ in range(12):
        daemon.tick()
    return daemon, eyes


def test_the_simulated_swing_is_known_to_two_centimetres_after_150_ms_of_dark(swinging):
    daemon, eyes = swinging
    eyes.shut = True
    moved_m = 0.0
    at_m = daemon.robot.body.tip_m
    for _ in range(4):
        daemon.tick()
        values, (y_m, z_m) = daemon.outputs.observed.values, daemon.robot.body.tip_m
        assert math.hypot(values.tip_y_m - y_m, values.tip_z_m - z_m) < 0.02
        assert values.cart_position_m == pytest.approx(daemon.robot.body.cart_position_m, abs=0.002)
        assert values.cart_velocity_m_s == pytest.approx(daemon.robot.body.cart_velocity_m_s, abs=0.15)
        moved_m = max(moved_m, math.hypot(y_m - at_m[0], z_m - at_m[1]))
    assert moved_m > 0.15  # what holding on to the last frame would be off
    assert daemon.outputs.observed.dark_ns == pytest.approx(4 * TICK_NS, abs=10)


def test_what_follows_the_dark_is_seen_and_its_velocities_are_no_jump(swinging):
    daemon, eyes = swinging
    eyes.shut = True
    for _ in range(3):
        daemon.tick()
    eyes.shut = False
    before_m = daemon.robot.body.tip_m
    daemon.tick()
    values, (y_m, z_m) = daemon.outputs.observed.values, daemon.robot.body.tip_m
    assert daemon.outputs.observed.dark_ns == 0
    assert (values.tip_y_m, values.tip_z_m) == pytest.approx((y_m, z_m), abs=1e-9)
    assert values.tip_vy_m_s == pytest.approx((y_m - before_m[0]) * 30, abs=0.4)
    assert values.tip_vz_m_s == pytest.approx((z_m - before_m[1]) * 30, abs=0.4)


def test_a_target_that_only_the_estimate_reaches_is_not_reached(swinging):
    daemon, eyes = swinging
    y_m, z_m = daemon.robot.body.tip_m
    eyes.shut = True
    daemon.tick()
    values = daemon.outputs.observed.values
    ahead = Goal("reach", 2 * values.tip_y_m - y_m, 2 * values.tip_z_m - z_m)  # where the tip goes
    daemon.tick(daemon.request("goal", ahead))
    values = daemon.outputs.observed.values
    assert math.hypot(values.tip_y_m - ahead.y_m, values.tip_z_m - ahead.z_m) < 0.04
    daemon.tick()
    assert daemon.outputs.goal.state == "running"


def test_an_arm_that_hangs_still_is_carried_on_where_it_hangs():
    observer = Observer(Config())
    for tick in range(8):
        now = tick * TICK_NS
        tremor_m = 1e-4 * (tick % 2)
        bodies = (Pose(tremor_m, HINGE_M, 0.0), *[Pose(0.0, 0.7, 0.0)] * 4, Pose(-0.0094 + tremor_m, 0.523, 0.0))
        frames = (MocapFrame(tick + 1, now, now, bodies),) if tick < 5 else ()
        inputs = Inputs(
            now, mocap=frames, rail=RailReading(now, 0.0, 0.0, True), pressure=PressureReading(now, 0.0, True)
        )
        observer.update(inputs)
    observed = observer.observe(now, 0.0)
    assert observed.dark_ns == 3 * TICK_NS
    assert observed.values.tip_y_m == pytest.approx(-0.0094, abs=0.003)
    assert observed.values.tip_z_m == pytest.approx(0.523, abs=0.003)
