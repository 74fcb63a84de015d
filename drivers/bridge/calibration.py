"""How a cameras' room lies to the robot, from an arm that hangs at rest and a cart that is pushed along the rail. Pure.

Up is the cameras' own (their ground plane is level); along is the line that the cart takes; place and height are
counted from the first hinge, by where the links hang; angles from how the arm hangs at rest: a little bent, as the
model has it, or straight.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from softarm.drivers.bridge.frame import Plane, level, product
from softarm.drivers.bridge.natnet import Body, Quaternion, Vector
from softarm.schemas.bridge import Marked, Marks, Room
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Arm
from softarm.schemas.robot import RAIL_TRAVEL_M

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

ARM = Arm()
HINGE_Z_M = ARM.base_height_m
TRAVEL_M = 2 * RAIL_TRAVEL_M

SEEN_MIN = 0.5  # share of the frames
STILL_M = 0.004  # a body at rest stays within
STRAIGHT_M = 0.004  # the cart stays so near to a line
TILT_REFUSED_RAD = 0.02  # a rail that slopes more, or a ground plane that does
LEAN_MAX_RAD = 0.15  # between the hanging arm and the cameras' up
PUSH_MIN_M, SHORT_M, LONG_M = 0.15, 0.4, 0.75  # about the middle; from end to end at least, and at most
TRAVEL_NOTED_M = 0.03
SPACING_REFUSED_M, SPACING_NOTED_M = 0.025, 0.008
BESIDE_REFUSED_M, BESIDE_NOTED_M = 0.06, 0.008  # markers beside the arm's axis
FLOOR_NOTED_M = 0.03
CART_OFF_MAX_M = 0.3
FAR_M = 1.5  # from the middle of its way no cart is farther
BINS = 40  # along the rail; the cart stands long at some places


class Sample(NamedTuple):
    """The arm's bodies in one frame; those that were not tracked are left out."""

    t_ns: int
    bodies: Mapping[str, Body]


class CalibrationError(Exception):
    """All that keeps a room from being found, a sentence each."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(problems))


@dataclass(frozen=True)
class Found:
    """The room and the markers, how well they fit, and what is odd but no hindrance."""

    room: Room
    marks: Marks
    travel_m: float  # of the cart
    crooked_m: float  # farthest of the cart from its line
    floor_m: float  # the cameras' ground plane above the floor, by the arm's own lengths
    beside_m: Mapping[str, float]  # each link's point beside where it should hang, towards +y
    spacing_m: Mapping[str, float]  # "link1-link2" -> how far below the other one hangs
    noise_m: float  # of a body at rest, the worst
    notes: tuple[str, ...]


class Line(NamedTuple):
    """Where the cart goes."""

    middle: Array  # a point of it
    along: Array  # unit vector, to where the cart stood last
    ends: tuple[float, float]  # along it, from `middle`
    crooked_m: float
    crooked_at: tuple[float, float, float]  # where along it, how far aside and how far up


class Hanging(NamedTuple):
    """A body at rest: in the middle of its frames."""

    position_m: Vector
    orientation: Quaternion
    moved_m: float  # 19 of 20 frames lie within so much of it


class Rest(NamedTuple):
    """A body where it hangs at rest, from the first hinge."""

    y_m: float
    z_m: float
    angle_rad: float


def rest_shape(straight: bool = False) -> dict[str, Rest]:
    """The arm at rest without pressure: gravity, the joints' stiffness and their constant torques in balance."""
    lengths, masses = np.array(ARM.link_length_m), np.array(ARM.link_mass_kg)
    angles = np.zeros(ARM.links)
    if not straight:
        joints = np.eye(ARM.links) - np.eye(ARM.links, k=-1)  # absolute angles -> joint angles
        pull = ARM.gravity_m_s2 * lengths * (np.cumsum(masses[::-1])[::-1] - masses / 2)
        stiffness = np.array(ARM.stiffness_nm_rad)
        for _ in range(20):  # Newton's; a few would do
            torque = joints.T @ (stiffness * (joints @ angles) + ARM.torque_offset_nm) + pull * np.sin(angles)
            slope = joints.T @ np.diag(stiffness) @ joints + np.diag(pull * np.cos(angles))
            angles = angles - np.linalg.solve(slope, torque)
    ends = zip(np.cumsum(lengths * np.sin(angles)), -np.cumsum(lengths * np.cos(angles)), angles, strict=True)
    hinge = {BODY_NAMES[0]: Rest(0.0, 0.0, 0.0)}
    return hinge | {name: Rest(*map(float, end)) for name, end in zip(BODY_NAMES[1:], ends, strict=True)}


def calibrate(
    rest: Sequence[Sample],
    push: Sequence[Sample],
    marks: Marks,
    last_is_plus: bool,
    middle_here: bool = False,
    straight: bool = False,
) -> Found:
    """Find it all. rest: the arm hangs still; push: the cart goes along the rail, and stands at an end at last.

    marks: whose `rigid_body` is kept. last_is_plus: that end is +y. middle_here: the cart is in the middle at rest;
    otherwise the middle is that of the two ends. straight: so does the arm hang. Raises CalibrationError.
    """
    hang, up = check_rest(rest, marks)
    _refuse(_unseen(push, ("cart",), "while the cart was pushed"))
    line = _line(np.array([s.bodies["cart"].position_m for s in push if "cart" in s.bodies]), up)
    _refuse(_bad_push(line, middle_here))
    plane = _through(line, hang["cart"], up, last_is_plus, middle_here)
    places = {name: Plane(plane).place(each.position_m) for name, each in hang.items()}
    shape = rest_shape(straight)
    # The first hinge: the links tell it better than the cart's markers do.
    links = [name for name in hang if name != "cart"]
    hinge_y = float(np.median([places[name][0] - shape[name].y_m for name in links]))
    hinge_z = float(np.median([places[name][1] - shape[name].z_m for name in links]))
    across, along = hinge_y - places["cart"][0], hinge_z - places["cart"][1]
    beside = {name: places[name][0] - shape[name].y_m - hinge_y for name in links}
    spacing = _spacing({name: z for name, (_, z) in places.items()})
    _refuse(_misplaced(across, along, beside))
    room = plane.model_copy(update={"origin_m": Plane(plane).point(across, hinge_z - HINGE_Z_M)})
    found = {name: _mark(getattr(marks, name), each, Plane(room), shape[name]) for name, each in hang.items()}
    found["cart"] = found["cart"].model_copy(update={"across_m": across, "along_m": along})
    floor_m = -float(np.array(room.origin_m) @ np.array(level(up)[2]))
    return Found(
        room=room,
        marks=Marks.model_validate({name: found.get(name) for name in BODY_NAMES}),
        travel_m=line.ends[1] - line.ends[0],
        crooked_m=line.crooked_m,
        floor_m=floor_m,
        beside_m=beside,
        spacing_m=spacing,
        noise_m=max(each.moved_m for each in hang.values()),
        notes=tuple(_notes(line, floor_m, beside, spacing, middle_here)),
    )


def check_rest(rest: Sequence[Sample], marks: Marks) -> tuple[dict[str, Hanging], Literal["y", "z"]]:
    """Where each body hangs, and the axis that is up. Raises CalibrationError for what a push would not mend."""
    wanted = [name for name in BODY_NAMES if getattr(marks, name) is not None]
    _refuse(_unseen(rest, wanted, "at rest"))
    hang = {name: _at_rest(rest, name) for name in wanted}
    _refuse(_restless(hang))
    up = _up(hang)
    vertical = np.array(level(up)[2])
    heights = {name: float(np.array(each.position_m) @ vertical) for name, each in hang.items()}
    _refuse(_out_of_order(heights))
    _refuse(_badly_spaced(_spacing(heights)))
    return hang, up


def depth(name: str) -> float:
    """How far along the arm from the first hinge a body is (m)."""
    return sum(ARM.link_length_m[: BODY_NAMES.index(name)])


def _refuse(problems: Iterable[str]) -> None:
    if told := list(problems):
        raise CalibrationError(told)


def _restless(hang: Mapping[str, Hanging]) -> Iterator[str]:
    for name, each in hang.items():
        if each.moved_m > STILL_M:
            yield f"{name} moves by {1e3 * each.moved_m:.0f} mm; wait until the arm hangs still"


def _through(line: Line, cart: Hanging, up: Literal["y", "z"], last_is_plus: bool, middle_here: bool) -> Room:
    """A room whose plane lies along the rail, and whose origin is the middle of the cart's markers' way."""
    along = line.along if last_is_plus else -line.along
    first, second, vertical = (np.array(axis) for axis in level(up))
    tilt_rad = math.asin(float(along @ vertical))
    yaw_rad = math.atan2(float(along @ second), float(along @ first))
    if abs(tilt_rad) > TILT_REFUSED_RAD:
        rises = f"{math.degrees(tilt_rad):+.1f} degrees towards +y above the cameras' ground plane"
        raise CalibrationError([f"the rail rises by {rises}; level it, or set the ground plane anew"])
    step = float((np.array(cart.position_m) - line.middle) @ line.along) if middle_here else sum(line.ends) / 2
    return Room(up=up, yaw_rad=yaw_rad, tilt_rad=tilt_rad, origin_m=_vector(line.middle + step * line.along))


def _unseen(samples: Sequence[Sample], wanted: Sequence[str], when: str) -> Iterator[str]:
    remedy = "name it in Motive, or in bodies of --config, and bring it into view; `softarm bridge natnet --once` shows"
    for name in wanted:
        share = sum(name in sample.bodies for sample in samples) / len(samples) if samples else 0.0
        if share == 0.0:
            yield f"{name} was never seen {when}; {remedy}"
        elif share < SEEN_MIN:
            yield f"{name} was seen in {100 * share:.0f} % of the frames {when}; see to its markers and the cameras"


def _at_rest(rest: Sequence[Sample], name: str) -> Hanging:
    bodies = [sample.bodies[name] for sample in rest if name in sample.bodies]
    positions = np.array([body.position_m for body in bodies])
    turns = np.array([body.orientation for body in bodies])
    turns = turns * np.where(turns @ turns[0] < 0, -1.0, 1.0)[:, None]  # q and -q are the same turn
    middle, turn = np.median(positions, axis=0), np.median(turns, axis=0)
    turn = turn / np.linalg.norm(turn)
    moved = float(np.quantile(np.linalg.norm(positions - middle, axis=1), 0.95))
    return Hanging(_vector(middle), (float(turn[0]), float(turn[1]), float(turn[2]), float(turn[3])), moved)


def _up(hang: Mapping[str, Hanging]) -> Literal["y", "z"]:
    """The axis against which the arm hangs."""
    lowest = max(hang, key=BODY_NAMES.index)
    way = np.array(hang["cart"].position_m) - np.array(hang[lowest].position_m)
    length = float(np.linalg.norm(way))
    if length < depth(lowest) / 2:
        apart = f"{length:.3f} m apart at rest, not some {depth(lowest):.3f}"
        raise CalibrationError([f"cart and {lowest} are {apart}; are they the right bodies?"])
    up: Literal["y", "z"] = "y" if abs(way[1]) > abs(way[2]) else "z"
    vertical = np.array(level(up)[2])
    # The cart's markers may sit beside the hinge: the links alone say how the arm hangs.
    highest = min((name for name in hang if name != "cart"), key=BODY_NAMES.index)
    if highest != lowest:
        way = np.array(hang[highest].position_m) - np.array(hang[lowest].position_m)
    lean = math.acos(min(1.0, abs(float(way @ vertical)) / max(1e-9, float(np.linalg.norm(way)))))
    if lean > LEAN_MAX_RAD:
        leans = f"{math.degrees(lean):.0f} degrees from the cameras' up ({up})"
        remedy = "set their ground plane on the floor, and Up Axis to Y or Z"
        raise CalibrationError([f"the arm leans by {leans}; {remedy}"])
    return up


def _line(path: Array, up: str) -> Line:
    """A straight line through where the cart was; each piece of the rail counts alike, and what jumps does not."""
    middle = np.median(path, axis=0)
    path = path[np.linalg.norm(path - middle, axis=1) < FAR_M]
    along = np.linalg.svd(path - middle, full_matrices=False)[2][0]
    pieces = path
    for _ in range(3):
        away = path - middle
        steps = away @ along
        aside = np.linalg.norm(away - steps[:, None] * along, axis=1)
        near = aside < max(3 * float(np.median(aside)), 0.02)
        low, high = np.quantile(steps[near], [0.005, 0.995])
        edges = np.linspace(low, high, BINS + 1)
        where = np.digitize(steps, edges[1:-1])
        inside = near & (steps >= low - 0.002) & (steps <= high + 0.002)
        pieces = np.array(
            [np.median(path[inside & (where == k)], axis=0) for k in range(BINS) if np.any(inside & (where == k))]
        )
        if len(pieces) < 2:
            break
        middle = np.mean(pieces, axis=0)
        along = np.linalg.svd(pieces - middle, full_matrices=False)[2][0]
    steps = (path - middle) @ along
    if steps[-max(1, len(steps) // 50) :].mean() < 0:  # the cart stands at its last end
        along, steps = -along, -steps
    aside = np.linalg.norm(path - middle - steps[:, None] * along, axis=1)
    near = aside < max(3 * float(np.median(aside)), 0.02)
    ends = _ends(steps[near])
    rests = pieces - middle - ((pieces - middle) @ along)[:, None] * along
    worst = int(np.argmax(np.linalg.norm(rests, axis=1)))
    vertical = np.array(level(up)[2])
    height = float(rests[worst] @ vertical)
    crooked = float(np.linalg.norm(rests[worst]))
    beside = math.sqrt(max(0.0, crooked**2 - height**2))
    at = float((pieces[worst] - middle) @ along)
    return Line(middle, along, ends, crooked, (at, beside, height))


def _ends(steps: Array) -> tuple[float, float]:
    """The farthest either way; of each frame and its neighbours the middle one, so that a jump is none."""
    calm = np.median(np.lib.stride_tricks.sliding_window_view(steps, 3), axis=1) if len(steps) > 3 else steps
    return float(calm.min()), float(calm.max())


def _bad_push(line: Line, middle_here: bool) -> Iterator[str]:
    travel = line.ends[1] - line.ends[0]
    least = PUSH_MIN_M if middle_here else SHORT_M
    if travel < least:
        whole = (
            ""
            if middle_here
            else f" from stop to stop ({TRAVEL_M:.2f} m), or say --middle with the cart in the middle at rest"
        )
        yield f"the cart went {travel:.2f} m, which is too short; push it {least:.2f} m or more{whole}"
    elif travel > LONG_M:
        rail = f"on a rail of {TRAVEL_M:.2f}"
        yield f"the cart went {travel:.2f} m {rail}; is it the right body, and are the cameras calibrated?"
    if travel >= least and line.crooked_m > STRAIGHT_M:
        at, beside, height = line.crooked_at
        where = f"{at - line.ends[0]:.2f} m from the end where the push began"
        off = f"{1e3 * beside:.0f} mm aside and {1e3 * height:+.0f} mm in height"
        remedy = "see to the rail, its cart and the cameras' calibration"
        yield f"the rail is not straight: {where} the cart is {off} of its line; {remedy}"


def _out_of_order(heights: Mapping[str, float]) -> Iterator[str]:
    wanted = list(heights)
    there = sorted(wanted, key=lambda name: -heights[name])
    wrong = [name for name, other in zip(wanted, there, strict=True) if name != other]
    if not wrong:
        return
    if len(wrong) == 2:
        one, other = wrong
        yield f"{one} and {other} seem swapped: {other} hangs where {one} should; swap their names in Motive"
    else:
        yield f"from the top hang {', '.join(there)}, which should be {', '.join(wanted)}; name them so in Motive"


def _wanted_spacing(pair: str) -> float:
    above, _, below = pair.partition("-")
    return depth(below) - depth(above)


def _spacing(heights: Mapping[str, float]) -> dict[str, float]:
    links = [name for name in heights if name != "cart"]
    return {f"{a}-{b}": heights[a] - heights[b] for a, b in pairwise(links)}


def _badly_spaced(spacing: Mapping[str, float]) -> Iterator[str]:
    for pair, apart in spacing.items():
        if abs(apart - _wanted_spacing(pair)) > SPACING_REFUSED_M:
            above, _, below = pair.partition("-")
            yield (
                f"{above} and {below} hang {apart:.4f} m apart at rest, not {_wanted_spacing(pair):.4f}; "
                "put the markers at the far ends of their links, and their pivots there in Motive"
            )


def _misplaced(across: float, along: float, beside: Mapping[str, float]) -> Iterator[str]:
    for name, off in beside.items():
        if abs(off) > BESIDE_REFUSED_M:
            yield f"{name} hangs {1e3 * off:+.0f} mm beside the others; put its pivot on the arm's axis in Motive"
    for off, where in ((across, "beside"), (along, "in height of")):
        if abs(off) > CART_OFF_MAX_M:
            yield f"the cart's markers are {1e3 * off:+.0f} mm {where} the first hinge; are they the cart's?"


def _mark(mark: Marked, hang: Hanging, plane: Plane, rest: Rest) -> Marked:
    """How a body is streamed while it hangs straight: as it hangs at rest, turned back by what it is bent then."""
    back = plane.turn(-rest.angle_rad)
    return Marked(rigid_body=mark.rigid_body, hanging=product(back, hang.orientation))


def _notes(
    line: Line, floor_m: float, beside: Mapping[str, float], spacing: Mapping[str, float], middle_here: bool
) -> Iterator[str]:
    travel = line.ends[1] - line.ends[0]
    if not middle_here and abs(travel - TRAVEL_M) > TRAVEL_NOTED_M:
        rail = f"the rail has {TRAVEL_M:.2f}"
        yield f"the cart went {travel:.3f} m, {rail}: the middle is right if both ends were its stops"
    if abs(floor_m) > FLOOR_NOTED_M:
        side = "above" if floor_m > 0 else "below"
        given = f"if the first hinge is {HINGE_Z_M} m high and the markers sit at the far ends of the links"
        yield f"the cameras' ground plane lies {abs(floor_m):.3f} m {side} the floor, {given}"
    for pair, apart in spacing.items():
        if abs(apart - _wanted_spacing(pair)) > SPACING_NOTED_M:
            yield f"{pair} hang {apart:.4f} m apart, not {_wanted_spacing(pair):.4f}"
    for name, off in beside.items():
        if abs(off) > BESIDE_NOTED_M:
            cause = "its pivot, or an arm that is bent otherwise"
            yield f"{name} hangs {1e3 * off:+.0f} mm beside where it should: {cause}"


def _vector(array: Array) -> Vector:
    return (float(array[0]), float(array[1]), float(array[2]))
