"""Effects of the whole mechanism, which one joint alone cannot separate from its own."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import yaml

from softarm.diagnosis.data import tables
from softarm.diagnosis.engine.candidates import Nuisance
from softarm.diagnosis.rigs import whole
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.mjcf.links import PLACE
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from softarm.diagnosis.rigs.mjcf.patch import patched
from softarm.diagnosis.rigs.mjcf.view import JointView
from softarm.diagnosis.rigs.stage import examine
from softarm.diagnosis.rigs.subsample import together
from softarm.diagnosis.rigs.whole import FEW, judged
from softarm.schemas.verdict import Interval
from tests.diagnosis.rigs.recordings import mechanism, of_joint
from validation.mechanisms.record import ROBOTS, JointLaw, Truth

LOAD = 0.6  # share of the last body's mass


def by_joint(folder, robot, truth, seconds=3.0, item=None):
    """Return the trials of each joint of a recorded robot; item: as in `recordings.mechanism`."""
    own = {}
    for trial in tables.read(mechanism(folder, robot, truth, seconds, item)):
        own.setdefault(trial.stage.name, []).append(trial)
    return own


def shown(own, **names):
    """Return findings of joints on their own; names: the effects of each joint that explain its gap equally."""
    found = {}
    for joint, (name, *others) in names.items():
        view = JointView(own[joint][:1])  # one recording shows which effects there are
        effect = SimpleNamespace(name=f"{joint}.{name}", equivalents=tuple(f"{joint}.{each}" for each in others))
        found[joint] = SimpleNamespace(
            answer=SimpleNamespace(stage=joint),
            decision=SimpleNamespace(kind="named"),
            is_unexplained=False,
            fitted=(effect.name,),
            named=(effect,),
            vocabulary=view.vocabulary,
            whole={each: view.part(each) for each in view.whole},
            assumed={},
        )
    return found


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """A camera that is heavier than its model, by an item at the centre of its mass."""
    return by_joint(tmp_path_factory.mktemp("loaded"), "camera", Truth({}, load=LOAD))


@pytest.fixture(scope="module")
def shank(tmp_path_factory):
    """A leg with a lighter shank than its model."""
    return by_joint(tmp_path_factory.mktemp("shank"), "leg", Truth({}, masses={"shank": 2.2}), seconds=1.5)


@pytest.fixture(scope="module")
def payload(loaded):
    """Judgement of both joints of the loaded camera."""
    (found,) = judged(loaded, shown(loaded, pan=("payload",), tilt=("mass", "payload", "gain")))
    return found


def test_a_joint_with_a_gap_without_a_cause_says_nothing_about_a_common_effect(loaded):
    """Six joints of a real arm, each with several effects and a rest, took four minutes to contradict a payload."""
    found = shown(loaded, pan=("damping",), tilt=("payload",))
    found["pan"].is_unexplained = True
    assert judged(loaded, found) == []


@pytest.mark.slow
def test_recordings_in_which_a_joint_stands_still_do_not_count(loaded):
    names = shown(loaded, pan=("payload",), tilt=("payload",))
    (without,) = judged({"pan": loaded["pan"][1:], "tilt": loaded["tilt"]}, names)
    (both,) = judged({joint: trials[1:] for joint, trials in loaded.items()}, names)
    assert without == both
    assert judged({"pan": loaded["pan"][:1], "tilt": loaded["tilt"][1:]}, names) == []


def kg_of(share):
    """Return a share of the camera's mass, kg."""
    return share * mujoco.MjModel.from_xml_path(str(ROBOTS["camera"].model)).body("camera").mass[0]


@pytest.mark.slow
def test_joints_that_a_payload_loads_have_it_in_one_size_without_rivals(payload):
    """The tilt axis alone takes it for a heavier body or a weaker motor as well."""
    assert payload.text == "pan, tilt: one payload explains the gap, with one size for all joints"
    assert [held.named.shared_by for held in payload.held.values()] == [("pan", "tilt")] * 2
    pan, tilt = payload.held["pan"], payload.held["tilt"]
    assert pan.sizes == tilt.sizes
    assert (pan.named.name, pan.named.equivalents) == ("pan.payload", ())
    assert (tilt.named.name, tilt.named.equivalents) == ("tilt.payload", ())
    mass = pan.named.parameters["mass"]
    assert mass.low <= kg_of(LOAD) <= mass.high
    assert mass.value == pytest.approx(kg_of(LOAD), rel=0.1)
    assert pan.named.shrink.stage.value > 0.7
    assert tilt.named.shrink.stage.value > 0.7


@pytest.mark.prove
def test_a_payload_beside_the_line_of_its_link_has_its_mass_and_place(tmp_path):
    """On the line through the last joint and the centre of mass, it would be a third heavier."""
    item, place = 0.3, np.array([0.05, 0.09, -0.06])
    own = by_joint(tmp_path, "camera", Truth({}), item=("camera", place, item))
    (found,) = judged(own, shown(own, pan=("payload",), tilt=("payload",)))
    sizes = found.held["pan"].named.parameters
    assert sizes["mass"].low < item < sizes["mass"].high
    assert sizes["mass"].high - sizes["mass"].low < 0.5 * item
    link = Mechanism(tmp_path / "robot.xml").last_link(Mechanism(tmp_path / "robot.xml").joint("pan"))
    at = [sizes[axis].value for axis in PLACE]
    assert link.place(at) == pytest.approx(place, abs=0.02)


def test_a_load_across_a_link_that_no_joint_alone_explains_is_found_by_all_together(tmp_path):
    """A pole on a cart hangs at an angle. Where many effects were found, the search would take long."""
    item, place = 0.1, np.array([0.2, 0.0, -0.2])
    own = by_joint(tmp_path, "cartpole", Truth({}), seconds=2.0, item=("pole", place, item))
    alone = shown(own, rail=("gain",), hinge=("spring",))

    def judged_beside(effects):
        for stage, finding in alone.items():
            finding.decision.kind, finding.is_unexplained, finding.named = "unknown", True, ()
            finding.fitted = tuple(f"{stage}.effect{k}" for k in range(effects))
        return judged(own, alone)

    assert judged_beside(FEW + 1) == []
    (found,) = judged_beside(FEW)
    assert sorted(found.held) == ["hinge", "rail"]
    mass = found.held["hinge"].named.parameters["mass"]
    assert 0 < mass.low < item < mass.high


@pytest.mark.slow
def test_a_payload_beside_the_axis_of_the_last_joint_loads_it_as_well(tmp_path):
    """Along that axis it does not, so the joint alone takes it for an error of its servo."""
    item, place = 0.3, (0.0, 0.08, -0.1)
    stage = mechanism(tmp_path, "drone", Truth({}), seconds=1.5, item=("tool", place, item))
    own = {joint: of_joint(stage, joint) for joint in ("elbow", "twist")}
    (found,) = judged(own, shown(own, elbow=("payload",), twist=("command_bias",)))
    assert [held.named.name for held in found.held.values()] == ["elbow.payload", "twist.payload"]
    for held in found.held.values():
        assert held.named.shared_by == ("elbow", "twist")
        assert held.named.parameters["mass"].low < item < held.named.parameters["mass"].high

    sizes = {name: size.value for name, size in found.held["twist"].sizes.items()}
    stage.write_text(stage.read_text() + yaml.safe_dump({"effects": {"twist.payload": sizes}}))
    with_it, without = (JointView(trials).gap([{}]) for trials in (of_joint(stage, "twist"), own["twist"]))
    assert np.nanstd(with_it) < 0.3 * np.nanstd(without)


def test_one_heavier_body_is_named_at_all_joints_that_it_loads(shank):
    """Each joint alone takes it for another mass or length of all that it moves."""
    (found,) = judged(shank, shown(shank, hip=("mass",), knee=("length",), ankle=("damping",)))
    assert {stage: held.effect for stage, held in found.held.items()} == {"hip": "mass_shank", "knee": "mass_shank"}
    for held in found.held.values():
        assert held.named.shared_by == ("hip", "knee")
        size = held.named.parameters["scale"]
        assert 0 < size.low < 1.2 < size.high


@pytest.mark.prove
def test_a_body_that_all_joints_leave_open_is_listed_beside_the_effect_of_one_joint(tmp_path):
    """The wrist of a gripper with a finger of 1.88 times its mass had been a heavier hand, with a confidence."""
    own = by_joint(tmp_path, "gripper", Truth({}, masses={"left": 1.88}))
    found = shown(own, wrist=("mass", "length"), left=("damping",))
    found["left"].named, found["left"].decision.kind = (), "none"
    (judgement,) = judged(own, found)
    assert (judgement.effect, judgement.held) == ("mass_left", {})
    assert judgement.alike == {"wrist": ["wrist.mass"]}
    assert judgement.text == "the recordings cannot separate mass of left from wrist.mass"
    found["wrist"].named[0].equivalents = ("wrist.mass_left",)
    assert judged(own, found) == []  # the wrist's own answer lists it


@pytest.mark.prove
def test_a_heavier_body_is_no_payload_though_one_joint_alone_shows_it(tmp_path):
    """The others have too little of it on their own: an arm's wrist, 79 % heavier, was a payload at its end."""
    own = by_joint(tmp_path, "leg", Truth({}, masses={"shank": 2.2}))
    found = judged(own, shown(own, hip=("payload", "mass"), knee=("damping",), ankle=("damping",)))
    named = {held.effect for each in found for held in each.held.values() if held.named is not None}
    assert named == {"mass_shank"}
    assert any("payload alone would explain the gap, but" in each.text for each in found)


@pytest.mark.prove
def test_a_heavier_last_body_is_no_payload(tmp_path):
    """A point mass at the foot's centre lacks its inertia; beside it, the ankle had five wrong numbers."""
    own = by_joint(tmp_path, "leg", Truth({}, masses={"foot": 1.7}))
    (found,) = judged(own, shown(own, hip=("payload",), knee=("payload",), ankle=("mass", "payload")))
    assert {held.effect for held in found.held.values()} == {"mass_foot"}
    for held in found.held.values():
        assert held.named.shared_by == ("ankle", "hip", "knee")
        assert held.named.parameters["scale"].low < 0.7 < held.named.parameters["scale"].high


@pytest.mark.prove
@pytest.mark.parametrize(
    ("robot", "item", "names"),
    [
        ("leg", None, {"hip": ("mass",), "knee": ("damping",), "ankle": ("damping",)}),
        ("gripper", ("palm", [0.0, 0.0, -0.1], 0.2), {"wrist": ("payload",), "left": ("damping",)}),
    ],
    ids=["mass of one joint", "item on the palm"],
)
def test_a_load_that_one_joint_alone_shows_is_no_common_effect(tmp_path, robot, item, names):
    """An item on the palm does not load the fingers."""
    own = by_joint(tmp_path, robot, Truth({}), seconds=2.0, item=item)
    assert judged(own, shown(own, **names)) == []


@pytest.mark.prove
def test_a_light_joint_does_not_hold_a_large_payload_near_zero(loaded, monkeypatch):
    """A usual payload of a wrist is a hundredth of an arm's."""
    own = whole.candidate

    def light(view, effect):
        found = own(view, effect)
        if effect.name != "tilt.payload":
            return found
        mass, *place = found.parameters
        return replace(found, parameters=(replace(mass, size=mass.size / 300), *place))

    monkeypatch.setattr(whole, "candidate", light)
    (found,) = judged(loaded, shown(loaded, pan=("payload",), tilt=("mass", "payload", "gain")))
    assert found.held["pan"].named.parameters["mass"].value == pytest.approx(kg_of(LOAD), rel=0.1)


@pytest.mark.prove
def test_a_small_budget_decides_on_the_same_stretches_of_all_joints(loaded, monkeypatch):
    used = []
    monkeypatch.setattr(whole, "together", lambda *given: used.append(together(*given)) or used[-1])
    (found,) = judged(loaded, shown(loaded, pan=("payload",), tilt=("mass", "payload", "gain")), budget_s=0.3)
    ((stretches, of, share),) = used
    pan, tilt = ([trial.channels["measured"].t_s.tolist() for trial in each.trials] for each in stretches)
    assert pan == tilt
    assert len(stretches[0].trials) < of
    assert share < 0.8
    assert found.held["tilt"].named.parameters["mass"].value == pytest.approx(kg_of(LOAD), rel=0.15)


def test_beside_a_heavier_body_all_masses_together_are_no_cause(shank):
    """They would correct what the law of one body leaves: a hip had 4 % less of all masses beside it."""
    view = JointView(shank["hip"][:1])
    assert "hip.mass" in {each.name for each in candidates(view)}
    view.hold("mass_shank", {})
    assert "hip.mass" in {each.name for each in candidates(view)}
    view.hold("mass_shank", {"scale": Interval(value=0.8, low=0.7, high=0.9)})
    assert "hip.mass" not in {each.name for each in candidates(view)}
    assert "hip.mass.scale" in {each.path for each in nuisances(view)}


@pytest.mark.slow
def test_a_joint_with_a_held_payload_has_no_gap_left(loaded, payload):
    found = examine(loaded["tilt"], [payload.held["tilt"]])
    assert found.decision.kind == "named"
    assert [effect.name for effect in found.named] == ["tilt.payload"]
    assert found.answer.after < 0.3 * found.answer.before
    assert found.answer.total_shrink.value > 0.7


@pytest.mark.prove
def test_a_tilted_base_that_two_planar_joints_show_is_one(tmp_path):
    """Each joint alone cannot separate it from a torque or a wrong zero."""
    own = by_joint(tmp_path, "cartpole", Truth({}, tilt_rad=(0.0, 0.04)))
    (found,) = judged(own, shown(own, rail=("torque_offset", "tilt"), hinge=("sensor_bias", "tilt")))
    assert [held.named.name for held in found.held.values()] == ["hinge.tilt", "rail.tilt"]
    (tilt,) = found.held["rail"].named.parameters.values()
    assert tilt.low <= 0.04 <= tilt.high


@pytest.mark.prove
def test_a_torque_on_one_joint_is_no_tilted_base_if_the_other_joint_hangs_straight(tmp_path):
    own = by_joint(tmp_path, "cartpole", Truth({"rail": JointLaw(torque=1.5)}))
    (found,) = judged(own, shown(own, rail=("torque_offset", "tilt"), hinge=("damping",)))
    assert found.text == "rail: tilt alone would explain the gap, but the motion of hinge contradicts it"
    (held,) = found.held.values()
    assert (held.effect, held.sizes, held.named) == ("tilt", {}, None)
    view = JointView(own["rail"])
    assert ("rail.tilt",) in view.indistinguishable.values()
    view.hold("tilt", {})
    assert ("rail.tilt",) not in view.indistinguishable.values()
    assert "rail.tilt" not in {effect.name for effect in view.effects}


def test_an_effect_that_one_joint_alone_shows_is_not_judged(loaded):
    pan = {"pan": loaded["pan"]}
    assert list(judged(pan, shown(pan, pan=("payload",)))) == []
    assert list(judged(loaded, shown(loaded, pan=("damping",), tilt=("gain",)))) == []


def diagnosed(folder, robot, truth, seconds=5.0):
    """Return the verdict on a recorded robot."""
    return diagnose_table(tables.read(mechanism(folder, robot, truth, seconds))).verdict


@pytest.mark.prove
def test_one_payload_is_named_at_every_joint_and_patched_once(tmp_path):
    verdict = diagnosed(tmp_path, "camera", Truth({}, load=LOAD))
    assert verdict.verdict == "named"
    assert {e.name: e.equivalents for e in verdict.effects} == {"pan.payload": (), "tilt.payload": ()}
    pan, tilt = (effect.parameters for effect in verdict.effects)
    assert pan == tilt
    for joint in ("pan", "tilt"):
        assert verdict.gap.after[joint].value < 0.3 * verdict.gap.before[joint].value
    assert any("pan, tilt: one payload explains the gap" in text for text in verdict.warnings)
    model = mujoco.MjModel.from_xml_string(patched(tmp_path / "robot.xml", verdict, calibration=True).text)
    assert model.body("camera_payload").mass[0] == pytest.approx(pan["mass"].value, rel=1e-5)


@pytest.mark.prove
def test_an_eccentric_encoder_gives_no_confident_name(tmp_path):
    """A crank's reading is wrong by a sine of its angle; three effects of the joint explain it together."""
    verdict = diagnosed(tmp_path, "linkage", Truth({"crank": JointLaw(bent=0.03)}), seconds=4.0)
    assert len(verdict.effects) > 2
    assert all(effect.confidence is None for effect in verdict.effects)


def test_a_shared_tolerance_has_the_parameters_of_all_joints(monkeypatch):
    paths = {"pan": ["pan.tilt.x"], "tilt": ["tilt.tilt.x", "tilt.tilt.y", "tilt.mass.scale"]}
    monkeypatch.setattr(whole, "nuisances", lambda joint: [Nuisance(path, 0.0, -1.0, 1.0) for path in paths[joint]])
    found = whole.tolerated(["pan", "tilt"], {("tilt", "base"): ["pan", "tilt"]}, {"pan.tilt", "tilt.tilt"})
    assert [n.path for n in found] == ["tilt.mass.scale", "base.tilt.x", "base.tilt.y"]


@pytest.mark.prove
def test_an_answer_has_a_body_that_the_recordings_cannot_separate_from_a_joints_effect(tmp_path):
    trials = tables.read(mechanism(tmp_path, "gripper", Truth({}, masses={"left": 1.88}), 12.0))
    verdict = diagnose_table(trials).verdict
    (effect,) = verdict.effects
    assert "wrist.mass_left" in (effect.name, *effect.equivalents)
    if effect.name != "wrist.mass_left":
        assert f"the recordings cannot separate mass of left from {effect.name}" in verdict.warnings
