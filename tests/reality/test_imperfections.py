"""Each imperfection has an example and changes its own stage but none upstream."""

from dataclasses import fields, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from softarm.reality.parameters import GROUPS, RobotParameters, of
from softarm.reality.robot import Robot
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

PERIOD_S = 1 / 30
# A strong value, and the companions without which it has nothing to act on.
EXEMPLARS: dict[str, tuple[float, dict[str, float]]] = {
    "regulator.inflate_s": (0.3, {}),
    "regulator.deflate_s": (0.4, {}),
    "regulator.tube_s": (0.05, {}),
    "regulator.dead_time_s": (0.06, {}),
    "regulator.dead_time_jitter_s": (0.02, {}),
    "regulator.flow_limit_kpa_s": (30.0, {}),
    "regulator.deadband_kpa": (4.0, {}),
    "regulator.gain": (0.1, {}),
    "regulator.offset_kpa": (1.0, {}),
    "regulator.ceiling_kpa": (8.0, {}),
    "regulator.leak_1_s": (0.5, {}),
    "regulator.stick_kpa": (2.0, {"stick_below_kpa": 8.0}),
    "regulator.stick_below_kpa": (8.0, {"stick_kpa": 2.0}),
    "rail.acceleration_m_s2": (3.0, {}),
    "rail.velocity_gain_n_s_m": (10.0, {}),
    "rail.feedforward_kg": (0.0, {}),
    "rail.force_limit_n": (2.0, {}),
    "rail.delay_s": (0.08, {}),
    "rail.delay_jitter_s": (0.02, {}),
    "rail.lag_s": (0.05, {}),
    "rail.feed_error": (0.1, {}),
    "rail.coulomb_n": (2.0, {}),
    "rail.stiction_n": (3.0, {}),
    "rail.stribeck_m_s": (0.3, {"stiction_n": 3.0}),
    "rail.viscous_n_s_m": (5.0, {}),
    "rail.backlash_m": (0.01, {}),
    "rail.cable_n_m": (50.0, {"cable_taut_m": 0.0}),
    "rail.cable_taut_m": (-0.1, {"cable_n_m": 50.0}),
    "rail.ripple_n": (3.0, {}),
    "rail.ripple_period_m": (0.1, {"ripple_n": 3.0}),
    "arm.pieces": (1, {}),
    "arm.stiffness": (0.2, {}),
    "arm.damping": (0.5, {}),
    "arm.muscle_gain": (0.2, {}),
    "arm.torque_offset": (1.0, {}),
    "arm.friction_nm": (0.03, {}),
    "arm.stiffening_1_rad2": (2.0, {}),
    "arm.hysteresis": (0.4, {}),
    "arm.hysteresis_kpa": (8.0, {"hysteresis": 0.4}),
    "arm.saturation_kpa": (8.0, {}),
    "arm.payload_kg": (0.05, {}),
    "arm.tilt_rad": (0.05, {}),
    "arm.air_kg_m3": (5.0, {}),
    "arm.creep": (0.5, {"creep_s": 1.0}),
    "arm.creep_s": (0.3, {"creep": 0.5}),
    "arm.softening": (0.4, {"softening_s": 1.0}),
    "arm.softening_s": (2.0, {"softening": 0.4}),
    "arm.fatigue": (0.4, {"fatigue_s": 1.0}),
    "arm.fatigue_s": (2.0, {"fatigue": 0.4}),
    "mocap.rate_hz": (60.0, {}),
    "mocap.noise_m": (0.002, {}),
    "mocap.angle_noise_rad": (0.01, {}),
    "mocap.latency_s": (0.03, {}),
    "mocap.transport_s": (0.01, {}),
    "mocap.transport_jitter_s": (0.005, {}),
    "mocap.dropout": (0.2, {}),
    "mocap.rotation_rad": (0.03, {}),
    "mocap.scale": (0.02, {}),
    "mocap.offset_y_m": (0.01, {}),
    "mocap.offset_z_m": (0.01, {}),
    "mocap.loose_link": (3, {}),
    "mocap.loose_hz": (12.0, {"loose_link": 3}),
    "mocap.loose_damping": (0.5, {"loose_link": 3}),
    "pressure_sensor.rate_hz": (60.0, {}),
    "pressure_sensor.noise_kpa": (0.2, {}),
    "pressure_sensor.quantum_kpa": (0.2, {}),
    "pressure_sensor.bias_kpa": (0.5, {}),
    "rail_sensor.rate_hz": (60.0, {}),
    "rail_sensor.position_quantum_m": (0.002, {}),
    "rail_sensor.velocity_quantum_m_s": (0.05, {}),
    "clock.camera_drift": (0.001, {}),
}
# Parameters of the recording controller, not of the robot: tests/reality/test_record.py.
OF_THE_RECORDING = {"clock.tick_jitter_s", "clock.missed_ticks"}
QUIET = {"noise_m": 0.0, "angle_noise_rad": 0.0}


class Flown(NamedTuple):
    """Truth at every tick, and everything that was received."""

    pressure_kpa: np.ndarray  # [T]
    cart_m: np.ndarray  # [T]
    ends_m: np.ndarray  # [T, 5, 2]
    frames: list[MocapFrame]
    gauge: list[PressureReading]
    encoder: list[RailReading]


def shake(t_s: float) -> tuple[float, float]:
    """Both ways along the rail with a stop, pressure up and down and nearly off."""
    velocity = 0.6 if t_s < 0.2 else -0.6 if t_s < 0.4 else 0.0 if t_s < 0.5 else 0.4
    pressure = 15.0 if t_s < 0.3 else 4.0 if t_s < 0.4 else 1.0 if t_s < 0.6 else 6.0
    return velocity, pressure


def levels(*held: tuple[float, float]) -> Any:
    """A cart at rest, and pressures, kPa, each of them until a time, s."""
    return lambda t_s: (0.0, next(kpa for until_s, kpa in held if t_s < until_s))


@cache
def fly(parameters: RobotParameters, seconds: float = 0.8, excitation: Any = shake, **robot_options: Any) -> Flown:
    robot = Robot(parameters, 1, **robot_options)
    truths = []
    for tick in range(round(seconds / PERIOD_S)):
        robot.command(tick * PERIOD_S, *excitation(tick * PERIOD_S))
        robot.advance((tick + 1) * PERIOD_S)
        truths.append(robot.truth)
    return Flown(
        np.array([truth.pressure_kpa for truth in truths]),
        np.array([truth.cart_position_m for truth in truths]),
        np.array([truth.link_ends_m for truth in truths]),
        robot.mocap(),
        robot.pressure(),
        robot.rail(),
    )


def perturb(group: str, **values: float) -> RobotParameters:
    """The nominal robot with some values of one group."""
    nominal = RobotParameters()
    return replace(nominal, **{group: replace(getattr(nominal, group), **values)})


def test_every_quantity_has_an_exemplar() -> None:
    groups = [field.name for field in fields(RobotParameters) if field.default_factory in GROUPS]
    names = {f"{group}.{name}" for group in groups for name in of(type(getattr(RobotParameters(), group)))}
    assert set(EXEMPLARS) | OF_THE_RECORDING == names


@pytest.mark.parametrize("name", EXEMPLARS)
def test_an_imperfection_changes_its_stage_and_none_upstream(name: str) -> None:
    group, field = name.split(".")
    value, companions = EXEMPLARS[name]
    seconds = {"regulator": 0.8, "rail": 0.4, "arm": 0.4}.get(group, 0.2)
    without, having = (fly(perturb(group, **each), seconds) for each in (companions, companions | {field: value}))
    pressure, cart, ends = (np.abs(a - b).max() for a, b in zip(having[:3], without[:3], strict=True))
    if group in ("regulator", "rail", "arm"):
        moved = {"regulator": pressure / 20, "rail": cart, "arm": ends}[group]
        assert moved > 5e-4  # of 20 kPa, or half a millimetre
        assert (pressure == 0) == (group != "regulator")
    else:
        assert (pressure, cart, ends) == (0, 0, 0)
        changed = {
            "mocap": having.frames != without.frames,
            "pressure_sensor": having.gauge != without.gauge,
            "rail_sensor": having.encoder != without.encoder,
        }
        assert changed == {sensor: sensor == group.replace("clock", "mocap") for sensor in changed}


def test_dead_time_has_its_declared_length() -> None:
    late = fly(perturb("regulator", dead_time_s=2 / 30))
    np.testing.assert_array_equal(late.pressure_kpa[2:], fly(RobotParameters()).pressure_kpa[:-2])


@pytest.mark.parametrize(
    ("values", "reached_kpa"),
    [
        ({}, (10.0, 12.0, 4.0)),
        ({"gain": 0.1}, (11.0, 13.2, 4.4)),
        ({"offset_kpa": -1.0}, (9.0, 11.0, 3.0)),
        ({"ceiling_kpa": 11.0}, (10.0, 11.0, 4.0)),
        ({"deadband_kpa": 3.0}, (10.0, 10.0, 4.0)),
        # The nominal chamber fills in 0.1532 s: a share of 1 / (1 + 0.5 * 0.1532) of the command is reached.
        ({"leak_1_s": 0.5}, (9.288, 11.146, 3.715)),
    ],
)
def test_the_reached_pressure_follows_the_imperfections(values: dict[str, float], reached_kpa: Any) -> None:
    flown = fly(perturb("regulator", **values), 3.9, levels((1.3, 10.0), (2.3, 12.0), (3.9, 4.0)), held=True)
    np.testing.assert_allclose(flown.pressure_kpa[[38, 68, 116]], reached_kpa, atol=0.01)


def test_filling_and_venting_have_the_declared_time_constants() -> None:
    """The area between a step and the answer to it is the step times the time constant, whatever the tube."""
    up_and_down = levels((1, 10.0), (2.4, 0.0))
    for tube_s in (0.0, 0.03):
        flown = fly(perturb("regulator", inflate_s=0.1, deflate_s=0.2, tube_s=tube_s), 2.4, up_and_down, held=True)
        lags_s = (10 - flown.pressure_kpa[:30]).sum() / 300, flown.pressure_kpa[30:].sum() / 300
        # Sampled at the ends of the ticks: half a tick is missing from each area.
        np.testing.assert_allclose(np.add(lags_s, 0.5 / 30), (0.1, 0.2), rtol=0.03)


@pytest.mark.slow
def test_the_arm_hangs_as_declared() -> None:
    def hang_m(pressure_kpa: float, seconds: float = 0.1, **values: float) -> float:
        pressed = levels((seconds, pressure_kpa))
        start = {"held": True, "hanging": not pressure_kpa}
        flown = fly(perturb("arm", damping=4.0, **values), seconds, pressed, **start)
        return float(flown.ends_m[-1, -1, 0])

    assert hang_m(10.0, 1.0, muscle_gain=0.2) == pytest.approx(hang_m(12.0, 1.0), abs=2e-5)
    assert hang_m(0.0, torque_offset=-1.0) == pytest.approx(0.0, abs=2e-5)
    assert hang_m(0.0) < hang_m(0.0, stiffness=1.0) < -0.002
    assert hang_m(0.0) < hang_m(0.0, payload_kg=0.1) < -0.002
    assert hang_m(0.0, tilt_rad=0.1) > hang_m(0.0) + 0.005
    assert hang_m(8.0, 3.5, saturation_kpa=8.0) == pytest.approx(hang_m(8.0 / 2 ** (1 / 3), 3.5), abs=2e-5)


def test_choked_flow_limits_the_slope() -> None:
    rates = np.diff(fly(perturb("regulator", flow_limit_kpa_s=30.0)).pressure_kpa) * 30
    assert np.abs(rates).max() == pytest.approx(30.0, rel=0.01)


def test_the_valve_sticks_at_low_pressure_only() -> None:
    steps = levels((1.5, 12.0), (2.8, 11.0), (4.6, 1.0))
    flown = fly(perturb("regulator", stick_kpa=2.0, stick_below_kpa=5.0), 4.6, steps, held=True)
    assert flown.pressure_kpa[83] == pytest.approx(11.0, abs=0.01)  # a small step up there is followed
    assert flown.pressure_kpa[-1] == pytest.approx(3.0, abs=0.1)  # and down here it stays 2 kPa off


def test_stiction_holds_the_cart_until_the_drive_breaks_it_loose() -> None:
    def crawl(t_s: float) -> tuple[float, float]:
        return 0.06, 0.0  # 30 N s/m: 1.8 N at standstill

    moves_m = {
        stiction: np.ptp(fly(perturb("rail", coulomb_n=0.5, stiction_n=stiction), 1.0, crawl).cart_m[10:])
        for stiction in (0.0, 3.0)
    }
    assert moves_m[0.0] > 0.02
    assert moves_m[3.0] < 1e-3


def test_the_motor_plays_within_its_backlash() -> None:
    gap_m = 0.02
    flown = fly(perturb("rail", backlash_m=gap_m))
    encoder_m = np.array([reading.position_m for reading in flown.encoder])[3::4]
    apart_m = encoder_m - flown.cart_m
    assert np.abs(apart_m).max() == pytest.approx(gap_m / 2, abs=1e-3)
    assert np.ptp(apart_m) > 0.9 * gap_m  # both sides are visited


def test_with_play_the_motor_still_moves_the_whole_mass() -> None:
    rigid, loose = (
        fly(perturb("rail", force_limit_n=1.0, backlash_m=gap), 0.5, lambda t_s: (0.9, 0.0)) for gap in (0.0, 0.002)
    )
    assert rigid.cart_m[-1] > 0.1
    assert np.abs(loose.cart_m - rigid.cart_m).max() < 0.012  # the motor first has to cross its play, alone


def test_a_wrong_feed_shows_between_read_back_and_truth() -> None:
    flown = fly(perturb("rail", feed_error=0.05))
    encoder_m = np.array([reading.position_m for reading in flown.encoder])[3::4]
    np.testing.assert_allclose(flown.cart_m, 1.05 * encoder_m, atol=2e-5)


def test_the_cable_pulls_at_one_end() -> None:
    nominal, flown = fly(RobotParameters()), fly(perturb("rail", cable_n_m=80.0, cable_taut_m=0.03))
    before = np.argmax(nominal.cart_m > 0.03)
    np.testing.assert_array_equal(flown.cart_m[:before], nominal.cart_m[:before])
    assert flown.cart_m[before:].max() < nominal.cart_m.max() - 0.005


def test_poses_are_older_than_their_stamp_by_the_latency() -> None:
    flown = fly(perturb("mocap", latency_s=1 / 30, **QUIET))
    for frame in flown.frames:
        tick = frame.t_capture_ns * 30e-9 - 1
        if abs(tick - round(tick)) < 1e-6 and tick >= 1:
            ends = [(pose.y_m, pose.z_m) for pose in frame.bodies[1:]]
            np.testing.assert_allclose(ends, flown.ends_m[round(tick) - 1], atol=1e-9)
    assert all(frame.t_receive_ns == frame.t_capture_ns for frame in flown.frames)


def test_a_turned_and_shifted_calibration() -> None:
    """By hand: a point d below the rail's middle appears at d sin(angle) towards +y, d cos(angle) down."""
    angle, scale, rest = 0.1, 0.05, levels((1, 0.0))
    true = fly(perturb("mocap", **QUIET), 0.1, rest, held=True).frames[-1].bodies
    values = {"rotation_rad": angle, "scale": scale, "offset_y_m": 0.01, "offset_z_m": -0.02, **QUIET}
    seen = fly(perturb("mocap", **values), 0.1, rest, held=True).frames[-1].bodies
    for was, now in zip(true, seen, strict=True):
        below = 0.965 - was.z_m
        assert now.y_m == pytest.approx(1.05 * (was.y_m * np.cos(angle) + below * np.sin(angle)) + 0.01, abs=1e-12)
        assert now.z_m == pytest.approx(
            0.965 - 1.05 * (below * np.cos(angle) - was.y_m * np.sin(angle)) - 0.02, abs=1e-12
        )
        assert now.angle_rad == pytest.approx(was.angle_rad + angle)


def test_the_loose_marker_wobbles_alone() -> None:
    firm, loose = fly(perturb("mocap", **QUIET)).frames, fly(perturb("mocap", loose_link=4, **QUIET)).frames
    apart = np.array([np.subtract(a.bodies, b.bodies) for a, b in zip(loose, firm, strict=True)])
    assert (apart[:, [0, 1, 2, 3, 5]] == 0).all()
    assert 0.001 < np.abs(apart[:, 4, :2]).max() < 0.03
    assert np.abs(apart[:, 4, 0].mean()) < 0.3 * np.abs(apart[:, 4, 0]).max()


def test_frames_are_lost_at_the_declared_rate_and_counted() -> None:
    frames = fly(perturb("mocap", dropout=0.3), 3.0, held=True).frames
    assert 1 - len(frames) / frames[-1].sequence == pytest.approx(0.3, abs=0.05)


def test_drifting_stamps_gain_on_the_controllers_clock() -> None:
    frames = fly(perturb("clock", camera_drift=0.002)).frames
    gained_ns = [frame.t_capture_ns - frame.t_receive_ns for frame in frames]
    assert gained_ns[-1] == pytest.approx(0.002 * frames[-1].t_receive_ns, abs=2)
    assert (np.diff(gained_ns) > 0).all()


def test_the_gauge_reads_high_in_steps() -> None:
    flown = fly(perturb("pressure_sensor", bias_kpa=1.0, noise_kpa=0.0, quantum_kpa=0.5))
    readings = np.array([reading.pressure_kpa for reading in flown.gauge])
    np.testing.assert_allclose(readings % 0.5, 0.0, atol=1e-9)
    np.testing.assert_allclose(readings[3::4], flown.pressure_kpa + 1.0, atol=0.2501)


def test_hysteresis_is_a_rate_independent_loop() -> None:
    """At one and the same pressure the tip hangs elsewhere on the way down, however long one waits."""
    up_and_down = levels((2.5, 8.0), (3.5, 16.0), (6.5, 8.0))

    def loop_m(**values: float) -> float:
        tip_y_m = fly(perturb("arm", damping=4.0, **values), 6.5, up_and_down, held=True).ends_m[:, -1, 0]
        return float(tip_y_m[74] - tip_y_m[-1])

    # Three plays, on average 2/3 of 2 kPa to either side, 0.3 of it: 0.8 kPa at about 4 mm/kPa.
    assert 0.002 < loop_m(hysteresis=0.3) < 0.005
    assert abs(loop_m()) < 2e-4


def test_warming_up_softens_the_arm_and_creep_continues() -> None:
    def late_m(**values: float) -> float:
        tip_y_m = fly(perturb("arm", damping=4.0, **values), 5.0, levels((5, 10.0)), held=True).ends_m[:, -1, 0]
        return float(tip_y_m[-1] - tip_y_m[74])

    assert abs(late_m()) < 2e-4
    assert late_m(softening=0.4, softening_s=3.0) < -0.002
    assert late_m(creep=0.4, creep_s=3.0) < -0.002
