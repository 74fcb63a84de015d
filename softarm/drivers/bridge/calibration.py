"""Calibration of the cameras' coordinates, from an arm at rest and a cart that is pushed along the rail. Pure.

The vertical is the cameras' own (their ground plane is level), and the rail is the line of the cart. The origin is the
first hinge, from the positions of the links. Angles start from the arm at rest: slightly bent, as in the model, or
straight.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.drivers.bridge.frame import Plane, level, product
from softarm.drivers.bridge.natnet import Body, Quaternion, Vector
from softarm.schemas.bridge import Marked, Marks, Room
from softarm.schemas.messages import BODY_NAMES, Pose
from softarm.schemas.model import Arm
from softarm.schemas.robot import RAIL_TRAVEL_M

Array = NDArray[np.float64]

ARM = Arm()
HINGE_Z_M = ARM.base_height_m
TRAVEL_M = 2 * RAIL_TRAVEL_M

# Share of the frames in which a body must be tracked.
SEEN_MIN = 0.5
# Motion of a body at rest, and distance of the cart from a line.
STILL_M = 0.004
STRAIGHT_M = 0.004
# Slope of the rail or of the ground plane.
TILT_REFUSED_RAD = 0.02
# Angle between the hanging arm and the cameras' vertical.
LEAN_MAX_RAD = 0.15
# Push around the middle; from end to end, shortest and longest.
PUSH_MIN_M, SHORT_M, LONG_M = 0.15, 0.4, 0.75
TRAVEL_NOTED_M = 0.03
SPACING_REFUSED_M, SPACING_NOTED_M = 0.025, 0.008
# Distance of markers from the arm's axis.
BESIDE_REFUSED_M, BESIDE_NOTED_M = 0.06, 0.008
FLOOR_NOTED_M = 0.03
CART_OFF_MAX_M = 0.3
# A position farther from the middle of the path is an error of tracking.
FAR_M = 1.5
# Pieces of the rail with equal weight: the cart stays long at some places.
BINS = 40


class Sample(NamedTuple):
    """Tracked bodies of the arm in one frame."""

    t_ns: int
    bodies: Mapping[str, Body]


class CalibrationError(Exception):
    """Problems that prevent a calibration, one sentence each."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(problems))


@dataclass(frozen=True)
class Found:
    """Result of a calibration: coordinates, markers, quality, and notes on deviations that are tolerated.

    `crooked_m` is the largest distance of the cart from its line, `floor_m` the height of the cameras' ground plane
    above the floor by the arm's lengths. `beside_m` is the offset of each link from its nominal place towards +y,
    `noise_m` the largest motion of a body at rest.
    """

    room: Room
    marks: Marks
    travel_m: float
    crooked_m: float
    floor_m: float
    beside_m: Mapping[str, float]
    noise_m: float
    notes: tuple[str, ...]


class Line(NamedTuple):
    """Line of the cart's path.

    `middle` is a point of the line, `along` a unit vector towards the last position, `ends` the ends along it.
    `crooked_at` is the worst deviation: its position along the line, sideways and vertical.
    """

    middle: Array
    along: Array
    ends: tuple[float, float]
    crooked_m: float
    crooked_at: tuple[float, float, float]

    @property
    def travel_m(self) -> float:
        """Length of the path."""
        return self.ends[1] - self.ends[0]


class Hanging(NamedTuple):
    """Median pose of a body at rest; 19 of 20 frames are within `moved_m` of it."""

    position_m: Vector
    orientation: Quaternion
    moved_m: float


def rest_shape(straight: bool = False) -> dict[str, Pose]:
    """Return the arm's poses at rest, from its first hinge: gravity, stiffness and constant torques in balance."""
    lengths, masses = np.array(ARM.link_length_m), np.array(ARM.link_mass_kg)
    angles = np.zeros(ARM.links)
    if not straight:
        joints = np.eye(ARM.links) - np.eye(ARM.links, k=-1)  # absolute angles -> joint angles
        pull = ARM.gravity_m_s2 * lengths * (np.cumsum(masses[::-1])[::-1] - masses / 2)
        stiffness = np.array(ARM.stiffness_nm_rad)
        # Newton's method; a few steps suffice.
        for _ in range(20):
            torque = joints.T @ (stiffness * (joints @ angles) + ARM.torque_offset_nm) + pull * np.sin(angles)
            slope = joints.T @ np.diag(stiffness) @ joints + np.diag(pull * np.cos(angles))
            angles = angles - np.linalg.solve(slope, torque)
    ends = zip(np.cumsum(lengths * np.sin(angles)), -np.cumsum(lengths * np.cos(angles)), angles, strict=True)
    hinge = {BODY_NAMES[0]: Pose(0.0, 0.0, 0.0)}
    return hinge | {
        name: Pose(float(y), float(z), float(angle)) for name, (y, z, angle) in zip(BODY_NAMES[1:], ends, strict=True)
    }


def calibrate(
    rest: Sequence[Sample],
    push: Sequence[Sample],
    marks: Marks,
    last_is_plus: bool,
    middle_here: bool = False,
    straight: bool = False,
) -> Found:
    """Return the cameras' coordinates and the markers; the `rigid_body` of each mark is kept.

    Args:
        rest, push: Samples of the arm at rest, and of a push along the rail that ends at one end.
        last_is_plus: Whether the last end is +y.
        middle_here: Whether the cart is in the middle at rest; by default the middle of the two ends is used.
        straight: Whether the arm hangs straight.

    Raises:
        CalibrationError: The samples do not allow a calibration.
    """
    hang, up = check_rest(rest, marks)
    _refuse(_untracked(push, ("cart",), "while the cart was pushed"))
    line = _line(np.array([s.bodies["cart"].position_m for s in push if "cart" in s.bodies]), up)
    _refuse(_bad_push(line, middle_here))
    plane = _through(line, hang["cart"], up, last_is_plus, middle_here)
    places = {name: Plane(plane).place(each.position_m) for name, each in hang.items()}
    shape = rest_shape(straight)
    # The links locate the first hinge better than the cart's markers.
    links = [name for name in hang if name != "cart"]
    hinge_y = float(np.median([places[name][0] - shape[name].y_m for name in links]))
    hinge_z = float(np.median([places[name][1] - shape[name].z_m for name in links]))
    across, along = hinge_y - places["cart"][0], hinge_z - places["cart"][1]
    beside = {name: places[name][0] - shape[name].y_m - hinge_y for name in links}
    _refuse(_misplaced(across, along, beside))
    room = plane.model_copy(update={"origin_m": Plane(plane).point(across, hinge_z - HINGE_Z_M)})
    found = {name: _mark(getattr(marks, name), each, Plane(room), shape[name]) for name, each in hang.items()}
    found["cart"] = found["cart"].model_copy(update={"across_m": across, "along_m": along})
    floor_m = -float(np.array(room.origin_m) @ np.array(level(up)[2]))
    return Found(
        room=room,
        marks=Marks.model_validate({name: found.get(name) for name in BODY_NAMES}),
        travel_m=line.travel_m,
        crooked_m=line.crooked_m,
        floor_m=floor_m,
        beside_m=beside,
        noise_m=max(each.moved_m for each in hang.values()),
        notes=tuple(_notes(line, floor_m, beside, {name: z for name, (_, z) in places.items()}, middle_here)),
    )


def check_rest(rest: Sequence[Sample], marks: Marks) -> tuple[dict[str, Hanging], Literal["y", "z"]]:
    """Return the poses at rest and the vertical axis. Raises CalibrationError if a push cannot succeed."""
    wanted = list(marks.used)
    _refuse(_untracked(rest, wanted, "at rest"))
    hang = {name: _at_rest(rest, name) for name in wanted}
    _refuse(_restless(hang))
    up = _up(hang)
    vertical = np.array(level(up)[2])
    heights = {name: float(np.array(each.position_m) @ vertical) for name, each in hang.items()}
    _refuse(_out_of_order(heights))
    _refuse(_badly_spaced(heights))
    return hang, up


def depth(name: str) -> float:
    """Return the distance of a body from the first hinge along the arm, m."""
    return sum(ARM.link_length_m[: BODY_NAMES.index(name)])


def _refuse(problems: Iterable[str]) -> None:
    if found := list(problems):
        raise CalibrationError(found)


def _restless(hang: Mapping[str, Hanging]) -> Iterator[str]:
    for name, each in hang.items():
        if each.moved_m > STILL_M:
            allowed = f"at most {1e3 * STILL_M:.0f} mm allowed"
            yield f"{name} moves by {1e3 * each.moved_m:.0f} mm, {allowed}; wait until the arm is at rest"


def _through(line: Line, cart: Hanging, up: Literal["y", "z"], last_is_plus: bool, middle_here: bool) -> Room:
    """Return coordinates along the rail, with the origin in the middle of the path of the cart's markers."""
    along = line.along if last_is_plus else -line.along
    first, second, vertical = (np.array(axis) for axis in level(up))
    tilt_rad = math.asin(float(along @ vertical))
    yaw_rad = math.atan2(float(along @ second), float(along @ first))
    if abs(tilt_rad) > TILT_REFUSED_RAD:
        rises = f"{math.degrees(tilt_rad):+.1f} degrees towards +y above the cameras' ground plane"
        raise CalibrationError([f"the rail rises by {rises}; level it, or set the ground plane again"])
    step = float((np.array(cart.position_m) - line.middle) @ line.along) if middle_here else sum(line.ends) / 2
    return Room(up=up, yaw_rad=yaw_rad, tilt_rad=tilt_rad, origin_m=_vector(line.middle + step * line.along))


def _untracked(samples: Sequence[Sample], wanted: Sequence[str], when: str) -> Iterator[str]:
    remedy = (
        "name it in Motive or in bodies of --config, and bring it into view; `softarm bridge natnet --once` lists all"
    )
    for name in wanted:
        share = sum(name in sample.bodies for sample in samples) / len(samples) if samples else 0.0
        if share == 0.0:
            yield f"{name} was never tracked {when}; {remedy}"
        elif share < SEEN_MIN:
            yield f"{name} was tracked in {100 * share:.0f} % of the frames {when}; check its markers and the cameras"


def _at_rest(rest: Sequence[Sample], name: str) -> Hanging:
    bodies = [sample.bodies[name] for sample in rest if name in sample.bodies]
    positions = np.array([body.position_m for body in bodies])
    turns = np.array([body.orientation for body in bodies])
    # q and -q are the same rotation.
    turns = turns * np.where(turns @ turns[0] < 0, -1.0, 1.0)[:, None]
    middle, turn = np.median(positions, axis=0), np.median(turns, axis=0)
    turn = turn / np.linalg.norm(turn)
    moved = float(np.quantile(np.linalg.norm(positions - middle, axis=1), 0.95))
    return Hanging(_vector(middle), (float(turn[0]), float(turn[1]), float(turn[2]), float(turn[3])), moved)


def _up(hang: Mapping[str, Hanging]) -> Literal["y", "z"]:
    """Return the vertical axis, from the direction of the hanging arm."""
    lowest = max(hang, key=BODY_NAMES.index)
    way = np.array(hang["cart"].position_m) - np.array(hang[lowest].position_m)
    length = float(np.linalg.norm(way))
    if length < depth(lowest) / 2:
        apart = f"{length:.3f} m apart at rest, about {depth(lowest):.3f} m expected"
        raise CalibrationError([f"cart and {lowest} are {apart}; check that they are the right bodies"])
    up: Literal["y", "z"] = "y" if abs(way[1]) > abs(way[2]) else "z"
    vertical = np.array(level(up)[2])
    # The cart's markers may be away from the hinge, so only the links give the direction of the arm.
    highest = min((name for name in hang if name != "cart"), key=BODY_NAMES.index)
    if highest != lowest:
        way = np.array(hang[highest].position_m) - np.array(hang[lowest].position_m)
    lean = math.acos(min(1.0, abs(float(way @ vertical)) / max(1e-9, float(np.linalg.norm(way)))))
    if lean > LEAN_MAX_RAD:
        leans = f"{math.degrees(lean):.0f} degrees from the cameras' vertical ({up})"
        remedy = "set the ground plane on the floor, and Up Axis to Y or Z"
        raise CalibrationError([f"the arm leans by {leans}; {remedy}"])
    return up


def _line(path: Array, up: str) -> Line:
    """Fit a line through the cart's positions, with equal weight for each piece of the rail and without outliers."""
    middle = np.median(path, axis=0)
    path = path[np.linalg.norm(path - middle, axis=1) < FAR_M]
    along = np.linalg.svd(path - middle, full_matrices=False)[2][0]
    pieces = path
    for _ in range(3):
        steps, near = _along(path, middle, along)
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
    steps, near = _along(path, middle, along)
    # At the end the cart is at its last end.
    if steps[-max(1, len(steps) // 50) :].mean() < 0:
        along, steps = -along, -steps
    ends = _ends(steps[near])
    rests = pieces - middle - ((pieces - middle) @ along)[:, None] * along
    worst = int(np.argmax(np.linalg.norm(rests, axis=1)))
    vertical = np.array(level(up)[2])
    height = float(rests[worst] @ vertical)
    crooked = float(np.linalg.norm(rests[worst]))
    beside = math.sqrt(max(0.0, crooked**2 - height**2))
    at = float((pieces[worst] - middle) @ along)
    return Line(middle, along, ends, crooked, (at, beside, height))


def _along(path: Array, middle: Array, along: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return positions along a line, and which are no outliers."""
    away = path - middle
    steps = away @ along
    aside = np.linalg.norm(away - steps[:, None] * along, axis=1)
    return steps, aside < max(3 * float(np.median(aside)), 0.02)


def _ends(steps: Array) -> tuple[float, float]:
    """Return the two ends, from medians of three frames, which remove outliers."""
    calm = np.median(np.lib.stride_tricks.sliding_window_view(steps, 3), axis=1) if len(steps) > 3 else steps
    return float(calm.min()), float(calm.max())


def _bad_push(line: Line, middle_here: bool) -> Iterator[str]:
    travel = line.travel_m
    least = PUSH_MIN_M if middle_here else SHORT_M
    if travel < least:
        whole = (
            ""
            if middle_here
            else f" from stop to stop ({TRAVEL_M:.2f} m), or use --middle with the cart in the middle at rest"
        )
        yield f"the cart moved {travel:.2f} m, which is too short; push it {least:.2f} m or more{whole}"
    elif travel > LONG_M:
        rail = f"on a rail of {TRAVEL_M:.2f}"
        remedy = "check that it is the right body and that the cameras are calibrated"
        yield f"the cart moved {travel:.2f} m {rail} m; {remedy}"
    if travel >= least and line.crooked_m > STRAIGHT_M:
        at, beside, height = line.crooked_at
        where = f"{at - line.ends[0]:.2f} m from the end where the push began"
        off = f"{1e3 * beside:.0f} mm sideways and {1e3 * height:+.0f} mm vertically"
        remedy = "check the rail, its cart and the cameras' calibration"
        yield f"the rail is not straight: {where} the cart is {off} off its line; {remedy}"


def _out_of_order(heights: Mapping[str, float]) -> Iterator[str]:
    wanted = list(heights)
    there = sorted(wanted, key=lambda name: -heights[name])
    wrong = [name for name, other in zip(wanted, there, strict=True) if name != other]
    if not wrong:
        return
    if len(wrong) == 2:
        one, other = wrong
        yield f"{one} and {other} seem swapped: {other} is at the place of {one}; swap their names in Motive"
    else:
        yield f"the order from the top is {', '.join(there)}, expected {', '.join(wanted)}; rename them in Motive"


def _wrong_spacing(heights: Mapping[str, float], tolerance_m: float) -> Iterator[tuple[str, str, float, float]]:
    """Yield neighbouring links with a wrong distance, the distance and the expected one."""
    for above, below in pairwise(name for name in heights if name != "cart"):
        apart, wanted = heights[above] - heights[below], depth(below) - depth(above)
        if abs(apart - wanted) > tolerance_m:
            yield above, below, apart, wanted


def _badly_spaced(heights: Mapping[str, float]) -> Iterator[str]:
    for above, below, apart, wanted in _wrong_spacing(heights, SPACING_REFUSED_M):
        yield (
            f"{above} and {below} are {apart:.4f} m apart at rest, {wanted:.4f} m expected; "
            "move the markers, and their pivots in Motive, to the far ends of the links"
        )


def _misplaced(across: float, along: float, beside: Mapping[str, float]) -> Iterator[str]:
    for name, off in beside.items():
        if abs(off) > BESIDE_REFUSED_M:
            remedy = "move its pivot to the arm's axis in Motive"
            yield f"{name} is {1e3 * off:+.0f} mm away from the line of the others; {remedy}"
    for off, where in ((across, "sideways"), (along, "vertically")):
        if abs(off) > CART_OFF_MAX_M:
            place = f"{1e3 * off:+.0f} mm {where} from the first hinge"
            yield f"the cart's markers are {place}; check that they are the cart's"


def _mark(mark: Marked, hang: Hanging, plane: Plane, rest: Pose) -> Marked:
    """Return the orientation of a body that hangs straight: the one at rest, rotated back by its angle at rest."""
    back = plane.turn(-rest.angle_rad)
    return Marked(rigid_body=mark.rigid_body, hanging=product(back, hang.orientation))


def _notes(
    line: Line, floor_m: float, beside: Mapping[str, float], heights: Mapping[str, float], middle_here: bool
) -> Iterator[str]:
    travel = line.travel_m
    if not middle_here and abs(travel - TRAVEL_M) > TRAVEL_NOTED_M:
        rail = f"the rail has {TRAVEL_M:.2f}"
        yield f"the cart moved {travel:.3f} m, {rail} m: the middle is right only if both ends were the stops"
    if abs(floor_m) > FLOOR_NOTED_M:
        side = "above" if floor_m > 0 else "below"
        given = f"if the first hinge is {HINGE_Z_M} m high and the markers are at the far ends of the links"
        yield f"the cameras' ground plane is {abs(floor_m):.3f} m {side} the floor, {given}"
    for above, below, apart, wanted in _wrong_spacing(heights, SPACING_NOTED_M):
        yield f"{above}-{below} are {apart:.4f} m apart, {wanted:.4f} m expected"
    for name, off in beside.items():
        if abs(off) > BESIDE_NOTED_M:
            cause = "check its pivot, and the shape of the arm at rest"
            yield f"{name} is {1e3 * off:+.0f} mm away from its nominal place: {cause}"


def _vector(array: Array) -> Vector:
    return (float(array[0]), float(array[1]), float(array[2]))
