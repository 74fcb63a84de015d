"""Effects of a joint found in an independently simulated mechanism, from recordings to the patched model."""

import json
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import Series
from softarm.diagnosis.engine.decision import Decision
from softarm.diagnosis.rigs.candidates import candidates
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.grid import windows
from softarm.diagnosis.rigs.mjcf.view import JointView
from softarm.diagnosis.rigs.settling import settled
from softarm.diagnosis.rigs.stage import Finding, examine, is_rated, view_of
from softarm.schemas.verdict import Interval, NamedEffect, Shrink
from tests.cli.invoke import refuse, succeed
from tests.diagnosis.rigs.mjcf.test_joint_law import HARD
from tests.diagnosis.rigs.mjcf.test_joint_law import SERVO as SERVO_MODEL
from tests.diagnosis.rigs.recordings import (
    MECHANISM_KINDS,
    SERVO,
    STAGES,
    described_model,
    mechanism,
    of_joint,
    rms,
    shipped,
    simulate,
    view_of_joint,
)
from validation.mechanisms.record import JointLaw, Truth

GROUND = '<geom type="plane" size="2 2 0.1" pos="0.1 0 0" euler="0 -90 0"/>'
TILT_RAD = (0.0524, -0.0349)


def encoder(positions):
    """Return the readings of an encoder with steps of 0.1 mrad."""
    return np.round(positions, 4)


def record_twice(folder, simulated, seconds, read):
    """Record two motions of sines and steps of a servo at 100 Hz; read: its encoder."""
    t = np.arange(round(100 * seconds)) / 100
    for number in range(2):
        turn = np.random.default_rng(number).uniform(0, 6, 2)
        goals = 0.3 * np.sin(4 * t + turn[0]) + 0.2 * np.sign(np.sin(1.7 * t + turn[1]))
        simulate(simulated, folder / f"run-{number}.csv", goals, read=read)


@pytest.fixture(scope="module")
def camera(tmp_path_factory):
    """Three recordings of a camera that pans and tilts on a vehicle."""
    return tables.read(mechanism(tmp_path_factory.mktemp("camera"), "camera", Truth({}), seconds=1.5))


def test_each_measured_joint_is_a_stage_that_the_other_joints_and_the_base_drive(camera):
    assert {trial.stage.name for trial in camera} == {"pan", "tilt"}
    trials = [trial for trial in camera if trial.stage.name == "pan"]
    without = [replace(t, channels={n: s for n, s in t.channels.items() if n != "base"}) for t in trials]
    left, more = (rms(view_of(each)[0]) for each in (trials, without))
    assert left < 1.2e-3  # the step of the encoder is 1 mrad
    assert more > 3 * left


@pytest.mark.parametrize("creeps", [True, pytest.param(False, marks=pytest.mark.prove)])
def test_friction_that_creeps_as_in_mujoco_is_distinguished_from_friction_that_holds(tmp_path, creeps):
    """The joint has 0.6 N m more than its model, which MuJoCo regularises by default."""
    text = SERVO_MODEL.format(damping=0.05, dry=0.1, kp=60, limit=8)
    nominal = text.replace(HARD, "")
    simulated = mujoco.MjModel.from_xml_string(nominal if creeps else text)
    simulated.dof_frictionloss[:] = 0.7
    record_twice(tmp_path, simulated, 1.5, encoder)
    trials = tables.read(described_model(tmp_path, nominal))
    view, used = view_of(trials)
    settled(view, [trial.kind for trial in used.trials], used.origins)
    assert view.nominal("coulomb_friction.creep") == creeps
    assert any("creeps as MuJoCo" in text for text in view.warnings({})) == creeps
    (named,) = diagnose_table(trials).verdict.effects
    assert named.name == "elbow.coulomb_friction"
    assert named.parameters["torque"].value == pytest.approx(0.7, abs=0.02)


def test_a_friction_beyond_its_tolerance_is_named_though_the_calibrated_gap_is_below_two_floors(tmp_path):
    """The calibration takes all but 1.8 floors of a friction that is 35 % too large."""
    text = SERVO_MODEL.format(damping=0.05, dry=0.1, kp=60, limit=8).replace(HARD, "")
    simulated = mujoco.MjModel.from_xml_string(text)
    simulated.dof_frictionloss[:] = 0.135
    record_twice(tmp_path, simulated, 3.0, lambda x: np.round(x, 3))
    finding = examine(tables.read(described_model(tmp_path, text)))
    assert [each.name for each in finding.named] == ["elbow.coulomb_friction"]
    assert finding.named[0].parameters["torque"].value == pytest.approx(0.135, abs=0.005)


def test_windows_end_where_a_leg_touches_the_ground(tmp_path):
    """The ground pushes the foot for part of each swing; a simulation through it would lead far away."""
    text = SERVO_MODEL.format(damping=0.05, dry=0.0, kp=60, limit=8).replace("<worldbody>", f"<worldbody>{GROUND}")
    text = text.replace("</body>", '<geom name="foot" size="0.02" pos="0 0 -0.3" mass="0"/></body>')
    touches = []

    def control(data, goal):
        touches.append(data.ncon > 0)
        return goal

    for number in range(2):
        goals = 0.5 * np.sin(0.05 * np.arange(500) + number)
        simulate(text, tmp_path / f"run-{number}.csv", goals, control=control, read=encoder)
    view, touching = view_of_joint(described_model(tmp_path, text), "elbow"), np.mean(touches)
    assert touching > 0.2
    assert 0.2 < np.isfinite(view.measured).mean() < 1 - touching
    assert rms(view) < 1.5e-3  # 6 mrad with windows through the ground


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """Three recordings of a cart that a pole hangs from."""
    return tables.read(mechanism(tmp_path_factory.mktemp("swinging"), "cartpole", Truth({}), seconds=3.0))


def test_the_friction_of_the_model_bends_over_the_travel_that_leaves_the_smallest_gap(swinging):
    """The recorded friction bends by 1 mm. No model file states it, and its effect is far from linear."""
    view = JointView([trial for trial in swinging if trial.stage.name == "rail"])
    usual = view.nominal("coulomb_friction.give")
    left = rms(view)
    assert usual < 0.5e-3
    settled(view, MECHANISM_KINDS, range(len(MECHANISM_KINDS)))
    assert view.nominal("coulomb_friction.give") == pytest.approx(1e-3, abs=0.6 * usual)
    assert rms(view) < 0.6 * left


@pytest.mark.prove
def test_the_friction_bends_over_the_same_travel_beside_a_fault(tmp_path):
    """Without the spring, another travel leaves the smallest gap, and friction would be named next to the spring."""
    view = JointView(of_joint(mechanism(tmp_path, "cartpole", Truth({"rail": JointLaw(spring=2.0)})), "rail"))
    settled(view, MECHANISM_KINDS, range(len(MECHANISM_KINDS)))
    assert view.nominal("coulomb_friction.give") == pytest.approx(1e-3, abs=0.3e-3)


UPRIGHT = """<mujoco><option timestep="0.002"/><worldbody><body>
  <joint name="lean" axis="0 1 0" damping="0.3" armature="0.02"/>
  <inertial pos="0 0 0.3" mass="1.5" diaginertia="0.02 0.02 0.001"/>
</body></worldbody><actuator><motor name="drive" joint="lean"/></actuator></mujoco>"""


def test_an_upright_link_under_torque_commands_has_windows_in_which_errors_stay_small(tmp_path):
    """A link falls with a rate of 5 /s, held by a controller outside; the recording has the torques alone."""
    model = mujoco.MjModel.from_xml_string(UPRIGHT)
    model.opt.timestep = 5e-4

    def held(data, wanted):
        return 40.0 * (wanted - data.qpos) - 4.0 * data.qvel

    wanted = 0.6 * np.sin(0.9 * 0.005 * np.arange(2000))
    simulate(model, tmp_path / "sines.csv", wanted, control=held, read=encoder, step_s=0.005)
    assert rms(view_of_joint(described_model(tmp_path, UPRIGHT, "N m"), "lean")) < 2e-3


def finding(stage, driven_by, *, kind="none", noise=False, confidence=None):
    """Return what the diagnosis of a joint found; with a confidence its friction is named."""
    shrink = Shrink(stage=Interval(value=0.5, low=0.4, high=0.6))
    effect = NamedEffect(name=f"{stage}.coulomb_friction", parameters={}, confidence=confidence, shrink=shrink)
    decision = Decision(kind, (), {}, 0.0, noise=noise)
    named = (effect,) if confidence else ()
    about = SimpleNamespace(stage=stage)
    return Finding(
        about, 0.0, "", decision, (), named, (), None, (), None, "kind", (), {}, (), frozenset(driven_by), {}
    )


@pytest.mark.parametrize(
    ("kind", "exchangeable", "rated"),
    [
        ("named", (False,), True),
        ("named", (False, False), True),
        ("named", (False, False, False), False),
        ("named", (True, False), False),
        ("incomplete", (False,), False),
    ],
)
def test_more_names_than_blind_cases_have_and_replaceable_ones_are_not_rated(kind, exchangeable, rated):
    selected = tuple(SimpleNamespace(exchangeable=each) for each in exchangeable)
    assert is_rated(Decision(kind, selected, {}, 0.0)) == rated


@pytest.mark.parametrize(
    ("pole", "rated"),
    [
        ({"kind": "none"}, True),
        ({"kind": "named"}, True),
        ({"kind": "none", "noise": True}, False),
        ({"kind": "incomplete"}, False),
        ({"kind": "unknown"}, False),
    ],
)
def test_a_name_is_rated_if_the_motion_that_loads_its_joint_is_explained(pole, rated):
    """A bent encoder of a pole resembles friction of the cart that carries it."""
    found = {"rail": finding("rail", {"hinge"}, kind="named", confidence=0.86), "hinge": finding("hinge", (), **pole)}
    answer = found["rail"].rated(found)
    assert answer.named[0].confidence == (0.86 if rated else None)
    assert len(answer.warnings) == (0 if rated else 1)
    alone = {"rail": found["rail"]}
    assert alone["rail"].rated(alone) is found["rail"]


@pytest.mark.prove
def test_a_tilted_base_is_named_where_its_load_has_a_shape_of_its_own(tmp_path):
    """The pan axis is upright: no other effect makes it depend on gravity. The base has 3 and -2 degrees."""
    stage = mechanism(tmp_path, "camera", Truth({}, tilt_rad=TILT_RAD))
    (effect,) = diagnose_table(of_joint(stage, "pan")).verdict.effects
    assert (effect.name, effect.equivalents) == ("pan.tilt", ())
    for axis, angle in zip("xy", TILT_RAD, strict=True):
        assert effect.parameters[axis].low <= angle <= effect.parameters[axis].high


@pytest.mark.prove
def test_a_tilted_base_and_a_wrong_zero_are_one_for_a_planar_mechanism(tmp_path):
    stage = mechanism(tmp_path, "leg", Truth({}), seconds=2.0)
    for joint in ("hip", "knee", "ankle"):
        view = JointView(of_joint(stage, joint))
        same = {name for names in view.indistinguishable.values() for name in names}
        candidate = f"{joint}.tilt" in {each.name for each in candidates(view)}
        assert candidate != (f"{joint}.tilt" in same)
        assert candidate == ("tilt.y" in view.tolerances)
    assert view.value({}, "tilt.y") == 0.0


def test_joints_on_one_branch_load_each_other(swinging):
    views = {name: JointView([t for t in swinging if t.stage.name == name][:1]) for name in ("rail", "hinge")}
    assert views["rail"].driven_by == {"hinge"}
    assert views["hinge"].driven_by == {"rail"}


def with_zeros(trials, joint, zeros):
    """Return a joint's trials whose readings of it are off by a zero for each recording."""
    own = [trial for trial in trials if trial.stage.name == joint][: len(zeros)]
    found = []
    for trial, zero in zip(own, zeros, strict=True):
        series = trial.channels["measured"]
        moved = Series(series.t_s, {**series.columns, joint: series[joint] + zero})
        found.append(replace(trial, channels={**trial.channels, "measured": moved}))
    return found


def test_zeros_that_differ_between_recordings_are_no_gap_but_their_mean_is(swinging):
    """An encoder that is set to zero at each start: dry friction holds the pose at which it is set."""
    apart, same = (0.02, -0.02), (0.02, 0.02)
    right, differ, shifted = (
        rms(view_of(with_zeros(swinging, "hinge", zeros))[0]) for zeros in ((0.0, 0.0), apart, same)
    )
    assert right < differ < 0.2 * shifted


def test_a_difference_that_no_zero_has_stays_a_gap(swinging):
    view = JointView(with_zeros(swinging, "hinge", (0.3, -0.3)))
    assert rms(view) > 0.1
    assert not any("zero" in warning for warning in view.warnings({}))


def test_a_stretch_has_the_zero_of_its_recording(swinging):
    trials = with_zeros(swinging, "hinge", (0.02, -0.02, 0.0))
    stretches = [part for trial in trials for part in windows(trial, 1.5)]
    assert len(stretches) > 3
    (warning,) = (each for each in JointView(stretches).warnings({}) if "zero" in each)
    assert "differs between recordings by 0.04 rad" in warning
    assert "zero" not in str(JointView(with_zeros(swinging, "hinge", (0.02, 0.02, 0.02))).warnings({}))


def test_a_patched_model_as_xml_is_for_mujoco_alone(tmp_path):
    (tmp_path / "s.csv").write_text("t,u,y\n" + "".join(f"{0.01 * i},{i % 100},{i % 100}\n" for i in range(400)))
    stage = tmp_path / "stage.yaml"
    stage.write_text(SERVO)
    result = refuse("is for a stage of kind mujoco", "diagnose", stage, "--patch", tmp_path / "x.xml", code=2)
    assert "reading" not in result.output  # refused before the work
    refuse("for one stage.yaml of kind mujoco", "diagnose", stage, stage, "--patch", tmp_path / "x.xml", code=2)


def test_a_real_joint_has_the_dry_friction_that_its_authors_found(data, tmp_path):
    """Their law is arctan(100 rate), so 0.123 N m is the most; they give hardly any viscous friction."""
    (tmp_path / "double-pendulum").mkdir()
    run = sorted((data / "double-pendulum").glob("run-*.csv"))[1]
    (tmp_path / "double-pendulum" / run.name).symlink_to(run)
    trials = [trial for trial in shipped("double-pendulum-mujoco.yaml", tmp_path) if trial.stage.name == "elbow"]
    view, _ = view_of(trials)

    def left(path, values):
        gaps = view.gap([{f"elbow.{path}": value, "elbow.coulomb_friction.give": 0.0} for value in values])
        return np.sqrt(np.nanmean(gaps**2, axis=(1, 2)))

    dry, viscous = (0.0, 0.1, 0.123, 0.146, 0.18), (0.01, 0.02, 0.03, 0.04)
    with_dry = left("coulomb_friction.torque", dry)
    assert dry[int(np.argmin(with_dry))] == 0.123
    assert with_dry.min() < 0.5 * with_dry[0]
    assert with_dry.min() < 0.8 * left("damping.viscous", viscous).min()
    unsure = [warning for warning in view.warnings({}) if "between two samples" in warning]
    assert not unsure  # the other joint's accelerations are known between the samples


@pytest.mark.prove
@pytest.mark.timeout(900)
def test_the_command_line_names_the_dry_friction_of_a_real_double_pendulum(data, tmp_path):
    """Its authors give at most 0.146 and 0.123 N m, and hardly any viscous friction."""
    stage, verdict = STAGES / "double-pendulum-mujoco.yaml", tmp_path / "verdict.json"
    succeed("diagnose", stage, "--data", data, "--json", verdict)
    found = json.loads(verdict.read_text())
    named = {each["name"]: each["parameters"] for each in found["effects"]}
    assert not {"shoulder.damping", "elbow.damping"} & set(named)
    assert "between two samples" not in str(found["warnings"])  # each joint's acceleration is known between the samples
    for joint, theirs in (("shoulder", 0.146), ("elbow", 0.123)):
        torque = named[f"{joint}.coulomb_friction"]["torque"]
        assert torque["low"] <= theirs <= torque["high"]


HANGING = """<mujoco>
  <option timestep="0.001"/>
  <worldbody><body>
    <joint name="upper" axis="0 1 0" damping="0.5"/>
    <inertial pos="0 0 -0.2" mass="2" diaginertia="0.03 0.03 0.01"/>
    <body pos="0 0 -0.4">
      <joint name="hand" axis="0 1 0" damping="0.002" frictionloss="{dry}"/>
      <inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
    </body>
  </body></worldbody>
  <actuator><position name="servo" joint="upper" kp="80" kv="2"/></actuator>
</mujoco>"""


def hand(folder, dry, load="", *, wave=np.sin, samples=500):
    """Return the trials of a hand with a fine encoder, whose load depends on the coarse one of the upper arm.

    load: body in the hand that its model lacks; wave: of the arm's command.
    """
    text, place = HANGING.format(dry=dry), 'diaginertia="1e-4 1e-4 1e-4"/>'
    assert place in text
    loaded, random, t = text.replace(place, place + load), np.random.default_rng(3), np.arange(samples) / 100

    def read(positions):
        return positions[0] + 5e-4 * random.normal(), np.round(positions[1], 5)

    for number in range(2):
        goals = 0.3 * wave(3 * t + number) + 0.2 * np.sin(4.7 * t)
        simulate(loaded, folder / f"run-{number}.csv", goals, read=read)
    return of_joint(described_model(folder, text), "hand")


def test_noise_of_the_carrying_joint_is_in_the_floor_of_a_light_one_and_no_motion_between_samples(tmp_path):
    view, _ = view_of(hand(tmp_path, dry=0.0))
    left = rms(view)
    assert left > 5e-5
    assert 0.7 * left < view.floor[0] < 1.5 * left
    assert np.isfinite(view.measured).mean() > 0.9
    assert not any("between two samples" in each for each in view.warnings({}))


def test_steps_of_another_joint_between_samples_are_left_out_beside_its_noise(tmp_path):
    view, _ = view_of(hand(tmp_path, dry=0.0, wave=lambda phase: np.sign(np.sin(phase))))
    (warning,) = (each for each in view.warnings({}) if "between two samples" in each)
    assert "left out" in warning
    assert rms(view) < view.floor[0]


def test_a_payload_at_the_tip_explains_the_gap_at_its_own_distance(tmp_path):
    """The hand's centre of mass is 0.05 m from its joint, the payload 0.15 m."""
    load = '<body pos="0 0 -0.15"><inertial pos="0 0 0" mass="0.05" diaginertia="1e-9 1e-9 1e-9"/></body>'
    view, _ = view_of(hand(tmp_path, dry=0.0, load=load))

    def left(kg, m):
        return rms(view, {"hand.payload.mass": kg, "hand.payload.distance": m})

    at_tip, at_centre = left(0.05, 0.15), min(left(kg, 0.05) for kg in (0.05, 0.15, 0.3, 0.45))
    assert at_tip < 0.25 * left(0.0, 0.15)
    assert at_tip < 0.5 * at_centre


@pytest.mark.prove
def test_that_floor_is_measured_again_beside_friction_that_creeps(tmp_path):
    """Friction that holds passes other noise on than friction that yields to each peak of the load."""
    view, used = view_of(hand(tmp_path, dry=0.1, samples=1500))
    settled(view, [trial.kind for trial in used.trials], used.origins)
    assert view.nominal("coulomb_friction.creep")
    left = rms(view)
    assert 0.7 * left < view.floor[0] < 1.1 * left


@pytest.mark.prove
def test_a_light_joint_may_carry_ten_times_its_own_mass(tmp_path):
    """The hand of 0.1 kg swings with so little torque that a payload of 50 g would double it."""
    load = '<body pos="0 0 -0.08"><inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body>'
    verdict = diagnose_table(hand(tmp_path, dry=0.0, load=load, samples=1000)).verdict
    ((name, sizes),) = ((effect.name, effect.parameters) for effect in verdict.effects)
    assert (verdict.verdict, name) == ("named", "hand.payload")
    assert sizes["mass"].low <= 1.0 <= sizes["mass"].high
    assert sizes["distance"].low <= 0.08 <= sizes["distance"].high


@pytest.mark.parametrize("joint", ["pan", "tilt"])
def test_a_zero_that_little_depends_on_is_not_reported(camera, joint):
    """Both axes are hardly heavier at other angles, so chance alone makes zeros of a hundredth of a radian."""
    view, _ = view_of([trial for trial in camera if trial.stage.name == joint])
    assert not any("zero" in warning for warning in view.warnings({}))


MOTOR = """<mujoco>
  <option timestep="0.002"/>
  <worldbody><body>
    <joint name="elbow" axis="0 1 0" frictionloss="{dry}" damping="0.001"/>
    <inertial pos="0 0 -0.05" mass="1" diaginertia="0.005 0.005 0.005"/>
  </body></worldbody>
  <actuator><motor name="servo" joint="elbow"/></actuator>
</mujoco>"""


@pytest.mark.prove
def test_friction_that_takes_most_of_a_motors_torque_is_named(tmp_path):
    """The model has 0.01 N m, so its motion needs a small part of the torque that was given."""
    t = np.arange(600) / 100

    def held(data, wanted):
        return 1.6 * (wanted - data.qpos) + 0.5 * np.sin(data.qpos)

    for number in range(2):
        turn = np.random.default_rng(number).uniform(0, 6, 2)
        wanted = 0.4 * np.sin(3 * t + turn[0]) + 0.3 * np.sin(1.3 * t + turn[1])
        simulate(MOTOR.format(dry=0.6), tmp_path / f"run-{number}.csv", wanted, control=held, read=encoder)
    (named,) = diagnose_table(tables.read(described_model(tmp_path, MOTOR.format(dry=0.01), "N m"))).verdict.effects
    assert named.name == "elbow.coulomb_friction"
    assert named.parameters["torque"].value == pytest.approx(0.6, abs=0.01)


@pytest.mark.prove
def test_an_effect_that_enlarges_the_held_out_gap_is_not_named(tmp_path):
    """A spring beside a payload and a bias of the command imitates a soft stop; alone it multiplies the gap."""
    stage = mechanism(tmp_path, "linkage", Truth({"crank": JointLaw(stop=0.25)}))
    verdict = diagnose_table(tables.read(stage)).verdict
    assert (verdict.verdict, verdict.effects) == ("unknown", ())


@pytest.mark.prove
def test_an_interval_allows_for_errors_of_the_model_beside_a_large_effect(tmp_path):
    """With half the stiffness, the errors of gain, damper and rotor act otherwise than in the model."""
    law = JointLaw(stiff=0.5, gain=0.985, viscous=1.015, armature=0.985)
    stage = mechanism(tmp_path, "gripper", Truth({"wrist": law}), seconds=6.0)
    (named,) = examine(of_joint(stage, "wrist")).named
    assert named.name == "wrist.position_gain"
    assert named.parameters["scale"].low < law.stiff - 1 < named.parameters["scale"].high
