"""What cannot be true is left out, and named within a few frames; what a healthy robot shows never is."""

import itertools
import math

import numpy as np
import pytest

from softarm.daemon.control.plausibility import FEW, Plausibility
from softarm.daemon.shell.offline import Lockstep
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.policies.base import PolicySpec
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame, Pose
from softarm.schemas.model import Model

FRAME_NS = 8_333_333
HINGE_M = 0.965


def cameras(rng=None):
    """Frames of a swing at 120 Hz with the noise of cameras: cart and tip move, as on the robot."""
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
    return MocapFrame(frame.sequence, frame.t_capture_ns, frame.t_receive_ns, tuple(bodies))


def restamped(frame, sequence=None, ahead_ns=0):
    number = frame.sequence if sequence is None else sequence
    return MocapFrame(number, frame.t_capture_ns + ahead_ns, frame.t_receive_ns, frame.bodies)


def mirrored(frame):
    return MocapFrame(frame.sequence, frame.t_capture_ns, frame.t_receive_ns, frame.bodies[:1] + frame.bodies[:5])


def judged(frames, axis=lambda frame: frame.bodies[0].y_m):
    """The judge after these frames, and which of them it took."""
    judge = Plausibility()
    return judge, [judge.accepts(frame, axis(frame)) for frame in frames]


def names(judge):
    return [event.name for event in judge.events()]


def healthy(count):
    return list(itertools.islice(cameras(), count))


def test_a_swing_that_cameras_with_noise_see_is_never_doubted():
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
def test_the_third_frame_in_a_row_that_cannot_be_true_is_the_event_with_its_numbers(name):
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
def test_a_tip_that_jumps_in_every_tenth_frame_is_found_whatever_the_cameras_rate(rate):
    """0.3 m along the arc, which the arm could reach; `rate`: every frame at 120 Hz, or every fourth at 30 Hz."""
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


def test_one_frame_that_cannot_be_true_warns_is_left_out_and_is_forgotten():
    frames = healthy(60)
    judge, taken = judged([*frames[:10], SPOILT["mocap_jump"](frames[10]), *frames[11:30]])
    assert taken.count(False) == 1
    assert names(judge) == ["mocap_outlier"]
    for frame in frames[30:]:
        assert judge.accepts(frame, None)
    assert names(judge) == []


def test_a_tip_that_is_elsewhere_after_a_gap_is_believed_again():
    """What lies beyond a jump is where it is, once the body has had the time to go there."""
    frames = healthy(80)
    _, taken = judged([*frames[:10], *(moved(f, 5, dz_m=0.06) for f in frames[10:])])
    assert taken[10:12] == [False, True]


def frozen(frames, places, since):
    shown = {place: frames[since].bodies[place] for place in places}
    for frame in frames[since:]:
        bodies = tuple(shown.get(place, body) for place, body in enumerate(frame.bodies))
        yield MocapFrame(frame.sequence, frame.t_capture_ns, frame.t_receive_ns, bodies)


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


def test_two_bridges_at_once_are_found_whichever_counts_higher():
    for offset in (-1000, 0, 1000):
        both = itertools.chain.from_iterable(
            (restamped(f, sequence=5000 + i), restamped(f, sequence=5000 + i + offset, ahead_ns=1_000_000))
            for i, f in enumerate(healthy(10))
        )
        judge, _ = judged(both)
        assert names(judge) == ["mocap_two_sources"]


class BangBang:
    """As hard as commands go."""

    spec = PolicySpec("bang-bang", "as hard as commands go")

    def __init__(self, seed):
        self._rng, self._action = np.random.default_rng(seed), np.zeros(2, dtype=np.float32)

    def reset(self):
        pass

    def step(self, observation, goal):
        if self._rng.random() < 0.2:
            self._action = np.array((self._rng.choice((-1.0, 1.0)), self._rng.choice((-0.7, 20.0))), dtype=np.float32)
        return self._action


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"mocap.noise": {"sigma": 0.002}, "mocap.dropout": {"share": 0.02}},
        {"mocap.latency": {"delay": 0.06}},
        {"mocap.scale": {"scale": 0.02}, "mocap.rotation": {"angle": 0.02}},
    ],
)
def test_no_policy_on_the_simulated_robot_is_doubted_however_hard_it_swings(effects):
    model = Model()
    model.effects.update(effects)
    daemon = Lockstep(Config(goals={"time_limit_s": 20.0}), BangBang(4), body=SimulatedBody(model))
    for _ in range(60):
        daemon.tick()
    daemon.arm()
    found = set()
    for _ in range(2):
        daemon.tick(daemon.request("goal", Goal("reach", 0.0, 0.9)))
        for _ in range(500):
            found |= {event.name for event in daemon.tick().events}
    assert not {name for name in found if name.startswith("mocap")} - {"mocap_late", "mocap_bridged"}
