"""A room is found again from what cameras saw of an arm at rest and of a cart that was pushed."""

import dataclasses
import math
from datetime import date

import numpy as np
import pytest
from hypothesis import Phase as Phase_
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.common.yaml_lines import parse
from softarm.common.yaml_schema import fit
from softarm.drivers.bridge import calibration, written
from softarm.drivers.bridge.calibration import CalibrationError, Sample, calibrate, rest_shape
from softarm.drivers.bridge.frame import Plane, View, product
from softarm.drivers.bridge.gathering import Gathering, Phase
from softarm.drivers.bridge.natnet import Body
from softarm.schemas.bridge import Bridge, Marked, Marks, Room
from softarm.schemas.messages import BODY_NAMES, Pose

HINGE_M = 0.965
STEP_NS = 30_000_000  # fewer frames than cameras take


@dataclasses.dataclass
class Lab:
    """A robot in a room. markers: of the cart, beside and above the first hinge."""

    room: Room = Room(up="y", yaw_rad=0.6, tilt_rad=0.004, origin_m=(1.0, 0.02, -2.0))  # noqa: RUF009
    markers_m: tuple[float, float] = (0.01, 0.04)
    noise_m: float = 0.0003
    turns: dict = dataclasses.field(default_factory=dict)  # body -> how its own axes were made
    called: dict = dataclasses.field(default_factory=dict)  # body -> what it is taken for
    shift: dict = dataclasses.field(default_factory=dict)  # body -> where it hangs too far along and up
    lost: dict = dataclasses.field(default_factory=dict)  # body -> share of frames
    straight: bool = False
    bump_m: float = 0.0  # of the rail, in its middle
    seed: int = 1

    def __post_init__(self):
        self.random = np.random.default_rng(self.seed)
        self.plane = Plane(self.room)

    def poses(self, cart_m, swing_rad=0.0):
        """The arm under a cart at y; swing: added to every angle."""
        poses = {}
        for name, rest in rest_shape(self.straight).items():
            far = math.hypot(rest.y_m, rest.z_m)
            way = math.atan2(rest.y_m, -rest.z_m) + swing_rad
            angle = 0.0 if name == "cart" else rest.angle_rad + swing_rad
            poses[name] = Pose(cart_m + far * math.sin(way), HINGE_M - far * math.cos(way), angle)
        return poses

    def sample(self, t_ns, cart_m, swing_rad=0.0):
        bodies = {}
        for name, pose in self.poses(cart_m, swing_rad).items():
            if self.random.random() < self.lost.get(name, 0.0):
                continue
            y, z = pose.y_m, pose.z_m
            if name == "cart":
                y, z = y + self.markers_m[0], z + self.markers_m[1] + self.bump_m * math.exp(-((cart_m / 0.05) ** 2))
            along, up = self.shift.get(name, (0.0, 0.0))
            place = np.array(self.plane.point(y + along, z + up)) + self.noise_m * self.random.standard_normal(3)
            noise = self.plane.turn(2 * self.noise_m * self.random.standard_normal())
            turn = product(product(noise, self.plane.turn(pose.angle_rad)), self.turns.get(name, (0.0, 0.0, 0.0, 1.0)))
            bodies[self.called.get(name, name)] = Body(0, tuple(map(float, place)), turn, 0.0, True)
        return Sample(t_ns, bodies)

    def rest(self, cart_m=0.05, seconds=3.0):
        return [self.sample(k * STEP_NS, cart_m) for k in range(round(1e9 * seconds / STEP_NS))]

    def push(self, *stops, begin=0.05):
        """From stop to stop at 0.3 m/s, two seconds at the last."""
        way = [begin]
        for stop in stops:
            way += [way[-1]] * 5  # nobody turns on the spot
            way += list(np.linspace(way[-1], stop, max(2, round(abs(stop - way[-1]) / 0.3 * 1e9 / STEP_NS))))
        way += [stops[-1]] * round(2e9 / STEP_NS)
        return [self.sample(k * STEP_NS, y, 0.2 * math.sin(0.2 * k)) for k, y in enumerate(way)]

    def found(self, **options):
        return calibrate(
            self.rest(), self.push(-0.3, 0.3), Marks(), **{"last_is_plus": True, "straight": self.straight} | options
        )

    def farthest(self, found):
        """How wrong a pose is at worst after the calibration (m, rad)."""
        view, quiet = View(found.room, found.marks), dataclasses.replace(self, noise_m=0.0, lost={})
        worst_m = worst_rad = 0.0
        for cart_m, swing in ((-0.3, 0.5), (0.0, 0.0), (0.3, -0.7)):
            shown, there = quiet.sample(0, cart_m, swing).bodies, quiet.poses(cart_m, swing)
            for name, pose in there.items():
                if getattr(found.marks, name) is None:
                    continue
                seen = view.pose(shown[name], getattr(found.marks, name))
                worst_m = max(worst_m, math.dist(seen[:2], pose[:2]))
                worst_rad = max(worst_rad, abs(seen.angle_rad - pose.angle_rad) if name != "cart" else 0.0)
        return worst_m, worst_rad


unit = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.3)
turns = unit.map(lambda q: tuple(part / math.hypot(*q) for part in q))
number = st.floats(-3.0, 3.0)
labs = st.builds(
    Lab,
    room=st.builds(
        Room,
        up=st.sampled_from(["y", "z"]),
        yaw_rad=st.floats(-math.pi, math.pi),
        tilt_rad=st.floats(-0.019, 0.019),
        origin_m=st.tuples(number, number, number),
    ),
    markers_m=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.1)),
    noise_m=st.floats(0.0, 0.0005),
    turns=st.fixed_dictionaries(dict.fromkeys(BODY_NAMES, turns)),
    straight=st.booleans(),
    seed=st.integers(0, 1000),
)


@settings(max_examples=12, deadline=None, derandomize=True, phases=[Phase_.generate, Phase_.explicit])
@given(labs)
@pytest.mark.slow
def test_whatever_the_room_poses_come_back_within_two_millimetres(lab):
    found = lab.found()
    worst_m, worst_rad = lab.farthest(found)
    assert worst_m < 0.002
    assert worst_rad < 0.002
    assert found.room.up == lab.room.up
    assert found.travel_m == pytest.approx(0.6, abs=0.004)


def test_the_sense_is_that_of_the_last_end():
    lab = Lab(room=Room(up="z", yaw_rad=-2.0))
    assert lab.farthest(lab.found())[0] < 0.001
    other = calibrate(lab.rest(), lab.push(0.3, -0.3), Marks(), last_is_plus=False)
    assert lab.farthest(other)[0] < 0.001


def test_the_middle_may_be_where_the_cart_hangs():
    lab = Lab()
    found = calibrate(lab.rest(0.0), lab.push(0.25, begin=0.0), Marks(), last_is_plus=True, middle_here=True)
    assert lab.farthest(found)[0] < 0.001
    assert not [note for note in found.notes if "the cart went" in note]


def test_frames_in_which_the_cart_jumps_change_nothing():
    lab = Lab()
    push = lab.push(-0.3, 0.3)
    for k in range(0, len(push), 20):  # a reflection, or another body
        far = push[k].bodies["cart"]._replace(position_m=(5.0, 1.0, 2.0 + 0.01 * k))
        push[k] = push[k]._replace(bodies=dict(push[k].bodies) | {"cart": far})
    found = calibrate(lab.rest(), push, Marks(), last_is_plus=True)
    assert lab.farthest(found)[0] < 0.001


def test_a_link_that_is_left_out_is_left_out():
    lab = Lab(lost={"link2": 1.0})
    found = calibrate(lab.rest(), lab.push(-0.3, 0.3), Marks(link2=None), last_is_plus=True)
    assert found.marks.link2 is None
    assert list(found.spacing_m) == ["link1-link3", "link3-link4", "link4-link5"]


def test_names_and_ids_of_the_rigid_bodies_are_kept():
    marks = Marks(cart=Marked(rigid_body="Wagen"), link3=Marked(rigid_body=7))
    lab = Lab()
    found = calibrate(lab.rest(), lab.push(-0.3, 0.3), marks, last_is_plus=True)
    assert (found.marks.cart.rigid_body, found.marks.link3.rigid_body) == ("Wagen", 7)


@pytest.mark.parametrize(
    ("lab", "says"),
    [
        (Lab(lost={"link4": 1.0}), "link4 was never seen at rest; name it in Motive"),
        (Lab(lost={"link4": 0.7}), r"link4 was seen in \d\d % of the frames at rest"),
        (
            Lab(called={"link2": "link4", "link4": "link2"}),
            "link2 and link4 seem swapped: link4 hangs where link2 should",
        ),
        (
            Lab(called={"link2": "link3", "link3": "link4", "link4": "link2"}),
            "from the top hang cart, link1, link3, link4, link2, link5, which should be cart, link1",
        ),
        (Lab(shift={"link2": (0.0, 0.03)}), "link1 and link2 hang 0.058. m apart at rest, not 0.0885"),
        (Lab(shift={"link2": (0.1, 0.0)}), r"link2 hangs \+1?\d\d mm beside the others"),
        (Lab(room=Room(tilt_rad=0.03)), r"the rail rises by \+1.7 degrees towards \+y"),
        (Lab(bump_m=0.03), "the rail is not straight: .* in height"),
        (Lab(noise_m=0.01), "moves by .* mm; wait until the arm hangs still"),
        (Lab(markers_m=(0.0, 0.4)), r"the cart's markers are -\d\d\d mm in height of the first hinge"),
    ],
)
def test_what_is_wrong_is_named(lab, says):
    with pytest.raises(CalibrationError, match=says):
        lab.found()


def test_a_bump_is_told_with_its_place():
    lab = Lab(bump_m=0.02)
    with pytest.raises(
        CalibrationError, match=r"0\.(29|3\d) m from the end where the push began .* \d mm aside and \+1\d mm in height"
    ):
        lab.found()


@pytest.mark.parametrize(
    ("stops", "middle", "says"),
    [
        (
            (-0.1, 0.1),
            False,
            r"the cart went 0.20 m, which is too short; push it 0.40 m or more from stop to stop \(0.60 m\)",
        ),
        ((0.1,), True, "push it 0.15 m or more$"),
        ((-0.5, 0.5), False, "the cart went 1.00 m on a rail of 0.60"),
    ],
)
def test_a_push_that_is_none_is_told(stops, middle, says):
    lab = Lab()
    with pytest.raises(CalibrationError, match=says):
        calibrate(lab.rest(0.0), lab.push(*stops, begin=0.0), Marks(), last_is_plus=True, middle_here=middle)


def test_an_arm_that_leans_is_told():
    lab = Lab()
    rest = [lab.sample(k, 0.0, 0.3) for k in range(100)]
    with pytest.raises(CalibrationError, match=r"the arm leans by 1[4-9] degrees from the cameras' up"):
        calibrate(rest, lab.push(-0.3, 0.3), Marks(), last_is_plus=True)


def test_what_is_odd_but_no_hindrance_is_noted():
    lab = Lab(room=Room(origin_m=(0.0, -0.07, 0.0)), shift={"link3": (0.0, 0.012), "link4": (0.02, 0.0)})
    found = calibrate(lab.rest(), lab.push(-0.25, 0.25), Marks(), last_is_plus=True)
    told = "\n".join(found.notes)
    assert "the cart went 0.50" in told
    assert "the rail has 0.60: the middle is right if both ends were its stops" in told
    assert "the cameras' ground plane lies 0.070 m above the floor" in told
    assert "link2-link3 hang 0.076" in told
    assert "link4 hangs +20 mm beside where it should" in told


@pytest.mark.slow
def test_the_arm_hangs_as_the_simulator_has_it():
    from softarm.drivers.bodies.simulated import SimulatedBody

    body = SimulatedBody()
    for _ in range(300):
        body.step(0.0, 0.0, 33_333_333)
    for pose, rest in zip(body.frames()[-1].bodies, rest_shape().values(), strict=True):
        assert pose[:3] == pytest.approx((rest.y_m, HINGE_M + rest.z_m, rest.angle_rad), abs=3e-4)
    assert [each.y_m for each in rest_shape(straight=True).values()] == [0.0] * 6


@pytest.mark.parametrize(
    "config", [Bridge(), Bridge(command_port=1600, received_after_s=0.004, bodies=Marks(link1=None))]
)
def test_what_is_written_is_read_again(config):
    lab = Lab(room=Room(origin_m=(0.0, -0.07, 0.0)), lost={"link1": 1.0} if config.bodies.link1 is None else {})
    found = calibrate(lab.rest(), lab.push(-0.3, 0.3), config.bodies, last_is_plus=True)
    whole = written.configuration(config, "192.168.1.10", found)
    text = written.text(whole, found, date(2026, 11, 23))
    assert fit(parse(text, "bridge.yaml"), Bridge) == whole
    assert whole.server == "192.168.1.10"
    assert "-0.0," not in text
    assert "-0.0}" not in text
    assert "# Odd: the cameras' ground plane lies 0.07" in text
    assert max(map(len, text.splitlines())) < 220
    assert lab.farthest(dataclasses.replace(found, room=whole.room, marks=whole.bodies))[0] < 0.001


# What is gathered


def gathered(samples, middle_here=False, gathering=None):
    gathering = gathering or Gathering(BODY_NAMES, middle_here)
    begin = getattr(gathering, "clock", 0)
    for k, sample in enumerate(samples):
        gathering.see(begin + k * STEP_NS, sample.bodies)
    gathering.clock = begin + len(samples) * STEP_NS
    return gathering


def test_it_waits_for_the_rest_and_ends_when_the_cart_stands_at_its_last_end():
    lab = Lab()
    swinging = [lab.sample(0, 0.05, 0.2 * math.sin(0.2 * k)) for k in range(200)]
    gathering = gathered(swinging)
    assert gathering.phase is Phase.RESTING
    assert gathering.moves_m() > 0.05
    gathered(lab.rest(seconds=3.5), gathering=gathering)
    assert gathering.phase is Phase.PUSHING
    assert len(gathering.rest) == 101
    gathered(lab.push(-0.3), gathering=gathering)  # stands there for long: half of a push
    assert gathering.phase is Phase.PUSHING
    gathered(lab.push(0.3, begin=-0.3), gathering=gathering)
    assert gathering.phase is Phase.DONE
    assert gathering.gone_m() == pytest.approx(0.6, abs=0.01)
    found = calibrate(gathering.rest, gathering.push, Marks(), last_is_plus=True)
    assert lab.farthest(found)[0] < 0.001


def test_from_the_middle_a_push_to_one_end_will_do():
    lab = Lab()
    gathering = gathered([*lab.rest(0.0, 3.5), *lab.push(0.25, begin=0.0)], middle_here=True)
    assert gathering.phase is Phase.DONE


def test_a_body_that_is_not_seen_is_named_while_it_waits():
    lab = Lab(lost={"link3": 1.0})
    gathering = gathered(lab.rest(seconds=5))
    assert gathering.phase is Phase.RESTING
    assert gathering.missing() == ("link3",)
    gathering.break_off()
    with pytest.raises(CalibrationError, match="link3 was never seen at rest"):
        calibrate(gathering.rest, gathering.push, Marks(), last_is_plus=True)


def test_all_figures_are_those_of_the_model():
    assert calibration.HINGE_Z_M == HINGE_M
    assert calibration.depth("link5") == pytest.approx(5 * 0.0885)
