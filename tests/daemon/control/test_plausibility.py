"""Plausibility of motion capture frames: faults are named within a few frames, healthy robots never."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from softarm.daemon.control.plausibility import FEW, Plausibility, is_usable
from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame, Pose
from softarm.schemas.model import Model
from tests.daemon.rig import BangBang

FRAME_NS = 8_333_333
HINGE_M = 0.965


def cameras(rng=None):
    """Yield frames of a swing at 120 Hz with camera noise."""
    rng = rng or np.random.default_rng(0)
    for number in itertools.count(1):
        t_s = number * FRAME_NS * 1e-9
        cart_y_m, angle = 0.2 * math.sin(4 * t_s), 0.8 * math.sin(5 * t_s)
        places = [(cart_y_m, HINGE_M), *[(cart_y_m, 0.7)] * 4]
        places.append((cart_y_m + 0.44 * math.sin(angle), HINGE_M - 0.44 * math.cos(angle)))
        bodies = tuple(Pose(*(place + rng.normal(0.0, 0.0003, 2)), 0.0) for place in np.array(places))
        yield MocapFrame(number, number * FRAME_NS, number * FRAME_NS + 2_000_000, bodies)


def moved(frame, place, dy_m=0.0, dz_m=0.0):
    bodies = list(frame.bodies)
    bodies[place] = bodies[place]._replace(y_m=bodies[place].y_m + dy_m, z_m=bodies[place].z_m + dz_m)
    return replace(frame, bodies=tuple(bodies))


def restamped(frame, sequence=None, ahead_ns=0):
    number = frame.sequence if sequence is None else sequence
    return replace(frame, sequence=number, t_capture_ns=frame.t_capture_ns + ahead_ns)


def judged(frames, axis=lambda frame: frame.bodies[0].y_m):
    """Return the judge after these frames, and the accepted ones."""
    judge = Plausibility()
    return judge, [judge.accepts(frame, axis(frame)) for frame in frames]


def names(judge):
    return [event.name for event in judge.events()]


def healthy(count):
    return list(itertools.islice(cameras(), count))


def test_a_swing_with_camera_noise_is_plausible():
    judge, taken = judged(healthy(1200))
    assert all(taken)
    assert names(judge) == []


SPOILT = {
    "mocap_clock": lambda frame: restamped(frame, ahead_ns=50_000_000),
    "mocap_height": lambda frame: moved(moved(frame, 0, dz_m=1.0), 5, dz_m=1.0),
    "mocap_reach": lambda frame: moved(frame, 5, dy_m=10.0),
    "mocap_jump": lambda frame: moved(moved(frame, 0, dy_m=0.15), 5, dy_m=0.15),
    "mocap_two_sources": lambda frame: restamped(frame, sequence=17),
}


@pytest.mark.parametrize("name", SPOILT)
def test_the_third_implausible_frame_in_a_row_is_an_event(name):
    frames = healthy(40)
    judge, taken = judged([*frames[:37], *map(SPOILT[name], frames[37:39])])
    assert names(judge) == ["mocap_outlier"]
    taken.append(judge.accepts(SPOILT[name](frames[39]), frames[39].bodies[0].y_m))
    assert names(judge) == [name]
    assert taken == [True] * 37 + [False] * 3
    (event,) = judge.events()
    assert f"{FEW} of the last 32 frames" in event.text
    assert any(character.isdigit() for character in event.detail.partition(";")[0])


@pytest.mark.parametrize("rate", [1, 4])
def test_a_tip_that_jumps_in_every_tenth_frame_is_found_at_any_rate(rate):
    """The tip jumps 0.3 m along its arc; every frame arrives, or every fourth."""
    frames = healthy(160 * rate)[::rate]
    frames = [restamped(frame, sequence=number) for number, frame in enumerate(frames)]

    def jumped(frame):
        cart, tip = frame.bodies[0], frame.bodies[5]
        angle = math.atan2(tip.y_m - cart.y_m, cart.z_m - tip.z_m)
        angle -= math.copysign(0.75, angle)
        return moved(
            frame,
            5,
            dy_m=cart.y_m + 0.44 * math.sin(angle) - tip.y_m,
            dz_m=cart.z_m - 0.44 * math.cos(angle) - tip.z_m,
        )

    judge, taken = judged([jumped(f) if i % 10 == 9 else f for i, f in enumerate(frames)])
    assert taken == [i % 10 != 9 for i in range(160)]
    assert names(judge) == ["mocap_jump"]


def test_one_implausible_frame_warns_and_is_rejected():
    frames = healthy(60)
    judge, taken = judged([*frames[:10], SPOILT["mocap_jump"](frames[10]), *frames[11:30]])
    assert taken.count(False) == 1
    assert names(judge) == ["mocap_outlier"]
    for frame in frames[30:]:
        assert judge.accepts(frame, None)
    assert names(judge) == []


def test_a_tip_elsewhere_after_a_gap_is_accepted_again():
    """A body is accepted beyond a jump once it has had the time to move there."""
    frames = healthy(80)
    _, taken = judged([*frames[:10], *(moved(f, 5, dz_m=0.06) for f in frames[10:])])
    assert taken[10:12] == [False, True]


def frozen(frames, places, since):
    shown = {place: frames[since].bodies[place] for place in places}
    for frame in frames[since:]:
        yield replace(frame, bodies=tuple(shown.get(place, body) for place, body in enumerate(frame.bodies)))


@pytest.mark.parametrize(("places", "within"), [((5,), 6), ((0, 1, 2, 3, 4, 5), 6), ((0,), 26)])
def test_a_body_that_is_repeated_to_the_last_digit_while_the_robot_moves_is_found(places, within):
    frames = healthy(100)
    axis = {frame.sequence: frame.bodies[0].y_m for frame in frames}
    shown = [*frames[:50], *frozen(frames, places, 50)]
    judge, _ = judged(shown[: 50 + within], lambda frame: axis[frame.sequence])
    assert "mocap_frozen" in names(judge)


def test_an_arm_at_rest_without_any_noise_is_not_frozen():
    frame = healthy(1)[0]
    still = [MocapFrame(n, n * FRAME_NS, n * FRAME_NS, frame.bodies) for n in range(1, 1000)]
    judge, taken = judged(still)
    assert all(taken)
    assert names(judge) == []


def test_a_bridge_that_is_restarted_costs_one_frame():
    frames = healthy(60)
    judge, taken = judged([*frames[:40], *(restamped(f, sequence=i) for i, f in enumerate(frames[40:]))])
    assert taken.count(False) == 1
    assert names(judge) == ["mocap_outlier"]


def test_two_simultaneous_bridges_are_found():
    for offset in (-1000, 0, 1000):
        both = itertools.chain.from_iterable(
            (restamped(f, sequence=5000 + i), restamped(f, sequence=5000 + i + offset, ahead_ns=1_000_000))
            for i, f in enumerate(healthy(10))
        )
        judge, _ = judged(both)
        assert names(judge) == ["mocap_two_sources"]


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"mocap.noise": {"sigma": 0.002}, "mocap.dropout": {"share": 0.02}},
        pytest.param({"mocap.latency": {"delay": 0.06}}, marks=pytest.mark.prove),
        {"mocap.scale": {"scale": 0.02}, "mocap.rotation": {"angle": 0.02}},
    ],
)
def test_no_simulated_swing_is_implausible(effects):
    model = Model()
    model.effects.update(effects)
    daemon = Lockstep(Config(goals={"time_limit_s": 20.0}), BangBang(4), body=SimulatedBody(model))
    for _ in range(60):
        daemon.tick()
    daemon.arm()
    found = set()
    daemon.tick(daemon.request("goal", Goal("reach", 0.0, 0.9)))
    for _ in range(250):
        found |= {event.name for event in daemon.tick().events}
    assert not {name for name in found if name.startswith("mocap")} - {"mocap_late", "mocap_bridged"}


# Where the limits are: just within them nothing is said, just beyond it is named, with its numbers


def still(number, cart=(0.0, HINGE_M), tip=(0.0, 0.525), ahead_ns=-2_000_000, step_ns=FRAME_NS):
    """Return a frame of a hanging arm with camera noise."""
    noise = 1e-5 * (number % 2)
    bodies = (Pose(cart[0] + noise, cart[1], 0.0), *[Pose(0.0, 0.7, 0.0)] * 4, Pose(tip[0] + noise, tip[1], 0.0))
    return MocapFrame(number, number * step_ns, number * step_ns - ahead_ns, bodies)


def said(*frames, axis=lambda frame: None):
    """Return the detail of the last frame as a single outlier."""
    judge, taken = judged(frames, axis)
    return "" if taken[-1] else list(judge.events())[-1].detail.partition(";")[0]


@pytest.mark.parametrize("ahead_ms", [5.0, 5.1])
def test_a_stamp_ahead_by_the_clocks_noise_is_plausible(ahead_ms):
    expected = "" if ahead_ms == 5.0 else "0.005 s ahead of CLOCK_MONOTONIC, allowed 0.005 s"
    assert said(still(1, ahead_ns=round(ahead_ms * 1e6))) == expected
    assert said(still(1, ahead_ns=50_000_000)) == "0.050 s ahead of CLOCK_MONOTONIC, allowed 0.005 s"


@pytest.mark.parametrize("side", [-1, 1])
def test_a_cart_within_five_centimetres_of_the_hinges_height_is_plausible(side):
    assert said(still(1, cart=(0.0, HINGE_M + side * 0.049), tip=(0.0, 0.55))) == ""
    off_m = HINGE_M + side * 0.051
    assert said(still(1, cart=(0.0, off_m), tip=(0.0, 0.55))) == f"the cart at z {off_m:.3f} m, the hinge is at 0.965 m"


def test_a_tip_within_the_longest_arm_is_plausible():
    longest_m = 1.15 * sum(Model().arm.link_length_m)
    for reach_m, plausible in ((0.149, False), (0.151, True), (longest_m - 1e-3, True), (longest_m + 1e-3, False)):
        found = said(still(1, tip=(reach_m, HINGE_M)))
        assert (found == "") is plausible
        assert plausible or found == f"{reach_m:.3f} m from the cart, the arm allows 0.15 to {longest_m:.3f} m"


@pytest.mark.parametrize(("body", "top_m_s"), [("tip", 8.0), ("cart", 2.0)])
@pytest.mark.parametrize("step_ms", [8, 33])
def test_the_highest_velocity_plus_noise_is_plausible(body, top_m_s, step_ms):
    """A jump directly after the first frame."""
    for off_m, plausible in ((-1e-3, True), (1e-3, False)):
        far_m = top_m_s * step_ms * 1e-3 + 0.03 + off_m
        angle = 2 * math.asin(min(1.0, far_m / 2 / 0.44))  # along the arc
        to = (0.44 * math.sin(angle), HINGE_M - 0.44 * math.cos(angle))
        place = {"tip": to} if body == "tip" else {"cart": (far_m, HINGE_M), "tip": (0.2, 0.6)}
        first = {"tip": (0.0, 0.525)} if body == "tip" else {"tip": (0.2, 0.6)}
        before, after = (still(number, **at, step_ns=step_ms * 1_000_000) for number, at in ((2, first), (3, place)))
        found = said(before, moved(after, 0 if body == "cart" else 5, dy_m=-1e-5))  # without the noise
        assert (found == "") is plausible, found
        assert plausible or found == f"the {body} moved {far_m * 1e3:.0f} mm in {step_ms} ms"


@pytest.mark.parametrize(("place", "name", "top_m_s2"), [(5, "tip", 150.0), (0, "cart", 60.0)])
def test_the_highest_acceleration_is_plausible(place, name, top_m_s2):
    """A body at rest may move by its acceleration over both steps plus noise."""
    step_ns = 25_000_000
    allowed_m = top_m_s2 * 0.025**2 + 0.03
    for off_m, plausible in ((-1e-3, True), (1e-3, False)):
        rest = [still(number, tip=(0.2, 0.6), step_ns=step_ns) for number in (2, 3)]
        last = moved(still(4, tip=(0.2, 0.6), step_ns=step_ns), place, dy_m=-(allowed_m + off_m))
        assert (said(*rest, last) == "") is plausible


def test_a_velocity_above_the_highest_is_implausible():
    places_m = (0.0, 0.075, 0.160)  # the last at 3.4 m/s, of which cameras' noise may be 1.2
    frames = [
        still(number, cart=(place_m, HINGE_M), tip=(0.2 + place_m, 0.6), step_ns=25_000_000)
        for number, place_m in enumerate(places_m, start=1)
    ]
    assert said(*frames[:2]) == ""
    assert said(*frames) == "the cart moved 85 mm in 25 ms"


def test_two_frames_with_one_stamp_give_no_velocity():
    frame = still(1)
    assert said(frame, replace(frame, sequence=2, bodies=still(2, tip=(0.2, 0.6)).bodies)) == ""


def stuck(count, place, *, came_m=0.0, cart_m=0.0, axis_m=0.0):
    """Return the detail of a body that moves once and then repeats its pose while others move."""
    frames = [still(1, tip=(0.1, 0.6)), moved(still(2, tip=(0.1, 0.6)), place, dy_m=came_m)]
    for number in range(3, count + 2):
        share = (number - 2) / (count - 1)
        bodies = list(still(number, tip=(0.1, 0.6)).bodies)
        bodies[0] = bodies[0]._replace(y_m=frames[1].bodies[0].y_m + cart_m * share)
        bodies[place] = frames[1].bodies[place]
        frames.append(MocapFrame(number, number * FRAME_NS, number * FRAME_NS, tuple(bodies)))
    return said(*frames, axis=lambda frame: 0.1 + axis_m * (frame.sequence - 2) / (count - 1))


def test_a_tip_that_stops_abruptly_in_a_swing_is_frozen_in_the_third_frame():
    frame_s = FRAME_NS * 1e-9
    assert stuck(2, 5, came_m=0.5 * frame_s) == ""
    found = stuck(3, 5, came_m=0.5 * frame_s)
    assert found == "the tip has the same pose to the last digit in 3 frames, after a swing at 0.5 m/s"
    assert stuck(3, 5, came_m=0.29 * frame_s) == ""
    assert "swing" in stuck(3, 5, came_m=0.31 * frame_s)
    assert stuck(3, 0, came_m=0.5 * frame_s) == ""  # a cart may stop dead: it has a drive


@pytest.mark.parametrize("side", [-1, 1])
def test_a_tip_that_stays_while_the_cart_moves_is_frozen(side):
    assert stuck(3, 5, cart_m=side * 0.0099) == ""
    assert stuck(3, 5, cart_m=side * 0.0101) == (
        "the tip has the same pose to the last digit in 3 frames, while the cart moved 10 mm"
    )


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("name", "place"), [("tip", 5), ("cart", 0)])
def test_a_body_that_stays_while_the_axis_moves_is_frozen(name, place, side):
    assert stuck(3, place, axis_m=side * 0.0499) == ""
    assert stuck(3, place, axis_m=side * 0.0501) == (
        f"the {name} has the same pose to the last digit in 3 frames, while the axis moved 50 mm"
    )


def test_a_tip_that_stays_while_the_cart_moves_is_frozen_without_an_axis():
    frames = [still(number, cart=(0.004 * number, HINGE_M)) for number in range(1, 12)]
    stays = [replace(frame, bodies=(*frame.bodies[:5], frames[0].bodies[5])) for frame in frames]
    judge, _ = judged(stays, lambda frame: None)
    assert names(judge) == ["mocap_frozen"]


@pytest.mark.parametrize("readings", [range(1, 3), range(3, 6), range(0)])
def test_an_axis_with_one_reading_shows_no_motion(readings):
    still_frames = [MocapFrame(n, n * FRAME_NS, n * FRAME_NS, still(1).bodies) for n in range(1, 6)]
    assert said(*still_frames, axis=lambda frame: 0.2 * frame.sequence if frame.sequence in readings else None) == ""


@pytest.mark.parametrize("place", [0, 5])
@pytest.mark.parametrize("lack", [{"tracked": False}, {"y_m": math.nan}, {"z_m": math.inf}])
def test_a_frame_needs_valid_cart_and_tip_poses_only(place, lack):
    whole = still(1)
    assert is_usable(whole)
    bodies = list(whole.bodies)
    bodies[place] = bodies[place]._replace(**lack)
    assert not is_usable(replace(whole, bodies=tuple(bodies)))
    links = (whole.bodies[0], *[whole.bodies[1]._replace(**lack)] * 4, whole.bodies[5])
    assert is_usable(replace(whole, bodies=links))
