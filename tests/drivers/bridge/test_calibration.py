"""Calibration of the cameras' coordinates from an arm at rest and a pushed cart."""

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
from softarm.drivers.bridge import written
from softarm.drivers.bridge.calibration import CalibrationError, Sample, calibrate, rest_shape
from softarm.drivers.bridge.frame import Plane, View, product
from softarm.drivers.bridge.gathering import Gathering, Phase
from softarm.drivers.bridge.natnet import Body
from softarm.schemas.bridge import Bridge, Marked, Marks, Room
from softarm.schemas.messages import BODY_NAMES, Pose

HINGE_M = 0.965
# Fewer frames than cameras take.
STEP_NS = 30_000_000


@dataclasses.dataclass
class Lab:
    """Robot in front of cameras. `markers` is the offset of the cart's markers from the first hinge.

    By body: `turns` is the rotation of its own axes, `called` its wrong name, `shift` its displacement along and up,
    `lost` the share of frames without it. `bump_m` is a deviation of the rail in its middle.
    """

    room: Room = Room(up="y", yaw_rad=0.6, tilt_rad=0.004, origin_m=(1.0, 0.02, -2.0))  # noqa: RUF009
    markers_m: tuple[float, float] = (0.01, 0.04)
    noise_m: float = 0.0003
    turns: dict = dataclasses.field(default_factory=dict)
    called: dict = dataclasses.field(default_factory=dict)
    shift: dict = dataclasses.field(default_factory=dict)
    lost: dict = dataclasses.field(default_factory=dict)
    straight: bool = False
    bump_m: float = 0.0
    seed: int = 1

    def __post_init__(self):
        self.random = np.random.default_rng(self.seed)
        self.plane = Plane(self.room)
        self.shape = rest_shape(self.straight)

    def poses(self, cart_m, swing_rad=0.0):
        """Return the bodies for a cart at y; `swing` is added to every angle."""
        poses = {}
        for name, rest in self.shape.items():
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
            bodies[self.called.get(name, name)] = Body(0, tuple(map(float, place)), turn, True)
        return Sample(t_ns, bodies)

    def rest(self, cart_m=0.05, seconds=3.0):
        return [self.sample(k * STEP_NS, cart_m) for k in range(round(1e9 * seconds / STEP_NS))]

    def push(self, *stops, begin=0.05):
        """Return samples from stop to stop at 0.3 m/s, with two seconds at the last."""
        way = [begin]
        for stop in stops:
            way += [way[-1]] * 5
            way += list(np.linspace(way[-1], stop, max(2, round(abs(stop - way[-1]) / 0.3 * 1e9 / STEP_NS))))
        way += [stops[-1]] * round(2e9 / STEP_NS)
        return [self.sample(k * STEP_NS, y, 0.2 * math.sin(0.2 * k)) for k, y in enumerate(way)]

    def found(self, **options):
        return calibrate(
            self.rest(), self.push(-0.3, 0.3), Marks(), **{"last_is_plus": True, "straight": self.straight} | options
        )

    def farthest(self, found):
        """Return the largest error of a pose after the calibration, m and rad."""
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


@settings(max_examples=6, deadline=None, derandomize=True, phases=[Phase_.generate, Phase_.explicit])
@given(labs)
def test_poses_are_recovered_within_two_millimetres(lab):
    found = lab.found()
    worst_m, worst_rad = lab.farthest(found)
    assert worst_m < 0.002
    assert worst_rad < 0.002
    assert found.room.up == lab.room.up
    assert found.travel_m == pytest.approx(0.6, abs=0.004)


def test_the_last_end_may_be_the_negative_one():
    lab = Lab(room=Room(up="z", yaw_rad=-2.0))
    found = calibrate(lab.rest(), lab.push(0.3, -0.3), Marks(), last_is_plus=False)
    assert lab.farthest(found)[0] < 0.001


def test_the_middle_may_be_the_position_at_rest():
    lab = Lab()
    found = calibrate(lab.rest(0.0), lab.push(0.25, begin=0.0), Marks(), last_is_plus=True, middle_here=True)
    assert lab.farthest(found)[0] < 0.001
    assert not [note for note in found.notes if "the cart went" in note]


def test_frames_in_which_the_cart_jumps_change_nothing():
    lab = Lab()
    push = lab.push(-0.3, 0.3)
    for k in range(0, len(push), 20):
        far = push[k].bodies["cart"]._replace(position_m=(5.0, 1.0, 2.0 + 0.01 * k))
        push[k] = push[k]._replace(bodies=dict(push[k].bodies) | {"cart": far})
    found = calibrate(lab.rest(), push, Marks(), last_is_plus=True)
    assert lab.farthest(found)[0] < 0.001


def test_a_link_may_be_omitted_and_names_and_ids_are_kept():
    lab = Lab(lost={"link2": 1.0})
    marks = Marks(cart=Marked(rigid_body="Wagen"), link2=None, link3=Marked(rigid_body=7))
    found = calibrate(lab.rest(), lab.push(-0.3, 0.3), marks, last_is_plus=True)
    assert (found.marks.cart.rigid_body, found.marks.link2, found.marks.link3.rigid_body) == ("Wagen", None, 7)
    assert lab.farthest(found)[0] < 0.001


@pytest.mark.parametrize(
    ("lab", "says"),
    [
        (Lab(lost={"link4": 1.0}), "link4 was never tracked at rest; name it in Motive"),
        (Lab(lost={"link4": 0.7}), r"link4 was tracked in \d\d % of the frames at rest"),
        (
            Lab(called={"link2": "link4", "link4": "link2"}),
            "link2 and link4 seem swapped: link4 is at the place of link2",
        ),
        (
            Lab(called={"link2": "link3", "link3": "link4", "link4": "link2"}),
            "the order from the top is cart, link1, link3, link4, link2, link5, expected cart, link1",
        ),
        (Lab(shift={"link2": (0.0, 0.03)}), "link1 and link2 are 0.058. m apart at rest, 0.0885 m expected"),
        (Lab(shift={"link2": (0.1, 0.0)}), r"link2 is \+1?\d\d mm away from the line of the others"),
        (Lab(room=Room(tilt_rad=0.03)), r"the rail rises by \+1.7 degrees towards \+y"),
        (
            Lab(bump_m=0.02),
            r"the rail is not straight: 0\.(29|3\d) m from the end where the push began .* \d mm sideways and \+1\d mm",
        ),
        (Lab(noise_m=0.01), "moves by .* mm, at most 4 mm allowed; wait until the arm is at rest"),
        (Lab(markers_m=(0.0, 0.4)), r"the cart's markers are -\d\d\d mm vertically from the first hinge"),
    ],
)
def test_a_problem_is_reported(lab, says):
    with pytest.raises(CalibrationError, match=says):
        lab.found()


@pytest.mark.parametrize(
    ("stops", "middle", "says"),
    [
        (
            (-0.1, 0.1),
            False,
            r"the cart moved 0.20 m, which is too short; push it 0.40 m or more from stop to stop \(0.60 m\)",
        ),
        ((0.1,), True, "push it 0.15 m or more$"),
        ((-0.5, 0.5), False, "the cart moved 1.00 m on a rail of 0.60"),
    ],
)
def test_an_invalid_push_is_reported(stops, middle, says):
    lab = Lab()
    with pytest.raises(CalibrationError, match=says):
        calibrate(lab.rest(0.0), lab.push(*stops, begin=0.0), Marks(), last_is_plus=True, middle_here=middle)


def test_a_leaning_arm_is_reported():
    lab = Lab()
    rest = [lab.sample(k, 0.0, 0.3) for k in range(100)]
    with pytest.raises(CalibrationError, match=r"the arm leans by 1[4-9] degrees from the cameras' vertical"):
        calibrate(rest, lab.push(-0.3, 0.3), Marks(), last_is_plus=True)


def test_tolerated_deviations_are_noted():
    lab = Lab(room=Room(origin_m=(0.0, -0.07, 0.0)), shift={"link3": (0.0, 0.012), "link4": (0.02, 0.0)})
    found = calibrate(lab.rest(), lab.push(-0.25, 0.25), Marks(), last_is_plus=True)
    notes = "\n".join(found.notes)
    assert "the cart moved 0.50" in notes
    assert "the rail has 0.60 m: the middle is right only if both ends were the stops" in notes
    assert "the cameras' ground plane is 0.070 m above the floor" in notes
    assert "link2-link3 are 0.076" in notes
    assert "link4 is +20 mm away from its nominal place" in notes


@pytest.mark.slow
def test_the_shape_at_rest_is_the_simulators():
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
def test_the_written_file_can_be_read(config):
    lab = Lab(room=Room(origin_m=(0.0, -0.07, 0.0)), lost={"link1": 1.0} if config.bodies.link1 is None else {})
    found = calibrate(lab.rest(), lab.push(-0.3, 0.3), config.bodies, last_is_plus=True)
    whole = written.configuration(config, "192.168.1.10", found)
    text = written.text(whole, found, date(2026, 11, 23))
    assert fit(parse(text, "bridge.yaml"), Bridge) == whole
    assert whole.server == "192.168.1.10"
    assert "-0.0," not in text
    assert "-0.0}" not in text
    assert "# Note: the cameras' ground plane is 0.07" in text
    assert max(map(len, text.splitlines())) < 220
    assert lab.farthest(dataclasses.replace(found, room=whole.room, marks=whole.bodies))[0] < 0.001


# What is gathered


def gathered(samples, middle_here=False, gathering=None):
    gathering = gathering or Gathering(BODY_NAMES, middle_here)
    begin = getattr(gathering, "clock", 0)
    for k, sample in enumerate(samples):
        gathering.add(begin + k * STEP_NS, sample.bodies)
    gathering.clock = begin + len(samples) * STEP_NS
    return gathering


def test_the_recording_waits_for_rest_and_ends_at_the_last_end():
    lab = Lab()
    swinging = [lab.sample(0, 0.05, 0.2 * math.sin(0.2 * k)) for k in range(200)]
    gathering = gathered(swinging)
    assert gathering.phase is Phase.RESTING
    assert gathering.motion_m() > 0.05
    gathered(lab.rest(seconds=3.5), gathering=gathering)
    assert gathering.phase is Phase.PUSHING
    assert len(gathering.rest) == 101
    gathered(lab.push(-0.3), gathering=gathering)
    assert gathering.phase is Phase.PUSHING
    gathered(lab.push(0.3, begin=-0.3), gathering=gathering)
    assert gathering.phase is Phase.DONE
    assert gathering.push_m() == pytest.approx(0.6, abs=0.01)
    found = calibrate(gathering.rest, gathering.push, Marks(), last_is_plus=True)
    assert lab.farthest(found)[0] < 0.001


def test_a_pause_of_the_frames_is_no_rest_of_the_cart():
    lab = Lab()
    way = lab.push(0.3, begin=-0.3)
    gathering = gathered([*lab.rest(seconds=3.5), *lab.push(-0.3), *way[:66]])
    gathering.clock += 3_000_000_000
    gathered(way[66:67], gathering=gathering)
    assert gathering.phase is Phase.PUSHING


def test_from_the_middle_a_push_to_one_end_suffices():
    lab = Lab()
    gathering = gathered([*lab.rest(0.0, 3.5), *lab.push(0.25, begin=0.0)], middle_here=True)
    assert gathering.phase is Phase.DONE


def test_a_body_without_tracking_is_reported_while_waiting():
    lab = Lab(lost={"link3": 1.0})
    gathering = gathered(lab.rest(seconds=5))
    assert gathering.phase is Phase.RESTING
    assert gathering.missing() == ("link3",)
    gathering.finish()
    with pytest.raises(CalibrationError, match="link3 was never tracked at rest"):
        calibrate(gathering.rest, gathering.push, Marks(), last_is_plus=True)
